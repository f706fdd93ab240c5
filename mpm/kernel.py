"""The time loop: frames of MLS-MPM steps, for many scenes on a thread each or for one large scene on all threads.

    particles to grid    m_i, (m v)_i, f_i                   `mpm.physics.transfer`
    grid                 v_i* = v_i + dt (g + f_i / m_i)     `mpm.physics.grid`, then walls, solids, barriers
    grid to particles    v_p, C_p, x_p, sigma_p              `mpm.physics.particles`, `mpm.physics.stress`

Many scenes: each scene runs on one thread throughout a call, without atomics or waiting; the result is the same to the
bit on any number of threads. One large scene: each worker has its own part of the particles and its own grid; where
grids overlap, they are summed. The order of the sums depends on the number of workers (two or four for up to four
threads), not on the number of threads: the result is the same to the bit on one, two and four. Usually each worker has
a thread. Threads wait for each other three times a step, and more often with water, so that two threads are slower than
one next to another busy process. `mpm.simulation.Crew` then gives one thread the parts of several workers.
"""

from collections.abc import Callable
from enum import Enum, auto
from functools import cache

import numpy as np
import taichi as ti

from mpm.arrays.access import columns_deep, synchronise, workers_of
from mpm.arrays.batch import Batch
from mpm.arrays.features import NODE, Features
from mpm.arrays.kernel_arguments import DEVICE, RECORD, STEP, kernel_of
from mpm.arrays.layout import Energy, Offset, Setting, StepControl, Worker
from mpm.output.recorder import (
    add_energies,
    record_block,
    record_frame,
    record_scene,
    squared_speed,
    steps_at_speed,
    steps_of_frame,
)
from mpm.physics.columns import MARGIN, OUTDATED, has_room, make_columns
from mpm.physics.grid import clear, relaxation_factor, update_grid, update_node
from mpm.physics.particles import update_block, update_particles
from mpm.physics.transfer import number_to_grid, particles_to_grid, prepare_contributions
from mpm.physics.water import update_water

ITERATIONS = 512
"""The fewest iterations of a loop that Taichi gives to a thread: with fewer, one thread would get the work of several,
run it in turn, and in a shared scene wait for itself. All of a thread's work is in the first of its iterations."""

SUMMED = 32  # particles that one GPU thread sums, or takes the maximum of, before all threads are combined


class Phase(Enum):
    """What a call of the kernel computes."""

    FRAMES = auto()  # each scene's frames from `Offset.NEXT` to before `last`, on the threads of a CPU
    SPEED = auto()  # the number of steps that each scene needs for its next frame
    STEP = auto()  # one step of every scene whose dt is not zero; `last` is the largest number of nodes of a scene
    RECORD = auto()  # record frame `first` of every scene that still moves


@ti.func
def step(thread, scene, dt, kappa, moved, arrays: ti.template()):
    """Advance a thread's part of a scene by a step; if a grid has no room for it, nothing changes.

    moved: the most cells that its particles have moved since its columns were made. Returns the same after the step, or
    a negative number if there was no room.
    """
    first, end = workers_of(thread, arrays)
    for worker in range(first, end):
        if moved > MARGIN:
            make_columns(worker, scene, arrays)
        if arrays.workers[worker, Worker.USED] <= arrays.workers[worker, Worker.ROOM]:
            clear(worker, arrays)
            particles_to_grid(worker, scene, arrays)
    if moved > MARGIN:
        moved = 0.0 * moved
    synchronise(thread, arrays)
    if has_room(first, arrays):
        for worker in range(first, end):
            update_grid(worker, scene, dt, kappa, arrays)
        synchronise(thread, arrays)
        farthest = 0.0 * moved
        for worker in range(first, end):
            farthest = ti.max(farthest, update_particles(worker, scene, dt, kappa, arrays))
        moved += farthest
        if ti.static(arrays.features.wet):
            update_water(thread, scene, dt, arrays)
    else:
        moved = 0.0 * moved - 1.0
    return moved


@ti.func
def advance_thread(thread, last, arrays: ti.template()):
    """Compute the frames before `last` of a thread's part of its scene; record them if it is the scene's first.

    It stops before a step for which a grid of the scene has no room; the next call continues from there.
    """
    scene = arrays.workers[thread, Worker.SCENE]
    moved = 0.0 * arrays.settings[scene, Setting.CELL] + OUTDATED
    for frame in range(arrays.offsets[scene, Offset.NEXT], ti.min(last, arrays.offsets[scene, Offset.FRAMES])):
        if arrays.offsets[scene, Offset.REST] > 0:
            break
        done, substeps = arrays.offsets[scene, Offset.DONE], arrays.offsets[scene, Offset.FRAME_STEPS]
        if done == 0:
            substeps = steps_of_frame(scene, arrays)
        synchronise(thread, arrays)
        if substeps == 0:
            arrays.offsets[scene, Offset.FRAMES] = frame
            break
        dt = arrays.settings[scene, Setting.FRAME_DT] / substeps
        kappa = relaxation_factor(scene, dt, arrays)
        while done < substeps:
            moved = step(thread, scene, dt, kappa, moved, arrays)
            if moved < 0.0:
                break
            done += 1
        synchronise(thread, arrays)
        if thread == 0 or not ti.static(arrays.features.processor.shared):
            arrays.offsets[scene, Offset.NEXT], arrays.offsets[scene, Offset.DONE] = frame, done
            arrays.offsets[scene, Offset.FRAME_STEPS] = substeps
            if done == substeps:
                arrays.offsets[scene, Offset.NEXT], arrays.offsets[scene, Offset.DONE] = frame + 1, 0
                arrays.offsets[scene, Offset.STEPS] = arrays.offsets[scene, Offset.STEPS] + substeps
                record_frame(scene, frame, arrays)
        synchronise(thread, arrays)
        if done < substeps:
            break


@ti.func
def ends_sum(block, arrays: ti.template()):
    """Whether a block is the last of its scene, or of the SUMMED blocks of a GPU thread."""
    last = arrays.owner.shape[0] - 1
    changes = block == last or arrays.owner[ti.min(block + 1, last)] != arrays.owner[block]
    return changes or (block + 1) % SUMMED == 0


@ti.func
def advance(arrays: ti.template(), first, last, phase: ti.template()):
    """What a call of the kernel does; see `Phase`."""
    if ti.static(phase == Phase.FRAMES):
        ti.loop_config(block_dim=ITERATIONS)
        for iteration in range(arrays.arrivals.shape[0] * ITERATIONS):
            if iteration % ITERATIONS == 0:
                advance_thread(iteration // ITERATIONS, last, arrays)
    if ti.static(phase == Phase.SPEED):
        for scene in range(arrays.offsets.shape[0]):
            arrays.step_control[scene, StepControl.SPEED] = 0.0
        for portion in range((arrays.owner.shape[0] + SUMMED - 1) // SUMMED):
            fastest = 0.0 * arrays.settings[0, 0]
            for block in range(portion * SUMMED, ti.min((portion + 1) * SUMMED, arrays.owner.shape[0])):
                fastest = ti.max(fastest, squared_speed(block, arrays))
                if ends_sum(block, arrays):
                    ti.atomic_max(arrays.step_control[arrays.owner[block], StepControl.SPEED], ti.sqrt(fastest))
                    fastest = 0.0 * fastest
        for scene in range(arrays.offsets.shape[0]):
            fastest = arrays.step_control[scene, StepControl.SPEED]
            arrays.step_control[scene, StepControl.STEPS] = steps_at_speed(scene, fastest, arrays)
    if ti.static(phase == Phase.STEP):
        for n in range(arrays.grid.shape[0]):
            arrays.grid[n] = 0.0 * arrays.grid[n]
        for block in range(arrays.owner.shape[0]):
            scene = arrays.owner[block]
            if arrays.step_control[scene, StepControl.DT] > 0.0:
                prepare_contributions(scene, block, block * arrays.features.scratch.size, arrays)
        for number in range(arrays.owner.shape[0] * NODE):
            block, k = number // NODE, number % NODE
            scene = arrays.owner[block]
            if k < arrays.features.node.size and arrays.step_control[scene, StepControl.DT] > 0.0:
                number_to_grid(arrays.workers[scene, Worker.COLUMN], block, k, columns_deep(scene, arrays), arrays)
        for q in range(last * arrays.offsets.shape[0]):
            update_node(q % last, q // last, arrays)
        for block in range(arrays.owner.shape[0]):
            scene = arrays.owner[block]
            dt = arrays.step_control[scene, StepControl.DT]
            if dt > 0.0:
                table, kappa = arrays.workers[scene, Worker.COLUMN], relaxation_factor(scene, dt, arrays)
                update_block(scene, table, scene, block, block * arrays.features.scratch.size, dt, kappa, arrays)
    if ti.static(phase == Phase.RECORD):
        for portion in range((arrays.owner.shape[0] + SUMMED - 1) // SUMMED):
            sums = ti.Vector.zero(ti.f64, ti.static(len(Energy)))
            for block in range(portion * SUMMED, ti.min((portion + 1) * SUMMED, arrays.owner.shape[0])):
                scene = arrays.owner[block]
                if arrays.step_control[scene, StepControl.STEPS] > 0.0:
                    sums += record_block(scene, first, block, arrays)
                    if ends_sum(block, arrays):
                        add_energies(scene, first, sums, arrays)
                        # Not zero times the sums: in a scene that blew up these are NaN.
                        sums = ti.Vector.zero(ti.f64, ti.static(len(Energy)))
        for scene in range(arrays.offsets.shape[0]):
            if arrays.step_control[scene, StepControl.STEPS] > 0.0:
                record_scene(scene, first, arrays)


@cache
def kernel(features: Features) -> Callable[..., None]:
    """The kernel for scenes with `features`; nothing else is compiled into it.

    It takes the arrays of `mpm.arrays.batch.Batch.arguments`, then `first`, `last` and the phase. Phase.FRAMES: compute
    and record the frames before `last`, while grids have room. The other phases are parts of a frame on a GPU, with one
    thread per particle: see `mpm.device`."""
    # With water, optimisation by Taichi takes ten more seconds in 3D and makes a step one per cent faster.
    return kernel_of(STEP | RECORD | DEVICE, advance, features, optimised=not features.wet)


def compute(batch: Batch, last: int, threads: int | None = None) -> None:
    """Compute the remaining frames of a batch before `last`, on the threads of a CPU.

    threads: for a shared scene, one per worker unless given; the result is the same to the bit. If a grid has no room
    for the next step, the kernel returns before it and continues with a larger grid."""
    first, run = batch.computed + 1, kernel(batch.features)
    batch.offsets[:, Offset.NEXT], batch.offsets[:, Offset.DONE] = first, 0
    grown = True
    while grown:
        batch.arrivals = np.zeros(threads or len(batch.workers), np.int32)
        run(*batch.arguments.values(), first, last, Phase.FRAMES)
        grown = batch.grow_grid()
    batch.computed = last - 1
