"""The graph: particles are nodes, and pairs closer than a cutoff radius are edges, in PyTorch Geometric's layout.

Neighbours are found on the CPU, in double precision, by a compiled cell list: the neighbours of a particle lie in its
own cell and the surrounding ones; a row of these along the first axis is one range of the sorted particles. SciPy's
cKDTree takes several times as long for pairs in the same order.
"""

import math
from dataclasses import dataclass
from typing import Any

import numba
import numpy as np
import torch
from torch import Tensor

from datasets.errors import WorkFailed

Floats = np.ndarray[Any, np.dtype[np.float64]]
Integers = np.ndarray[Any, np.dtype[np.int64]]

CELL_MARGIN = 1.0e-6
"""Cells exceed the radius by this share [-], so that rounding never puts two neighbours two cells apart."""


@dataclass(frozen=True, kw_only=True)
class Graph:
    """Directed edges, both ways between two nodes, sorted by receiver, then by sender."""

    edge_index: Tensor  # sender and receiver of each edge, int64, shape [2, E]
    starts: Tensor  # first edge of each receiver, and the number of edges, shape [N + 1]
    positions: Tensor  # of the nodes, from their mean, over the radius [-], shape [N, D]; no edge is longer than 1


def radius_graph(positions: Tensor, radius: float, batch: Tensor | None = None) -> Graph:
    """The graph of `positions` [m], shape [N, D], D at most 3: all pairs no further apart than `radius` [m].
    batch: sample of each particle, shape [N]; samples share no edges. Raises WorkFailed if positions are not finite."""
    points = positions.detach().double().cpu().numpy()
    if not np.isfinite(points).all():
        raise WorkFailed("the positions of the particles are no longer finite numbers")
    samples = np.zeros(len(points), dtype=np.int64) if batch is None else batch.cpu().contiguous().numpy()
    axes = np.zeros((3, len(points)))
    axes[: points.shape[1]] = points.T
    lower = axes.min(axis=1, initial=np.inf)
    extent = axes.max(axis=1, initial=-np.inf) - lower if len(points) else np.zeros(3)
    # About as many cells as particles, however far a few of them may have flown.
    edge, most = radius * (1.0 + CELL_MARGIN), (16.0 * len(points) + 4096.0) / (samples.max(initial=0) + 1)
    while np.prod(extent / edge + 1.0) > most:
        edge *= 1.5
    counts = (extent / edge).astype(np.int64) + 1
    x, y, z = ((axes - lower[:, None]) / edge).astype(np.int64)
    cells = ((samples * counts[2] + z) * counts[1] + y) * counts[0] + x
    filled = np.bincount(cells, minlength=(samples.max(initial=0) + 1) * counts.prod())
    first, order = np.append(0, np.cumsum(filled)), np.argsort(cells, kind="stable")
    found = neighbours(axes, cells, first, order, counts, radius)
    edge_index, starts = (torch.from_numpy(part).to(positions.device) for part in found)
    offset = positions - positions.detach().mean(dim=0)
    return Graph(edge_index=edge_index, starts=starts, positions=offset / radius)


def mean_envelope_sum(radius: float, particle_volume: float, dimension: int) -> float:
    """Sum of the envelope over the neighbours of a particle inside a dense packing [-]. The mean of (1 - r^2)^2 over
    the unit ball, times the number of particles in a ball of the radius."""
    mean = 1.0 - 2.0 * dimension / (dimension + 2.0) + dimension / (dimension + 4.0)
    ball = math.pi ** (dimension / 2.0) / math.gamma(dimension / 2.0 + 1.0) * radius**dimension
    return float(mean * ball / particle_volume)


@numba.njit(cache=True)
def neighbours(
    positions: Floats, cells: Integers, first: Integers, order: Integers, counts: Integers, radius: float
) -> tuple[Integers, Integers]:
    """`Graph.edge_index` and `Graph.starts` of the pairs no further apart than the radius.
    positions: [m], shape [3, N]; cells: the cell of each particle, shape [N], x fastest; first: where each cell begins
    among the particles in the order of the cells, `order`, shape [N]; counts: of cells along each axis."""
    count, (nx, ny, nz) = len(cells), counts
    ordered = positions[:, order]
    square = radius * radius
    starts = np.zeros(count + 1, dtype=np.int64)
    near = np.empty(32 * count + 64, dtype=np.int64)
    edges = 0
    for i in range(count):
        x, y, z = positions[0, i], positions[1, i], positions[2, i]
        ix, iy, iz, sample = cells[i] % nx, cells[i] // nx % ny, cells[i] // (nx * ny) % nz, cells[i] // (nx * ny * nz)
        for jz in range(max(iz - 1, 0), min(iz + 2, nz)):
            for jy in range(max(iy - 1, 0), min(iy + 2, ny)):
                row = ((sample * nz + jz) * ny + jy) * nx
                begin, end = first[row + max(ix - 1, 0)], first[row + min(ix + 2, nx)]
                if edges + end - begin > len(near):
                    longer = np.empty(2 * len(near) + end - begin, dtype=np.int64)
                    longer[:edges] = near[:edges]
                    near = longer
                for k in range(begin, end):
                    dx, dy, dz = x - ordered[0, k], y - ordered[1, k], z - ordered[2, k]
                    # Always written, kept only if near: a branch would be mispredicted too often.
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
