"""The reverse of a block of particles in a step: `mpm.physics.particles` and its contributions to the grid.

    x <- x + dt u_p,   v <- kappa v + change_p,   C <- C_p,   sigma <- stress step of (sigma, dt C_p)

From the last of these to the first: adjoints of the stress and C by `mpm.adjoint.stress`; a coordinate that a wall of
the box has reset has none; u_p' = dt x'; change_p' = v' and then v' = kappa v'. The adjoints go to the nodes, through
the grid, and come back to x, v, C, sigma and the properties of the particles.
"""

import taichi as ti

from mpm.adjoint.contact import push_reverse
from mpm.adjoint.grid import add_kappa_adjoint
from mpm.adjoint.layout import Block, add_adjoints, add_property_adjoint, add_setting_adjoint, adjoints_of, state_before
from mpm.adjoint.pullback import Pullback
from mpm.adjoint.stress import stress_reverse
from mpm.adjoint.transfer import affine_reverse, gather_moments, moments_of, prepare_weights, transfer_reverse
from mpm.arrays.access import dot, lane_sum, minimum, no_overflow, present, vectors
from mpm.arrays.features import NODE
from mpm.arrays.layout import Contact, Offset, Property, Setting, Worker
from mpm.physics.boundary import is_wall
from mpm.physics.channel import side_friction
from mpm.physics.contact import touches
from mpm.physics.transfer import (
    contributions,
    contributions_of_contact,
    prepare_contributions,
    property_of,
    volume_of,
    weights_of,
)


@ti.func
def block_of(worker, scene, number, step, dt, kappa, arrays: ti.template()):
    """The data of the block with this number for the functions that reverse `step`."""
    state, adj = no_overflow(number * arrays.features.state.size), number * arrays.layout.width
    after = state_before(step + 1, number, arrays)
    table, scratch = arrays.workers[worker, Worker.COLUMN], arrays.workers[worker, Worker.SCRATCH]
    return ti.static([Block(worker, scene, number, table, state, adj, after, scratch, dt, kappa)])[0]


@ti.func
def update_block_reverse(block: ti.template(), arrays: ti.template()):
    """Adjoints of a block at the start of a step, without its contributions to the grid; and those of the nodes."""
    features, layout, scene = arrays.features, arrays.layout, block.scene
    size, velocity = ti.static(features.dimension, features.state.velocity)
    if ti.static(features.outflow):
        # Particles that have left keep only their position.
        here = arrays.history[block.after + features.state.present]
        for k in range(velocity, ti.static(features.state.stress + features.stresses)):
            arrays.adjoints[block.adj + k] = here * arrays.adjoints[block.adj + k]
    dx = arrays.settings[scene, Setting.CELL]
    f = weights_of(scene, block.number, block.scratch, 1.0 / dx, arrays)
    prepare_weights(block, arrays)
    density, sums = block.scratch + features.scratch.density, block.scratch + layout.scratch.sums
    if ti.static(features.volume_correction):
        gather_moments(block, arrays)
        mass_slopes = moments_of(block, size, 1, 4.0 / (dx * dx), arrays)
        arrays.scratch[density] = arrays.scratch[sums + size]
        for k in ti.static(range(size)):
            arrays.scratch[density + 1 + k] = mass_slopes[k]
    if ti.static(features.turbulent):
        for k in ti.static(range(2)):
            arrays.scratch[block.scratch + features.scratch.layer + k] = 0.0 * arrays.state[block.state]
    stress_reverse(block, arrays)
    adj_motion_slopes, adj_kappa = affine_reverse(block, arrays)
    adj_motion = adjoints_of(block, 0, size, arrays)
    adj_change = adjoints_of(block, velocity, size, arrays)
    for i in ti.static(range(size)):
        x, length = arrays.history[block.after + i], arrays.offsets[scene, Offset.CELLS_X + i] * dx
        inside = (x > 0.0) & (x < length)
        if ti.static(features.outflow):
            below, above = is_wall(2 * i, scene, arrays), is_wall(2 * i + 1, scene, arrays)
            inside = ((x > 0.0) | (below == 0)) & ((x < length) | (above == 0))
        adj_x = ti.select(inside, adj_motion[i], 0.0)
        arrays.adjoints[block.adj + i] = adj_x
        if ti.static(features.outflow):
            adj_x = present(block.number, arrays) * adj_x
        adj_motion[i] = block.dt * adj_x
        if ti.static(features.contact):
            adj_motion[i] = adj_motion[i] + arrays.scratch[block.scratch + layout.scratch.foot + i]
        adj_kappa = adj_kappa + adj_change[i] * arrays.state[block.state + velocity + i]
        arrays.adjoints[block.adj + velocity + i] = block.kappa * adj_change[i]
    # The adjoints of a particle's sums over nodes, number by number, and of the slopes of these.
    numbers = ti.static([first + k for first in (0, features.node.change) for k in range(size)] + [size])
    adj_taken = adj_motion + adj_change + [0.0 * adj_kappa]
    adj_slopes = adj_motion_slopes + [0.0 * adj_kappa for _ in ti.static(range(size))]
    if ti.static(features.volume_correction):
        adj_taken[2 * size] = arrays.scratch[density]
        for k in ti.static(range(size)):
            adj_slopes[2 * size * size + k] = arrays.scratch[density + 1 + k]
    for n in ti.static(range(len(numbers))):
        at, value = block.scratch + features.scratch.values + numbers[n], adj_taken[n]
        for j in ti.static(range(size)):
            slope = 4.0 / dx * adj_slopes[n * size + j]
            value = value - slope * f[j]
            arrays.scratch[at + (1 + j) * NODE] = slope
        arrays.scratch[at] = value
    if ti.static(features.channel):
        for k in ti.static(range(1 + size)):
            at = block.scratch + features.scratch.values + k * NODE + features.node.side_friction
            arrays.scratch[at] = 0.0 * arrays.state[block.state]
    if ti.static(features.turbulent):
        at, layer = block.scratch + features.scratch.values, block.scratch + features.scratch.layer
        arrays.scratch[at + size] = arrays.scratch[at + size] + arrays.scratch[layer]
        arrays.scratch[at + features.node.distance] = arrays.scratch[layer + 1]
        for k in ti.static(range(size)):
            arrays.scratch[at + (1 + k) * NODE + features.node.distance] = 0.0 * arrays.state[block.state]
    transfer_reverse(block, True, arrays)
    for j in ti.static(range(size)):
        moved = arrays.scratch[block.scratch + layout.scratch.forces + j]
        for n in ti.static(range(len(numbers) if features.volume_correction else size)):
            moved = moved - 4.0 / (dx * dx) * adj_slopes[n * size + j] * arrays.scratch[sums + numbers[n]]
        add_adjoints(block, j, [moved], arrays)
    add_kappa_adjoint(block.worker, block.dt, block.kappa, lane_sum(adj_kappa, arrays), arrays)


def given_of(carried, volume, density, pushed, grip, distances, dx, width, features):
    """Contribution of a particle to a node at its own place, number by number, then its slopes per cell; traced."""
    mass, here = volume * density, [0.0] * features.dimension
    momentum, slopes, pull, forces = contributions(carried, mass, volume, here, dx, features)
    if pushed:
        more_pull, more_forces = contributions_of_contact(pushed, volume, here, dx, features.dimension)
        pull = [a + b for a, b in zip(pull, more_pull, strict=True)]
        forces = [a + b for a, b in zip(forces, more_forces, strict=True)]
    braked = [side_friction(carried[2], volume, grip)] if features.channel else []
    weighed = [mass * minimum(distance / width, 1.0) for distance in distances]
    return momentum, mass, pull, braked, weighed, slopes, forces


@ti.func
def block_to_grid_reverse(block: ti.template(), arrays: ti.template()):
    """Add to the adjoints of a block those of its contributions to the nodes, whose adjoints are known.

    Particles whose velocity then has an adjoint beyond the cut (`mpm.adjoint.tape.CUT`) lose all adjoints.
    """
    features, layout, scene = arrays.features, arrays.layout, block.scene
    size = ti.static(features.dimension)
    prepare_contributions(scene, block.number, block.scratch, arrays)
    if ti.static(features.contact):
        if not touches(block.number, arrays):
            for k in ti.static(range(2 * size)):
                arrays.scratch[block.scratch + features.scratch.push + k] = 0.0 * arrays.state[block.state]
    prepare_weights(block, arrays)
    transfer_reverse(block, False, arrays)
    dx = arrays.settings[scene, Setting.CELL]
    per_dx = 1.0 / dx
    volume, density = volume_of(scene, block.number, arrays), property_of(scene, block.number, Property.DENSITY, arrays)
    velocity = vectors(arrays.state, block.state + features.state.velocity, size)
    affine = vectors(arrays.state, block.state + features.state.affine, size * size)
    stress = vectors(arrays.state, block.state + features.state.stress, features.stresses)
    pushed = vectors(arrays.scratch, block.scratch + features.scratch.push, 2 * size * int(features.contact))
    grip, width = arrays.settings[scene, Setting.GRIP], arrays.settings[scene, Setting.CONTACT_WIDTH]
    away = ti.static(features.state.contacts + int(Contact.DISTANCE))
    distances = vectors(arrays.state, block.state + away, int(features.turbulent))
    numbers = ti.static(((velocity, affine, stress), volume, density, pushed, grip, distances))
    given = ti.static([Pullback(given_of, numbers, (dx, width, features))])[0]
    # Of the contribution at the particle itself, then of its slopes per cell.
    adj = vectors(arrays.scratch, block.scratch + layout.scratch.sums, features.node.size)
    slopes = moments_of(block, 0, size, per_dx, arrays)
    forces = moments_of(block, features.node.force, size, per_dx, arrays)
    adj_carried, adj_volume, adj_density, adj_pushed, adj_grip, adj_away = ti.static(given(adj + slopes + forces))
    for k in ti.static(range(size)):
        moved = arrays.scratch[block.scratch + layout.scratch.forces + k]
        for i in ti.static(range(size)):
            number = ti.static(features.node.size + i * size + k)
            moved = moved - per_dx * given.values[number] * adj[i]
            moved = moved - per_dx * given.values[number + size * size] * adj[features.node.force + i]
        add_adjoints(block, k, [moved], arrays)
    add_adjoints(block, features.state.velocity, adj_carried[0], arrays)
    add_adjoints(block, features.state.affine, adj_carried[1], arrays)
    add_adjoints(block, features.state.stress, adj_carried[2], arrays)
    if ti.static(features.channel):
        add_setting_adjoint(block, Setting.GRIP, adj_grip, arrays)
    add_property_adjoint(block, Property.VOLUME, adj_volume, arrays)
    add_property_adjoint(block, Property.DENSITY, adj_density, arrays)
    if ti.static(features.contact):
        push_reverse(block, stress, adj_pushed, volume, arrays)
        add_adjoints(block, away, adj_away, arrays)
    adj_v, here = adjoints_of(block, features.state.velocity, size, arrays), present(block.number, arrays)
    within = dot(adj_v, adj_v) <= arrays.cuts[scene, 0]
    cut = lane_sum(ti.select(within, 0.0 * here, here), arrays)
    if cut > 0.0:
        arrays.cuts[scene, 1] += ti.cast(cut, float)
    for k in range(ti.static(features.state.velocity if features.outflow else 0), ti.static(features.state.properties)):
        arrays.adjoints[block.adj + k] = ti.select(within, here * arrays.adjoints[block.adj + k], 0.0 * here)
