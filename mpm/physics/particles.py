"""Update of a block of particles after the grid: it moves, stays outside the solids, and its stress follows."""

import taichi as ti

from mpm.arrays.access import clamp, magnitude, maximum, minimum, no_overflow, over_lanes, vectors
from mpm.arrays.layout import Contact, Offset, Property, Setting, Worker
from mpm.physics.boundary import is_wall
from mpm.physics.contact import (
    contact_at,
    contact_of,
    foot_velocity,
    jump_at_contact,
    motion_and_stress,
    record_traction,
    shear_traction_step,
    touches,
    with_jump,
)
from mpm.physics.contact_search import find_contacts
from mpm.physics.inflow import let_in, waits
from mpm.physics.pore_pressure import record_wall_pressure, total_stress
from mpm.physics.stress import midpoint_increment, stress_step
from mpm.physics.transfer import grid_to_block, property_of
from mpm.physics.volume_correction import grid_gap, is_loose, kept_gap, updated_gap
from mpm.physics.water import give_to_cells


@ti.func
def update_particles(worker, scene, dt, kappa, arrays: ti.template()):
    """Update positions and stresses of the particles of `worker`; return the largest move along an axis [cells]."""
    features = arrays.features
    first = arrays.workers[worker, Worker.FIRST]
    furthest = 0.0 * arrays.state[first * features.state.size]
    table, scratch = arrays.workers[worker, Worker.COLUMN], arrays.workers[worker, Worker.SCRATCH]
    for block in range(first, arrays.workers[worker, Worker.LAST]):
        before = vectors(arrays.state, no_overflow(block * features.state.size), features.dimension)
        if ti.static(features.inflow):
            if not waits(block, arrays):
                update_block(worker, table, scene, block, scratch, dt, kappa, arrays)
        else:
            update_block(worker, table, scene, block, scratch, dt, kappa, arrays)
        for k in ti.static(range(features.dimension)):
            moved = arrays.state[no_overflow(block * features.state.size) + k] - before[k]
            furthest = maximum(magnitude(moved), furthest)
    return over_lanes(maximum, furthest, arrays.features.lanes) / arrays.settings[scene, Setting.CELL]


@ti.func
def update_block(worker, table, scene, block, scratch, dt, kappa, arrays: ti.template()):
    """Update positions and stresses of a block from the velocities of its nodes, in columns from `table` on."""
    features = arrays.features
    volume = property_of(scene, block, Property.VOLUME, arrays)
    near = False
    if ti.static(features.contact):
        near = touches(block, arrays)
        if near:
            record_traction(block, scratch, volume, dt, worker, arrays)
        for k in ti.static(range(features.dimension)):
            arrays.scratch[scratch + features.scratch.origin + k] = arrays.state[block * features.state.size + k]
    if ti.static(features.wet and features.recorded.walls):
        record_wall_pressure(block, volume, dt, scene, worker, arrays)
    grid_to_block(table, scene, block, scratch, 1.0 / arrays.settings[scene, Setting.CELL], kappa, arrays)
    step_particles(scene, block, scratch, dt, kappa, arrays)
    update_stress(scene, block, scratch, near, dt, arrays)
    if ti.static(features.outflow):
        remove_outflow(block, scene, arrays)
    if ti.static(features.inflow):
        let_in(block, scene, dt, arrays)
    if ti.static(features.contact):
        mass = volume * property_of(scene, block, Property.DENSITY, arrays)
        find_contacts(block, scratch, mass, worker, scene, arrays)
    if ti.static(features.wet):
        give_to_cells(scene, table, block, scratch, arrays)


@ti.func
def step_particles(scene, block, scratch, dt, kappa, arrays: ti.template()):
    """Move a block by its velocity; no particle leaves the box."""
    features = arrays.features
    x = no_overflow(block * features.state.size)
    v, remainder = x + features.state.velocity, x + features.state.remainder
    for k in ti.static(range(features.dimension)):
        at = scratch + features.scratch.lowest + features.dimension + k
        speed = arrays.scratch[at]
        arrays.state[v + k] = kappa * arrays.state[v + k] + arrays.scratch[at + features.dimension]
        if ti.static(features.outflow):
            speed = arrays.state[x + features.state.present] * speed
        if ti.static(features.compensated):
            old, part = arrays.state[x + k], dt * speed + arrays.state[remainder + k]
            new = old + part
            arrays.state[remainder + k] = part - (new - old)
            arrays.state[x + k] = new
        else:
            arrays.state[x + k] = arrays.state[x + k] + dt * speed
    nearby = arrays.settings[scene, Setting.CONTACT_WIDTH]
    for k in ti.static(range(features.dimension)):
        free = arrays.state[x + k]
        length = arrays.offsets[scene, Offset.CELLS_X + k] * arrays.settings[scene, Setting.CELL]
        inside = clamp(free, 0.0, length)
        if ti.static(features.outflow):
            below, above = is_wall(2 * k, scene, arrays), is_wall(2 * k + 1, scene, arrays)
            beyond = ((free < inside) & (below == 0)) | ((free > inside) & (above == 0))
            inside = ti.select(beyond, free, inside)
        if ti.static(features.contact):
            # Where a solid covers a side of the box, contact keeps the particle in and takes its momentum.
            facing = arrays.state[contact_at(block, Contact.NORMAL + k, arrays)]
            near = arrays.state[contact_at(block, Contact.DISTANCE, arrays)] < nearby
            covered = near & (((free < inside) & (facing > 0.5)) | ((free > inside) & (facing < -0.5)))
            inside = ti.select(covered, free, inside)
        arrays.state[x + k] = inside


@ti.func
def remove_outflow(block, scene, arrays: ti.template()):
    """Remove particles of a block beyond an open side from the flow: they lose mass, stress and velocity."""
    features = arrays.features
    x = block * features.state.size
    here = arrays.state[x + features.state.present]
    for k in ti.static(range(features.dimension)):
        length = arrays.offsets[scene, Offset.CELLS_X + k] * arrays.settings[scene, Setting.CELL]
        # Where a solid covers a wall, a particle may be beyond the wall until contact moves it back.
        left = (arrays.state[x + k] < 0.0) & (is_wall(2 * k, scene, arrays) == 0)
        right = (arrays.state[x + k] > length) & (is_wall(2 * k + 1, scene, arrays) == 0)
        here = ti.select(left | right, 0.0, here)
    arrays.state[x + features.state.present] = here
    for k in ti.static(range(features.state.velocity, features.state.stress + features.stresses)):
        arrays.state[x + k] = here * arrays.state[x + k]


@ti.func
def update_stress(scene, block, scratch, near, dt, arrays: ti.template()):
    """Update the stress, and the plastic strain if needed, of a block by its new velocity gradient.

    near: whether it touches a solid. If the material softens, the strength in the step is explicit: it follows the
    plastic strain at the start of the step.
    """
    features = arrays.features
    first = no_overflow(block * features.state.size)
    lame, shear = property_of(scene, block, Property.LAME, arrays), property_of(scene, block, Property.SHEAR, arrays)
    strain = vectors(arrays.state, first + features.state.plastic_strain, int(features.softens))
    dx, values = arrays.settings[scene, Setting.CELL], law_values(scene, block, arrays)
    strengths = features.law.strengths(values, strain, dx, dt, features)
    stress = vectors(arrays.state, first + features.state.stress, features.stresses)
    increment = strain_increment(block, scratch, near, lame + 2.0 * shear, dt, arrays)
    opened, closed = 0.0 * stress[0], 0.0 * stress[0]
    if ti.static(features.volume_correction):
        if is_loose(block, arrays):
            tension = strengths[3] - arrays.settings[scene, Setting.LEAST_TENSION]
            opened = opened_of(scene, block, scratch, tension, lame + shear * (2.0 / 3.0), dt, arrays)
            closed = arrays.state[first + features.state.gap] - opened
    if ti.static(features.wet):
        volumetric = increment[0] + increment[features.dimension + 1]
        if ti.static(features.dimension == 3):
            volumetric += increment[8]
        # The closing of the gap by the density of the grid strains the water.
        arrays.state[first + features.state.volume_strain] = volumetric - closed / (lame + shear * (2.0 / 3.0))
    new = stress_step(stress, increment, opened, strengths, lame, shear, features)
    for k in ti.static(range(features.stresses)):
        arrays.state[first + features.state.stress + k] = new[k]
    if ti.static(features.contact):
        if near:
            density = property_of(scene, block, Property.DENSITY, arrays)
            shear_traction_step(scene, block, scratch, dt, shear, density, arrays)
    if ti.static(features.volume_correction):
        mean = (new[0] + new[1] + new[2]) / 3.0
        tension = strengths[3] - arrays.settings[scene, Setting.LEAST_TENSION]
        gap = kept_gap(new[features.stresses + 1], mean, tension, lame + shear * (2.0 / 3.0))
        arrays.state[first + features.state.gap] = arrays.settings[scene, Setting.CORRECTED] * gap
    if ti.static(features.strained):
        at = first + features.state.plastic_strain
        arrays.state[at] = arrays.state[at] + new[features.stresses]


@ti.func
def opened_of(scene, block, scratch, tension, bulk, dt, arrays: ti.template()):
    """K e [Pa] of the particles of a block in this step; tension: T - T_0 [Pa], bulk: K [Pa]."""
    features = arrays.features
    first = no_overflow(block * features.state.size)
    x = vectors(arrays.state, first, features.dimension)
    grid = vectors(arrays.scratch, scratch + features.scratch.density, 1 + features.dimension)
    cells = [arrays.offsets[scene, Offset.CELLS_X + k] for k in ti.static(range(features.dimension))]
    density, dx = property_of(scene, block, Property.DENSITY, arrays), arrays.settings[scene, Setting.CELL]
    gap = grid_gap(grid, x, contact_of(block, arrays), density, (dx, cells), features)
    rate = dt * arrays.settings[scene, Setting.GAP_RATE]
    before = arrays.state[first + features.state.gap]
    after = updated_gap(before, tension, bulk, rate, gap)
    if ti.static(features.wet):
        # Beside water the gap only decreases, and only if the water is open, too.
        least = ti.select(arrays.state[first + features.state.pore_pressure] < 0.0, minimum(after, before), before)
        after = ti.select(arrays.state[first + features.state.saturated] > 0.0, least, after)
    return after


@ti.func
def strain_increment(block, scratch, near, modulus, dt, arrays: ti.template()):
    """G [-] of a block, row by row: of its velocity gradient and the jump of velocity at solids; `modulus`: M [Pa]."""
    features = arrays.features
    first = no_overflow(block * features.state.size)
    gradient = [dt * arrays.state[first + features.state.affine + k] for k in ti.static(range(features.dimension**2))]
    increment = midpoint_increment(gradient, features.dimension)
    if ti.static(features.contact):
        if near:
            motion, _grains = motion_and_stress(block, scratch, arrays)
            stress = total_stress(block, [], arrays)
            jump = jump_at_contact(motion, stress, modulus, dt, features.dimension)
            if ti.static(features.wet):
                # Water and grains both remember an opening.
                _foot, opening = foot_velocity(motion, features.dimension)
                wet = arrays.state[first + features.state.saturated] > 0.0
                jump = ti.select(wet, dt * motion[2][Contact.DELTA] * opening, jump)
            strained = with_jump(increment, jump, motion[2], features.dimension)
            for k in ti.static(range(features.dimension**2)):
                increment[k] = strained[k]
    return increment


@ti.func
def law_values(scene, block, arrays: ti.template()):
    """The values of all columns of the law of a block; constant zeros for columns that the law does not read."""
    return [law_value(scene, block, column, arrays) for column in ti.static(list(arrays.features.law.Column))]


@ti.func
def law_value(scene, block, column: ti.template(), arrays: ti.template()):
    """One of these values."""
    columns = ti.static(arrays.features.law.columns(arrays.features))
    if ti.static(column in columns):
        return property_of(scene, block, column, arrays)
    else:
        return 0.0 * property_of(scene, block, columns[0], arrays)
