"""Positions and extents of baffles; and the boxes that they may occupy within the bounds of their parameters."""

import dataclasses
import itertools
from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from datasets.geometry.closed import turned
from datasets.scene import Baffle, Scene
from gns.initial import InitialState
from inverse.parameters.kind import UP, Kind, Parts, T, replaced, require_axis, require_index


@dataclass(frozen=True)
class BaffleKind(Kind):
    """A length of a baffle along an axis [m]."""

    baffle: int
    axis: int

    unit = "m"
    digits = 4
    step = 0.002
    differentiable = True

    def check(self, scene: Scene) -> None:
        require_index("baffles", self.baffle, len(scene.baffles))
        require_axis(self.axis, scene)

    def put(self, parts: Parts, value: float) -> None:
        baffle = parts.baffles[self.baffle]
        low, size = self.changed(baffle.lower[self.axis], baffle.size[self.axis], value)
        lower = replaced(baffle.lower, self.axis, low)
        parts.baffles[self.baffle] = dataclasses.replace(
            baffle, lower=lower, size=replaced(baffle.size, self.axis, size)
        )

    def enter(self, initial: InitialState, value: Tensor) -> InitialState:
        boxes = initial.conditions.baffles
        assert boxes is not None, "the scene has baffles, and so has the model"
        number, corner, axis = torch.meshgrid(*map(torch.arange, boxes.shape[1:]), indexing="ij")
        own = (number == self.baffle) & (axis == self.axis)
        lower, upper = boxes[0, self.baffle, :, self.axis]
        low, size = self.changed(lower, upper - lower, value.to(boxes.dtype))
        return initial.with_conditions(baffles=torch.where(own, low + corner * size, boxes))

    @abstractmethod
    def changed(self, low: T, size: T, value: T) -> tuple[T, T]:
        """Lower end and extent along the axis [m] with this value."""


@dataclass(frozen=True)
class Centre(BaffleKind):
    """The centre of a baffle [m]."""

    def read(self, scene: Scene) -> float:
        baffle = scene.baffles[self.baffle]
        return baffle.lower[self.axis] + 0.5 * baffle.size[self.axis]

    def changed(self, low: T, size: T, value: T) -> tuple[T, T]:
        return value - 0.5 * size, size


@dataclass(frozen=True)
class Extent(BaffleKind):
    """Extent of a baffle [m]: upwards from its foot, else about its centre."""

    def read(self, scene: Scene) -> float:
        return scene.baffles[self.baffle].size[self.axis]

    def changed(self, low: T, size: T, value: T) -> tuple[T, T]:
        return (low if self.axis == UP else low + 0.5 * size - 0.5 * value), value


def swept(scene: Scene, kinds: Sequence[Kind], bounds: Sequence[tuple[float, float]]) -> dict[int, Baffle]:
    """The box that each baffle with a parameter may occupy, while each parameter stays in its (lower, upper).

    For a turned baffle the smaller one of the box turned alike and the one along the axes around all it may occupy.
    """
    moving = [(kind, ends) for kind, ends in zip(kinds, bounds, strict=True) if isinstance(kind, BaffleKind)]
    boxes = {}
    for index in sorted({kind.baffle for kind, _ in moving}):
        own = [(kind, ends) for kind, ends in moving if kind.baffle == index]
        extremes = []
        for values in itertools.product(*(ends for _, ends in own)):
            parts = Parts.split(scene)
            for (kind, _), value in zip(own, values, strict=True):
                kind.put(parts, value)
            extremes.append(parts.baffles[index])
        around = [_around(extremes, turned_deg) for turned_deg in (scene.baffles[index].turned_deg, 0.0)]
        boxes[index] = min(around, key=lambda box: float(np.prod(box.size)))
    return boxes


def _around(baffles: Sequence[Baffle], turned_deg: float) -> Baffle:
    """The smallest box, turned by this angle, around baffles of an equal turn."""
    dimension = len(baffles[0].size)
    lower, size = (np.array([getattr(each, key) for each in baffles], dtype=np.float64) for key in ("lower", "size"))
    middle, plane = lower + 0.5 * size, [0, dimension - 1]
    if turned_deg != baffles[0].turned_deg:
        angle = np.radians(baffles[0].turned_deg - turned_deg)
        size[:, plane] = abs(np.cos(angle)) * size[:, plane] + abs(np.sin(angle)) * size[:, plane[::-1]]
    # About any point: the middles in the axes of the box.
    pivot = middle[0, plane]
    middle[:, plane] = turned(middle[:, plane], pivot, -turned_deg)
    low, high = (middle - 0.5 * size).min(axis=0), (middle + 0.5 * size).max(axis=0)
    centre, extent = 0.5 * (low + high), (high - low).round(9)
    centre[plane] = turned(centre[None, plane], pivot, turned_deg)[0]
    corner = (centre - 0.5 * extent).round(9)
    return Baffle(lower=tuple(corner.tolist()), size=tuple(extent.tolist()), turned_deg=turned_deg)
