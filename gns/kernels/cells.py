"""The cell list on a CPU, compiled: see `gns.kernels.neighbours`."""

from typing import Any

import numba
import numpy as np

Floats = np.ndarray[Any, np.dtype[np.float64]]
Integers = np.ndarray[Any, np.dtype[np.int64]]

CELL_MARGIN = 1.0e-6
"""By this share cells are larger than the radius: rounding must not put two neighbours two cells apart [-]."""


@numba.njit(cache=True)
def search(positions: Floats, samples: Integers, radius: float) -> tuple[Integers, Integers]:
    """Pairs no further apart than the radius.

    positions: [m], finite, shape [3, N]; samples: the one that each particle belongs to, shape [N].
    Returns senders and receivers [2, E], sorted by receiver, then by sender, and the first edge of each receiver,
    shape [N + 1].
    """
    count = len(samples)
    last_sample = 0
    lower, extent = np.zeros(3), np.zeros(3)
    for i in range(count):
        last_sample = max(last_sample, samples[i])
    for axis in range(3):
        if count:
            low = high = positions[axis, 0]
            for i in range(count):
                low, high = min(low, positions[axis, i]), max(high, positions[axis, i])
            lower[axis], extent[axis] = low, high - low
    # As many cells as there are particles or so, however far a few of them may have flown.
    edge = radius * (1.0 + CELL_MARGIN)
    while (extent[0] / edge + 1.0) * (extent[1] / edge + 1.0) * (extent[2] / edge + 1.0) * (
        last_sample + 1
    ) > 16.0 * count + 4096.0:
        edge *= 1.5
    nx, ny, nz = int(extent[0] / edge) + 1, int(extent[1] / edge) + 1, int(extent[2] / edge) + 1
    # Counting sort: the number of particles in each cell, the index of its first, then the particles in order.
    number = np.empty(count, dtype=np.int64)
    first = np.zeros((last_sample + 1) * nz * ny * nx + 1, dtype=np.int64)
    for i in range(count):
        ix = int((positions[0, i] - lower[0]) / edge)
        iy = int((positions[1, i] - lower[1]) / edge)
        iz = int((positions[2, i] - lower[2]) / edge)
        number[i] = ((samples[i] * nz + iz) * ny + iy) * nx + ix
        first[number[i] + 1] += 1
    for cell in range(len(first) - 1):
        first[cell + 1] += first[cell]
    cursor = first.copy()
    order = np.empty(count, dtype=np.int64)
    ordered = np.empty((3, count))
    for i in range(count):
        k = cursor[number[i]]
        cursor[number[i]] += 1
        order[k] = i
        for axis in range(3):
            ordered[axis, k] = positions[axis, i]
    # The neighbours of each particle, in the order of the cells.
    square = radius * radius
    starts = np.zeros(count + 1, dtype=np.int64)
    near = np.empty(32 * count + 64, dtype=np.int64)
    edges = 0
    for i in range(count):
        x, y, z = positions[0, i], positions[1, i], positions[2, i]
        ix, iy, iz = number[i] % nx, number[i] // nx % ny, number[i] // (nx * ny) % nz
        for jz in range(max(iz - 1, 0), min(iz + 2, nz)):
            for jy in range(max(iy - 1, 0), min(iy + 2, ny)):
                row = ((samples[i] * nz + jz) * ny + jy) * nx
                begin, end = first[row + max(ix - 1, 0)], first[row + min(ix + 2, nx)]
                if edges + end - begin > len(near):
                    longer = np.empty(2 * len(near) + end - begin, dtype=np.int64)
                    longer[:edges] = near[:edges]
                    near = longer
                for k in range(begin, end):
                    dx, dy, dz = x - ordered[0, k], y - ordered[1, k], z - ordered[2, k]
                    # Written always, kept where it is near: a branch would be mispredicted too often.
                    near[edges] = order[k]
                    edges += int((dx * dx + dy * dy + dz * dz <= square) & (order[k] != i))
        starts[i + 1] = edges
    # The relation is symmetric: i is a sender to each of its neighbours, and with i ascending the senders are sorted.
    index = np.empty((2, edges), dtype=np.int64)
    cursor = starts.copy()
    for i in range(count):
        for k in range(starts[i], starts[i + 1]):
            receiver = near[k]
            index[0, cursor[receiver]] = i
            cursor[receiver] += 1
            index[1, k] = i
    return index, starts
