"""The cell list of a CPU, compiled: see `gns.kernels.neighbours`."""

from typing import Any

import numba
import numpy as np

Floats = np.ndarray[Any, np.dtype[np.float64]]
Integers = np.ndarray[Any, np.dtype[np.int64]]

HAIR = 1.0e-6
"""By this share cells are larger than the radius: rounding must not put two neighbours two cells apart [-]."""


@numba.njit(cache=True)
def search(points: Floats, samples: Integers, radius: float) -> tuple[Integers, Integers, Integers]:
    """Pairs no further apart than the radius.

    points: [m], finite, shape [3, N]; samples: the one that each point belongs to, shape [N].
    Returns senders [E] and receivers [E], sorted by receiver, then by sender, and the first edge of each receiver,
    shape [N + 1].
    """
    count = len(samples)
    most = 0
    lower, extent = np.zeros(3), np.zeros(3)
    for i in range(count):
        most = max(most, samples[i])
    for axis in range(3):
        if count:
            least = greatest = points[axis, 0]
            for i in range(count):
                least, greatest = min(least, points[axis, i]), max(greatest, points[axis, i])
            lower[axis], extent[axis] = least, greatest - least
    # As many cells as there are points or so, however far a few of them may have flown.
    edge = radius * (1.0 + HAIR)
    while (extent[0] / edge + 1.0) * (extent[1] / edge + 1.0) * (extent[2] / edge + 1.0) * (
        most + 1
    ) > 16.0 * count + 4096.0:
        edge *= 1.5
    nx, ny, nz = int(extent[0] / edge) + 1, int(extent[1] / edge) + 1, int(extent[2] / edge) + 1
    # Sort by counting: the points of each cell, then where its first goes, then all of them.
    number = np.empty(count, dtype=np.int64)
    first = np.zeros((most + 1) * nz * ny * nx + 1, dtype=np.int64)
    for i in range(count):
        ix = int((points[0, i] - lower[0]) / edge)
        iy = int((points[1, i] - lower[1]) / edge)
        iz = int((points[2, i] - lower[2]) / edge)
        number[i] = ((samples[i] * nz + iz) * ny + iy) * nx + ix
        first[number[i] + 1] += 1
    for cell in range(len(first) - 1):
        first[cell + 1] += first[cell]
    cursor = first.copy()
    order = np.empty(count, dtype=np.int64)
    place = np.empty((3, count))
    for i in range(count):
        k = cursor[number[i]]
        cursor[number[i]] += 1
        order[k] = i
        for axis in range(3):
            place[axis, k] = points[axis, i]
    # Whom each point hears, in the order of the cells.
    square = radius * radius
    starts = np.zeros(count + 1, dtype=np.int64)
    near = np.empty(32 * count + 64, dtype=np.int64)
    edges = 0
    for i in range(count):
        x, y, z = points[0, i], points[1, i], points[2, i]
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
                    dx, dy, dz = x - place[0, k], y - place[1, k], z - place[2, k]
                    # Written always, kept where it is near: a branch would be guessed wrong too often.
                    near[edges] = order[k]
                    edges += int((dx * dx + dy * dy + dz * dz <= square) & (order[k] != i))
        starts[i + 1] = edges
    # Whom i hears also hears i: handed to them one i after the other, the senders of each are in order.
    senders, receivers = np.empty(edges, dtype=np.int64), np.empty(edges, dtype=np.int64)
    heads = starts.copy()
    for i in range(count):
        for k in range(starts[i], starts[i + 1]):
            receiver = near[k]
            senders[heads[receiver]] = i
            heads[receiver] += 1
            receivers[k] = i
    return senders, receivers, starts


@numba.njit(cache=True)
def closer(
    candidates: Integers, starts: Integers, points: Floats, radius: float
) -> tuple[Integers, Integers, Integers]:
    """Those of the candidates that are no longer than the radius, in their order.

    candidates: senders, shape [C]; starts: the first of each receiver, shape [N + 1]; points: [m], shape [3, N].
    Returns senders [E], receivers [E] and the first edge of each receiver, shape [N + 1].
    """
    count = len(starts) - 1
    square = radius * radius
    near = np.empty(len(candidates), dtype=np.int64)
    kept = np.zeros(count + 1, dtype=np.int64)
    edges = 0
    for i in range(count):
        x, y, z = points[0, i], points[1, i], points[2, i]
        for k in range(starts[i], starts[i + 1]):
            j = candidates[k]
            dx, dy, dz = x - points[0, j], y - points[1, j], z - points[2, j]
            near[edges] = j
            edges += int(dx * dx + dy * dy + dz * dz <= square)
        kept[i + 1] = edges
    receivers = np.empty(edges, dtype=np.int64)
    for i in range(count):
        receivers[kept[i] : kept[i + 1]] = i
    return near[:edges].copy(), receivers, kept
