"""The pressure of water in the cells of the grid: the system of `mpm.physics.water`, its sources and its sweeps.

A cell belongs to the worker that computes the node below it (`mpm.physics.grid.owns`). In a shared scene the cell holds
the sum of the contributions of all workers, in their order, and the other workers get a copy of its result: the result
is the same to the bit on any number of threads.
"""

import taichi as ti

from datasets.scene.water import DENSITY
from mpm.arrays.access import columns_deep, maximum, minimum, synchronise, workers_of
from mpm.arrays.features import NODE
from mpm.arrays.layout import PADDING, Beside, Face, Offset, Pore, Setting, Span, Worker
from mpm.physics.boundary import is_wall
from mpm.physics.grid import has_node, own_node, owner_of, owns

FEWEST_SWEEPS, SWEEPS, MOST_SWEEPS = 2, 0.4, 12  # least number; addition per coefficient of the Laplacian / dx^2; most


@ti.func
def number(array: ti.template(), cell, which: ti.template()):
    """One of the numbers of a cell."""
    return array[2 * cell + which // NODE][which % NODE]


@ti.func
def solve_cells(thread, scene, stiffness, diffusion, arrays: ti.template()):
    """The change of the pressure in the cells, from the contributions of the particles of all workers."""
    first, end = workers_of(thread, arrays)
    synchronise(thread, arrays)
    for worker in range(first, end):
        list_cells(worker, scene, arrays)
    synchronise(thread, arrays)
    for worker in range(first, end):
        even, odd = arrays.workers[worker, Worker.EVEN], arrays.workers[worker, Worker.ODD]
        for n in range(even + odd):
            cell = listed_cell(worker, n if n < even else n - even, n < even, arrays)
            source_of_cell(cell, worker, scene, stiffness, diffusion, arrays)
    synchronise(thread, arrays)
    sweeps = ti.min(FEWEST_SWEEPS + ti.cast(SWEEPS * stiffness, ti.i32), MOST_SWEEPS)
    for half in range(2 * sweeps + 1):
        of_evens = half % 2 == 0
        for worker in range(first, end):
            for n in range(arrays.workers[worker, Worker.EVEN] if of_evens else arrays.workers[worker, Worker.ODD]):
                relax_cell(listed_cell(worker, n, of_evens, arrays), stiffness, half >= 2 * sweeps - 1, arrays)
        synchronise(thread, arrays)
    if ti.static(arrays.features.processor.shared):
        for worker in range(first, end):
            pass_cells_on(worker, scene, arrays)
        synchronise(thread, arrays)


@ti.func
def listed_cell(worker, n, of_evens, arrays: ti.template()):
    """The n-th cell listed by `list_cells`, among the even or the odd ones."""
    line = arrays.workers[worker, Worker.NODE] + n
    if not of_evens:
        line = arrays.workers[worker, Worker.NODE] + arrays.workers[worker, Worker.USED] - 1 - n
    return arrays.beside[line, Beside.LISTED]


@ti.func
def list_cells(worker, scene, arrays: ti.template()):
    """List a worker's cells with water, even ones from its first line on, odd ones from its last; sums become means."""
    table, deep, even, odd = arrays.workers[worker, Worker.COLUMN], columns_deep(scene, arrays), 0, 0
    first = arrays.workers[worker, Worker.NODE]
    end = first + arrays.workers[worker, Worker.USED]
    for n in range(arrays.workers[worker, Worker.ACTIVE]):
        column = arrays.spans[table + n, Span.ACTIVE] - table
        alone = arrays.spans[table + column, Span.ALONE] == 1
        for j in range(arrays.spans[table + column, Span.LOW], arrays.spans[table + column, Span.HIGH]):
            if alone or owns(column, j, worker, arrays):
                cell = own_node(column, j, worker, arrays)
                sums = arrays.cells[2 * cell]
                if not alone:
                    sums = given_to_cell(column, j, arrays)
                if sums[Pore.VOLUME] > 0.0:
                    per_volume = 1.0 / sums[Pore.VOLUME]
                    means = per_volume * sums
                    means[Pore.VOLUME], means[Pore.CLOSED] = sums[Pore.VOLUME], sums[Pore.CLOSED]
                    arrays.cells[2 * cell] = means
                    arrays.beside[cell, Beside.COLUMN] = column
                    line = first + even
                    if (j + column // deep + column % deep) % 2 == 0:
                        even += 1
                    else:
                        odd += 1
                        line = end - odd
                    arrays.beside[line, Beside.LISTED] = cell
    arrays.workers[worker, Worker.EVEN], arrays.workers[worker, Worker.ODD] = even, odd


@ti.func
def given_to_cell(column, j, arrays: ti.template()):
    """The contributions of the particles of all workers to a cell of a shared scene."""
    total = 0.0 * arrays.cells[0]
    for other in range(arrays.workers.shape[0]):
        if has_node(other, column, j, arrays):
            sums = arrays.cells[2 * own_node(column, j, other, arrays)]
            closed = ti.cast(total[Pore.CLOSED], ti.i32) | ti.cast(sums[Pore.CLOSED], ti.i32)
            total += sums
            total[Pore.CLOSED] = ti.cast(closed, float)
    return total


@ti.func
def pass_cells_on(worker, scene, arrays: ti.template()):
    """Copy the results in the cells of one worker of a shared scene to the other workers."""
    even = arrays.workers[worker, Worker.EVEN]
    for n in range(even + arrays.workers[worker, Worker.ODD]):
        cell = listed_cell(worker, n if n < even else n - even, n < even, arrays)
        column = arrays.beside[cell, Beside.COLUMN]
        at = arrays.workers[worker, Worker.COLUMN] + column
        if arrays.spans[at, Span.ALONE] == 0:
            j = cell - arrays.bases[at]
            for other in range(arrays.workers.shape[0]):
                if other != worker and has_node(other, column, j, arrays):
                    copy = own_node(column, j, other, arrays)
                    for half in ti.static(range(2)):
                        arrays.cells[2 * copy + half] = arrays.cells[2 * cell + half]


@ti.func
def neighbour(place, face: ti.template(), steps: ti.template(), worker, scene, arrays: ti.template()):
    """The cell `steps` beyond a face of the cell at `place`, (column of the box, j); -1 if there is none with water."""
    axis = ti.static(face // 2)
    towards = ti.static(steps * (2 * (face % 2) - 1))
    column, j, result = place[0], place[1], -1
    if ti.static(axis == 0):
        column += towards * columns_deep(scene, arrays)
    elif ti.static(axis == 1):
        j += towards
    else:
        column += towards
    owner, at = worker, arrays.workers[worker, Worker.COLUMN] + column
    there = arrays.spans[at, Span.LOW] <= j < arrays.spans[at, Span.HIGH]
    if ti.static(arrays.features.processor.shared):
        if arrays.spans[at, Span.HIGH] == 0 or arrays.spans[at, Span.ALONE] == 0:
            owner = owner_of(column, j, arrays)
            there = owner >= 0
    if there:
        cell = own_node(column, j, owner, arrays)
        if number(arrays.cells, cell, Pore.VOLUME) > 0.0:
            result = cell
    return result


@ti.func
def beyond_face(cell, place, next_cell, face: ti.template(), worker, scene, arrays: ti.template()):
    """What lies beyond a face of a cell, a `Face`; next_cell: the `neighbour` there."""
    axis = ti.static(face // 2)
    kind = ti.cast(Face.SURFACE, ti.i32)
    deep = columns_deep(scene, arrays)
    index = ti.Vector([place[0] // deep, place[1], place[0] % deep])
    solid = (ti.cast(number(arrays.cells, cell, Pore.CLOSED), ti.i32) >> face) & 1
    edge = index[axis] == (PADDING if face % 2 == 0 else PADDING - 1 + arrays.offsets[scene, Offset.CELLS_X + axis])
    if next_cell >= 0:
        kind = Face.CELL
    elif solid == 1 or (edge and is_wall(face, scene, arrays) == 1):
        kind = Face.TIGHT
        if (solid == 1 or face == 2) and arrays.settings[scene, Setting.DRAINED] > 0.0:
            kind = Face.DRAIN
    elif neighbour(place, face, 2, worker, scene, arrays) >= 0:
        kind = Face.GAP
    return kind


@ti.func
def below_surface(sums, face: ti.template()):
    """Distance from the centre of mass of a cell to a surface beyond a face [cells]: its material lies opposite."""
    return maximum(0.5 + ti.static(2 * (face % 2) - 1) * sums[Pore.CENTRE_X + ti.static(face // 2)], 0.25)


@ti.func
def source_of_cell(cell, worker, scene, stiffness, diffusion, arrays: ti.template()):
    """The explicit change of the pressure of a cell, its slope, the diagonal of the system and the neighbours."""
    features, dx = arrays.features, arrays.settings[scene, Setting.CELL]
    sums, table = arrays.cells[2 * cell], arrays.workers[worker, Worker.COLUMN]
    column, dry = arrays.beside[cell, Beside.COLUMN], arrays.beside.shape[0] - 1
    place = ti.Vector([column, cell - arrays.bases[table + column]])
    pressure, inflow, given = sums[Pore.PRESSURE], 0.0 * sums[Pore.PRESSURE], arrays.cells[2 * cell + 1]
    pull = ti.Vector([arrays.settings[scene, Setting.GRAVITY_X], arrays.settings[scene, Setting.GRAVITY_Y], 0.0 * dx])
    full, diagonal = 1.0 + 0.0 * pressure, 0.0 * pressure
    for axis in ti.static(range(features.dimension)):
        rise, run = 0.0 * pressure, 0.0 * pressure
        for side in ti.static(range(2)):
            face = ti.static(2 * axis + side)
            away = ti.static(2 * side - 1)
            next_cell = neighbour(place, face, 1, worker, scene, arrays)
            kind = beyond_face(cell, place, next_cell, face, worker, scene, arrays)
            arrays.beside[cell, face] = dry
            if kind == Face.CELL:
                arrays.beside[cell, face] = next_cell
                diagonal += stiffness
                other = arrays.cells[2 * next_cell]
                apart = maximum(1.0 + away * (other[Pore.CENTRE_X + axis] - sums[Pore.CENTRE_X + axis]), 0.25)
                weight = 0.0 * pressure
                for k in ti.static(range(features.dimension)):
                    part = other[Pore.CENTRE_X + k] - sums[Pore.CENTRE_X + k]
                    if ti.static(k == axis):
                        part += away
                    weight += DENSITY * dx * pull[k] * part
                there, here = other[Pore.PRESSURE] + other[Pore.SUCTION], pressure + sums[Pore.SUCTION]
                step = maximum(there, 0.0) - maximum(here, 0.0) - other[Pore.SUCTION] + sums[Pore.SUCTION]
                flow = (step - weight) / apart
                # No water flows out of pores that are not full.
                inflow += ti.select(ti.select(flow > 0.0, there, here) > 0.0, flow, 0.0)
                rise += away * step
                run += apart
            elif kind == Face.SURFACE or kind == Face.DRAIN:
                distance = 0.5 + 0.0 * pressure
                if kind == Face.SURFACE:
                    distance = below_surface(sums, face)
                    full *= minimum(2.0 * distance, 1.0)
                    diagonal += stiffness / distance
                else:
                    diagonal += diffusion / distance
                head = maximum(pressure, 0.0 - sums[Pore.SUCTION])
                outflow = head / distance + DENSITY * dx * pull[axis] * away
                if (outflow > 0.0 and pressure > 0.0) or (outflow < 0.0 and kind == Face.SURFACE):
                    inflow -= outflow
            elif kind == Face.GAP:
                # Water does not pass it, but the material beside it gives way.
                diagonal += (stiffness - diffusion) / below_surface(sums, face)
            elif kind == Face.TIGHT:
                rise += arrays.settings[scene, Setting.SEEPAGE] * DENSITY * dx * pull[axis]
                run += arrays.settings[scene, Setting.SEEPAGE]
        if run > 0.0:
            given[Pore.SLOPE_X + axis - NODE] = rise / run
    source = diffusion * inflow - full * arrays.settings[scene, Setting.WATER_MODULUS] * sums[Pore.STRAIN]
    given[Pore.SOURCE - NODE], given[Pore.SHARE - NODE] = source, full
    given[Pore.PER_DIAGONAL - NODE] = 1.0 / (full + diagonal)
    least = 0.0 - sums[Pore.SUCTION]
    given[Pore.FELT - NODE] = maximum(pressure + source / full, least) - maximum(pressure, least)
    arrays.cells[2 * cell + 1] = given


@ti.func
def relax_cell(cell, stiffness, last, arrays: ti.template()):
    """One projected Gauss-Seidel step for the change of the pressure in a cell and of the part that presses."""
    given, sums = arrays.cells[2 * cell + 1], arrays.cells[2 * cell]
    total = 0.0 * stiffness
    for face in ti.static(range(2 * arrays.features.dimension)):
        total += number(arrays.cells, arrays.beside[cell, face], Pore.FELT)
    total = given[Pore.SOURCE - NODE] + stiffness * total
    full, per_diagonal = given[Pore.SHARE - NODE], given[Pore.PER_DIAGONAL - NODE]
    pressure, least = sums[Pore.PRESSURE], 0.0 - sums[Pore.SUCTION]
    before = maximum(pressure, least)
    felt = maximum((full * (pressure - before) + total) * per_diagonal, least - before)
    arrays.cells[2 * cell + 1][Pore.FELT - NODE] = felt
    if last:
        change = before + felt - pressure
        if before + felt <= least:
            # Open: the pressure of its neighbours has opened it further.
            change = felt + (total - felt / per_diagonal) / full
        arrays.cells[2 * cell + 1][Pore.CHANGE - NODE] = change
