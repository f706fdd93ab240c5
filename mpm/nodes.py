"""The grid between the transfers: cleared, then momentum becomes velocity under gravity, damping and the walls.

    v_i = (m v)_i / m_i + dt (g + f_i / m_i - alpha |g + f_i / m_i| sign v_i)

The last term is local damping (Cundall 1987) as CB-Geo MPM applies it at a node: |f| is the length of the whole force,
the sign is each component's (Cundall's own form takes each component's force too). A scene without damping neither
stores nor sums f_i apart. Only the bounding box of the material is cleared and updated.
"""

import taichi as ti

from mpm.lanes import add
from mpm.layout import PADDING, Pace, Place, Setting, Worker
from mpm.walls import against_walls


@ti.func
def cells_of(scene, of: ti.template()):
    """Cells of the box along each axis, shape [D]."""
    needs = of.needs
    return ti.Vector([of.places[scene, Place.CELLS_X + k] for k in ti.static(range(needs.dimension))])


@ti.func
def rows_of(scene, of: ti.template()):
    """Nodes from one to its neighbour along each axis, shape [3]; the last axis is the innermost."""
    needs = of.needs
    across = of.places[scene, Place.CELLS_Y] + 2 * PADDING + 1
    if ti.static(needs.dimension == 2):
        return ti.Vector([across, 1, 0])
    else:
        deep = of.places[scene, Place.CELLS_Z] + 2 * PADDING + 1
        return ti.Vector([across * deep, deep, 1])


@ti.func
def clear(worker, rows, of: ti.template()):
    """Set the nodes around the material of `worker` to zero."""
    needs = of.needs
    zero = ti.Vector([0.0 for _ in ti.static(range(needs.node))])
    for i in range(of.workers[worker, Worker.LOW_X], of.workers[worker, Worker.HIGH_X]):
        for j in range(of.workers[worker, Worker.LOW_Y], of.workers[worker, Worker.HIGH_Y]):
            first = of.workers[worker, Worker.NODE] + i * rows[0] + j * rows[1]
            for k in range(of.workers[worker, Worker.LOW_Z], of.workers[worker, Worker.HIGH_Z]):
                of.grid[first + k] = zero


@ti.func
def update_nodes(worker, scene, dt, rows, of: ti.template()):
    """Momentum to velocity, on the grid of a worker that has the scene to itself, or on a share of all their grids."""
    if ti.static(of.needs.shared):
        share_nodes(worker, scene, dt, rows, of)
    else:
        update_own_nodes(worker, scene, dt, rows, of)


@ti.func
def update_own_nodes(worker, scene, dt, rows, of: ti.template()):
    """Momentum to velocity, where one worker has the scene to itself."""
    needs = of.needs
    for i in range(of.workers[worker, Worker.LOW_X], of.workers[worker, Worker.HIGH_X]):
        for j in range(of.workers[worker, Worker.LOW_Y], of.workers[worker, Worker.HIGH_Y]):
            first = of.workers[worker, Worker.NODE] + i * rows[0] + j * rows[1]
            for k in range(of.workers[worker, Worker.LOW_Z], of.workers[worker, Worker.HIGH_Z]):
                node = of.grid[first + k]
                if node[needs.dimension] > 0.0:
                    put_velocity(first + k, velocity_of(node, i, j, k, worker, scene, dt, of), of)


@ti.func
def share_nodes(worker, scene, dt, rows, of: ti.template()):
    """Sum the nodes over the grids of all workers of a scene and give each the velocities; a share of the rows each."""
    needs = of.needs
    count = of.workers.shape[0]
    low = ti.Vector([of.workers[0, Worker.LOW_X + k] for k in ti.static(range(3))])
    high = ti.Vector([of.workers[0, Worker.HIGH_X + k] for k in ti.static(range(3))])
    for other in range(1, count):
        for k in ti.static(range(3)):
            low[k] = ti.min(low[k], of.workers[other, Worker.LOW_X + k])
            high[k] = ti.max(high[k], of.workers[other, Worker.HIGH_X + k])
    zero = ti.Vector([0.0 for _ in ti.static(range(needs.node))])
    for i in range(low[0], high[0]):
        if i % count == worker:
            for j in range(low[1], high[1]):
                for k in range(low[2], high[2]):
                    at = i * rows[0] + j * rows[1] + k
                    node = zero
                    for other in range(count):
                        if reaches(other, i, j, k, of):
                            node += of.grid[of.workers[other, Worker.NODE] + at]
                    if node[needs.dimension] > 0.0:
                        v = velocity_of(node, i, j, k, worker, scene, dt, of)
                        for other in range(count):
                            if reaches(other, i, j, k, of):
                                put_velocity(of.workers[other, Worker.NODE] + at, v, of)


@ti.func
def update_node(n, scene, of: ti.template()):
    """Momentum to velocity on the n-th node of a scene, where every node has a thread."""
    rows = rows_of(scene, of)
    i, j, k = n // rows[0], 0, 0
    if ti.static(of.needs.dimension == 2):
        j = n - i * rows[0]
    else:
        j = (n - i * rows[0]) // rows[1]
        k = n - i * rows[0] - j * rows[1]
    dt = of.pace[scene, Pace.DT]
    if i < of.places[scene, Place.CELLS_X] + 2 * PADDING + 1 and dt > 0.0:
        at = of.workers[scene, Worker.NODE] + n
        node = of.grid[at]
        if node[of.needs.dimension] > 0.0:
            put_velocity(at, velocity_of(node, i, j, k, scene, scene, dt, of), of)


@ti.func
def reaches(worker, i, j, k, of: ti.template()):
    """Whether the material of a worker reaches node (i, j, k)."""
    return (
        of.workers[worker, Worker.LOW_X] <= i < of.workers[worker, Worker.HIGH_X]
        and of.workers[worker, Worker.LOW_Y] <= j < of.workers[worker, Worker.HIGH_Y]
        and of.workers[worker, Worker.LOW_Z] <= k < of.workers[worker, Worker.HIGH_Z]
    )


@ti.func
def put_velocity(n, v, of: ti.template()):
    """Store the velocity of node n in place of its momentum."""
    for axis in ti.static(range(of.needs.dimension)):
        of.grid[n][axis] = v[axis]


@ti.func
def velocity_of(node, i, j, k, worker, scene, dt, of: ti.template()):
    """The new velocity [m/s] of the node (momentum, mass, force) at (i, j, k), shape [D]."""
    needs = of.needs
    mass = node[needs.dimension]
    v = ti.Vector([node[axis] / mass for axis in ti.static(range(needs.dimension))])
    gravity = [of.settings[scene, Setting.GRAVITY_X], of.settings[scene, Setting.GRAVITY_Y], 0.0]
    a = ti.Vector([gravity[axis] for axis in ti.static(range(needs.dimension))])
    if ti.static(needs.damped):
        a = a + ti.Vector([node[needs.force + axis] / mass for axis in ti.static(range(needs.dimension))])
        drag = of.settings[scene, Setting.DAMPING] * a.norm()
        a = a - drag * ti.Vector([ti.math.sign(v[axis]) for axis in ti.static(range(needs.dimension))])
    free = ti.Vector([v[axis] + dt * a[axis] for axis in ti.static(range(needs.dimension))])
    index = ti.Vector([[i, j, k][axis] for axis in ti.static(range(needs.dimension))])
    held = against_walls(
        free,
        index,
        cells_of(scene, of),
        of.settings[scene, Setting.FLOOR_FRICTION],
        of.settings[scene, Setting.WALL_FRICTION],
    )
    if ti.static(needs.fields):
        # What the walls take is counted behind the baffles.
        for axis in ti.static(range(needs.dimension)):
            taken = of.workers[worker, Worker.IMPULSE] + of.places[scene, Place.BAFFLES] * needs.dimension + axis
            add(of.impulse_lanes, taken * needs.lanes, mass * (free[axis] - held[axis]), of)
    return held
