"""Compiled distances for `mpm.solids.faces`: of cells from triangles near them, of nodes from listed triangles."""

from typing import Any

import numba
import numpy as np

Floats = np.ndarray[Any, np.dtype[np.float64]]
Integers = np.ndarray[Any, np.dtype[np.int64]]


@numba.njit(cache=True)
def pairs_within(
    corners: Floats, low: Integers, high: Integers, origin: Floats, cell: float, rows: Integers, limit: float
) -> tuple[Integers, Integers, Floats]:
    """Cells, triangles and distances [m] of all pairs of a triangle and a cell of its range that are within `limit`.

    corners: of T triangles [m], shape [T, 3, 3]; low, high: the range of cells of each, [low, high), shape [T, 3];
    origin: centre of cell (0, 0, 0) [m]; rows: from the number of a cell to its neighbour's along each axis.
    """
    size, count = 4 * len(corners) + 1024, 0
    cells, triangles, distances = np.empty(size, np.int64), np.empty(size, np.int64), np.empty(size)
    for triangle in range(len(corners)):
        a, b, c = corners[triangle, 0], corners[triangle, 1], corners[triangle, 2]
        n = normal_of(a, b, c)
        farthest = limit * limit * (n[0] * n[0] + n[1] * n[1] + n[2] * n[2])
        for i in range(low[triangle, 0], high[triangle, 0]):
            x = origin[0] + i * cell
            for j in range(low[triangle, 1], high[triangle, 1]):
                y = origin[1] + j * cell
                for k in range(low[triangle, 2], high[triangle, 2]):
                    z = origin[2] + k * cell
                    height = (x - a[0]) * n[0] + (y - a[1]) * n[1] + (z - a[2]) * n[2]
                    if height * height > farthest:
                        continue
                    square = triangle_distance_squared(a, b, c, n, x, y, z)
                    if square <= limit * limit:
                        if count == size:
                            size *= 2
                            cells, triangles = longer(cells, size), longer(triangles, size)
                            distances = longer(distances, size)
                        cells[count] = i * rows[0] + j * rows[1] + k * rows[2]
                        triangles[count] = triangle
                        distances[count] = np.sqrt(square)
                        count += 1
    return cells[:count], triangles[:count], distances[:count]


@numba.njit(cache=True)
def longer(values: Any, size: int) -> Any:
    """A copy of an array with room for `size` values."""
    new = np.empty(size, values.dtype)
    new[: len(values)] = values
    return new


@numba.njit(cache=True)
def nearest_listed(corners: Floats, points: Floats, ends: Integers, listed: Integers) -> tuple[Integers, Floats]:
    """The nearest of the triangles listed[ends[p] : ends[p + 1]] for each point p, the first of equals, both [P].

    Returns triangles and squared distances [m^2]; corners [T, 3, 3] and points [P, 3] in m.
    """
    nearest, smallest = np.empty(len(points), np.int64), np.full(len(points), np.inf)
    for p in range(len(points)):
        for entry in range(ends[p], ends[p + 1]):
            a, b, c = corners[listed[entry], 0], corners[listed[entry], 1], corners[listed[entry], 2]
            n = normal_of(a, b, c)
            square = triangle_distance_squared(a, b, c, n, points[p, 0], points[p, 1], points[p, 2])
            if square < smallest[p]:
                nearest[p], smallest[p] = listed[entry], square
    return nearest, smallest


@numba.njit(cache=True)
def normal_of(a: Floats, b: Floats, c: Floats) -> tuple[float, float, float]:
    """(b - a) x (c - a) [m^2]."""
    ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    wx, wy, wz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    return uy * wz - uz * wy, uz * wx - ux * wz, ux * wy - uy * wx


@numba.njit(cache=True)
def triangle_distance_squared(
    a: Floats, b: Floats, c: Floats, n: tuple[float, float, float], x: float, y: float, z: float
) -> float:
    """Squared distance [m^2] of (x, y, z) from the triangle a b c, n = (b - a) x (c - a), or the segment a b = c.

    Between the three planes across its edges it is that from the triangle's plane, else that from an edge.
    """
    square = n[0] * n[0] + n[1] * n[1] + n[2] * n[2]
    if square > 0.0:
        ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
        wx, wy, wz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
        px, py, pz = x - a[0], y - a[1], z - a[2]
        v = (py * wz - pz * wy) * n[0] + (pz * wx - px * wz) * n[1] + (px * wy - py * wx) * n[2]
        w = (uy * pz - uz * py) * n[0] + (uz * px - ux * pz) * n[1] + (ux * py - uy * px) * n[2]
        if v >= 0.0 and w >= 0.0 and v + w <= square:
            height = px * n[0] + py * n[1] + pz * n[2]
            return float(height * height / square)
    return min(
        segment_distance_squared(a, b, x, y, z),
        segment_distance_squared(b, c, x, y, z),
        segment_distance_squared(c, a, x, y, z),
    )


@numba.njit(cache=True)
def segment_distance_squared(a: Floats, b: Floats, x: float, y: float, z: float) -> float:
    """Squared distance [m^2] of (x, y, z) from the segment a b."""
    ex, ey, ez = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    px, py, pz = x - a[0], y - a[1], z - a[2]
    length = ex * ex + ey * ey + ez * ez
    share = 0.0
    if length > 0.0:
        share = min(1.0, max(0.0, (px * ex + py * ey + pz * ez) / length))
    px, py, pz = px - share * ex, py - share * ey, pz - share * ez
    return float(px * px + py * py + pz * pz)
