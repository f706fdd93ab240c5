"""The reverse of `mpm.physics.grid`: bars of momentum, mass and force at the nodes from those of their velocities.

    v* = v + dt (a - alpha |a| s(v)),   a = g + f / m,   v = (m v) / m,   s(v) = v / sqrt(v^2 + v_s^2)

    a'     = dt v*' - (dt alpha s . v*') a / |a|            alpha' = -dt |a| s . v*'
    v'     = v*' - v_s^2 l,    (v_s^2)' = v . l / 2,    l = dt alpha |a| (v^2 + v_s^2)^(-3/2) v*' by components
    (m v)' = v' / m,    f' = a' / m,    m' = -(v . v' + f / m . a') / m,    g' = a'

**The slope of the sign** at v = 0 is 1 / v_s, and dt alpha |a| / v_s is far above 2 where stress waves pass: such a
node jumps to and fro about v = 0, and neighbouring runs part at every jump until they are some 1e-6 m apart, where it
ends. The derivative along one run is then that of the jumps (1e25 after a second of ten layers) and says nothing of
the flow. Unless `exact`, the reverse therefore spreads the slope over the jump that a step of damping makes,
h = dt alpha |a|:

    s'(v) = (v_s^2 + h^2) (v^2 + v_s^2 + h^2)^(-3/2)

so that h s'(v) lies in [0, 1], as of a force that opposes motion; it is exact where h is small against v_s or |v|, and
its integral over v stays 2, so that where v scatters by more than h its mean is right.

A node keeps u = v* after the walls and its change u - kappa v, so v*' begins as the sum of both bars, and v' and kappa'
with -kappa and -v times that of the change.
"""

import taichi as ti

from mpm.adjoint.boundary import wall_reverse, with_friction_reverse
from mpm.adjoint.contact import solids_reverse
from mpm.arrays.access import TINY, box_cells, columns_deep, zero_node
from mpm.arrays.layout import Setting, Span, Worker
from mpm.physics.barriers import apply_barriers
from mpm.physics.boundary import apply_walls
from mpm.physics.contact import apply_solids
from mpm.physics.grid import SLOW, acceleration, damping_terms, node_of, own_node, owns, put_node, velocity_before

SHARED = (Setting.GRAVITY_X, Setting.GRAVITY_Y, Setting.FLOOR_FRICTION, Setting.WALL_FRICTION, Setting.DAMPING)
SUMS = len(SHARED) + 1
"""Bars that nodes share: of these settings and of kappa."""


@ti.func
def keep_nodes(worker, arrays: ti.template()):
    """Keep momentum, mass and force of the nodes that a worker owns; the bars of all of its nodes become 0."""
    zero, first = zero_node(), arrays.workers[worker, Worker.COLUMN]
    for n in range(arrays.workers[worker, Worker.ACTIVE]):
        column = arrays.spans[first + n, Span.ACTIVE] - first
        for j in range(arrays.spans[first + column, Span.LOW], arrays.spans[first + column, Span.HIGH]):
            at = own_node(column, j, worker, arrays)
            arrays.grid_adjoints[at] = zero
            if owns(column, j, worker, arrays):
                arrays.kept[at] = node_of(arrays.grid, column, j, worker, arrays)


@ti.func
def node_reverse(node, bar, index: ti.template(), worker, scene, dt, kappa, arrays: ti.template()):
    """Bar of node `index`, i, j, k, (momentum, mass, force) from that of what it became; then the SUMS it shares."""
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
    change_bar = ti.Vector([bar[features.node.change + axis] for axis in ti.static(range(dimension))])
    new_bar = ti.Vector([bar[axis] for axis in ti.static(range(dimension))]) + change_bar
    v_bar = (0.0 - kappa) * change_bar
    kappa_bar = 0.0 - v.dot(change_bar)
    indices, cells = ti.Vector([index[axis] for axis in ti.static(range(dimension))]), box_cells(scene, arrays)
    v_star = v + dt * damped
    if ti.static(features.barriers):
        # Barriers take components away and damp: what they do to a velocity they do to its bar.
        new_bar = apply_barriers(new_bar, indices, scene, dt, arrays)
    mass_bar, side_bar = zero, zero
    if ti.static(features.contact or features.channel):
        stopped = apply_walls(v_star, indices, cells, dimension, node[dimension], worker, scene, arrays)
        if ti.static(features.channel):
            braked = stopped
            if ti.static(features.contact):
                braked = apply_solids(stopped, node[dimension], indices, worker, scene, False, arrays)
            grip = node[features.node.side_friction] * per_mass
            new_bar, limit_bar = with_friction_reverse(new_bar, braked, dt * grip)
            side_bar = dt * per_mass * limit_bar
            mass_bar = 0.0 - grip * side_bar
        if ti.static(features.contact):
            new_bar, solid_bar = solids_reverse(new_bar, stopped, node[dimension], indices, worker, scene, arrays)
            mass_bar = mass_bar + solid_bar
    star_bar, floor_bar, wall_bar = wall_reverse(new_bar, v_star, indices, cells, scene, arrays)
    v_bar = v_bar + star_bar
    a_bar = dt * star_bar
    damping_bar, slow_bar = zero, zero
    if ti.static(features.damped):
        opposed = sign.dot(star_bar)
        damping_bar = (0.0 - dt) * size * opposed
        for axis in ti.static(range(dimension)):
            strength = dt * alpha * size
            wide = slow
            if ti.static(not arrays.layout.exact):
                wide = slow + strength * strength
            square = v[axis] * v[axis] + wide
            lost = strength / (square * ti.sqrt(square))
            v_bar[axis] -= wide * lost * star_bar[axis]
            slow_bar += 0.5 * v[axis] * lost * star_bar[axis]
        a_bar = a_bar - (dt * alpha * opposed / (size + TINY)) * a
    gravity_y_bar = a_bar[1]
    if ti.static(features.damped):
        # v_s^2 grows with gravity.
        sign_y = ti.math.sign(arrays.settings[scene, Setting.GRAVITY_Y])
        gravity_y_bar += slow_bar * SLOW * SLOW * arrays.settings[scene, Setting.CELL] * sign_y
    result = 0.0 * node
    # With volume correction particles see the mass of nodes itself.
    result[dimension] = mass_bar + bar[dimension]
    if ti.static(features.channel):
        result[features.node.side_friction] = side_bar
    if ti.static(features.turbulent):
        result[features.node.distance] = bar[features.node.distance]
    for axis in ti.static(range(dimension)):
        result[axis] = v_bar[axis] * per_mass
        result[dimension] -= v[axis] * v_bar[axis] * per_mass
        result[features.node.force + axis] = a_bar[axis] * per_mass
        result[dimension] -= force[axis] * a_bar[axis] * per_mass
    return result, ti.Vector([a_bar[0], gravity_y_bar, floor_bar, wall_bar, damping_bar, kappa_bar])


@ti.func
def update_grid_reverse(worker, scene, dt, kappa, arrays: ti.template()):
    """Bars of the nodes that a worker owns, in place; add what they share to `arrays.sums`."""
    total = ti.Vector([ti.cast(0.0, ti.f64) for _ in ti.static(range(SUMS))])
    first, deep = arrays.workers[worker, Worker.COLUMN], columns_deep(scene, arrays)
    for n in range(arrays.workers[worker, Worker.ACTIVE]):
        column = arrays.spans[first + n, Span.ACTIVE] - first
        i, k = column // deep, column % deep
        for j in range(arrays.spans[first + column, Span.LOW], arrays.spans[first + column, Span.HIGH]):
            if owns(column, j, worker, arrays):
                node = arrays.kept[own_node(column, j, worker, arrays)]
                if node[arrays.features.dimension] > 0.0:
                    bar = node_of(arrays.grid_adjoints, column, j, worker, arrays)
                    bar, shared = node_reverse(node, bar, [i, j, k], worker, scene, dt, kappa, arrays)
                    for number in ti.static(range(SUMS)):
                        total[number] += ti.cast(shared[number], ti.f64)
                    put_node(arrays.grid_adjoints, bar, column, j, worker, arrays)
    for number in ti.static(range(len(SHARED))):
        arrays.sums[worker, ti.static(int(SHARED[number]))] += total[number]
    add_kappa_bar(worker, dt, kappa, total[ti.static(SUMS - 1)], arrays)


@ti.func
def add_kappa_bar(worker, dt, kappa, bar, arrays: ti.template()):
    """Add the bar of kappa = exp(-dt rate) to that of the rate of relaxation."""
    arrays.sums[worker, ti.static(int(Setting.RELAXATION_RATE))] -= ti.cast(dt * kappa, ti.f64) * bar
