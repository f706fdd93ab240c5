"""Neighbours: the pairs of particles closer than a cutoff radius.

Two cell lists that find the same edges in the same order: `gns.kernels.cells`, compiled for a CPU, and here one in
plain torch for any other device, in whose place torch_cluster's runs where it is installed. A cell list sorts the
particles into cells no smaller than the radius, so that the neighbours of a particle lie in its own cell and those
around it; along the first axis these are one run of sorted particles. Distances are compared in double precision,
|x_j - x_i|^2 <= R^2, summed axis by axis.

Measured on one core, milliseconds, SciPy's cKDTree with its pairs in the same order beside it: 500 particles with 17
neighbours each 0.07 (SciPy 0.5), 3,200 particles 0.45 (4.0), 20,000 particles 2.9 (28), in 3D with 28 neighbours 7.4
(55).
"""

import importlib
import itertools
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Any

import numpy as np
import torch
from torch import Tensor

from datasets.command_line import WorkFailed
from gns.kernels import cells

torch_cluster: Any = importlib.import_module("torch_cluster") if find_spec("torch_cluster") else None
"""An optional package, with its own kernels for a GPU; it has no wheel on the registry."""

CELLS_PER_AXIS = 65_536
"""At most so many in torch's cell list, for the number of a cell to fit into 64 bits; a wider cloud has larger ones."""
BLOCK = 16_384
"""Particles whose candidates torch's cell list compares together, to bound its memory."""
CLUSTER_NEIGHBOURS = 256
"""Neighbours for which torch_cluster reserves memory; where a particle has as many, torch's cell list is used."""


@dataclass(frozen=True, kw_only=True)
class Edges:
    """Directed edges, both ways, no self-loops; sorted by receiver, then by sender. int64, on the positions' device."""

    edge_index: Tensor
    """Sender and receiver of each edge, shape [2, E]."""
    starts: Tensor
    """First edge of each receiver, and the number of edges, shape [N + 1]."""


def neighbours(positions: Tensor, radius: float, batch: Tensor | None = None) -> Edges:
    """All pairs no further apart than `radius` [m] among `positions` [m], shape [N, D], D at most 3.

    batch: the sample that each particle belongs to, shape [N]; there are no edges between samples. Raises WorkFailed
    for positions that are not finite.
    """
    double = positions.detach().double()
    if not double.isfinite().all():
        raise WorkFailed("the positions of the particles are no longer finite numbers")
    if double.is_cpu:
        samples = np.zeros(len(double), dtype=np.int64) if batch is None else batch.contiguous().numpy()
        axes = np.zeros((3, len(double)))
        axes[: double.shape[1]] = double.numpy().T
        index, starts = cells.search(axes, samples, radius)
        return Edges(edge_index=torch.from_numpy(index), starts=torch.from_numpy(starts))
    if torch_cluster is not None:
        edges = neighbours_by_cluster(double, radius, batch)
        if edges is not None:
            return edges
    return neighbours_by_torch(double, radius, batch)


def neighbours_by_cluster(positions: Tensor, radius: float, batch: Tensor | None = None) -> Edges | None:
    """`neighbours` by torch_cluster; None where a particle may have more than `CLUSTER_NEIGHBOURS`."""
    found = torch_cluster.radius_graph(positions, radius, batch, loop=False, max_num_neighbors=CLUSTER_NEIGHBOURS)
    count = len(positions)
    senders, receivers = found[0], found[1]
    if len(receivers) and int(receivers.bincount(minlength=count).max()) >= CLUSTER_NEIGHBOURS:
        return None
    return _sorted(senders, receivers, count)


def neighbours_by_torch(positions: Tensor, radius: float, batch: Tensor | None = None) -> Edges:
    """`neighbours` on any device, a dozen passes over whole arrays."""
    double = positions.detach().double()
    count, dimension = double.shape
    if count == 0:
        none = torch.zeros(1, dtype=torch.long, device=double.device)
        return Edges(edge_index=none.new_zeros(2, 0), starts=none)
    lower = double.amin(dim=0)
    edge = ((double - lower).amax() / CELLS_PER_AXIS).clamp(min=(1.0 + cells.CELL_MARGIN) * radius)
    # Each row begins with an empty cell: what lies beyond the end of one is never a cell with particles of the next.
    cell = ((double - lower) / edge).long() + 1
    strides = torch.cat((torch.ones_like(cell[0, :1]), (cell.amax(dim=0) + 1).cumprod(dim=0)))
    number = (cell * strides[:-1]).sum(dim=1)
    if batch is not None:
        number = number + batch * strides[-1]
    sorted_number, order = number.sort()
    rows = torch.tensor(list(itertools.product((-1, 0, 1), repeat=dimension - 1)), device=double.device).long()
    middle = number.unsqueeze(1) + (rows * strides[1:-1]).sum(dim=1)
    first = torch.searchsorted(sorted_number, middle - 1)
    lengths = torch.searchsorted(sorted_number, middle + 1, right=True) - first
    found: list[tuple[Tensor, Tensor]] = []
    for start in range(0, count, BLOCK):
        block = slice(start, start + BLOCK)
        length = lengths[block].flatten()
        # Runs of candidates one after the other: where each begins, less the candidates before it, and counting on.
        begin = first[block].flatten() - length.cumsum(dim=0) + length
        run = torch.arange(len(length), device=double.device).repeat_interleave(length)
        senders = order[begin[run] + torch.arange(len(run), device=double.device)]
        receivers = start + run.div(len(rows), rounding_mode="floor")
        square = double.new_zeros(len(senders))
        for axis in double.T.contiguous():
            square += (axis[receivers] - axis[senders]).square()
        near = (square <= radius * radius) & (senders != receivers)
        found.append((senders[near], receivers[near]))
    senders, receivers = (torch.cat(parts) for parts in zip(*found, strict=True))
    return _sorted(senders, receivers, count)


def _sorted(senders: Tensor, receivers: Tensor, count: int) -> Edges:
    """Edges sorted by receiver, then by sender, among `count` nodes."""
    key = (receivers * count + senders).sort().values
    receivers = key.div(count, rounding_mode="floor") if count else key
    starts = torch.searchsorted(receivers, torch.arange(count + 1, device=key.device))
    return Edges(edge_index=torch.stack((key - receivers * count, receivers)), starts=starts)
