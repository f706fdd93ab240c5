"""Pore water of saturated material: the pressure p beside the effective stress sigma' of the grains.

The stress of the mixture is sigma' - p I; the strength depends on sigma'. Grains and water move together except for
Darcy flow (Terzaghi 1923; Biot 1941, with incompressible grains):

    dp/dt = Q [div(kappa (grad p - rho_w g)) - div v]

with Q and kappa of `datasets.scene.water`. p and the volume strain are fields of the cells of the grid (Hughes 1980;
the reasons of all this are in docs/theory/pore-water.md). A step is

    p_c = sum_p V_p p_p / sum_p V_p,    e_c = sum_p V_p tr(D_p) / sum_p V_p        over the particles p in cell c
    delta + L f = -Q e_c + dt Q kappa div(grad p_c - rho_w g),   f = max(p_c + delta, -u_c) - max(p_c, -u_c)
    p_p <- p_c + delta_c + s_c . (x_p - x_c)

with the slope s_c of p_c between the neighbours of a cell and its centre of mass x_c: a linear pressure stays
unchanged, and particles keep no pressure from other cells. L = -(dt Q kappa + (dt c)^2) Laplace, c^2 = Q / rho: it is
backward in time for the flow of water and for its pressure waves, so that these do not shorten the step. L acts on the
change f of the acting pressure, bounded below by the suction u that water bears: open pores carry no waves and pass
nothing on. If L acted on delta itself, it would smooth the opening of pores over the neighbours.

**Grains** strain with the water that flows: full pores keep their volume, and the change of volume due to the numerical
Q is no strain of the skeleton. The volume strain of the grains of a particle in a step is

    e_g = e_c - w_c - (q_p - change of max(p_p, 0)) / Q,    w_c = -waves (L f)_c / Q

with q_p the part of the change of p_p other than delta_c, by which particles of a cell equalise their pressure, and w_c
the strain that the waves' part of L removes.

Projected Gauss-Seidel sweeps (Cryer 1971) over red and black cells solve the system, starting from delta without L: a
few keep it stable, and a uniform strain is exact before the first.

Where a cell has no saturated neighbour, there is either a surface, with p = 0, or a solid, which is tight or a drain: a
wall of the box, or a solid touched by particles in the cell. A gap of one cell between two others is neither. Water
leaves and enters through a surface; for the little that enters, the suction is at most the mean effective stress of the
grains. At a tight solid nothing flows, and the slope is hydrostatic. The distance of a surface from the centre of mass
of a cell follows from the filling of the cell.

**Dilation.** If a material of the scene dilates, water bears a suction up to cavitation, and no more than the pressure
between grains; it ends with the dilation (`softening_length`).

**Opening.** Otherwise water bears no tension: forces use max(p, 0), while p falls below 0, so that an opening closes
before the water presses again. Grains do the same with their gap e (`mpm.physics.volume_correction`). Such strain
drifts. So where both are open, p < 0 and e > 0, the gap follows the density of the grid down, e <- min(e, its value
there), and its decrease is a volume strain of the particle, which raises p. It never follows the density up: such a gap
could not close while water fills it. For the same reason all opening at a solid counts as strain.
"""

import taichi as ti

from mpm.arrays.access import TINY, clamp, columns_deep, dot, maximum, minimum, no_overflow, vectors, workers_of
from mpm.arrays.features import NODE
from mpm.arrays.layout import PADDING, Contact, Offset, Pore, Property, Setting, Worker
from mpm.arrays.nodes import turn
from mpm.physics.columns import node_at
from mpm.physics.contact import contact_at
from mpm.physics.pore_pressure import suction_held
from mpm.physics.transfer import lowest_column, particles_in, property_of, volume_of
from mpm.physics.water_cells import solve_cells

MOST = 10.0  # cap on the diffusion number dt Q kappa / dx^2: such water drains before the grains react
STEEPEST = 3.0  # deviator over mean pressure that no cohesionless grains can bear [-]
DAMPING = 0.5  # share of the last f added to the pressure in the forces: it damps the water's pressure waves
LEANING = 0.05  # least component of a solid's normal along an axis for which it closes cell faces across the axis


@ti.func
def find_cells(scene, block, scratch, arrays: ti.template()):
    """Store in `scratch` the cells of a block, D vectors, and its positions from their centres [cells], D more."""
    features = arrays.features
    first, at = no_overflow(block * features.state.size), scratch + features.scratch.lowest
    for k in ti.static(range(features.dimension)):
        f = arrays.state[first + k] / arrays.settings[scene, Setting.CELL] + PADDING
        last = ti.cast(arrays.offsets[scene, Offset.CELLS_X + k] + (PADDING - 1), float)
        cell = clamp(ti.floor(f), 1.0 * PADDING, last)
        arrays.scratch[at + k] = cell
        arrays.scratch[at + features.dimension + k] = f - cell - 0.5


@ti.func
def cell_of(scratch, lane, table, deep, arrays: ti.template()):
    """The cell of the particle in `lane`, after `find_cells`."""
    column, j = lowest_column(arrays, scratch, lane, table, deep)
    return node_at(column, j, arrays)


@ti.func
def give_to_cells(scene, table, block, scratch, arrays: ti.template()):
    """Add the volume, volume strain, pressure and place of the saturated particles of a block to their cells."""
    features, lanes, deep = arrays.features, arrays.features.lanes, columns_deep(scene, arrays)
    first, values = no_overflow(block * features.state.size), scratch + features.scratch.values
    rows, places = (scratch + features.scratch.rows) * lanes // NODE, scratch + features.scratch.lowest
    find_cells(scene, block, scratch, arrays)
    weight = volume_of(scene, block, arrays) * arrays.state[first + features.state.saturated]
    arrays.scratch[values + Pore.VOLUME] = weight
    arrays.scratch[values + Pore.STRAIN] = weight * arrays.state[first + features.state.volume_strain]
    arrays.scratch[values + Pore.PRESSURE] = weight * arrays.state[first + features.state.pore_pressure]
    arrays.scratch[values + Pore.CLOSED] = 0.0 * weight
    for k in ti.static(range(3)):
        arrays.scratch[values + Pore.CENTRE_X + k] = 0.0 * weight
        if ti.static(k < features.dimension):
            arrays.scratch[values + Pore.CENTRE_X + k] = weight * arrays.scratch[places + features.dimension + k]
    stress = vectors(arrays.state, first + features.state.stress, 3)
    # Without flow no water is drawn in.
    drawn = 1.0 if features.dilates else arrays.settings[scene, Setting.SEEPAGE]
    arrays.scratch[values + Pore.SUCTION] = weight * drawn * suction_held(stress, True)
    faces = places + 2 * features.dimension
    if ti.static(features.contact):
        arrays.scratch[faces] = closed_faces(block, arrays)
    turn("to_rows", values, scratch + features.scratch.rows, arrays)
    for lane in range(particles_in(scene, block, arrays)):
        given = arrays.rows[no_overflow(rows + 4 * lane)]
        # A particle that has left the box, without volume, may be beyond the nodes of its column.
        if given[Pore.VOLUME] > 0.0:
            cell = cell_of(scratch, lane, table, deep, arrays)
            sums = arrays.cells[2 * cell] + given
            if ti.static(features.contact):
                closed = ti.cast(arrays.scratch_lanes[no_overflow(faces * lanes + lane)], ti.i32)
                if closed > 0:
                    sums[Pore.CLOSED] = ti.cast(ti.cast(sums[Pore.CLOSED], ti.i32) | closed, float)
            arrays.cells[2 * cell] = sums


@ti.func
def closed_faces(block, arrays: ti.template()):
    """The faces of cells that are closed by solids touched by the particles of a block, as `Pore.CLOSED`."""
    delta = arrays.state[contact_at(block, Contact.DELTA, arrays)]
    near, none, closed = delta > 0.0, 0.0 * delta, 0.0 * delta
    for k in ti.static(range(arrays.features.dimension)):
        normal = arrays.state[contact_at(block, Contact.NORMAL + k, arrays)]
        closed = closed + ti.select(near & (normal > LEANING), none + ti.static(4.0**k), none)
        closed = closed + ti.select(near & (normal < 0.0 - LEANING), none + ti.static(2.0 * 4.0**k), none)
    return closed


@ti.func
def update_water(thread, scene, dt, arrays: ti.template()):
    """Advance the pore pressure of a thread's particles by a step, after their positions and strains."""
    square = arrays.settings[scene, Setting.CELL] ** 2
    diffusion = ti.min(dt * arrays.settings[scene, Setting.WATER_DIFFUSION] / square, MOST)
    stiffness = diffusion + dt * dt * arrays.settings[scene, Setting.WATER_WAVE] / square
    solve_cells(thread, scene, stiffness, diffusion, arrays)
    first, end = workers_of(thread, arrays)
    for worker in range(first, end):
        table, scratch = arrays.workers[worker, Worker.COLUMN], arrays.workers[worker, Worker.SCRATCH]
        for block in range(arrays.workers[worker, Worker.FIRST], arrays.workers[worker, Worker.LAST]):
            take_from_cells(scene, table, block, scratch, 1.0 - diffusion / stiffness, arrays)


@ti.func
def take_from_cells(scene, table, block, scratch, waves, arrays: ti.template()):
    """Set the pore pressure of the particles of a block, and the strain of their grains, from their cells."""
    features, lanes, deep = arrays.features, arrays.features.lanes, columns_deep(scene, arrays)
    first, values = no_overflow(block * features.state.size), scratch + features.scratch.values
    rows, places = (scratch + features.scratch.rows) * lanes // NODE, scratch + features.scratch.lowest
    find_cells(scene, block, scratch, arrays)
    weight = volume_of(scene, block, arrays) * arrays.state[first + features.state.saturated]
    shares = places + 2 * features.dimension
    arrays.scratch[shares] = weight
    for lane in range(lanes):
        if arrays.scratch_lanes[no_overflow(shares * lanes + lane)] > 0.0:
            cell, row = cell_of(scratch, lane, table, deep, arrays), no_overflow(rows + 4 * lane)
            arrays.rows[row], arrays.rows[row + 1] = arrays.cells[2 * cell], arrays.cells[2 * cell + 1]
    turn("to_lanes", scratch + features.scratch.rows, values, arrays)
    of_cell = vectors(arrays.scratch, values, 2 * NODE)
    wet = weight > 0.0
    change, modulus = of_cell[Pore.CHANGE], arrays.settings[scene, Setting.WATER_MODULUS]
    p = of_cell[Pore.PRESSURE] + change
    for k in ti.static(range(features.dimension)):
        apart = arrays.scratch[places + features.dimension + k] - of_cell[Pore.CENTRE_X + k]
        p = p + of_cell[Pore.SLOPE_X + k] * apart
    least = ti.static(-1.0 * features.dilates) * of_cell[Pore.SUCTION]
    pressure, strained = first + features.state.pore_pressure, first + features.state.volume_strain
    before = arrays.state[pressure]
    mixed = p - change - before - (maximum(p, least) - maximum(before, least))
    removed = waves * (change - of_cell[Pore.SOURCE] / of_cell[Pore.SHARE])
    strain = of_cell[Pore.STRAIN] - arrays.state[strained] - (mixed + removed) / modulus
    arrays.state[pressure] = ti.select(wet, p, before)
    arrays.state[strained] = ti.select(wet, DAMPING * of_cell[Pore.FELT], arrays.state[strained])
    for k in ti.static(range(features.dimension)):
        slope = of_cell[Pore.SLOPE_X + k] / arrays.settings[scene, Setting.CELL]
        arrays.state[first + features.state.pressure_slope + k] = ti.select(wet, slope, 0.0 * p)
    share_strain(scene, block, ti.select(wet, strain, 0.0 * strain), arrays)


@ti.func
def share_strain(scene, block, strain, arrays: ti.template()):
    """Give the grains of a block the `strain` [-] by which the volume strain of their cells exceeds their own."""
    features, first = arrays.features, no_overflow(block * arrays.features.state.size)
    lame, shear = property_of(scene, block, Property.LAME, arrays), property_of(scene, block, Property.SHEAR, arrays)
    stress, gap = first + features.state.stress, first + features.state.gap
    opened, change = arrays.state[gap], (lame + shear * (2.0 / 3.0)) * strain
    if ti.static(features.cohesive or not features.volume_correction):
        if ti.static(features.volume_correction):
            # An open crack closes by its own strain only.
            change = ti.select(opened > 0.0, 0.0, change)
        for k in ti.static(range(3)):
            arrays.state[stress + k] = arrays.state[stress + k] + change
    else:
        # An opening closes before grains carry stress, and grains under tension open. Where they carry almost nothing,
        # the deviator vanishes continuously, too: the return map has not seen this strain.
        mean = (arrays.state[stress] + arrays.state[stress + 1] + arrays.state[stress + 2]) / 3.0
        level = opened + change + mean
        arrays.state[gap], level = maximum(level, 0.0), minimum(level, 0.0)
        deviator = [
            arrays.state[stress + k] - mean if k < 3 else arrays.state[stress + k]
            for k in ti.static(range(features.stresses))
        ]
        square = dot(deviator, deviator) + TINY
        scale = minimum((0.0 - STEEPEST) * level / ti.sqrt(square), 1.0)
        for k in ti.static(range(features.stresses)):
            part = scale * deviator[k]
            if ti.static(k < 3):
                part = part + level
            arrays.state[stress + k] = part
