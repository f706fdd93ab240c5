"""The reverse of `mpm.physics.grid`: from adjoints of nodal velocities to those of momentum, mass and force.

    v* = v + dt (a - alpha |a| s(v)),   a = g + f / m,   v = (m v) / m,   s(v) = v / sqrt(v^2 + v_s^2)

    a'     = dt v*' - (dt alpha s . v*') a / |a|            alpha' = -dt |a| s . v*'
    v'     = v*' - v_s^2 l,    (v_s^2)' = v . l / 2,    l = dt alpha |a| (v^2 + v_s^2)^(-3/2) v*' by components
    (m v)' = v' / m,    f' = a' / m,    m' = -(v . v' + f / m . a') / m,    g' = a'

**The slope of the sign** at v = 0 is 1 / v_s, and dt alpha |a| / v_s is far above 2 where stress waves pass. Such a
node jumps back and forth about v = 0, and neighbouring runs diverge at every jump until they are some 1e-6 m apart, and
no further. The derivative along one run is then that of the jumps (1e25 after a second of ten layers) and says nothing
about the flow. Unless `exact`, the reverse therefore spreads the slope over the jump of a damping step, h = dt alpha
|a|:

    s'(v) = (v_s^2 + h^2) (v^2 + v_s^2 + h^2)^(-3/2)

so that h s'(v) lies in [0, 1], as for a force that opposes motion. It is exact where h is small against v_s or |v|, and
its integral over v stays 2, so that its mean is right where v scatters by more than h.

A node keeps u = v* after the walls and its change u - kappa v, so v*' begins as the sum of both adjoints, and v' and
kappa' with -kappa and -v times that of the change.
"""

import taichi as ti

from mpm.adjoint.boundary import wall_reverse, with_friction_reverse
from mpm.adjoint.contact import solids_reverse
from mpm.arrays.access import TINY, box_cells, columns_deep
from mpm.arrays.layout import Setting, Span, Worker
from mpm.arrays.nodes import zero_node
from mpm.physics.barriers import apply_barriers
from mpm.physics.boundary import apply_walls
from mpm.physics.contact import apply_solids
from mpm.physics.grid import SLOW, acceleration, damping_terms, node_of, own_node, owns, put_node, velocity_before
from mpm.solids.terrain import bed_under

SHARED = (Setting.GRAVITY_X, Setting.GRAVITY_Y, Setting.FLOOR_FRICTION, Setting.WALL_FRICTION, Setting.DAMPING)
SUMS = len(SHARED) + 1  # number of adjoints that nodes share: of these settings and of kappa


@ti.func
def keep_nodes(worker, arrays: ti.template()):
    """Keep momentum, mass and force of the nodes that a worker owns; the adjoints of all of its nodes become 0."""
    zero, first = zero_node(), arrays.workers[worker, Worker.COLUMN]
    for n in range(arrays.workers[worker, Worker.ACTIVE]):
        column = arrays.spans[first + n, Span.ACTIVE] - first
        for j in range(arrays.spans[first + column, Span.LOW], arrays.spans[first + column, Span.HIGH]):
            at = own_node(column, j, worker, arrays)
            arrays.grid_adjoints[at] = zero
            if owns(column, j, worker, arrays):
                arrays.kept[at] = node_of(arrays.grid, column, j, worker, arrays)


@ti.func
def node_reverse(node, adj, index: ti.template(), worker, scene, dt, kappa, arrays: ti.template()):
    """Adjoints of node `index`, i, j, k, (momentum, mass, force) from those after the step; and the SUMS it shares."""
    features = arrays.features
    dimension = ti.static(features.dimension)
    per_mass = 1.0 / node[dimension]
    zero = 0.0 * per_mass
    v = velocity_before(node, arrays)
    a, force = acceleration(node, scene, arrays)
    damped = a
    size, alpha, sign, slow = zero, zero, 0.0 * a, zero
    if ti.static(features.damped):
        alpha = arrays.settings[scene, Setting.DAMPING]
        size, sign, slow = damping_terms(v, a, scene, arrays)
        damped = a - alpha * size * sign
    adj_change = ti.Vector([adj[features.node.change + axis] for axis in ti.static(range(dimension))])
    adj_new = ti.Vector([adj[axis] for axis in ti.static(range(dimension))]) + adj_change
    adj_v = (0.0 - kappa) * adj_change
    adj_kappa = 0.0 - v.dot(adj_change)
    indices, cells = ti.Vector([index[axis] for axis in ti.static(range(dimension))]), box_cells(scene, arrays)
    v_star = v + dt * damped
    if ti.static(features.barriers):
        # Barriers remove components and damp: they act on the adjoint as on the velocity.
        adj_new = apply_barriers(adj_new, indices, scene, dt, arrays)
    adj_mass, adj_side = zero, zero
    if ti.static(features.contact or features.channel):
        stopped = apply_walls(v_star, indices, cells, dimension, node[dimension], worker, scene, arrays)
        if ti.static(features.channel):
            braked = stopped
            if ti.static(features.contact):
                bed = bed_under(indices, scene, arrays)
                braked = apply_solids(stopped, node[dimension], indices, bed, worker, scene, False, arrays)
            grip = node[features.node.side_friction] * per_mass
            adj_new, adj_limit = with_friction_reverse(adj_new, braked, dt * grip)
            adj_side = dt * per_mass * adj_limit
            adj_mass = 0.0 - grip * adj_side
        if ti.static(features.contact):
            adj_new, adj_solid = solids_reverse(adj_new, stopped, node[dimension], indices, worker, scene, arrays)
            adj_mass = adj_mass + adj_solid
    adj_star, adj_floor, adj_wall = wall_reverse(adj_new, v_star, indices, cells, scene, arrays)
    adj_v = adj_v + adj_star
    adj_a = dt * adj_star
    adj_damping, adj_slow = zero, zero
    if ti.static(features.damped):
        opposed = sign.dot(adj_star)
        adj_damping = (0.0 - dt) * size * opposed
        for axis in ti.static(range(dimension)):
            strength = dt * alpha * size
            wide = slow
            if ti.static(not arrays.layout.exact):
                wide = slow + strength * strength
            square = v[axis] * v[axis] + wide
            lost = strength / (square * ti.sqrt(square))
            adj_v[axis] -= wide * lost * adj_star[axis]
            adj_slow += 0.5 * v[axis] * lost * adj_star[axis]
        adj_a = adj_a - (dt * alpha * opposed / (size + TINY)) * a
    adj_gravity_y = adj_a[1]
    if ti.static(features.damped):
        # v_s^2 grows with gravity.
        sign_y = ti.math.sign(arrays.settings[scene, Setting.GRAVITY_Y])
        adj_gravity_y += adj_slow * SLOW * SLOW * arrays.settings[scene, Setting.CELL] * sign_y
    result = 0.0 * node
    # With volume correction particles see the mass of nodes itself.
    result[dimension] = adj_mass + adj[dimension]
    if ti.static(features.channel):
        result[features.node.side_friction] = adj_side
    if ti.static(features.turbulent):
        result[features.node.distance] = adj[features.node.distance]
    for axis in ti.static(range(dimension)):
        result[axis] = adj_v[axis] * per_mass
        result[dimension] -= v[axis] * adj_v[axis] * per_mass
        result[features.node.force + axis] = adj_a[axis] * per_mass
        result[dimension] -= force[axis] * adj_a[axis] * per_mass
    return result, ti.Vector([adj_a[0], adj_gravity_y, adj_floor, adj_wall, adj_damping, adj_kappa])


@ti.func
def update_grid_reverse(worker, scene, dt, kappa, arrays: ti.template()):
    """Adjoints of the nodes that a worker owns, in place; add their shared adjoints to `arrays.sums`."""
    total = ti.Vector([ti.cast(0.0, ti.f64) for _ in ti.static(range(SUMS))])
    first, deep = arrays.workers[worker, Worker.COLUMN], columns_deep(scene, arrays)
    for n in range(arrays.workers[worker, Worker.ACTIVE]):
        column = arrays.spans[first + n, Span.ACTIVE] - first
        i, k = column // deep, column % deep
        for j in range(arrays.spans[first + column, Span.LOW], arrays.spans[first + column, Span.HIGH]):
            if owns(column, j, worker, arrays):
                node = arrays.kept[own_node(column, j, worker, arrays)]
                if node[arrays.features.dimension] > 0.0:
                    adj = node_of(arrays.grid_adjoints, column, j, worker, arrays)
                    adj, shared = node_reverse(node, adj, [i, j, k], worker, scene, dt, kappa, arrays)
                    for number in ti.static(range(SUMS)):
                        total[number] += ti.cast(shared[number], ti.f64)
                    put_node(arrays.grid_adjoints, adj, column, j, worker, arrays)
    for number in ti.static(range(len(SHARED))):
        arrays.sums[worker, ti.static(int(SHARED[number]))] += total[number]
    add_kappa_adjoint(worker, dt, kappa, total[ti.static(SUMS - 1)], arrays)


@ti.func
def add_kappa_adjoint(worker, dt, kappa, adj, arrays: ti.template()):
    """Add the adjoint of kappa = exp(-dt rate) to that of the rate of relaxation."""
    arrays.sums[worker, ti.static(int(Setting.RELAXATION_RATE))] -= ti.cast(dt * kappa, ti.f64) * adj
