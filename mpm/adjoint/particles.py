"""The reverse of what a block of particles does in a step: `mpm.physics.particles` and its giving to the grid.

    x <- x + dt u_p,   v <- kappa v + change_p,   C <- C_p,   sigma <- stress step of (sigma, dt C_p)

From the last of these to the first: bars of the stress and C by `mpm.adjoint.stress`; a coordinate that a wall of the
box has put back has none; u_p' = dt x'; change_p' = v' and then v' = kappa v'. The bars
go to the nodes, through the grid, and come back to x, v, C, sigma and the properties of the particles.
"""

import taichi as ti

from mpm.adjoint.contact import push_reverse
from mpm.adjoint.grid import add_kappa_bar
from mpm.adjoint.layout import add_bars, add_property_bar, contact_bar
from mpm.adjoint.pullback import Pullback
from mpm.adjoint.stress import stress_reverse
from mpm.adjoint.transfer import affine_reverse, gather_moments, prepare_weights, transfer_reverse
from mpm.arrays.access import dot, lane_sum, minimum, no_overflow, vectors
from mpm.arrays.features import NODE
from mpm.arrays.layout import Contact, Offset, Property, Setting
from mpm.physics.boundary import is_wall
from mpm.physics.channel import side_friction
from mpm.physics.contact import touches
from mpm.physics.transfer import contributions, prepare_contributions, property_of, volume_of, weights_of


@ti.func
def update_block_reverse(worker, table, scene, block, scratch, after, dt, kappa, arrays: ti.template()):
    """Bars of a block at the start of a step, but for what it gave to the grid; and those of the nodes.

    table: the first column of the nodes; after: its first vector in the history of the state after the step.
    """
    features, layout = arrays.features, arrays.layout
    size = ti.static(features.dimension)
    first, own = no_overflow(block * features.state.size), block * layout.width
    if ti.static(features.outflow):
        # What has left keeps its position alone.
        here = arrays.history[after + features.state.present]
        for k in range(ti.static(features.state.velocity), ti.static(features.state.stress + features.stresses)):
            arrays.adjoints[own + k] = here * arrays.adjoints[own + k]
    dx = arrays.settings[scene, Setting.CELL]
    per_dx = 1.0 / dx
    values = scratch + features.scratch.values
    arrays.scratch[values + size] = 0.0 * arrays.state[first]
    if ti.static(features.channel):
        for k in ti.static(range(1 + size)):
            arrays.scratch[values + k * NODE + features.node.side_friction] = 0.0 * arrays.state[first]
    if ti.static(features.turbulent):
        for k in ti.static(range(1 + size)):
            arrays.scratch[values + k * NODE + features.node.distance] = 0.0 * arrays.state[first]
        for k in ti.static(range(2)):
            arrays.scratch[scratch + features.scratch.drag + k] = 0.0 * arrays.state[first]
    f = weights_of(scene, block, scratch, per_dx, arrays)
    prepare_weights(scene, block, scratch, arrays)
    if ti.static(features.volume_correction):
        gather_moments(table, scene, block, scratch, arrays)
        arrays.scratch[scratch + features.scratch.density] = arrays.scratch[scratch + layout.scratch.sums + size]
        for k in ti.static(range(size)):
            moment = arrays.scratch[scratch + layout.scratch.sums + (1 + k) * NODE + size]
            arrays.scratch[scratch + features.scratch.density + 1 + k] = (4.0 * per_dx * per_dx) * moment
    stress_reverse(worker, table, scene, block, scratch, after, dt, arrays)
    slope_bar, change_bar, affine_bar, kappa_bar, slow_bar = affine_reverse(scene, block, scratch, kappa, arrays)
    slow_total = lane_sum(arrays.state[first + features.state.present] * slow_bar, arrays)
    arrays.sums[worker, ti.static(int(Setting.SLOW_AFFINE))] += ti.cast(slow_total, ti.f64)
    for i in ti.static(range(size)):
        x_bar = arrays.adjoints[own + i]
        x, length = arrays.history[after + i], arrays.offsets[scene, Offset.CELLS_X + i] * dx
        inside = (x > 0.0) & (x < length)
        if ti.static(features.outflow):
            below, above = is_wall(2 * i, scene, arrays), is_wall(2 * i + 1, scene, arrays)
            inside = ((x > 0.0) | (below == 0)) & ((x < length) | (above == 0))
        x_bar = ti.select(inside, x_bar, 0.0)
        arrays.adjoints[own + i] = x_bar
        if ti.static(features.outflow):
            x_bar = arrays.state[first + features.state.present] * x_bar
        v_bar = arrays.adjoints[own + features.state.velocity + i]
        value = dt * x_bar
        if ti.static(features.contact):
            value = value + arrays.scratch[scratch + layout.scratch.foot + i]
        arrays.scratch[values + features.node.change + i] = v_bar
        kappa_bar = kappa_bar + v_bar * arrays.state[first + features.state.velocity + i]
        arrays.adjoints[own + features.state.velocity + i] = kappa * v_bar
        for j in ti.static(range(size)):
            slope = 4.0 * per_dx * slope_bar[i * size + j]
            value = value - slope * f[j]
            arrays.scratch[values + (1 + j) * NODE + i] = slope
            slope = 4.0 * per_dx * change_bar[i * size + j]
            arrays.scratch[values + (1 + j) * NODE + features.node.force + i] = slope
            if ti.static(features.volume_correction):
                at = values + features.node.force + i
                arrays.scratch[at] = arrays.scratch[at] - slope * f[j]
        arrays.scratch[values + i] = value
    if ti.static(features.volume_correction):
        value = arrays.scratch[scratch + features.scratch.density]
        for j in ti.static(range(size)):
            slope = 4.0 * per_dx * arrays.scratch[scratch + features.scratch.density + 1 + j]
            value = value - slope * f[j]
            arrays.scratch[values + (1 + j) * NODE + size] = slope
        arrays.scratch[values + size] = value
    if ti.static(features.turbulent):
        mass_bar = arrays.scratch[scratch + features.scratch.drag]
        arrays.scratch[values + size] = arrays.scratch[values + size] + mass_bar
        arrays.scratch[values + features.node.distance] = arrays.scratch[scratch + features.scratch.layer]
    transfer_reverse(table, scene, block, scratch, True, arrays)
    square = 4.0 * per_dx * per_dx
    for j in ti.static(range(size)):
        moved = arrays.adjoints[own + j] + arrays.scratch[scratch + layout.scratch.forces + j]
        if ti.static(features.volume_correction):
            mass_bar = arrays.scratch[scratch + features.scratch.density + 1 + j]
            moved = moved - square * mass_bar * arrays.scratch[scratch + layout.scratch.sums + size]
        for i in ti.static(range(size)):
            moved = moved - square * slope_bar[i * size + j] * arrays.scratch[scratch + layout.scratch.sums + i]
            if ti.static(features.volume_correction):
                change = arrays.scratch[scratch + layout.scratch.sums + features.node.change + i]
                moved = moved - square * change_bar[i * size + j] * change
                arrays.adjoints[own + features.state.affine + i * size + j] = affine_bar[i * size + j]
        arrays.adjoints[own + j] = moved
    add_kappa_bar(worker, dt, kappa, lane_sum(kappa_bar, arrays), arrays)


def given_of(carried, volume, density, pushed, grip, distances, dx, width, features):
    """What a particle gives to a node at its own place, number by number, then the slopes of it per cell; traced."""
    mass, here = volume * density, [0.0] * features.dimension
    momentum, slopes, pull, forces = contributions(carried, mass, volume, pushed, here, dx, features)
    braked = [side_friction(carried[2], volume, grip)] if features.channel else []
    weighed = [mass * minimum(distance / width, 1.0) for distance in distances]
    return momentum, mass, pull, braked, weighed, slopes, forces


@ti.func
def block_to_grid_reverse(worker, table, scene, block, scratch, dt, arrays: ti.template()):
    """Add to the bars of a block those of what it gave to the nodes in the columns from `table` on, whose are known.

    Particles whose velocity then has a bar beyond the cut (`mpm.adjoint.tape.CUT`) have none any more.
    """
    features, layout = arrays.features, arrays.layout
    size = ti.static(features.dimension)
    first, own = no_overflow(block * features.state.size), block * layout.width
    prepare_contributions(scene, block, scratch, arrays)
    if ti.static(features.contact):
        if not touches(block, arrays):
            for k in ti.static(range(2 * size)):
                arrays.scratch[scratch + features.scratch.push + k] = 0.0 * arrays.state[first]
    prepare_weights(scene, block, scratch, arrays)
    transfer_reverse(table, scene, block, scratch, False, arrays)
    dx = arrays.settings[scene, Setting.CELL]
    per_dx = 1.0 / dx
    volume, density = volume_of(scene, block, arrays), property_of(scene, block, Property.DENSITY, arrays)
    present, sums = arrays.state[first + features.state.present], scratch + layout.scratch.sums
    velocity = vectors(arrays.state, first + features.state.velocity, size)
    affine = vectors(arrays.state, first + features.state.affine, size * size)
    stress = vectors(arrays.state, first + features.state.stress, features.stresses)
    pushed = vectors(arrays.scratch, scratch + features.scratch.push, 2 * size * int(features.contact))
    grip = arrays.settings[scene, Setting.GRIP]
    away = block * features.state.size + features.state.contacts + ti.static(int(Contact.DISTANCE))
    distances = vectors(arrays.state, away, int(features.turbulent))
    width = arrays.settings[scene, Setting.CONTACT_WIDTH]
    numbers = ti.static(((velocity, affine, stress), volume, density, pushed, grip, distances))
    given = ti.static([Pullback(given_of, numbers, (dx, width, features))])[0]
    # Of what is given at the particle itself, then of its slopes per cell.
    shifts = ti.static((0, features.node.force))
    places = ti.static([shift + (1 + k % size) * NODE + k // size for shift in shifts for k in range(size * size)])
    slopes = [per_dx * arrays.scratch[sums + n] for n in ti.static(places)]
    bars = vectors(arrays.scratch, sums, features.node.size) + slopes
    carried_bar, volume_bar, density_bar, pushed_bar, grip_bar, distances_bar = ti.static(given(bars))
    for k in ti.static(range(size)):
        moved = arrays.adjoints[own + k] + arrays.scratch[scratch + layout.scratch.forces + k]
        for i in ti.static(range(size)):
            number = ti.static(features.node.size + i * size + k)
            moved = moved - per_dx * given.values[number] * bars[i]
            moved = moved - per_dx * given.values[number + size * size] * bars[features.node.force + i]
        arrays.adjoints[own + k] = moved
    if ti.static(not features.volume_correction):
        for k in ti.static(range(size * size)):
            arrays.adjoints[own + features.state.affine + k] = 0.0 * affine[k]
    add_bars(own + features.state.velocity, carried_bar[0], arrays)
    add_bars(own + features.state.affine, carried_bar[1], arrays)
    add_bars(own + features.state.stress, carried_bar[2], arrays)
    if ti.static(features.channel):
        arrays.sums[worker, ti.static(int(Setting.GRIP))] += lane_sum(present * grip_bar, arrays)
    add_property_bar(block, Property.VOLUME, volume_bar, arrays)
    add_property_bar(block, Property.DENSITY, density_bar, arrays)
    if ti.static(features.contact):
        push_reverse(worker, block, scratch, stress, pushed_bar, volume, dt, arrays)
        add_bars(contact_bar(block, Contact.DISTANCE, arrays), distances_bar, arrays)
    v_bar = vectors(arrays.adjoints, own + features.state.velocity, size)
    within = dot(v_bar, v_bar) <= arrays.cuts[scene, 0]
    cut = lane_sum(ti.select(within, 0.0 * present, present), arrays)
    if cut > 0.0:
        arrays.cuts[scene, 1] += ti.cast(cut, float)
    for k in range(ti.static(features.state.velocity if features.outflow else 0), ti.static(features.state.properties)):
        arrays.adjoints[own + k] = ti.select(within, present * arrays.adjoints[own + k], 0.0 * present)
