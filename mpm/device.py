"""Scenes on a GPU: every point and every node a thread, all scenes of a batch in one launch per step.

The kernel is the CPU's, with blocks of one point and atomic sums; the arrays stay on the device from the first frame to
the last, and per step only the launch itself crosses over.
"""

from collections.abc import Callable

import numpy as np
import taichi as ti
from tqdm import tqdm

from mpm.advance import Phase
from mpm.batch import Array, Batch
from mpm.layout import Needs, Pace, Place, Setting

TWICE = {"lanes": "state", "scratch_lanes": "scratch", "impulse_lanes": "impulse"}
"""With one lane a vector of lanes is a number: the second view of such memory is the first."""
COME_BACK = ("record", "fields", "energy", "taken", "places", "clamped")


def run_on_device(batch: Batch, kernel: Callable[..., None], bar: "tqdm[None]") -> None:
    """Compute all frames of all scenes of a batch and bring back what was recorded."""
    arguments = batch.arguments
    device = upload(arguments, batch.needs)

    def launch(phase: Phase, first: int = 0, last: int = 0) -> None:
        kernel(*device.values(), first, last, phase)

    largest = int(np.diff([*batch.first_nodes, len(batch.grid)]).max())
    ended = np.zeros(len(batch.scenes), bool)
    for frame in range(1, max(scene.frames for scene in batch.scenes)):
        launch(Phase.SPEED)
        pace = device["pace"].to_numpy()
        if batch.needs.rests:
            batch.places[:] = device["places"].to_numpy()
        blown = (pace[:, Pace.STEPS] == 0) & ~ended
        batch.places[blown, Place.FRAMES] = frame
        ended |= blown | (frame >= batch.places[:, Place.FRAMES]) | (batch.places[:, Place.REST] > 0)
        steps = np.where(ended, 0, pace[:, Pace.STEPS]).astype(int)
        if not steps.any():
            break
        dt = batch.settings[:, Setting.FRAME_DT] / np.maximum(steps, 1)
        pace[:, Pace.STEPS] = steps
        for step in range(int(steps.max())):
            if step == 0 or (steps == step).any():
                pace[:, Pace.DT] = np.where(step < steps, dt, 0.0)
                device["pace"].from_numpy(pace)
            launch(Phase.STEP, last=largest)
        batch.places[:, Place.STEPS] += steps
        device["places"].from_numpy(batch.places)
        launch(Phase.NOTE, first=frame)
        bar.update()
    for name in COME_BACK:
        arguments[name][...] = device[name].to_numpy().reshape(arguments[name].shape)


def upload(arguments: dict[str, Array], needs: Needs) -> dict[str, ti.Ndarray]:
    """The arrays of a batch on the device, by name and in the same order."""
    device: dict[str, ti.Ndarray] = {}
    for name, array in arguments.items():
        if name in TWICE:
            device[name] = device[TWICE[name]]
            continue
        kind = {"f": ti.f32, "d": ti.f64, "i": ti.i32}[array.dtype.char]
        if name == "grid":
            device[name] = ti.Vector.ndarray(needs.node, kind, array.shape[0])
        else:
            flat = array.reshape(-1) if name in TWICE.values() else array
            device[name] = ti.ndarray(kind, flat.shape)
            array = flat
        device[name].from_numpy(np.ascontiguousarray(array))
    return device
