"""Contact with a terrain in 3D: a bed that is smooth below the size of a cell.

    H(x, z) = sum_ik w_i(x) w_k(z) H_ik,    d = (y - H) / s,    n = (-H_x, 1, -H_z) / s,    s = sqrt(1 + H_x^2 + H_z^2)

with the elevations H_ik of the raster at the nodes of a lattice in plan, half a cell apart (`mpm.solids.bed`), and
quadratic B-splines w, as of the transfers. The distance d is measured from the plane through (x, H, z) with the normal
n: it is exact on the bed and for planes. Creases are rounded over a cell, below which the grid has no velocities of its
own, so that normals never jump, and nine elevations suffice for the contact of a particle, however rough the ground is.

A node of the grid deep in the bed is held as by a face (`mpm.solids.obstacles`), with d, n and the friction there.
"""

import taichi as ti

from mpm.arrays.access import clamp, dot
from mpm.arrays.layout import BED_FIRST, BED_PER_CELL, PADDING, BedUnder, Offset, Setting, TerrainNumber

FADE = 0.5
"""Depth [cells] in a solid over which its hold of a node grows from none to full. With three quarters of a cell, nodes
give way while a bed builds up against the solid, and its thrust is up to 15 % too low."""
FAR_BELOW = -1.0e30  # elevation [m] of an absent bed


@ti.func
def in_terrain(face, scene, arrays: ti.template()):
    """Whether the number of a face denotes the scene's bed; constant for the compiler if scenes have none."""
    if ti.static(arrays.features.terrain):
        return face >= arrays.offsets[scene, Offset.TERRAIN_FACE]
    else:
        return False


@ti.func
def bed_spacing(scene, arrays: ti.template()):
    """Distance between the nodes of the lattice [m]."""
    return arrays.settings[scene, Setting.CELL] / BED_PER_CELL


@ti.func
def lattice_nodes(axis: ti.template(), scene, arrays: ti.template()):
    """How many nodes the lattice has along an axis."""
    return BED_PER_CELL * arrays.offsets[scene, Offset.CELLS_X + axis] + 2 * BED_FIRST + 1


@ti.func
def lowest_node(x, axis: ti.template(), scene, arrays: ti.template()):
    """The number (as a real) of the first of the three lattice nodes around `x` [m], and its coordinate [m]."""
    spacing = bed_spacing(scene, arrays)
    last = ti.cast(lattice_nodes(axis, scene, arrays) - 3, float)
    node = clamp(ti.floor(x / spacing + (BED_FIRST - 0.5)), 0.0 * x, 0.0 * x + last)
    return node, (node - 1.0 * BED_FIRST) * spacing


@ti.func
def place_in_bed(i, k, scene, arrays: ti.template()):
    """Places in `terrain` of a lattice node's elevation and of its friction, or that of the bed; the stride along x."""
    along, across = lattice_nodes(0, scene, arrays), lattice_nodes(2, scene, arrays)
    height = arrays.offsets[scene, Offset.TERRAIN] + ti.static(len(TerrainNumber)) + i * across + k
    friction = height + along * across
    if not varied_friction(scene, arrays):
        friction = arrays.offsets[scene, Offset.TERRAIN] + TerrainNumber.FRICTION
    return height, friction, across


@ti.func
def varied_friction(scene, arrays: ti.template()):
    """Whether the friction of a bed varies in space."""
    return arrays.offsets[scene, Offset.TERRAIN_FRICTION] == 1


@ti.func
def spline(x, corner, spacing):
    """The three weights along an axis at `x` [m] [-], and their slopes [1/m], from the first node at `corner` [m]."""
    f = (x - corner) / spacing
    low, middle, high = 1.5 - f, f - 1.0, f - 0.5
    weights = [0.5 * low * low, 0.75 - middle * middle, 0.5 * high * high]
    return weights, [(0.0 - low) / spacing, -2.0 * middle / spacing, high / spacing]


@ti.func
def row_sum(numbers: ti.template(), row: ti.template(), w: ti.template()):
    """The sum of a row of nine numbers times weights."""
    return numbers[3 * row] * w[0] + numbers[3 * row + 1] * w[1] + numbers[3 * row + 2] * w[2]


@ti.func
def spline_sums(x: ti.template(), numbers: ti.template(), corner: ti.template(), spacing):
    """The value at `x` [m] of nine numbers of the lattice, row by row, and its slopes along x and z."""
    wx, sx = spline(x[0], corner[0], spacing)
    wz, sz = spline(x[2], corner[1], spacing)
    rows = [row_sum(numbers, 0, wz), row_sum(numbers, 1, wz), row_sum(numbers, 2, wz)]
    slopes = [row_sum(numbers, 0, sz), row_sum(numbers, 1, sz), row_sum(numbers, 2, sz)]
    return dot(rows, wx), dot(rows, sx), dot(slopes, wx)


@ti.func
def bed_contact(x: ti.template(), heights: ti.template(), corner: ti.template(), spacing):
    """y - H [m], d [m] and n of `x` [m], a list; heights: the nine elevations around it [m]."""
    # Differences are small numbers, of which single precision keeps more digits.
    below = [heights[k] - x[1] for k in ti.static(range(9))]
    rise, along, across = spline_sums(x, below, corner, spacing)
    per_length = 1.0 / ti.sqrt(1.0 + along * along + across * across)
    n = [(0.0 - along) * per_length, per_length, (0.0 - across) * per_length]
    return 0.0 - rise, (0.0 - rise) * per_length, n


@ti.func
def nine(first, row, step, arrays: ti.template()):
    """Nine numbers of `terrain` from `first` on, three rows of three, as a list."""
    return [arrays.terrain[first + a * row + b * step] for a in ti.static(range(3)) for b in ti.static(range(3))]


@ti.func
def column_height(i, k, scene, arrays: ti.template()):
    """Elevation of the bed [m] at the column i, k of nodes."""
    across = arrays.offsets[scene, Offset.CELLS_Z] + 2 * PADDING + 1
    i = ti.max(0, ti.min(i, arrays.offsets[scene, Offset.CELLS_X] + 2 * PADDING))
    k = ti.max(0, ti.min(k, across - 1))
    return arrays.column_heights[arrays.offsets[scene, Offset.COLUMNS] + i * across + k]


@ti.func
def node_position(node, scene, arrays: ti.template()):
    """Position of a node from its index [m], shape [D]."""
    cell = arrays.settings[scene, Setting.CELL]
    return ti.Vector([(node[k] - PADDING) * cell for k in ti.static(range(arrays.features.dimension))])


@ti.func
def bed_under(node, scene, arrays: ti.template()):
    """The bed over the lowest node of a column, of shape [D]: `BedUnder`; far below if the bed is not above it."""
    bed = ti.Vector([FAR_BELOW, 0.0, 0.0, 1.0, 0.0, 0.0])
    if ti.static(arrays.features.terrain):
        x = node_position(node, scene, arrays)
        if arrays.offsets[scene, Offset.TERRAIN] > 0:
            reference = column_height(node[0], node[2], scene, arrays)
            if x[1] < reference:
                i, corner_x = lowest_node(x[0], 0, scene, arrays)
                k, corner_z = lowest_node(x[2], 2, scene, arrays)
                height, friction, row = place_in_bed(ti.cast(i, ti.i32), ti.cast(k, ti.i32), scene, arrays)
                corner, spacing = [corner_x, corner_z], bed_spacing(scene, arrays)
                heights, at = nine(height, row, 1, arrays), [x[0], reference, x[2]]
                above, _, n = bed_contact(at, heights, corner, spacing)
                mu = arrays.terrain[friction]
                if varied_friction(scene, arrays):
                    mu, _, _ = spline_sums(at, nine(friction, row, 1, arrays), corner, spacing)
                bed = ti.Vector([reference, above, n[0], n[1], n[2], mu])
    return bed


@ti.func
def bed_hold(node, bed, scene, arrays: ti.template()):
    """The share with which the `bed` under a node holds it, the normal n and the friction there."""
    above = node_position(node, scene, arrays)[1] - bed[BedUnder.REFERENCE] + bed[BedUnder.ABOVE]
    d, n = above * bed[BedUnder.NORMAL_Y], [bed[BedUnder.NORMAL_X + k] for k in ti.static(range(3))]
    part = ti.max(0.0, ti.min((0.0 - d) / (FADE * arrays.settings[scene, Setting.CELL]), 1.0))
    return part * part * (3.0 - 2.0 * part), ti.Vector([n[0], n[1], n[2]]), bed[BedUnder.FRICTION]
