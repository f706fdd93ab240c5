"""The grid between the transfers: cleared, then momentum becomes velocity under gravity, damping and the walls.

    v_i* = v_i + dt (a_i - alpha |a_i| s(v_i)),   a_i = g + f_i / m_i,   s(v) = v / sqrt(v^2 + v_s^2)

The last term is local damping (Cundall 1987) as CB-Geo MPM applies it at a node: |a| is the length of the whole
acceleration, the sign is each component's (Cundall's own form takes each component's force too). The sign is made
continuous over v_s = SLOW sqrt(g dx), so that the flow depends continuously on its parameters. The damping opposes
sliding like a friction of the base and turns with the stress, not with the speed: a block that slides on an incline at
damping 0.12 behaves as if the coefficient of friction were larger by 0.2. It is off by default.

Only the bounding box of the material is cleared and updated.
"""

import taichi as ti

from mpm.arrays.access import box_cells, node_strides, zero_node
from mpm.arrays.layout import PADDING, Offset, Setting, StepControl, Worker
from mpm.physics.barriers import apply_barriers
from mpm.physics.boundary import add_wall_impulse, apply_walls
from mpm.physics.channel import after_side_walls
from mpm.physics.contact import apply_solids

TINY = 1.0e-30
"""Keeps a quotient finite where nothing moves and nothing weighs."""
SLOW = 1.0e-3
"""Speed over sqrt(g dx) below which local damping fades [-]."""


@ti.func
def clear(worker, strides, arrays: ti.template()):
    """Set the nodes around the material of `worker` to zero."""
    zero = zero_node()
    for i in range(arrays.workers[worker, Worker.LOW_X], arrays.workers[worker, Worker.HIGH_X]):
        for j in range(arrays.workers[worker, Worker.LOW_Y], arrays.workers[worker, Worker.HIGH_Y]):
            first = arrays.workers[worker, Worker.NODE] + i * strides[0] + j * strides[1]
            for k in range(arrays.workers[worker, Worker.LOW_Z], arrays.workers[worker, Worker.HIGH_Z]):
                arrays.grid[first + k] = zero


@ti.func
def update_grid(worker, scene, dt, kappa, strides, arrays: ti.template()):
    """Momentum to velocity at the nodes of a worker; in a shared scene at its rows of all, summed over the grids."""
    features = arrays.features
    low, high = own_box(worker, arrays)
    for i in range(low[0], high[0]):
        if shares_row(i, worker, arrays):
            for j in range(low[1], high[1]):
                for k in range(low[2], high[2]):
                    n = i * strides[0] + j * strides[1] + k
                    node = node_of(arrays.grid, n, [i, j, k], worker, arrays)
                    if node[features.dimension] > 0.0:
                        node = moved_node(node, n, [i, j, k], worker, scene, dt, kappa, arrays)
                        put_node(arrays.grid, node, n, [i, j, k], worker, arrays)


@ti.func
def own_box(worker, arrays: ti.template()):
    """The nodes in the support of a worker's particles, of those of all workers of a shared scene; [low, high), [3]."""
    first = worker
    if ti.static(arrays.features.processor.shared):
        first = 0
    low = ti.Vector([arrays.workers[first, Worker.LOW_X + k] for k in ti.static(range(3))])
    high = ti.Vector([arrays.workers[first, Worker.HIGH_X + k] for k in ti.static(range(3))])
    if ti.static(arrays.features.processor.shared):
        for other in range(1, arrays.workers.shape[0]):
            for k in ti.static(range(3)):
                low[k] = ti.min(low[k], arrays.workers[other, Worker.LOW_X + k])
                high[k] = ti.max(high[k], arrays.workers[other, Worker.HIGH_X + k])
    return low, high


@ti.func
def shares_row(i, worker, arrays: ti.template()):
    """Whether the nodes of row i are a worker's to compute, who is one of several in a shared scene."""
    result = 1
    if ti.static(arrays.features.processor.shared):
        result = ti.cast(i % arrays.workers.shape[0] == worker, ti.i32)
    return result


@ti.func
def node_of(array: ti.template(), n, index: ti.template(), worker, arrays: ti.template()):
    """Node `index`, the n-th of a worker; of a shared scene the sum over the workers in whose support it is."""
    if ti.static(arrays.features.processor.shared):
        node = zero_node()
        for other in range(arrays.workers.shape[0]):
            if covers(other, index, arrays):
                node += array[arrays.workers[other, Worker.NODE] + n]
        return node
    else:
        return array[arrays.workers[worker, Worker.NODE] + n]


@ti.func
def put_node(array: ti.template(), value, n, index: ti.template(), worker, arrays: ti.template()):
    """Put what `node_of` reads; in a shared scene all workers in whose support it is have the sum."""
    if ti.static(arrays.features.processor.shared):
        for other in range(arrays.workers.shape[0]):
            if covers(other, index, arrays):
                array[arrays.workers[other, Worker.NODE] + n] = value
    else:
        array[arrays.workers[worker, Worker.NODE] + n] = value


@ti.func
def update_node(n, scene, arrays: ti.template()):
    """Momentum to velocity on the n-th node of a scene, where every node has a thread."""
    strides = node_strides(scene, arrays)
    i, j, k = n // strides[0], 0, 0
    if ti.static(arrays.features.dimension == 2):
        j = n - i * strides[0]
    else:
        j = (n - i * strides[0]) // strides[1]
        k = n - i * strides[0] - j * strides[1]
    dt = arrays.step_control[scene, StepControl.DT]
    if i < arrays.offsets[scene, Offset.CELLS_X] + 2 * PADDING + 1 and dt > 0.0:
        at = arrays.workers[scene, Worker.NODE] + n
        node = arrays.grid[at]
        if node[arrays.features.dimension] > 0.0:
            kappa = relaxation_factor(scene, dt, arrays)
            arrays.grid[at] = moved_node(node, n, [i, j, k], scene, scene, dt, kappa, arrays)


@ti.func
def covers(worker, index: ti.template(), arrays: ti.template()):
    """Whether node `index` is in the support of a worker's particles."""
    return (
        arrays.workers[worker, Worker.LOW_X] <= index[0] < arrays.workers[worker, Worker.HIGH_X]
        and arrays.workers[worker, Worker.LOW_Y] <= index[1] < arrays.workers[worker, Worker.HIGH_Y]
        and arrays.workers[worker, Worker.LOW_Z] <= index[2] < arrays.workers[worker, Worker.HIGH_Z]
    )


@ti.func
def velocity_before(node, arrays: ti.template()):
    """v_i [m/s] of a node (momentum, mass, force) before its forces act, shape [D]."""
    features = arrays.features
    per_mass = 1.0 / node[features.dimension]
    return ti.Vector([node[axis] * per_mass for axis in ti.static(range(features.dimension))])


@ti.func
def moved_node(node, n, index: ti.template(), worker, scene, dt, kappa, arrays: ti.template()):
    """Node `index`, the n-th of its scene, with its new velocity for its momentum, and its change new - kept old."""
    features = arrays.features
    old = velocity_before(node, arrays)
    new = velocity_after(node, old, n, index, worker, scene, dt, arrays)
    for axis in ti.static(range(features.dimension)):
        node[axis] = new[axis]
        node[features.node.change + axis] = new[axis] - kappa * old[axis]
    return node


@ti.func
def relaxation_factor(scene, dt, arrays: ti.template()):
    """The part of the velocity beyond the grid's that a particle keeps over a step, exp(-dt / tau) [-]."""
    return ti.exp(0.0 - dt * arrays.settings[scene, Setting.RELAXATION_RATE])


@ti.func
def acceleration(node, scene, arrays: ti.template()):
    """g + f_i / m_i of a node (momentum, mass, force), and f_i / m_i alone [m/s^2], shape [D] each."""
    features = arrays.features
    per_mass = 1.0 / node[features.dimension]
    gravity = [arrays.settings[scene, Setting.GRAVITY_X], arrays.settings[scene, Setting.GRAVITY_Y], 0.0 * per_mass]
    force = ti.Vector([node[features.node.force + axis] * per_mass for axis in ti.static(range(features.dimension))])
    return ti.Vector([gravity[axis] for axis in ti.static(range(features.dimension))]) + force, force


@ti.func
def damping_terms(v, a, scene, arrays: ti.template()):
    """|a| [m/s^2], s(v) [-], shape [D], and v_s^2 [m^2/s^2] of local damping."""
    slow = SLOW * SLOW * ti.abs(arrays.settings[scene, Setting.GRAVITY_Y]) * arrays.settings[scene, Setting.CELL] + TINY
    sign = [v[axis] / ti.sqrt(v[axis] * v[axis] + slow) for axis in ti.static(range(arrays.features.dimension))]
    return a.norm(), ti.Vector(sign), slow


@ti.func
def velocity_after(node, v, n, index: ti.template(), worker, scene, dt, arrays: ti.template()):
    """The new velocity [m/s] of the n-th node (momentum, mass, force), shape [D], from its old one."""
    features = arrays.features
    mass = node[features.dimension]
    a, _ = acceleration(node, scene, arrays)
    if ti.static(features.damped):
        size, sign, _ = damping_terms(v, a, scene, arrays)
        a = a - arrays.settings[scene, Setting.DAMPING] * size * sign
    v_star = ti.Vector([v[axis] + dt * a[axis] for axis in ti.static(range(features.dimension))])
    indices = ti.Vector([index[axis] for axis in ti.static(range(features.dimension))])
    v_star = apply_walls(v_star, indices, box_cells(scene, arrays), mass, worker, scene, arrays)
    if ti.static(features.contact):
        v_star = apply_solids(v_star, mass, indices, worker, scene, True, arrays)
    if ti.static(features.channel):
        v_star = after_side_walls(v_star, node, dt, features)
    if ti.static(features.barriers):
        v_behind = apply_barriers(v_star, indices, scene, dt, arrays)
        if ti.static(features.recorded.walls):
            add_wall_impulse(2 * features.dimension, mass * (v_star - v_behind), worker, scene, arrays)
        v_star = v_behind
    return v_star
