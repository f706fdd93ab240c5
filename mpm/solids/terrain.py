"""A terrain in 3D as a height field: the triangles that a point can be near to follow from its place in plan.

A raster has two triangles a cell, along the diagonal whose ends differ less (`datasets.geometry.ground`). A point that
is g above the triangle over or under it is no farther than |g| from the terrain, and no nearer than
|g| / sqrt(1 + s^2), with s the steepest slope: only cells of the raster within |g| of it in plan are looked at, at most
those within the distance that is searched, R. With posts a apart and particles of a first row at R that is some
2 (2 R / a + 1)^2 triangles; those farther in plan than the nearest so far cost a comparison.

The offset of a point from its nearest place on a height field points up if and only if the point lies above it: the
ball around the point that touches the surface there is free of it, and a surface that passed below the point and came
back over the ball would be no function of the place in plan. So edges and corners need no normals of their own.
"""

import taichi as ti

from mpm.arrays.layout import PADDING, Offset, Setting, TerrainNumber

LEVEL = 1.0e-30
"""Stands for zero where a zero means that nothing is kept yet: an elevation [m] or a tilt [-]."""
AROUND = 2
"""Cells of the raster around one whose triangles its own are compared with."""
UNKNOWN = 1.0e10
"""Tilt [-] of triangles beside which others have to be searched."""
STEEP = 0.7
"""Least cosine of the angle between triangles beside which one is known to be nearest."""


@ti.func
def in_terrain(face, scene, arrays: ti.template()):
    """Whether a face is a triangle of the scene's height field; known to the compiler where scenes have none."""
    if ti.static(arrays.features.terrain):
        return face >= arrays.offsets[scene, Offset.TERRAIN_FACE]
    else:
        return False


@ti.func
def terrain_number(column: ti.template(), scene, arrays: ti.template()):
    """One of the first numbers of a height field."""
    return arrays.terrain[arrays.offsets[scene, Offset.TERRAIN] + column]


@ti.func
def posts(scene, arrays: ti.template()):
    """How many posts a height field has along x and z, and where x, z, heights and friction begin in `terrain`."""
    along, across = arrays.offsets[scene, Offset.POSTS_X], arrays.offsets[scene, Offset.POSTS_Z]
    x = arrays.offsets[scene, Offset.TERRAIN] + ti.static(len(TerrainNumber))
    return along, across, x, x + along, x + along + across, x + along + across + along * across


@ti.func
def post_spacing(scene, arrays: ti.template()):
    """The lesser of the distances between posts along x and z [m]."""
    per_x = terrain_number(TerrainNumber.PER_X, scene, arrays)
    return 1.0 / ti.max(per_x, terrain_number(TerrainNumber.PER_Z, scene, arrays))


@ti.func
def raster_cell(x, scene, arrays: ti.template()):
    """The cell i, k of the raster that `x` [m] lies over or under, or the last one on its side."""
    along, across, _, _, _, _ = posts(scene, arrays)
    to_x = (x[0] - terrain_number(TerrainNumber.X, scene, arrays)) * terrain_number(TerrainNumber.PER_X, scene, arrays)
    to_z = (x[2] - terrain_number(TerrainNumber.Z, scene, arrays)) * terrain_number(TerrainNumber.PER_Z, scene, arrays)
    i = ti.cast(ti.floor(to_x), ti.i32) + arrays.offsets[scene, Offset.EVEN_X]
    k = ti.cast(ti.floor(to_z), ti.i32) + arrays.offsets[scene, Offset.EVEN_Z]
    return ti.max(0, ti.min(i, along - 2)), ti.max(0, ti.min(k, across - 2))


@ti.func
def cell_code(i, k, scene, arrays: ti.template()):
    """Bit 0: the triangles of a cell meet along its second diagonal; bit 1: they are faces that are listed."""
    at = i * (arrays.offsets[scene, Offset.POSTS_Z] - 1) + k
    return arrays.terrain_cells[arrays.offsets[scene, Offset.TERRAIN_CELLS] + at]


@ti.func
def triangle_under(x, scene, arrays: ti.template()):
    """The triangle that `x` [m] lies over or under: its cell i, k, which of the two it is, and the code of the cell."""
    i, k = raster_cell(x, scene, arrays)
    _, _, first_x, first_z, _, _ = posts(scene, arrays)
    code, half = cell_code(i, k, scene, arrays), 0
    x0, z0 = arrays.terrain[first_x + i], arrays.terrain[first_z + k]
    u = (x[0] - x0) / (arrays.terrain[first_x + i + 1] - x0)
    v = (x[2] - z0) / (arrays.terrain[first_z + k + 1] - z0)
    if (code & 1) == 1:
        v = 1.0 - v
    if (v > u and (code & 1) == 0) or (u > v and (code & 1) == 1):
        half = 1
    return i, k, half, code


@ti.func
def height_above(x, scene, arrays: ti.template()):
    """How far `x` [m] is above the height field [m], and 1 where the triangle there is a listed face, else 0."""
    i, k, half, code = triangle_under(x, scene, arrays)
    a, b, c = triangle_corners(i, k, half, code, scene, arrays)
    across = (b - a).cross(c - b)
    return (x - a).dot(across) / across[1], code >> 1


@ti.func
def column_height(i, k, scene, arrays: ti.template()):
    """Elevation of the height field [m] at the column i, k of nodes; kept once it has been needed."""
    across = arrays.offsets[scene, Offset.CELLS_Z] + 2 * PADDING + 1
    i = ti.max(0, ti.min(i, arrays.offsets[scene, Offset.CELLS_X] + 2 * PADDING))
    k = ti.max(0, ti.min(k, across - 1))
    at = arrays.offsets[scene, Offset.COLUMNS] + i * across + k
    height = arrays.column_heights[at]
    if height == 0.0:
        cell = arrays.settings[scene, Setting.CELL]
        above, _ = height_above(ti.Vector([(i - PADDING) * cell, 0.0 * cell, (k - PADDING) * cell]), scene, arrays)
        height = 0.0 - above
        if height == 0.0:
            height += LEVEL
        arrays.column_heights[at] = height
    return height


@ti.func
def terrain_radius(x, reach, scene, arrays: ti.template()):
    """The distance in plan within which the nearest triangle of those up to `reach` [m] from `x` [m] lies, -1 where
    there can be none; a lower bound of the distance of `x` from the others, and one from all of them [m].
    """
    above, listed = height_above(x, scene, arrays)
    nearest = ti.abs(above) * terrain_number(TerrainNumber.NEARNESS, scene, arrays)
    bound, radius = nearest, 0.0 * reach - 1.0
    if bound < reach:
        bound, radius = reach, reach
        if listed == 0:
            radius = ti.min(ti.abs(above), reach)
    return radius, bound, nearest


@ti.func
def cells_within(low, high, scene, arrays: ti.template()):
    """The cells of the raster over or under a box from `low` to `high` [m]: first in x and z, then past the last."""
    i0, k0 = raster_cell(low, scene, arrays)
    i1, k1 = raster_cell(high, scene, arrays)
    return i0, k0, i1 + 1, k1 + 1


@ti.func
def triangle_number(i, k, half, scene, arrays: ti.template()):
    """The number, as a face, of one of the two triangles of a cell."""
    cell = i * (arrays.offsets[scene, Offset.POSTS_Z] - 1) + k
    return arrays.offsets[scene, Offset.TERRAIN_FACE] + 2 * cell + half


@ti.func
def cell_of_triangle(face, scene, arrays: ti.template()):
    """i, k of the cell of a triangle, and which of its two it is."""
    across = arrays.offsets[scene, Offset.POSTS_Z] - 1
    triangle = face - arrays.offsets[scene, Offset.TERRAIN_FACE]
    i = ti.raw_div(triangle // 2, across)
    return i, triangle // 2 - i * across, triangle & 1


@ti.func
def squared_plan_distance(x, i, k, scene, arrays: ti.template()):
    """Square of the distance in plan of `x` [m] from a cell [m^2]."""
    _, _, first_x, first_z, _, _ = posts(scene, arrays)
    along = ti.max(arrays.terrain[first_x + i] - x[0], x[0] - arrays.terrain[first_x + i + 1], 0.0 * x[0])
    aside = ti.max(arrays.terrain[first_z + k] - x[2], x[2] - arrays.terrain[first_z + k + 1], 0.0 * x[0])
    return along * along + aside * aside


@ti.func
def corner_posts(code, half):
    """How far the posts at the first two corners of a triangle are along x from the first of its cell: p, q.

    The corners are at (p, 0), (q, 1) and (1, half), in the order of `datasets.geometry.ground.grid_triangles`: a, c, b
    and a, d, c of the first diagonal; a, d, b and b, d, c of the second one.
    """
    return half * (code & 1), (1 - half) * (1 - (code & 1))


@ti.func
def triangle_corners(i, k, half, code, scene, arrays: ti.template()):
    """The corners of a triangle of a cell with the code `code` [m], three vectors."""
    _, across, first_x, first_z, heights, _ = posts(scene, arrays)
    p, q = corner_posts(code, half)
    at_x, at_z, at = first_x + i, first_z + k, heights + i * across + k
    a = ti.Vector([arrays.terrain[at_x + p], arrays.terrain[at + p * across], arrays.terrain[at_z]])
    b = ti.Vector([arrays.terrain[at_x + q], arrays.terrain[at + q * across + 1], arrays.terrain[at_z + 1]])
    c = ti.Vector([arrays.terrain[at_x + 1], arrays.terrain[at + across + half], arrays.terrain[at_z + half]])
    return a, b, c


@ti.func
def corner_frictions(i, k, half, code, scene, arrays: ti.template()):
    """Where the Coulomb coefficients at the corners of a triangle stand in `terrain`, three numbers."""
    _, across, _, _, _, friction = posts(scene, arrays)
    a, b, c = friction, friction, friction
    if arrays.offsets[scene, Offset.TERRAIN_FRICTION] == 1:
        p, q = corner_posts(code, half)
        at = friction + i * across + k
        a, b, c = at + p * across, at + q * across + 1, at + across + half
    return a, b, c


@ti.func
def tilt_around(i, k, half, scene, arrays: ti.template()):
    """tan of the largest angle of a triangle to those AROUND it [-], kept; UNKNOWN where one is listed or too steep."""
    along, across, _, _, _, _ = posts(scene, arrays)
    cell = arrays.offsets[scene, Offset.TERRAIN_CELLS] + i * (across - 1) + k
    tilt = arrays.terrain_tilts[2 * cell + half]
    if tilt == 0.0:
        a, b, c = triangle_corners(i, k, half, cell_code(i, k, scene, arrays), scene, arrays)
        normal = (b - a).cross(c - b)
        tilt += LEVEL
        for other_i in range(ti.max(i - AROUND, 0), ti.min(i + AROUND + 1, along - 1)):
            for other_k in range(ti.max(k - AROUND, 0), ti.min(k + AROUND + 1, across - 1)):
                code = cell_code(other_i, other_k, scene, arrays)
                for other in range(2):
                    p, q, r = triangle_corners(other_i, other_k, other, code, scene, arrays)
                    facing = (q - p).cross(r - q)
                    cosine, sine = normal.dot(facing), normal.cross(facing).norm()
                    if code < 2 and cosine > STEEP * ti.sqrt(cosine * cosine + sine * sine):
                        tilt = ti.max(tilt, sine / cosine)
                    else:
                        tilt = 0.0 * tilt + UNKNOWN
        arrays.terrain_tilts[2 * cell + half] = tilt
    return tilt
