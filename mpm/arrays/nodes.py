"""Where a node stands in the flat array of nodes."""

import taichi as ti

from mpm.arrays.layout import PADDING, Offset


@ti.func
def cells_of(scene, arrays: ti.template()):
    """Cells of the box along each axis, shape [D]."""
    features = arrays.features
    return ti.Vector([arrays.offsets[scene, Offset.CELLS_X + k] for k in ti.static(range(features.dimension))])


@ti.func
def rows_of(scene, arrays: ti.template()):
    """Nodes from one to its neighbour along each axis, shape [3]; the last axis is the innermost."""
    features = arrays.features
    across = arrays.offsets[scene, Offset.CELLS_Y] + 2 * PADDING + 1
    if ti.static(features.dimension == 2):
        return ti.Vector([across, 1, 0])
    else:
        deep = arrays.offsets[scene, Offset.CELLS_Z] + 2 * PADDING + 1
        return ti.Vector([across * deep, deep, 1])
