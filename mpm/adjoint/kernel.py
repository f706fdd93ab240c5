"""Replay of the steps of a segment, keeping every state; and reversal of these steps, from the last to the first.

    replay     states s_0, ..., s_n of a segment, by the functions of `mpm.kernel` in their order: the same to the bit
    reverse    s_k' = (ds_{k+1} / ds_k)^T s_{k+1}',  k = n - 1, ..., 0

A reverse step recomputes the grid of its step from s_k, which is cheaper than storing it: particles to grid, velocities
of the nodes, then adjoints of particles to adjoints of nodes, of nodes before their forces, and of particles
(`mpm.adjoint.particles`). Scenes and threads are those of `mpm.kernel`.
"""

from collections.abc import Callable
from enum import Enum, auto
from functools import cache

import taichi as ti

from mpm.adjoint.faces import found_reverse
from mpm.adjoint.grid import keep_nodes, update_grid_reverse
from mpm.adjoint.layout import Layout, state_before
from mpm.adjoint.particles import block_of, block_to_grid_reverse, update_block_reverse
from mpm.arrays.access import synchronise
from mpm.arrays.kernel_arguments import ADJOINT, STEP, kernel_of
from mpm.arrays.layout import Setting, Worker
from mpm.kernel import ITERATIONS
from mpm.kernel import step as advance
from mpm.output.recorder import steps_of_frame
from mpm.physics.columns import OUTDATED, has_room, make_columns
from mpm.physics.grid import clear, relaxation_factor, update_grid
from mpm.physics.transfer import particles_to_grid


class Pass(Enum):
    """What a call of the kernel does with the frames of a segment."""

    REPLAY = auto()  # compute the frames [first, last) and keep the state before every step and at the end
    REVERSE = auto()  # take the adjoints at the end of the replayed steps back to their beginning
    START = auto()  # take the adjoints of the initial contact to those of its inputs


@ti.func
def copy_state(worker, step, keep: ti.template(), arrays: ti.template()):
    """Store the states of a worker's blocks as those before `step`, or restore these."""
    for block in range(arrays.workers[worker, Worker.FIRST], arrays.workers[worker, Worker.LAST]):
        at, state_at = state_before(step, block, arrays), block * arrays.features.state.size
        for k in range(arrays.layout.history):
            if ti.static(keep):
                arrays.history[at + k] = arrays.state[state_at + k]
            else:
                arrays.state[state_at + k] = arrays.history[at + k]


@ti.func
def replay(worker, first, last, arrays: ti.template()):
    """Compute the frames [first, last) like `mpm.kernel.advance_thread`, keeping every state, while grids have room."""
    scene = arrays.workers[worker, Worker.SCENE]
    step, moved = 0, 0.0 * arrays.settings[scene, Setting.CELL] + OUTDATED
    for _frame in range(first, last):
        substeps = steps_of_frame(scene, arrays)
        synchronise(worker, arrays)
        dt = arrays.settings[scene, Setting.FRAME_DT] / substeps
        kappa = relaxation_factor(scene, dt, arrays)
        for _step in range(substeps):
            copy_state(worker, step, True, arrays)
            arrays.step_times[scene, step] = dt
            moved = advance(worker, scene, dt, kappa, moved, arrays)
            if moved < 0.0:
                break
            step += 1
        synchronise(worker, arrays)
        if moved < 0.0:
            break
    copy_state(worker, step, True, arrays)
    arrays.step_counts[scene] = step


@ti.func
def reverse(worker, arrays: ti.template()):
    """Adjoints of a worker's scene at the beginning of its replayed steps from those at their end.

    If a grid has no room for a step, `step_counts` says how many remain to be reversed.
    """
    scene = arrays.workers[worker, Worker.SCENE]
    remaining = arrays.step_counts[scene]
    while remaining > 0:
        make_grid(worker, scene, remaining - 1, arrays)
        synchronise(worker, arrays)
        if not has_room(worker, arrays):
            break
        remaining -= 1
        reverse_step(worker, scene, remaining, arrays)
    synchronise(worker, arrays)
    arrays.step_counts[scene] = remaining


@ti.func
def make_grid(worker, scene, step, arrays: ti.template()):
    """Restore the states of a worker before `step`, and their sums at its nodes, if there is room."""
    copy_state(worker, step, False, arrays)
    make_columns(worker, scene, arrays)
    if arrays.workers[worker, Worker.USED] <= arrays.workers[worker, Worker.ROOM]:
        clear(worker, arrays)
        particles_to_grid(worker, scene, arrays)


@ti.func
def reverse_step(worker, scene, step, arrays: ti.template()):
    """Adjoints of a worker before `step` from those after it; its grid must be made."""
    dt = arrays.step_times[scene, step]
    kappa = relaxation_factor(scene, dt, arrays)
    keep_nodes(worker, arrays)
    update_grid(worker, scene, dt, kappa, arrays)
    synchronise(worker, arrays)
    for number in range(arrays.workers[worker, Worker.FIRST], arrays.workers[worker, Worker.LAST]):
        block = block_of(worker, scene, number, step, dt, kappa, arrays)
        update_block_reverse(block, arrays)
    synchronise(worker, arrays)
    update_grid_reverse(worker, scene, dt, kappa, arrays)
    synchronise(worker, arrays)
    for number in range(arrays.workers[worker, Worker.FIRST], arrays.workers[worker, Worker.LAST]):
        block = block_of(worker, scene, number, step, dt, kappa, arrays)
        block_to_grid_reverse(block, arrays)


@ti.func
def reverse_start(worker, arrays: ti.template()):
    """From the adjoints of the initial contact of a run to those of positions and faces."""
    if ti.static(arrays.features.contact):
        scene = arrays.workers[worker, Worker.SCENE]
        for number in range(arrays.workers[worker, Worker.FIRST], arrays.workers[worker, Worker.LAST]):
            # The state after no step is that before the first.
            block = block_of(worker, scene, number, -1, 0.0, 0.0, arrays)
            found_reverse(block, False, arrays)


@ti.func
def walk(arrays: ti.template(), first, last, direction: ti.template()):
    """What a call of the kernel does; see `Pass`."""
    ti.loop_config(block_dim=ITERATIONS)
    for iteration in range(arrays.workers.shape[0] * ITERATIONS):
        if iteration % ITERATIONS == 0:
            if ti.static(direction == Pass.REPLAY):
                replay(iteration // ITERATIONS, first, last, arrays)
            if ti.static(direction == Pass.REVERSE):
                reverse(iteration // ITERATIONS, arrays)
            if ti.static(direction == Pass.START):
                reverse_start(iteration // ITERATIONS, arrays)


@cache
def kernel(layout: Layout) -> Callable[..., None]:
    """The kernel: it takes the arrays `STEP` and `ADJOINT`, then `first`, `last` and the pass."""
    return kernel_of(STEP | ADJOINT, walk, layout.features, optimised=False, layout=layout)
