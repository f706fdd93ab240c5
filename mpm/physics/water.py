"""Pore water of saturated material: the pressure p beside the effective stress sigma' of the grains.

The stress of the mixture is sigma' - p I; strength is that of sigma'. Grains and water move together but for Darcy's
flow (Terzaghi 1923; Biot 1941, of grains that cannot be compressed):

    dp/dt = Q [div(kappa (grad p - rho_w g)) - div v]

with Q and kappa of `datasets.scene.water`. p is a field of the cells of the grid, constant volume strain over each:
that of each particle times Q would make of the scatter of particles, which no node feels, a scatter of p that opens and
slides grains at random (the locking of Nagtegaal, Parks & Rice 1974, cured as by Hughes 1980). A step is

    p_c = sum_p V_p p_p / sum_p V_p,    e_c = sum_p V_p tr(D_p) / sum_p V_p        over the particles p in cell c
    (1 + L) delta = -Q e_c + dt Q kappa div(grad p_c - rho_w g)
    p_p <- p_c + delta_c + s_c . (x_p - x_c)

with the slope s_c of p_c between the neighbours of a cell and its centre of mass x_c: so a linear pressure stays as it
is, and what particles keep of other cells is gone. L = -(dt Q kappa + (dt c)^2) Laplace, c^2 = Q / rho: backward in
time for the flow of water, and for its pressure waves as much, so that these do not shorten the step. At a wave number
k 1 / Q + (dt k)^2 / rho then stands for 1 / Q, which over M is (step_fraction k dx)^2 more.

**Grains** strain by the water that flows: full pores keep their volume, and what the numerical Q lets it change is no
strain of the skeleton. The volume strain of the grains of a particle in a step is

    e_g = e_c - w_c - (q_p - change of max(p_p, 0)) / Q,    w_c = waves (delta_c - source_c) / Q

with q_p the part of the change of p_p that is not delta_c, by which particles of a cell share their pressure, and w_c
the strain that the waves' part of L takes away. Where p > 0 that is the flow alone, kappa div(grad p - rho_w g) dt:
undrained grains keep their mean effective stress to rounding, whatever Q, E and the scatter of e_c. Where water has
opened, it is e_c but for the sharing, and the stress comes back as p does.

Gauss-Seidel sweeps over red and black cells solve the system, from delta without L on: a few keep it stable, and a
uniform strain is exact before the first.

Where a cell has no saturated neighbour is a surface, with p = 0, or something solid, which is tight or a drain: a wall
of the box or what particles in the cell touch. A gap of one cell between two others is neither. Through a surface water
leaves and enters: grains that are relieved swell, and draw in what little that takes (p' / M of the volume) by a
suction of p' at most, their own mean effective stress; so p tends to that of water at rest from above and from below.

At a tight solid nothing flows, and the slope there is that at rest; a surface lies as far from the centre of mass of
a cell as what fills it from the other side tells.

**Dilation.** Grains that dilate while they shear suck, those that contract press on their water: the return map does
that, at the volume that water keeps. Where a material of the scene dilates, water bears a suction up to that of
cavitation, and no more than presses grains on each other; it ends with the dilation (`softening_length`).

**Opening.** Else water pulls nothing: forces have max(p, 0), while p goes on below 0, so that what has opened closes
before it presses again. Grains do the same with their gap e (`mpm.physics.volume_correction`). Such strain drifts: in
a flow that shears, openings add up that the places of the particles do not show, and neither water nor grains would
press again. So where both are open, p < 0 and e > 0, the gap follows the density of the grid down, e <- min(e, its
value there), and what it loses is volume strain of the particle, by which p grows. It never follows the density up:
such a gap could not close while water fills it, and the grains would have lost their friction for good. For the same
reason all that opens at a solid is strain.
"""

import taichi as ti

from datasets.scene.water import DENSITY
from mpm.arrays.access import TINY, clamp, columns_deep, dot, maximum, minimum, no_overflow, vectors
from mpm.arrays.features import NODE
from mpm.arrays.layout import PADDING, Beside, Contact, Face, Offset, Pore, Property, Setting, Span, Worker
from mpm.arrays.nodes import turn
from mpm.physics.boundary import is_wall
from mpm.physics.columns import node_at
from mpm.physics.contact import contact_at, suction_held
from mpm.physics.transfer import lowest_column, particles_in, property_of, volume_of

MOST = 10.0
"""Diffusion number dt Q kappa / dx^2 beyond which water is no faster: it is gone before the grains notice."""
FEWEST_SWEEPS, SWEEPS, MOST_SWEEPS = 2, 0.4, 12
"""Sweeps: so many, more by the coefficient of the Laplacian over dx^2, at most."""
STEEPEST = 3.0
"""Deviator over mean pressure that no grains without cohesion bear [-]."""
DAMPING = 0.5
"""Part of its last change by which the pressure in the forces is ahead: it damps the water's pressure waves."""
LEANING = 0.05
"""Least component of a solid's normal along an axis by which it closes the cells' faces across that."""


@ti.func
def number(array: ti.template(), cell, which: ti.template()):
    """One of the numbers of a cell."""
    return array[2 * cell + which // NODE][which % NODE]


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
    arrays.scratch[values + Pore.SUCTION] = weight * suction_held(stress, True)
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
def update_water(worker, scene, dt, arrays: ti.template()):
    """Bring the pore pressure of a worker's particles forward by a step, after their new places and strains."""
    square = arrays.settings[scene, Setting.CELL] ** 2
    diffusion = ti.min(dt * arrays.settings[scene, Setting.WATER_DIFFUSION] / square, MOST)
    stiffness = diffusion + dt * dt * arrays.settings[scene, Setting.WATER_WAVE] / square
    first = arrays.workers[worker, Worker.NODE]
    end = first + arrays.workers[worker, Worker.USED]
    even, odd = list_cells(worker, scene, first, end, arrays)
    for n in range(even + odd):
        line = first + n if n < even else end - 1 - (n - even)
        source_of_cell(arrays.beside[line, Beside.LISTED], worker, scene, stiffness, diffusion, arrays)
    sweeps = ti.min(FEWEST_SWEEPS + ti.cast(SWEEPS * stiffness, ti.i32), MOST_SWEEPS)
    for half in range(2 * sweeps + 1):
        of_evens = half % 2 == 0
        for n in range(even if of_evens else odd):
            line = first + n if of_evens else end - 1 - n
            relax_cell(arrays.beside[line, Beside.LISTED], stiffness, arrays)
    table, scratch = arrays.workers[worker, Worker.COLUMN], arrays.workers[worker, Worker.SCRATCH]
    for block in range(arrays.workers[worker, Worker.FIRST], arrays.workers[worker, Worker.LAST]):
        take_from_cells(scene, table, block, scratch, 1.0 - diffusion / stiffness, arrays)


@ti.func
def list_cells(worker, scene, first, end, arrays: ti.template()):
    """List the cells with water, every other one from line `first` on, the rest from `end` back; how many each are.

    Their sums become means.
    """
    table, deep, even, odd = arrays.workers[worker, Worker.COLUMN], columns_deep(scene, arrays), 0, 0
    for n in range(arrays.workers[worker, Worker.ACTIVE]):
        column = arrays.spans[table + n, Span.ACTIVE]
        for j in range(arrays.spans[column, Span.LOW], arrays.spans[column, Span.HIGH]):
            cell = node_at(column, j, arrays)
            sums = arrays.cells[2 * cell]
            if sums[Pore.VOLUME] > 0.0:
                per_volume = 1.0 / sums[Pore.VOLUME]
                means = per_volume * sums
                means[Pore.VOLUME], means[Pore.CLOSED] = sums[Pore.VOLUME], sums[Pore.CLOSED]
                arrays.cells[2 * cell] = means
                arrays.beside[cell, Beside.COLUMN] = column
                line = first + even
                if (j + (column - table) // deep + (column - table) % deep) % 2 == 0:
                    even += 1
                else:
                    odd += 1
                    line = end - odd
                arrays.beside[line, Beside.LISTED] = cell
    return even, odd


@ti.func
def neighbour(place, face: ti.template(), steps: ti.template(), table, scene, arrays: ti.template()):
    """The cell so many steps beyond a face of the one at `place`, -1 where none with water is."""
    axis = ti.static(face // 2)
    towards = ti.static(steps * (2 * (face % 2) - 1))
    column, j, result = place[0], place[1], -1
    if ti.static(axis == 0):
        column += towards * columns_deep(scene, arrays)
    elif ti.static(axis == 1):
        j += towards
    else:
        column += towards
    if arrays.spans[column, Span.LOW] <= j and j < arrays.spans[column, Span.HIGH]:
        cell = node_at(column, j, arrays)
        if number(arrays.cells, cell, Pore.VOLUME) > 0.0:
            result = cell
    return result


@ti.func
def beyond_face(cell, place, face: ti.template(), table, scene, arrays: ti.template()):
    """What lies beyond a face of a cell, a `Face`."""
    axis = ti.static(face // 2)
    kind = ti.cast(Face.SURFACE, ti.i32)
    deep = columns_deep(scene, arrays)
    index = ti.Vector([(place[0] - table) // deep, place[1], (place[0] - table) % deep])
    solid = (ti.cast(number(arrays.cells, cell, Pore.CLOSED), ti.i32) >> face) & 1
    edge = index[axis] == (PADDING if face % 2 == 0 else PADDING - 1 + arrays.offsets[scene, Offset.CELLS_X + axis])
    if neighbour(place, face, 1, table, scene, arrays) >= 0:
        kind = Face.CELL
    elif solid == 1 or (edge and is_wall(face, scene, arrays) == 1):
        kind = Face.TIGHT
        if (solid == 1 or face == 2) and arrays.settings[scene, Setting.DRAINED] > 0.0:
            kind = Face.DRAIN
    elif neighbour(place, face, 2, table, scene, arrays) >= 0:
        kind = Face.GAP
    return kind


@ti.func
def below_surface(sums, face: ti.template()):
    """How far the centre of mass of a cell lies below a surface beyond a face [cells]: what fills it lies opposite."""
    return ti.max(0.5 + ti.static(2 * (face % 2) - 1) * sums[Pore.CENTRE_X + ti.static(face // 2)], 0.25)


@ti.func
def source_of_cell(cell, worker, scene, stiffness, diffusion, arrays: ti.template()):
    """The change of the pressure of a cell explicit in time, its slope, the diagonal of the system, its neighbours."""
    features, dx = arrays.features, arrays.settings[scene, Setting.CELL]
    sums, table = arrays.cells[2 * cell], arrays.workers[worker, Worker.COLUMN]
    column, dry = arrays.beside[cell, Beside.COLUMN], arrays.beside.shape[0] - 1
    place = ti.Vector([column, cell - arrays.bases[column]])
    pressure, inflow, given = sums[Pore.PRESSURE], 0.0 * sums[Pore.PRESSURE], arrays.cells[2 * cell + 1]
    pull = ti.Vector([arrays.settings[scene, Setting.GRAVITY_X], arrays.settings[scene, Setting.GRAVITY_Y], 0.0 * dx])
    full, diagonal = 1.0 + 0.0 * pressure, 0.0 * pressure
    for axis in ti.static(range(features.dimension)):
        rise, run = 0.0 * pressure, 0.0 * pressure
        for side in ti.static(range(2)):
            face = ti.static(2 * axis + side)
            away = ti.static(2 * side - 1)
            kind = beyond_face(cell, place, face, table, scene, arrays)
            arrays.beside[cell, face] = dry
            if kind == Face.CELL:
                next_cell = neighbour(place, face, 1, table, scene, arrays)
                arrays.beside[cell, face] = next_cell
                diagonal += stiffness
                other = arrays.cells[2 * next_cell]
                apart = ti.max(1.0 + away * (other[Pore.CENTRE_X + axis] - sums[Pore.CENTRE_X + axis]), 0.25)
                weight = 0.0 * pressure
                for k in ti.static(range(features.dimension)):
                    part = other[Pore.CENTRE_X + k] - sums[Pore.CENTRE_X + k]
                    if ti.static(k == axis):
                        part += away
                    weight += DENSITY * dx * pull[k] * part
                there, here = other[Pore.PRESSURE] + other[Pore.SUCTION], pressure + sums[Pore.SUCTION]
                step = ti.max(there, 0.0) - ti.max(here, 0.0) - other[Pore.SUCTION] + sums[Pore.SUCTION]
                flow = (step - weight) / apart
                # Nothing flows out of pores that are not full.
                if (flow > 0.0 and there > 0.0) or (flow < 0.0 and here > 0.0):
                    inflow += flow
                rise += away * step
                run += apart
            elif kind == Face.SURFACE or kind == Face.DRAIN:
                distance = 0.5 + 0.0 * pressure
                if kind == Face.SURFACE:
                    distance = below_surface(sums, face)
                    full *= ti.min(2.0 * distance, 1.0)
                    diagonal += stiffness / distance
                else:
                    diagonal += diffusion / distance
                head = ti.max(pressure, 0.0 - sums[Pore.SUCTION])
                outflow = head / distance + DENSITY * dx * pull[axis] * away
                if (outflow > 0.0 and pressure > 0.0) or (outflow < 0.0 and kind == Face.SURFACE):
                    inflow -= outflow
            elif kind == Face.GAP:
                # Water does not pass it, but what is beside it gives way.
                diagonal += (stiffness - diffusion) / below_surface(sums, face)
            elif kind == Face.TIGHT:
                rise += arrays.settings[scene, Setting.SEEPAGE] * DENSITY * dx * pull[axis]
                run += arrays.settings[scene, Setting.SEEPAGE]
        if run > 0.0:
            given[Pore.SLOPE_X + axis - NODE] = rise / run
    source = diffusion * inflow - full * arrays.settings[scene, Setting.WATER_MODULUS] * sums[Pore.STRAIN]
    given[Pore.CHANGE - NODE], given[Pore.SOURCE - NODE] = source / full, source
    given[Pore.SHARE - NODE], given[Pore.PER_DIAGONAL - NODE] = full, 1.0 / (full + diagonal)
    arrays.cells[2 * cell + 1] = given


@ti.func
def relax_cell(cell, stiffness, arrays: ti.template()):
    """One step of Gauss and Seidel for the change of the pressure in a cell."""
    given = arrays.cells[2 * cell + 1]
    total = 0.0 * stiffness
    for face in ti.static(range(2 * arrays.features.dimension)):
        total += number(arrays.cells, arrays.beside[cell, face], Pore.CHANGE)
    total = (given[Pore.SOURCE - NODE] + stiffness * total) * given[Pore.PER_DIAGONAL - NODE]
    arrays.cells[2 * cell + 1][Pore.CHANGE - NODE] = total


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
    arrays.state[strained] = ti.select(wet, DAMPING * change, arrays.state[strained])
    if ti.static(features.contact):
        foot, none = p, 0.0 * p
        away = arrays.state[contact_at(block, Contact.DISTANCE, arrays)] / arrays.settings[scene, Setting.CELL]
        for k in ti.static(range(features.dimension)):
            foot = foot - of_cell[Pore.SLOPE_X + k] * arrays.state[contact_at(block, Contact.NORMAL + k, arrays)] * away
        near = wet & (arrays.state[contact_at(block, Contact.DELTA, arrays)] > 0.0)
        higher = maximum(foot, least) - maximum(p, least)
        arrays.state[first + features.state.foot_pressure] = ti.select(near, higher, none)
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
