"""Baffles and ground as geometry: signed distances, outward directions and friction, as features of the particles.

Baffles are boxes that may be turned; the ground is a raster, multilinear between its elevations. Everything is
differentiable in positions, corners, turns and elevations. Only particles near a baffle are processed.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from itertools import product

import torch
from torch import Tensor

from datasets.geometry.ground import plan_axes
from gns.settings import UP
from gns.surroundings.state import Conditions, Ground

ROUNDING = 0.1  # radius of edges over the cutoff radius for outward directions: sharp ones have no bounded gradient [-]


@dataclass(frozen=True, kw_only=True)
class Boxes:
    """K boxes for each of n points, or for all (n = 1), turned in 2D from x to y, in 3D from x to z."""

    middle: Tensor  # [m], shape [n, K, D]
    half: Tensor  # half of the extent along its own axes [m], shape [n, K, D]
    turn: tuple[Tensor, Tensor] | None  # its cosine and sine [-], shape [n, K] each; None if none is turned

    @staticmethod
    def of_conditions(conditions: Conditions, margin: float = 0.0) -> "Boxes":
        """The baffles of each sample, n = B; margin: enlargement on every side [m]."""
        assert conditions.baffles is not None
        lower, upper = conditions.baffles.unbind(dim=2)
        angle = conditions.baffle_turn
        turn = None if angle is None else (angle.cos(), angle.sin())
        return Boxes(middle=0.5 * (lower + upper), half=0.5 * (upper - lower) + margin, turn=turn)

    def mapped(self, change: Callable[[Tensor], Tensor]) -> "Boxes":
        """The boxes with the same change applied to all tensors."""
        turn = None if self.turn is None else (change(self.turn[0]), change(self.turn[1]))
        return Boxes(middle=change(self.middle), half=change(self.half), turn=turn)

    def select(self, rows: Tensor) -> "Boxes":
        return self.mapped(lambda part: part.index_select(0, rows))

    def one(self, box: Tensor) -> "Boxes":
        """In each of n rows only the box with this number [n], K = 1."""
        return self.mapped(lambda part: part[torch.arange(len(box), device=box.device), box].unsqueeze(1))

    def in_axes(self, points: Tensor) -> Tensor:
        """Points [n, D] in the axes of their boxes [m], shape [n, K, D]."""
        vectors = points.unsqueeze(1) - self.middle
        return vectors if self.turn is None else rotated(vectors, self.turn[0], -self.turn[1])

    def world_vectors(self, vectors: Tensor) -> Tensor:
        """Vectors [n, K, D] turned from the axes of their boxes into those of the scene."""
        return vectors if self.turn is None else rotated(vectors, *self.turn)

    def contain(self, points: Tensor, slack: float) -> Tensor:
        """Whether each point [n, D] is more than `slack` [m] inside each box, shape [n, K]."""
        return (self.in_axes(points).abs() < self.half - slack).all(dim=2)


def rotated(vectors: Tensor, cosine: Tensor, sine: Tensor, *, symmetric: bool = False) -> Tensor:
    """Vectors [..., D] turned from the first axis to the last; cosine, sine: of the angle, shape [...].
    symmetric: both terms with the sine are positive, as of extents."""
    first, last = vectors[..., 0], vectors[..., -1]
    turned = cosine * first + sine * last if symmetric else cosine * first - sine * last
    between = [vectors[..., axis].expand_as(turned) for axis in range(1, vectors.shape[-1] - 1)]
    return torch.stack((turned, *between, sine * first + cosine * last), dim=-1)


class Below:
    """The places on a raster below particles; fields are looked up there on request."""

    def __init__(self, positions: Tensor, ground: Ground, batch: Tensor | None) -> None:
        """positions: [m], shape [N, D]; batch: sample of each particle, shape [N], None if there is only one."""
        self._shape, self._spacing = ground.elevation.shape[1:], ground.spacing
        index: Tensor | int = 0 if batch is None else batch
        self._shares = []
        for axis, count in zip(plan_axes(positions.shape[1]), self._shape, strict=True):
            scaled = (positions[:, axis] / ground.spacing).clamp(0.0, count - 1.0)
            base = scaled.detach().floor().long().clamp(max=count - 2)
            index = index * count + base
            self._shares.append(scaled - base)
        assert isinstance(index, Tensor)
        self._index = index

    def _corners(self, field: Tensor) -> tuple[Tensor, ...]:
        """Values of a field at the 2^(D - 1) corners around each place, the last axis fastest; each [N]."""
        field = field.reshape(-1)
        strides = (math.prod(self._shape[axis + 1 :]) for axis in range(len(self._shape)))
        steps = [sum(bits) for bits in product(*((0, stride) for stride in strides))]
        return tuple(field.index_select(0, self._index + step if step else self._index) for step in steps)

    def value(self, field: Tensor) -> Tensor:
        """A field of the raster [B, X(, Z)] at the places, shape [N]."""
        values = self._corners(field)
        for share in reversed(self._shares):
            values = tuple(torch.lerp(low, high, share) for low, high in zip(values[::2], values[1::2], strict=True))
        return values[0]

    def value_and_slope(self, field: Tensor) -> tuple[Tensor, Tensor]:
        """A field at the places, [N], and its derivatives along the axes in plan [1/m], [N, D - 1]."""
        values = self._corners(field)
        if len(values) == 2:
            rise = values[1] - values[0]
            return values[0] + self._shares[0] * rise, (rise / self._spacing).unsqueeze(1)
        s, t = self._shares
        along = torch.lerp(values[0], values[1], t), torch.lerp(values[2], values[3], t)
        rise = along[1] - along[0]
        across = torch.lerp(values[1] - values[0], values[3] - values[2], s)
        return along[0] + s * rise, torch.stack((rise, across), dim=1) / self._spacing


def solid_features(positions: Tensor, conditions: Conditions, cutoff: float) -> Tensor:
    """Features of the solids closer than `cutoff` [m] to the particles: shape [N, 3 D + 2].

    positions: [m], shape [N, D].

    | distance to the walls  | lower ones, then upper ones, over the cutoff, at most 1 [-]                  |
    | distance to a solid    | of the nearest baffle or ground over the cutoff, at most 1 [-]               |
    | outward direction      | of these: sum_k (w_k^2 / sum_j w_j) n_k, w = max(1 - distance / cutoff, 0)   |
    | friction               | of these: sum_k (w_k^2 / sum_j w_j) mu_k [-]                                 |

    n is a solid's outward unit normal and mu its friction. All features are continuous where another solid becomes the
    nearest, and where the last one leaves the cutoff.
    """
    above = conditions.of_particles(conditions.size) - positions
    walls = (torch.cat((positions, above), dim=1) / cutoff).clamp(max=1.0)
    near = []
    if conditions.baffles is not None:
        near.append(nearest_baffle(positions, conditions, cutoff))
    if conditions.ground is not None:
        near.append(nearest_ground(positions, conditions.ground, conditions.batch, cutoff))
    if not near:
        far = torch.ones_like(positions[:, :1])
        return torch.cat((walls, far, torch.zeros_like(positions), torch.zeros_like(far)), dim=1)
    distances, directions, frictions = (torch.stack(parts) for parts in zip(*near, strict=True))
    weights = _shares(1.0 - distances / cutoff, dim=0).unsqueeze(2)
    directed = torch.cat((directions, frictions.unsqueeze(2)), dim=2)
    nearest = distances.min(dim=0).values.unsqueeze(1) / cutoff
    return torch.cat((walls, nearest, (weights * directed).sum(dim=0)), dim=1)


def _shares(weights: Tensor, dim: int) -> Tensor:
    """Shares of weights in their sum along `dim`, negative ones counted as zero; 0 where the sum is 0."""
    weights = weights.clamp(min=0.0)
    total = weights.sum(dim=dim, keepdim=True)
    return weights / torch.where(total > 0.0, total, 1.0)


def nearest_baffle(positions: Tensor, conditions: Conditions, cutoff: float) -> tuple[Tensor, ...]:
    """Signed distance [m], shape [N], of the nearest baffle; outward direction [-], [N, D], and friction [-], [N].
    Direction and friction are weighted as in `solid_features`. With q = |x| - half the box, per axis and x from its
    middle in its own axes, the distance of a box is |max(q, 0)| outside and max(q), negative, inside (the exact
    distance function of a box, e.g. Ericson, Real-time collision detection, 2004, section 5.1), at most `cutoff`."""
    direction = torch.zeros_like(positions)
    distance, rough = torch.full_like(direction[:, 0], cutoff), torch.zeros_like(direction[:, 0])
    boxes = Boxes.of_conditions(conditions)
    near, row = close_to(boxes, positions, positions, cutoff, conditions.batch)
    if len(near) == 0:
        return distance, direction, rough
    boxes = boxes.select(row)
    x = boxes.in_axes(positions.index_select(0, near))
    q = x.abs() - boxes.half
    square = q.clamp(min=0.0).square().sum(dim=2)
    outside = square > 0.0
    # The root has no slope at zero: on the surface the distance is measured to the face.
    distances = torch.where(outside, torch.where(outside, square, 1.0).sqrt(), q.max(dim=2).values)
    weight = 1.0 - distances / cutoff
    weight = weight.clamp(min=0.0) * _shares(weight, dim=1)
    normals = boxes.world_vectors(_normals(x, boxes.half, q, ROUNDING * cutoff))
    nearest = distances.min(dim=1).values.clamp(max=cutoff)
    assert conditions.baffle_friction is not None
    friction = conditions.baffle_friction.index_select(0, row)
    distance = distance.index_copy(0, near, nearest)
    direction = direction.index_copy(0, near, (weight.unsqueeze(2) * normals).sum(dim=1))
    return distance, direction, rough.index_copy(0, near, (weight * friction).sum(dim=1))


def close_to(boxes: Boxes, first: Tensor, last: Tensor, margin: float, batch: Tensor | None) -> tuple[Tensor, Tensor]:
    """Particles whose path from `first` to `last` [N, D] comes within about `margin` [m] of a baffle: index, sample."""
    with torch.no_grad():
        low, high = torch.minimum(first, last).unsqueeze(1), torch.maximum(first, last).unsqueeze(1)
        # For a turned box, the extent along the axes of the scene.
        half = boxes.half if boxes.turn is None else rotated(boxes.half, *map(torch.abs, boxes.turn), symmetric=True)
        lower, upper = boxes.middle - half - margin, boxes.middle + half + margin
        if batch is not None:
            lower, upper = lower[batch], upper[batch]
        near = ((low < upper) & (high > lower)).all(dim=2).any(dim=1).nonzero().squeeze(1)
        return near, torch.zeros_like(near) if batch is None else batch.index_select(0, near)


def _normals(x: Tensor, half: Tensor, q: Tensor, radius: float) -> Tensor:
    """Outward unit normals [n, K, D] of boxes with edges rounded to `radius` [m], at `x`; q: of `nearest_baffle`."""
    arm = (q + half.clamp(max=radius)).clamp(min=0.0)
    square = arm.square().sum(dim=2, keepdim=True)
    outside = square > 0.0
    # Inside, it is the normal of the nearest face.
    face = torch.nn.functional.one_hot(q.argmax(dim=2), q.shape[2]).to(q)
    normal = torch.where(outside, arm / torch.where(outside, square, 1.0).sqrt(), face)
    return torch.where(x < 0.0, -normal, normal)


def upward(slope: Tensor) -> Tensor:
    """Outward unit normals [N, D] of ground of this slope [N, D - 1]."""
    normal = torch.cat((-slope[:, :1], torch.ones_like(slope[:, :1]), -slope[:, 1:]), dim=1)
    return torch.nn.functional.normalize(normal, dim=1)


def nearest_ground(positions: Tensor, ground: Ground, batch: Tensor | None, cutoff: float) -> tuple[Tensor, ...]:
    """Distance [m], outward direction and friction [-] of the ground, like `nearest_baffle` for baffles. The distance
    is measured to the tangent plane of the ground straight below, (y - h) / sqrt(1 + |grad h|^2)."""
    below = Below(positions, ground, batch)
    height, slope = below.value_and_slope(ground.elevation)
    normal = upward(slope)
    distance = ((positions[:, UP] - height) * normal[:, UP]).clamp(max=cutoff)
    weight = 1.0 - distance / cutoff
    return distance, weight.unsqueeze(1) * normal, weight * below.value(ground.friction)
