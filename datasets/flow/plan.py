"""Sums the shares of a flow's particles in the cells of a map; compiled, because a large flow has a billion shares."""

from typing import Any

import numba
import numpy as np

Singles = np.ndarray[Any, np.dtype[np.float32]]
Floats = np.ndarray[Any, np.dtype[np.float64]]
Integers = np.ndarray[Any, np.dtype[np.int64]]


@numba.njit(cache=True)
def add_to_plan(
    places: tuple[Singles, Singles],
    velocities: tuple[Singles, Singles],
    share: float,
    elapsed: float,
    volumes: Floats,
    limits: Floats,
    cell: float,
    sums: Floats,
    touched: Integers,
) -> int:
    """Add to each cell its part of the volume of the particles around it and, if known, of volume times velocity.

    The parts are those of `Grid.weights`, linear between cell centres.

    places, velocities: [m] and [m/s] before and after a time `elapsed` [s], shape [N, 3], velocities [0, 3] if they are
    not known; share: of that time, after which the particles have followed the cubic of both; limits: least and largest
    coordinates, shape [2, 3], beyond which a particle gives nothing; cell: edge [m]; sums: [X, Z, 4]. Returns the
    number of cells that are no longer empty; `touched`, with room for all cells, gets their indices, Z fastest.
    """
    first, second = places
    slow, fast = velocities
    rest, known = 1.0 - share, len(fast) > 0
    columns, rows, count = sums.shape[0], sums.shape[1], 0
    x, v = np.zeros(3), np.zeros(3)
    for n in range(len(second)):
        inside = volumes[n] > 0.0
        for axis in range(3):
            x[axis] = second[n, axis]
            if known:
                v[axis] = rest * slow[n, axis] + share * fast[n, axis]
            if share < 1.0:
                line = rest**2 * (1.0 + 2.0 * share) * first[n, axis] + share**2 * (3.0 - 2.0 * share) * x[axis]
                x[axis] = line + share * rest * elapsed * (rest * slow[n, axis] - share * fast[n, axis])
            inside = inside and limits[0, axis] <= x[axis] <= limits[1, axis]
        if inside:
            # The places of the cells' middles, linear between them.
            i = min(max(x[0] / cell - 0.5, 0.0), columns - 1.0)
            k = min(max(x[2] / cell - 0.5, 0.0), rows - 1.0)
            low_i, low_k = min(int(i), max(columns - 2, 0)), min(int(k), max(rows - 2, 0))
            for a in range(min(columns, 2)):
                along = i - low_i if a else 1.0 - (i - low_i)
                for b in range(min(rows, 2)):
                    part = volumes[n] * along * (k - low_k if b else 1.0 - (k - low_k))
                    if part > 0.0 and sums[low_i + a, low_k + b, 0] == 0.0:
                        touched[count] = (low_i + a) * rows + low_k + b
                        count += 1
                    sums[low_i + a, low_k + b, 0] += part
                    for axis in range(3):
                        sums[low_i + a, low_k + b, 1 + axis] += part * v[axis]
    return count
