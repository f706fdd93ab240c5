"""Neighbours: which points are closer than a radius, and when to look anew.

Two cell lists that find the same edges in the same order: `gns.kernels.cells`, compiled for a CPU, and here one in plain
torch for any other device. Both sort the points into cells no smaller than the radius, so that the neighbours of a
point lie in its own cell and those around it; along the first axis these are one run of sorted points. Who is near
is decided in double precision, |x_j - x_i|^2 <= R^2, summed axis by axis, everywhere alike.

Measured on one core, milliseconds, SciPy's cKDTree with its pairs in the same order beside it: 500 points with 17
neighbours each 0.07 (SciPy 0.5), 3,200 points 0.45 (4.0), 20,000 points 2.9 (28), in 3D with 28 neighbours 7.4 (55).
"""

import itertools
import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from datasets.command_line import WorkFailed
from gns.kernels import cells

CELLS_PER_AXIS = 65_536
"""At most so many in torch's cell list, for the number of a cell to fit into 64 bits; a wider cloud has larger ones."""
POINTS_AT_ONCE = 16_384
"""Points whose candidates torch's cell list weighs together, to bound its memory."""

SKIN = 0.3
"""Skin of a list of candidates in radii [-]; with 0.1 it serves too few steps, with 0.4 it has too many pairs in 3D."""
CALLS_WORTH = 4
"""Calls that a list of candidates must serve to be worth its making."""


@dataclass(frozen=True, kw_only=True)
class Edges:
    """Who hears whom, both ways, no point itself; sorted by receiver, then by sender. int64, on the points' device."""

    senders: Tensor
    """Sender of each edge, shape [E]."""
    receivers: Tensor
    """Receiver of each edge, shape [E]."""
    starts: Tensor
    """First edge of each receiver, and the number of edges, shape [N + 1]."""


def neighbours(positions: Tensor, radius: float, batch: Tensor | None = None) -> Edges:
    """Find all pairs no further apart than `radius` [m] among `positions` [m], shape [N, D], D at most 3.

    batch: the sample that each point belongs to, shape [N]; samples never meet.
    """
    points = positions.detach().double()
    if not points.isfinite().all():
        raise WorkFailed("the positions of the points are no longer finite numbers")
    if not points.is_cpu:
        return neighbours_by_torch(points, radius, batch)
    samples = np.zeros(len(points), dtype=np.int64) if batch is None else batch.contiguous().numpy()
    return _edges(cells.search(_axes(points), samples, radius))


def neighbours_by_torch(positions: Tensor, radius: float, batch: Tensor | None = None) -> Edges:
    """`neighbours` on any device, a dozen passes over whole arrays."""
    points = positions.detach().double()
    count, dimension = points.shape
    if count == 0:
        none = torch.zeros(1, dtype=torch.long, device=points.device)
        return Edges(senders=none[:0], receivers=none[:0], starts=none)
    lower = points.amin(dim=0)
    edge = ((points - lower).amax() / CELLS_PER_AXIS).clamp(min=(1.0 + cells.HAIR) * radius)
    # Each row begins with an empty cell: what lies beyond the end of one is never a cell with points of the next.
    place = ((points - lower) / edge).long() + 1
    strides = torch.cat((torch.ones_like(place[0, :1]), (place.amax(dim=0) + 1).cumprod(dim=0)))
    number = (place * strides[:-1]).sum(dim=1)
    if batch is not None:
        number = number + batch * strides[-1]
    sorted_number, order = number.sort()
    rows = torch.tensor(list(itertools.product((-1, 0, 1), repeat=dimension - 1)), device=points.device).long()
    middle = number.unsqueeze(1) + (rows * strides[1:-1]).sum(dim=1)
    first = torch.searchsorted(sorted_number, middle - 1)
    lengths = torch.searchsorted(sorted_number, middle + 1, right=True) - first
    found: list[tuple[Tensor, Tensor]] = []
    for point in range(0, count, POINTS_AT_ONCE):
        block = slice(point, point + POINTS_AT_ONCE)
        length = lengths[block].flatten()
        # Runs of candidates one after the other: where each begins, less the candidates before it, and counting on.
        begin = first[block].flatten() - length.cumsum(dim=0) + length
        run = torch.arange(len(length), device=points.device).repeat_interleave(length)
        senders = order[begin[run] + torch.arange(len(run), device=points.device)]
        receivers = point + run.div(len(rows), rounding_mode="floor")
        near = _near(points, senders, receivers, radius) & (senders != receivers)
        ordered = (receivers[near] * count + senders[near]).sort().values
        receivers = ordered.div(count, rounding_mode="floor")
        found.append((ordered - receivers * count, receivers))
    senders, receivers = (torch.cat(parts) for parts in zip(*found, strict=True))
    return Edges(senders=senders, receivers=receivers, starts=_starts(receivers, count))


class NeighbourList:
    """The neighbours of points that move: from a list of candidates while it serves, where it pays to have one.

    Candidates are the pairs closer than radius + skin. No pair comes nearer by more than the skin before a point has
    moved by more than half of it: until then the neighbours are among them. They are chosen by where the points are,
    so the edges are those of `neighbours`, whatever was asked for before: steps may be gone through backwards. A list
    costs more than a search; it is made only where the points move so little that it will serve `CALLS_WORTH` calls.
    Measured, a search being 1: 0.4 to 0.8 in a deposit at rest, 1.1 to 1.2 in a flow.

        find = NeighbourList(radius)
        edges = find(positions, batch)
    """

    def __init__(self, radius: float, skin: float | None = None) -> None:
        """radius, skin: [m]; a skin of `SKIN` radii unless given."""
        self.radius = radius
        self.skin = SKIN * radius if skin is None else skin
        self.searches = 0
        """How often the neighbours were searched for instead of found among candidates."""
        self._candidates: Edges | None = None
        self._built: Tensor | None = None
        self._last: Tensor | None = None
        self._batch: Tensor | None = None

    def __call__(self, positions: Tensor, batch: Tensor | None = None) -> Edges:
        """Edges among `positions` [m], shape [N, D], in samples `batch`, shape [N]."""
        # A copy: the caller may move the points in place.
        points = positions.detach().to(torch.float64, copy=True)
        same = _same(batch, self._batch)
        last, self._last, self._batch = self._last, points, batch
        if self._candidates is not None and same and _moved(points, self._built) <= 0.5 * self.skin:
            return closer(self._candidates, points, self.radius)
        self.searches += 1
        self._candidates = None
        if not same or CALLS_WORTH * _moved(points, last) > 0.5 * self.skin:
            return neighbours(points, self.radius, batch)
        self._built = points
        self._candidates = neighbours(points, (1.0 + cells.HAIR) * (self.radius + self.skin), batch)
        return closer(self._candidates, points, self.radius)


def _same(batch: Tensor | None, other: Tensor | None) -> bool:
    """Whether the points belong to the same samples."""
    if batch is None or other is None:
        return batch is other
    return batch is other or (batch.device == other.device and batch.equal(other))


def _moved(points: Tensor, before: Tensor | None) -> float:
    """How far the point went that went furthest [m]; infinitely far where it cannot be told."""
    if before is None or points.shape != before.shape or points.device != before.device:
        return math.inf
    if len(points) == 0:
        return 0.0
    furthest = math.sqrt((points - before).square().sum(dim=1).amax().item())
    return math.inf if math.isnan(furthest) else furthest


def closer(candidates: Edges, positions: Tensor, radius: float) -> Edges:
    """Those of the candidates that are no longer than `radius` [m]; positions [m], shape [N, D]."""
    points = positions.detach().double()
    if not points.is_cpu:
        return closer_by_torch(candidates, points, radius)
    return _edges(cells.closer(candidates.senders.numpy(), candidates.starts.numpy(), _axes(points), radius))


def closer_by_torch(candidates: Edges, positions: Tensor, radius: float) -> Edges:
    """`closer` on any device."""
    near = _near(positions.detach().double(), candidates.senders, candidates.receivers, radius)
    receivers = candidates.receivers[near]
    return Edges(senders=candidates.senders[near], receivers=receivers, starts=_starts(receivers, len(positions)))


def _near(points: Tensor, senders: Tensor, receivers: Tensor, radius: float) -> Tensor:
    """Whether each edge is no longer than the radius, shape [E]."""
    square = points.new_zeros(len(senders))
    for axis in points.T.contiguous():
        square += (axis[receivers] - axis[senders]).square()
    return square <= radius * radius


def _starts(receivers: Tensor, count: int) -> Tensor:
    """First edge of each of `count` receivers, and the number of edges, shape [N + 1]; receivers are sorted."""
    return torch.searchsorted(receivers, torch.arange(count + 1, device=receivers.device))


def _axes(points: Tensor) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Points [N, D] as the compiled search wants them, with three axes, shape [3, N]."""
    axes = np.zeros((3, len(points)))
    axes[: points.shape[1]] = points.numpy().T
    return axes


def _edges(found: tuple[cells.Integers, cells.Integers, cells.Integers]) -> Edges:
    """What the compiled search returned."""
    senders, receivers, starts = map(torch.from_numpy, found)
    return Edges(senders=senders, receivers=receivers, starts=starts)
