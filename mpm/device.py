"""Scenes on a GPU: one thread per particle and per node, all scenes of a batch in one launch per step.

The kernel is that of the CPU, with blocks of one particle and atomic sums. The arrays stay on the device from the first
frame to the last; per step, the host only launches the kernel.
"""

from collections.abc import Callable

import numpy as np
import taichi as ti
from tqdm import tqdm

from mpm.arrays.batch import Array, Batch
from mpm.arrays.features import NODE, Features
from mpm.arrays.kernel_arguments import VIEWS
from mpm.arrays.layout import Offset, Setting, StepControl, Worker
from mpm.initial.stages import begin_stages, call_end, next_stage
from mpm.kernel import Phase

RETURNED = ("state", "positions", "energy", "recorded_impulse", "offsets", "retained", "settling", "inflows")


def run_on_device(batch: Batch, kernel: Callable[..., None], bar: "tqdm[None]", stop: Callable[[], bool]) -> None:
    """Compute the frames of all scenes of a batch after `batch.computed`; bring back state and record."""
    arguments = batch.arguments
    device = upload(arguments, batch.features)

    def call_kernel(phase: Phase, first: int = 0, last: int = 0) -> None:
        kernel(*device.values(), first, last, phase)

    largest = int(batch.workers[:, Worker.ROOM].max())
    ended = np.zeros(len(batch.scenes), bool)
    for frame in range(batch.computed + 1, max(scene.frames for scene in batch.scenes)):
        if stop():
            break
        call_kernel(Phase.SPEED)
        step_control = device["step_control"].to_numpy()
        if batch.features.recorded.until_rest:
            batch.offsets[:] = device["offsets"].to_numpy()
        blown = (step_control[:, StepControl.STEPS] == 0) & ~ended
        batch.offsets[blown, Offset.FRAMES] = frame
        ended |= blown | (frame >= batch.offsets[:, Offset.FRAMES]) | (batch.offsets[:, Offset.REST] > 0)
        steps = np.where(ended, 0, step_control[:, StepControl.STEPS]).astype(int)
        if not steps.any():
            break
        dt = batch.settings[:, Setting.FRAME_DT] / np.maximum(steps, 1)
        step_control[:, StepControl.STEPS] = steps
        for step in range(int(steps.max())):
            if step == 0 or (steps == step).any():
                step_control[:, StepControl.DT] = np.where(step < steps, dt, 0.0)
                device["step_control"].from_numpy(step_control)
            call_kernel(Phase.STEP, last=largest)
        batch.offsets[:, Offset.STEPS] += steps
        call_end(batch, frame)
        device["offsets"].from_numpy(batch.offsets)
        call_kernel(Phase.RECORD, first=frame)
        batch.computed = frame
        if not batch.in_kernel and any(frame in batch.kept(index) for index in range(len(batch.scenes))):
            batch.state[...] = device["state"].to_numpy().reshape(batch.state.shape)
            batch.keep(frame)
        if any(next_stage(batch, index) for index in range(len(batch.scenes))):
            batch.state[...] = device["state"].to_numpy().reshape(batch.state.shape)
            batch.energy[...] = device["energy"].to_numpy().reshape(batch.energy.shape)
            begin_stages(batch)
            device["state"].from_numpy(batch.state.reshape(-1))
        bar.update()
    for name in RETURNED:
        arguments[name][...] = device[name].to_numpy().reshape(arguments[name].shape)


def upload(arguments: dict[str, Array], features: Features) -> dict[str, ti.Ndarray]:
    """The arrays of a batch on the device, by name and in the same order."""
    device: dict[str, ti.Ndarray] = {}
    for name, array in arguments.items():
        if name in VIEWS:
            # A block of one particle needs no rows.
            device[name] = device["grid" if name == "rows" else VIEWS[name]]
            continue
        kind = {"float32": ti.f32, "float64": ti.f64, "int32": ti.i32, "int64": ti.i64}[array.dtype.name]
        nodes = name in ("grid", "cells")
        device[name] = ti.Vector.ndarray(NODE, kind, len(array)) if nodes else ti.ndarray(kind, array.shape)
        device[name].from_numpy(np.ascontiguousarray(array))
    return device
