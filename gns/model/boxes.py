"""Baffles as boxes that may be turned: points in their own axes, their distance, and which of them a path enters."""

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from gns.model.state import Conditions


@dataclass(frozen=True, kw_only=True)
class Boxes:
    """K boxes for each of n points, or for all of them (n = 1); the own axes of a box begin in its middle.

    In 2D a box is turned from x to y, in 3D about the vertical from x to z.
    """

    middle: Tensor
    """[m], shape [n, K, D]."""
    half: Tensor
    """Half of the extent along its own axes [m], shape [n, K, D]."""
    cosine: Tensor | None
    """Of its turn [-], shape [n, K]; absent where none is turned."""
    sine: Tensor | None
    """Likewise."""

    @staticmethod
    def of_conditions(conditions: Conditions) -> "Boxes":
        """The baffles of each sample, n = B."""
        assert conditions.baffles is not None
        lower, upper = conditions.baffles.unbind(dim=2)
        turn = conditions.baffle_turn
        return Boxes(
            middle=0.5 * (lower + upper),
            half=0.5 * (upper - lower),
            cosine=None if turn is None else turn.cos(),
            sine=None if turn is None else turn.sin(),
        )

    def each(self, change: Callable[[Tensor], Tensor]) -> "Boxes":
        """The boxes after the same change of all their tensors."""
        cosine, sine = (None if part is None else change(part) for part in (self.cosine, self.sine))
        return Boxes(middle=change(self.middle), half=change(self.half), cosine=cosine, sine=sine)

    def select(self, rows: Tensor) -> "Boxes":
        """The boxes of these rows."""
        return self.each(lambda part: part.index_select(0, rows))

    def one(self, box: Tensor) -> "Boxes":
        """Of n rows the box with this number [n] alone, K = 1."""
        row = torch.arange(len(box), device=box.device)
        return self.each(lambda part: part[row, box].unsqueeze(1))

    def grown(self, by: float) -> "Boxes":
        """Boxes larger by `by` [m] on every side."""
        return dataclasses.replace(self, half=self.half + by)

    def own(self, points: Tensor) -> Tensor:
        """Points [n, D] in the axes of their boxes [m], shape [n, K, D]."""
        return self.own_vectors(points.unsqueeze(1) - self.middle)

    def own_vectors(self, vectors: Tensor) -> Tensor:
        """Vectors [n, K, D] in the axes of their boxes."""
        return vectors if self.cosine is None or self.sine is None else rotated(vectors, self.cosine, -self.sine)

    def world_vectors(self, vectors: Tensor) -> Tensor:
        """Vectors [n, K, D] from the axes of their boxes in those of the scene."""
        return vectors if self.cosine is None or self.sine is None else rotated(vectors, self.cosine, self.sine)

    @property
    def half_extent(self) -> Tensor:
        """Half of the extent along the axes of the scene [m], shape [n, K, D]."""
        if self.cosine is None or self.sine is None:
            return self.half
        cosine, sine = self.cosine.abs(), self.sine.abs()
        return rotated(self.half, cosine, sine, symmetric=True)

    def contain(self, points: Tensor, slack: float) -> Tensor:
        """Which points [n, D] are farther than `slack` [m] inside which box, shape [n, K]."""
        return (self.own(points).abs() < self.half - slack).all(dim=2)


def rotated(vectors: Tensor, cosine: Tensor, sine: Tensor, *, symmetric: bool = False) -> Tensor:
    """Vectors [..., D] turned from the first axis to the last; cosine, sine: of the angle, shape [...].

    symmetric: both terms with the sine are positive, as of extents.
    """
    first, last = vectors[..., 0], vectors[..., -1]
    turned = cosine * first + sine * last if symmetric else cosine * first - sine * last
    between = [vectors[..., axis].expand_as(turned) for axis in range(1, vectors.shape[-1] - 1)]
    return torch.stack((turned, *between, sine * first + cosine * last), dim=-1)


def entered(start: Tensor, end: Tensor, half: Tensor, *, graze: float, slack: float) -> tuple[Tensor, Tensor, Tensor]:
    """The box that each path enters first, -1 where none; along which axis of it; whether along this axis. Each [n].

    start, end: of the paths in the axes of the boxes [m], both [n, K, D]; half: [n, K, D]. A path that cuts off less
    than `graze` [m] of a box passes it; one that starts less than `slack` inside enters it.

    By the slab method (Kay and Kajiya 1986): the path is inside between the last of the axes' entries and the first
    of their exits.
    """
    path = end - start
    still = path == 0.0
    divisor = torch.where(still, 1.0, path)
    entry, leave = (-half - start) / divisor, (half - start) / divisor
    between = start.abs() < half
    entry, leave = (
        torch.where(still, torch.where(between, -math.inf, math.inf), torch.minimum(entry, leave)),
        torch.where(still, torch.where(between, math.inf, -math.inf), torch.maximum(entry, leave)),
    )
    last_entry, axis = entry.max(dim=2)
    # Of the path itself: what was crossed before its start does not count.
    cut = (leave.min(dim=2).values.clamp(max=1.0) - last_entry.clamp(min=0.0)) * path.norm(dim=2)
    outside = last_entry * path.gather(2, axis.unsqueeze(2)).squeeze(2).abs() >= -2.0 * slack
    hit = (end.abs() < half - slack).all(dim=2) | (outside & (cut > graze))
    earliest, box = torch.where(hit, last_entry, math.inf).min(dim=1)
    axis = axis.gather(1, box.unsqueeze(1)).squeeze(1)
    row = torch.arange(len(box), device=box.device)
    return torch.where(earliest < math.inf, box, -1), axis, path[row, box, axis] > 0.0
