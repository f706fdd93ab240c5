"""The ground below particles: elevation, slope and friction of a raster, and the projection onto it.

Elevations are multilinear between those of the raster; all of it is differentiable in them and in the positions.
"""

import math

import torch
from torch import Tensor

from gns.model.grid import UP
from gns.model.state import Ground


class Below:
    """The places of a raster below particles; what is asked for there is looked up, nothing else."""

    def __init__(self, positions: Tensor, ground: Ground, batch: Tensor | None) -> None:
        """positions: [m], shape [N, D]; batch: sample of each particle, shape [N], absent where there is one."""
        self._shape = ground.elevation.shape[1:]
        self._spacing = ground.spacing
        plan = [axis for axis in range(positions.shape[1]) if axis != UP]
        index: Tensor | int = 0 if batch is None else batch
        self._shares = []
        for axis, count in zip(plan, self._shape, strict=True):
            scaled = (positions[:, axis] / ground.spacing).clamp(0.0, count - 1.0)
            base = scaled.detach().floor().long().clamp(max=count - 2)
            index = index * count + base
            self._shares.append(scaled - base)
        assert isinstance(index, Tensor)
        self._index = index

    def _corners(self, field: Tensor) -> tuple[Tensor, ...]:
        """Values of a field at the 2^(D - 1) corners around each place, the last axis fastest; each [N]."""
        field = field.reshape(-1)
        strides = [math.prod(self._shape[axis + 1 :]) for axis in range(len(self._shape))]
        steps = [0]
        for stride in strides:
            steps = [step + bit for step in steps for bit in (0, stride)]
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


def upward(slope: Tensor) -> Tensor:
    """Outward unit normals [N, D] of ground of this slope [N, D - 1]."""
    normal = torch.cat((-slope[:, :1], torch.ones_like(slope[:, :1]), -slope[:, 1:]), dim=1)
    return torch.nn.functional.normalize(normal, dim=1)


def nearest_ground(
    positions: Tensor, ground: Ground, batch: Tensor | None, cutoff: float
) -> tuple[Tensor, Tensor, Tensor]:
    """Distance [m], outward direction and friction [-] of the ground, as `nearest_baffle` has those of baffles.

    The distance is that of the plane that touches the ground straight below, (y - h) / sqrt(1 + |grad h|^2).
    """
    below = Below(positions, ground, batch)
    height, slope = below.value_and_slope(ground.elevation)
    normal = upward(slope)
    distance = ((positions[:, UP] - height) * normal[:, UP]).clamp(max=cutoff)
    weight = 1.0 - distance / cutoff
    return distance, weight.unsqueeze(1) * normal, weight * below.value(ground.friction)


def above(points: Tensor, ground: Ground, batch: Tensor | None) -> Tensor:
    """Positions [n, D], those below the ground moved to it along its normal, what is left of the way straight up."""
    below = Below(points, ground, batch)
    with torch.no_grad():
        buried = (below.value(ground.elevation) > points[:, UP]).nonzero().squeeze(1)
    if len(buried) == 0:
        return points
    point = points.index_select(0, buried)
    own = None if batch is None else batch.index_select(0, buried)
    height, slope = Below(point, ground, own).value_and_slope(ground.elevation)
    normal = upward(slope)
    point = point + ((height - point[:, UP]) * normal[:, UP]).unsqueeze(1) * normal
    return points.index_copy(0, buried, lifted(point, ground, own))


def lifted(points: Tensor, ground: Ground, batch: Tensor | None) -> Tensor:
    """Positions [n, D], those below the ground moved straight up to it."""
    height = Below(points, ground, batch).value(ground.elevation)
    y = points[:, UP]
    # Not by torch.maximum, which would halve the gradient of a particle that rests exactly on the ground.
    up = torch.where(height > y, height, y)
    return torch.cat((points[:, :UP], up.unsqueeze(1), points[:, UP + 1 :]), dim=1)
