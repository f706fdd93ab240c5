"""The steps of a segment once more, with every state kept; and those steps backwards, from their last to their first.

    replay     states s_0, ..., s_n of a segment, by the functions of `mpm.kernel` in their order: the same to the bit
    reverse    s_k' = (ds_{k+1} / ds_k)^T s_{k+1}',  k = n - 1, ..., 0

A reverse step computes the grid of its step anew from s_k, because that is cheaper than to keep it: particles to grid,
velocities of the nodes, then bars of particles to bars of nodes, of nodes before their forces, and of particles
(`mpm.adjoint.particles`). Scenes and threads are those of `mpm.kernel`.
"""

from collections.abc import Callable
from enum import Enum, auto
from functools import cache

import taichi as ti

from mpm.adjoint.faces import found_reverse
from mpm.adjoint.grid import keep_nodes, update_grid_reverse
from mpm.adjoint.layout import Layout
from mpm.adjoint.particles import block_to_grid_reverse, update_block_reverse
from mpm.arrays.access import maximum, minimum, node_strides
from mpm.arrays.layout import Setting, Worker
from mpm.arrays.table import ADJOINT, STEP, kernel_of
from mpm.kernel import ITERATIONS, synchronise
from mpm.kernel import step as advance
from mpm.output.recorder import steps_of_frame
from mpm.physics.grid import clear, relaxation_factor, update_grid
from mpm.physics.particles import set_box
from mpm.physics.transfer import particles_to_grid


class Pass(Enum):
    """What a call of the kernel does with the frames of a segment."""

    REPLAY = auto()
    """Compute the frames [first, last) and keep the state before every step and at the end."""
    REVERSE = auto()
    """Take the bars at the end of what was replayed back to its beginning."""
    START = auto()
    """Take the bars of the contact at the beginning to those of what it follows from."""


@ti.func
def keep_state(worker, step, arrays: ti.template()):
    """Keep the states of a worker's blocks as those before `step`."""
    for block in range(arrays.workers[worker, Worker.FIRST], arrays.workers[worker, Worker.LAST]):
        at, own = state_before(step, block, arrays), block * arrays.features.state.size
        for k in range(arrays.layout.history):
            arrays.history[at + k] = arrays.state[own + k]


@ti.func
def state_before(step, block, arrays: ti.template()):
    """The first vector in the history of a block before `step`."""
    blocks = arrays.state.shape[0] // ti.static(arrays.features.state.size)
    return (step * blocks + block) * ti.static(arrays.layout.history)


@ti.func
def restore_state(worker, scene, step, arrays: ti.template()):
    """The states of a worker's blocks before `step`, and the box of nodes in their support."""
    features = arrays.features
    first = arrays.workers[worker, Worker.FIRST]
    low = [arrays.state[first * features.state.size + k] * 0.0 + 1.0e30 for k in ti.static(range(features.dimension))]
    high = [0.0 - low[k] for k in ti.static(range(features.dimension))]
    for block in range(first, arrays.workers[worker, Worker.LAST]):
        at, own = state_before(step, block, arrays), block * features.state.size
        for k in range(arrays.layout.history):
            arrays.state[own + k] = arrays.history[at + k]
        for k in ti.static(range(features.dimension)):
            low[k], high[k] = minimum(low[k], arrays.state[own + k]), maximum(high[k], arrays.state[own + k])
    set_box(worker, scene, low, high, arrays)


@ti.func
def replay(worker, first, last, arrays: ti.template()):
    """Compute the frames [first, last) of a worker as `mpm.kernel.advance_worker` does, and keep every state."""
    scene = arrays.workers[worker, Worker.SCENE]
    strides = node_strides(scene, arrays)
    step = 0
    for _frame in range(first, last):
        substeps = steps_of_frame(scene, arrays)
        synchronise(arrays)
        dt = arrays.settings[scene, Setting.FRAME_DT] / substeps
        kappa = relaxation_factor(scene, dt, arrays)
        for _step in range(substeps):
            keep_state(worker, step, arrays)
            arrays.step_times[scene, step] = dt
            advance(worker, scene, dt, kappa, strides, arrays)
            step += 1
        synchronise(arrays)
    keep_state(worker, step, arrays)
    arrays.step_counts[scene] = step


@ti.func
def reverse(worker, arrays: ti.template()):
    """Bars of a worker's scene at the beginning of its replayed steps from those at their end."""
    scene = arrays.workers[worker, Worker.SCENE]
    strides = node_strides(scene, arrays)
    grid, scratch = arrays.workers[worker, Worker.NODE], arrays.workers[worker, Worker.SCRATCH]
    count = arrays.step_counts[scene]
    for number in range(count):
        step = count - 1 - number
        dt = arrays.step_times[scene, step]
        kappa = relaxation_factor(scene, dt, arrays)
        restore_state(worker, scene, step, arrays)
        clear(worker, strides, arrays)
        particles_to_grid(worker, scene, strides, arrays)
        synchronise(arrays)
        keep_nodes(worker, strides, arrays)
        update_grid(worker, scene, dt, kappa, strides, arrays)
        synchronise(arrays)
        for block in range(arrays.workers[worker, Worker.FIRST], arrays.workers[worker, Worker.LAST]):
            after = state_before(step + 1, block, arrays)
            update_block_reverse(worker, grid, scene, block, scratch, after, dt, kappa, strides, arrays)
        synchronise(arrays)
        update_grid_reverse(worker, scene, dt, kappa, strides, arrays)
        synchronise(arrays)
        for block in range(arrays.workers[worker, Worker.FIRST], arrays.workers[worker, Worker.LAST]):
            block_to_grid_reverse(worker, grid, scene, block, scratch, dt, strides, arrays)


@ti.func
def reverse_start(worker, arrays: ti.template()):
    """From the bars of the contact that a run begins with to those of positions and faces."""
    if ti.static(arrays.features.contact):
        scene, scratch = arrays.workers[worker, Worker.SCENE], arrays.workers[worker, Worker.SCRATCH]
        for block in range(arrays.workers[worker, Worker.FIRST], arrays.workers[worker, Worker.LAST]):
            found_reverse(worker, block, scratch, state_before(0, block, arrays), False, scene, arrays)


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
    return kernel_of(STEP | ADJOINT, walk, layout.features, layout=layout)
