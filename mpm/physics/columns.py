"""The columns of the background grid: only nodes near material are in memory.

A column is a line of nodes along y at one place (x, z) of the box. The columns in use lie one after the other in a
worker's part of `grid`, each over the range [low, high) of j that the particles near it need. For every place of the
box, `bases` holds the number that node 0 of its column would have, so that node j has the number base + j. Memory and
time thus depend on the material, not on the size of the box.

A particle in cell c contributes to nodes c - 1 to c + 2 along each axis while it moves by less than half a cell.
Columns hold these nodes. They are rebuilt once the largest displacements of the steps since then add up to MARGIN, and
at the start of each call of the kernel, before which particles may have been sorted.
"""

import taichi as ti

from mpm.arrays.access import clamp, columns_deep, no_overflow
from mpm.arrays.layout import INDEX_LIMIT, PADDING, Offset, Setting, Span, Worker
from mpm.solids.face_lookup import entry_of, holds_of_node

MARGIN = 0.49  # cells that particles may move before columns are rebuilt: half a cell, less rounding in f32
OUTDATED = 1.0  # value of that displacement that forces a rebuild


@ti.func
def make_columns(worker, scene, arrays: ti.template()):
    """Make the columns of a worker from the places of its particles."""
    first, deep = arrays.workers[worker, Worker.COLUMN], columns_deep(scene, arrays)
    for n in range(arrays.workers[worker, Worker.ACTIVE]):
        arrays.spans[arrays.spans[first + n, Span.ACTIVE], Span.HIGH] = 0
    occupied = find_cells(worker, scene, first, deep, arrays)
    active = 0
    across = ti.static((-1, 3) if arrays.features.dimension == 3 else (0, 1))
    for n in range(occupied):
        cell = arrays.spans[first + n, Span.OCCUPIED]
        low, high = arrays.spans[cell, Span.CELL_LOW] - 1, arrays.spans[cell, Span.CELL_HIGH] + 2
        arrays.spans[cell, Span.CELL_HIGH] = 0
        for a in range(-1, 3):
            for b in range(across[0], across[1]):
                column = cell + a * deep + b
                if arrays.spans[column, Span.HIGH] == 0:
                    arrays.spans[first + active, Span.ACTIVE] = column
                    active += 1
                    arrays.spans[column, Span.LOW], arrays.spans[column, Span.HIGH] = low, high
                else:
                    arrays.spans[column, Span.LOW] = ti.min(arrays.spans[column, Span.LOW], low)
                    arrays.spans[column, Span.HIGH] = ti.max(arrays.spans[column, Span.HIGH], high)
    used, lowest, highest = 0, INDEX_LIMIT, -1
    for n in range(active):
        column = arrays.spans[first + n, Span.ACTIVE]
        lowest, highest = ti.min(lowest, column - first), ti.max(highest, column - first)
        low = arrays.spans[column, Span.LOW]
        arrays.bases[column] = arrays.workers[worker, Worker.NODE] + used - low
        high = arrays.spans[column, Span.HIGH]
        used += high - low
        if ti.static(arrays.features.listed):
            arrays.spans[column, Span.HELD] = has_holds(column - first, low, high, scene, arrays)
    arrays.workers[worker, Worker.ACTIVE], arrays.workers[worker, Worker.USED] = active, used
    arrays.workers[worker, Worker.LOWEST], arrays.workers[worker, Worker.HIGHEST] = lowest, highest


@ti.func
def find_cells(worker, scene, first, deep, arrays: ti.template()):
    """List the columns of cells that hold particles of a worker, with the range of these cells; return their number.

    Lanes that mirror a particle count, because they follow the grid, too.
    """
    features, lanes = arrays.features, arrays.features.lanes
    scratch, occupied = arrays.workers[worker, Worker.SCRATCH], 0
    per_dx = 1.0 / arrays.settings[scene, Setting.CELL]
    for block in range(arrays.workers[worker, Worker.FIRST], arrays.workers[worker, Worker.LAST]):
        for k in ti.static(range(features.dimension)):
            f = arrays.state[no_overflow(block * features.state.size) + k] * per_dx + PADDING
            # A particle that has left through an open side stays where it is, without mass.
            last = ti.cast(arrays.offsets[scene, Offset.CELLS_X + k] + (2 * PADDING - 2), float)
            arrays.scratch[scratch + features.scratch.lowest + k] = clamp(ti.floor(f), 1.0, last)
        for lane in range(lanes):
            at = no_overflow(scratch * lanes + lane) + features.scratch.lowest * lanes
            cell = first + ti.cast(arrays.scratch_lanes[at], ti.i32) * deep
            j = ti.cast(arrays.scratch_lanes[at + lanes], ti.i32)
            if ti.static(features.dimension == 3):
                cell += ti.cast(arrays.scratch_lanes[at + 2 * lanes], ti.i32)
            if arrays.spans[cell, Span.CELL_HIGH] == 0:
                arrays.spans[first + occupied, Span.OCCUPIED] = cell
                occupied += 1
                arrays.spans[cell, Span.CELL_LOW], arrays.spans[cell, Span.CELL_HIGH] = j, j + 1
            elif j < arrays.spans[cell, Span.CELL_LOW]:
                arrays.spans[cell, Span.CELL_LOW] = j
            elif j >= arrays.spans[cell, Span.CELL_HIGH]:
                arrays.spans[cell, Span.CELL_HIGH] = j + 1
    return occupied


@ti.func
def has_holds(column, low, high, scene, arrays: ti.template()):
    """1 where listed faces hold one of the nodes [low, high) of a column of the box, else 0."""
    result, deep = 0, columns_deep(scene, arrays)
    for j in range(low, high):
        first, end = holds_of_node(entry_of([column // deep, j, column % deep], scene, arrays), arrays)
        if end > first:
            result = 1
    return result


@ti.func
def has_room(worker, arrays: ti.template()):
    """Whether the columns of a worker, of all workers of a shared scene, fit in their parts of the grid."""
    result = arrays.workers[worker, Worker.USED] <= arrays.workers[worker, Worker.ROOM]
    if ti.static(arrays.features.processor.shared):
        for other in range(arrays.workers.shape[0]):
            if arrays.workers[other, Worker.USED] > arrays.workers[other, Worker.ROOM]:
                result = False
    return result


@ti.func
def node_at(column, j, arrays: ti.template()):
    """Number in `grid` of node j of a column."""
    return no_overflow(arrays.bases[column] + j)
