"""Pore water of saturated material: the pressure p beside the effective stress sigma' of the grains.

The stress of the mixture is sigma' - p I; strength is that of sigma'. Grains and water move together but for Darcy's
flow (Terzaghi 1923; Biot 1941, of grains that cannot be compressed):

    dp/dt = Q [div(kappa (grad p - rho_w g)) - div v]

with Q and kappa of `datasets.scene.water`. p and the volume strain are fields of the cells of the grid (Hughes 1980;
the reasons of all this are in docs/theory/pore-water.md). A step is

    p_c = sum_p V_p p_p / sum_p V_p,    e_c = sum_p V_p tr(D_p) / sum_p V_p        over the particles p in cell c
    delta + L f = -Q e_c + dt Q kappa div(grad p_c - rho_w g),   f = max(p_c + delta, -u_c) - max(p_c, -u_c)
    p_p <- p_c + delta_c + s_c . (x_p - x_c)

with the slope s_c of p_c between the neighbours of a cell and its centre of mass x_c: so a linear pressure stays as it
is, and what particles keep of other cells is gone. L = -(dt Q kappa + (dt c)^2) Laplace, c^2 = Q / rho: backward in
time for the flow of water, and for its pressure waves as much, so that these do not shorten the step. L acts on the
change f of what presses, down to the suction u that water bears: pores that are open carry no waves and pass nothing
on; were it to act on delta itself, it would smooth over the neighbours how far pores have opened.

**Grains** strain by the water that flows: full pores keep their volume, and what the numerical Q lets it change is no
strain of the skeleton. The volume strain of the grains of a particle in a step is

    e_g = e_c - w_c - (q_p - change of max(p_p, 0)) / Q,    w_c = -waves (L f)_c / Q

with q_p the part of the change of p_p that is not delta_c, by which particles of a cell share their pressure, and w_c
the strain that the waves' part of L takes away.

Projected Gauss-Seidel sweeps (Cryer 1971) over red and black cells solve the system, from delta without L on: a few
keep it stable, and a uniform strain is exact before the first.

Where a cell has no saturated neighbour is a surface, with p = 0, or something solid, which is tight or a drain: a wall
of the box or what particles in the cell touch. A gap of one cell between two others is neither. Through a surface water
leaves and enters; it draws in what little that takes by a suction of the grains' mean effective stress at most. At a
tight solid nothing flows, and the slope there is that at rest; a surface lies as far from the centre of mass of a cell
as what fills it from the other side tells.

**Dilation.** Where a material of the scene dilates, water bears a suction up to that of cavitation, and no more than
presses grains on each other; it ends with the dilation (`softening_length`).

**Opening.** Else water pulls nothing: forces have max(p, 0), while p goes on below 0, so that what has opened closes
before it presses again. Grains do the same with their gap e (`mpm.physics.volume_correction`). Such strain drifts. So
where both are open, p < 0 and e > 0, the gap follows the density of the grid down, e <- min(e, its value there), and
what it loses is volume strain of the particle, by which p grows. It never follows the density up: such a gap could not
close while water fills it. For the same reason all that opens at a solid is strain.
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

MOST = 10.0  # diffusion number dt Q kappa / dx^2 beyond which water is no faster: it is gone before the grains notice
STEEPEST = 3.0  # deviator over mean pressure that no grains without cohesion bear [-]
DAMPING = 0.5  # part of the last f by which the pressure in the forces is ahead: it damps the water's pressure waves
LEANING = 0.05  # least component of a solid's normal along an axis by which it closes the cells' faces across that


@ti.func
def find_cells(scene, block, scratch, arrays: ti.template()):
    """Leave in `scratch` the cells of a block, D vectors, and its places from their middles [cells], D more."""
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
    # Water that does not flow draws none in.
    drawn = 1.0 if features.dilates else arrays.settings[scene, Setting.SEEPAGE]
    arrays.scratch[values + Pore.SUCTION] = weight * drawn * suction_held(stress, True)
    faces = places + 2 * features.dimension
    if ti.static(features.contact):
        arrays.scratch[faces] = closed_faces(block, arrays)
    turn("to_rows", values, scratch + features.scratch.rows, arrays)
    for lane in range(particles_in(scene, block, arrays)):
        given = arrays.rows[no_overflow(rows + 4 * lane)]
        # What has left the box, without volume, may be beyond the nodes of its column.
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
    """The faces of their cells that solids close which the particles of a block touch, as `Pore.CLOSED`."""
    delta = arrays.state[contact_at(block, Contact.DELTA, arrays)]
    near, none, closed = delta > 0.0, 0.0 * delta, 0.0 * delta
    for k in ti.static(range(arrays.features.dimension)):
        normal = arrays.state[contact_at(block, Contact.NORMAL + k, arrays)]
        closed = closed + ti.select(near & (normal > LEANING), none + ti.static(4.0**k), none)
        closed = closed + ti.select(near & (normal < 0.0 - LEANING), none + ti.static(2.0 * 4.0**k), none)
    return closed


@ti.func
def update_water(thread, scene, dt, arrays: ti.template()):
    """Bring the pore pressure of a thread's particles forward by a step, after their new places and strains."""
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
    """Pore pressure of the particles of a block from that of their cells; their grains get the strain of these."""
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
    """Give the grains of a block `strain` [-], by which the volume strain of their cells exceeds their own."""
    features, first = arrays.features, no_overflow(block * arrays.features.state.size)
    lame, shear = property_of(scene, block, Property.LAME, arrays), property_of(scene, block, Property.SHEAR, arrays)
    stress, gap = first + features.state.stress, first + features.state.gap
    opened, change = arrays.state[gap], (lame + shear * (2.0 / 3.0)) * strain
    if ti.static(features.cohesive or not features.volume_correction):
        if ti.static(features.volume_correction):
            # Cracks close alone.
            change = ti.select(opened > 0.0, 0.0, change)
        for k in ti.static(range(3)):
            arrays.state[stress + k] = arrays.state[stress + k] + change
    else:
        # What is open closes before it bears, and grains that would pull open. Where they bear next to nothing their
        # deviator ends too, continuously: the return map has not seen this strain.
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
