"""The grid between the transfers: it is cleared; momentum becomes velocity under gravity, damping and the walls.

    v_i* = v_i + dt (a_i - alpha |a_i| s(v_i)),   a_i = g + f_i / m_i,   s(v) = v / sqrt(v^2 + v_s^2)

The last term is local damping (Cundall 1987) as CB-Geo MPM applies it at a node: |a| is the magnitude of the whole
acceleration, while the sign is taken per component (Cundall's form takes the force per component, too). The sign is
made continuous over v_s = SLOW sqrt(g dx), so that the flow depends continuously on its parameters. The damping opposes
sliding like basal friction and depends on the stress, not on the speed: a block that slides on an incline at damping
0.12 behaves as if the coefficient of friction were larger by 0.2. It is off by default.

Only the nodes of columns near the material are cleared and updated (`mpm.physics.columns`).
"""

import taichi as ti

from mpm.arrays.access import TINY, box_cells, columns_deep
from mpm.arrays.layout import PADDING, BedUnder, Offset, Setting, Span, StepControl, Worker
from mpm.arrays.nodes import zero_node
from mpm.physics.barriers import apply_barriers
from mpm.physics.boundary import add_impulse, apply_walls, with_friction
from mpm.physics.columns import node_at
from mpm.physics.contact import apply_solids
from mpm.physics.inflow import held_behind
from mpm.solids.terrain import FAR_BELOW, bed_under

SLOW = 1.0e-3  # speed over sqrt(g dx) below which local damping fades [-]


@ti.func
def clear(worker, arrays: ti.template()):
    """Set the nodes of `worker`, and their cells, to zero."""
    zero, first = zero_node(), arrays.workers[worker, Worker.NODE]
    for n in range(first, first + arrays.workers[worker, Worker.USED]):
        arrays.grid[n] = zero
        if ti.static(arrays.features.wet):
            arrays.cells[2 * n], arrays.cells[2 * n + 1] = zero, zero


@ti.func
def update_grid(worker, scene, dt, kappa, arrays: ti.template()):
    """Momentum to velocity at the nodes of a worker; in a shared scene at those it owns, summed over the workers."""
    first, deep = arrays.workers[worker, Worker.COLUMN], columns_deep(scene, arrays)
    for n in range(arrays.workers[worker, Worker.ACTIVE]):
        column = arrays.spans[first + n, Span.ACTIVE] - first
        i, k = column // deep, column % deep
        alone, low = has_alone(column, worker, arrays), arrays.spans[first + column, Span.LOW]
        if ti.static(arrays.features.wet):
            arrays.spans[first + column, Span.ALONE] = 1 if alone else 0
        bed = bed_under(index_of([i, low, k], arrays), scene, arrays)
        held = bed[BedUnder.REFERENCE] > FAR_BELOW
        if ti.static(arrays.features.listed):
            held = held or arrays.spans[first + column, Span.HELD] == 1
        for j in range(low, arrays.spans[first + column, Span.HIGH]):
            if alone or owns(column, j, worker, arrays):
                node = zero_node()
                if alone:
                    node = arrays.grid[own_node(column, j, worker, arrays)]
                else:
                    node = node_of(arrays.grid, column, j, worker, arrays)
                if node[arrays.features.dimension] > 0.0:
                    node = moved_node(node, index_of([i, j, k], arrays), bed, held, worker, scene, dt, kappa, arrays)
                    if alone:
                        arrays.grid[own_node(column, j, worker, arrays)] = node
                    else:
                        put_node(arrays.grid, node, column, j, worker, arrays)


@ti.func
def index_of(places: ti.template(), arrays: ti.template()):
    """The index of a node, shape [D], from its i, j, k."""
    return ti.Vector([places[axis] for axis in ti.static(range(arrays.features.dimension))])


@ti.func
def has_alone(column, worker, arrays: ti.template()):
    """Whether no other worker has nodes of a column of the box."""
    alone = True
    if ti.static(arrays.features.processor.shared):
        for other in range(arrays.workers.shape[0]):
            if other != worker and reaches(other, column, arrays):
                empty = arrays.spans[arrays.workers[other, Worker.COLUMN] + column, Span.HIGH] == 0
                alone = alone and empty
    return alone


@ti.func
def reaches(worker, column, arrays: ti.template()):
    """Whether a column of the box lies between the first and the last in use by a worker: a strip of the box if
    particles are sorted, so that few columns have to be looked up.
    """
    return arrays.workers[worker, Worker.LOWEST] <= column <= arrays.workers[worker, Worker.HIGHEST]


@ti.func
def has_node(worker, column, j, arrays: ti.template()):
    """Whether node j of a column of the box is one of a worker's."""
    result = False
    if reaches(worker, column, arrays):
        at = arrays.workers[worker, Worker.COLUMN] + column
        result = arrays.spans[at, Span.LOW] <= j < arrays.spans[at, Span.HIGH]
    return result


@ti.func
def owns(column, j, worker, arrays: ti.template()):
    """Whether a worker computes a node: in a shared scene one of those that have it does, in turn by column."""
    result = True
    if ti.static(arrays.features.processor.shared):
        result = owner_of(column, j, arrays) == worker
    return result


@ti.func
def owner_of(column, j, arrays: ti.template()):
    """The worker of a shared scene that computes a node; -1 if none has it."""
    owner, other = -1, column % arrays.workers.shape[0]
    for _ in range(arrays.workers.shape[0]):
        if owner < 0 and has_node(other, column, j, arrays):
            owner = other
        other = 0 if other + 1 == arrays.workers.shape[0] else other + 1
    return owner


@ti.func
def own_node(column, j, worker, arrays: ti.template()):
    """Number in `grid` of the copy that `worker` has of node j of a column of the box."""
    return node_at(arrays.workers[worker, Worker.COLUMN] + column, j, arrays)


@ti.func
def node_of(array: ti.template(), column, j, worker, arrays: ti.template()):
    """Node j of a column of the box; in a shared scene the sum over the workers that have it."""
    if ti.static(arrays.features.processor.shared):
        node = zero_node()
        for other in range(arrays.workers.shape[0]):
            if has_node(other, column, j, arrays):
                node += array[own_node(column, j, other, arrays)]
        return node
    else:
        return array[own_node(column, j, worker, arrays)]


@ti.func
def put_node(array: ti.template(), value, column, j, worker, arrays: ti.template()):
    """Write a node for `node_of` to read; in a shared scene all workers that have the node get the sum."""
    if ti.static(arrays.features.processor.shared):
        for other in range(arrays.workers.shape[0]):
            if has_node(other, column, j, arrays):
                array[own_node(column, j, other, arrays)] = value
    else:
        array[own_node(column, j, worker, arrays)] = value


@ti.func
def update_node(n, scene, arrays: ti.template()):
    """Momentum to velocity at the n-th node of a scene if all nodes of the box are in memory, each with a thread."""
    deep, high = columns_deep(scene, arrays), arrays.offsets[scene, Offset.CELLS_Y] + 2 * PADDING + 1
    column, j = n // high, n % high
    i, k = column // deep, column % deep
    dt = arrays.step_control[scene, StepControl.DT]
    if i < arrays.offsets[scene, Offset.CELLS_X] + 2 * PADDING + 1 and dt > 0.0:
        at = own_node(column, j, scene, arrays)
        node = arrays.grid[at]
        if node[arrays.features.dimension] > 0.0:
            kappa = relaxation_factor(scene, dt, arrays)
            index = index_of([i, j, k], arrays)
            bed = bed_under(index, scene, arrays)
            arrays.grid[at] = moved_node(node, index, bed, True, scene, scene, dt, kappa, arrays)


@ti.func
def velocity_before(node, arrays: ti.template()):
    """v_i [m/s] of a node (momentum, mass, force) before its forces act, shape [D]."""
    features = arrays.features
    per_mass = 1.0 / node[features.dimension]
    return ti.Vector([node[axis] * per_mass for axis in ti.static(range(features.dimension))])


@ti.func
def moved_node(node, indices, bed, held, worker, scene, dt, kappa, arrays: ti.template()):
    """The node `indices`, [D], over a `bed` with its new velocity and its change; held: whether solids may hold it."""
    features = arrays.features
    mass, old = node[features.dimension], velocity_before(node, arrays)
    a, _ = acceleration(node, scene, arrays)
    if ti.static(features.damped):
        size, sign, _ = damping_terms(old, a, scene, arrays)
        a = a - arrays.settings[scene, Setting.DAMPING] * size * sign
    new = ti.Vector([old[axis] + dt * a[axis] for axis in ti.static(range(features.dimension))])
    new = apply_walls(new, indices, box_cells(scene, arrays), features.dimension, mass, worker, scene, arrays)
    if ti.static(features.contact):
        if held:
            new = apply_solids(new, mass, indices, bed, worker, scene, True, arrays)
    if ti.static(features.channel):
        new = with_friction(new, dt * node[features.node.side_friction] / mass)
    if ti.static(features.barriers):
        behind = apply_barriers(new, indices, scene, dt, arrays)
        if ti.static(features.recorded.walls):
            side = arrays.offsets[scene, Offset.OBSTACLES] + 2 * features.dimension
            add_impulse(side, mass * (new - behind), 0, worker, arrays)
        new = behind
    if ti.static(features.inflow):
        new = held_behind(new, indices, scene, arrays)
    for axis in ti.static(range(features.dimension)):
        node[axis] = new[axis]
        node[features.node.change + axis] = new[axis] - kappa * old[axis]
    return node


@ti.func
def relaxation_factor(scene, dt, arrays: ti.template()):
    """The share that a particle keeps over a step of its velocity relative to the grid, exp(-dt / tau) [-]."""
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
