"""The toe of a deposit: the centroid of the furthest 10 % of the particles."""

import math
from typing import Self

import numpy as np
import scipy.optimize
import torch
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from numpy.typing import NDArray
from torch import Tensor

from datasets import measures
from datasets.errors import InputError
from datasets.scene import Scene
from inverse.observations.observation import DepositObservation, Values
from inverse.observations.target import Target
from inverse.settings import LoopSettings, ObservationSettings


class Toe(DepositObservation):
    """The centroid of the furthest 10 % of the particles, D numbers; the misfit is the paper's |c - c_target|^2.

    Smoothly, a particle at x belongs to them by 1 / (1 + exp((t - x) / width)), with the t at which the volume of all
    that belong is a tenth: a soft rank. The share of a particle that falls back goes to the others, and its part in the
    centroid's y and z as well, which fixed weights by rank would leave out. The width is half a cell.
    """

    kind = "toe"
    label = "the toe, the centroid of the furthest 10 % of the particles"
    sources = ("values",)
    source = "values"
    distance_unit = (1e3, "mm")

    def __init__(self, scene: Scene) -> None:
        self.width = 0.5 * scene.domain.cell
        self.components = scene.dimension

    @classmethod
    def build(cls, settings: ObservationSettings, scene: Scene) -> Self:
        return cls(scene)

    def stated(self, settings: ObservationSettings, scene: Scene) -> Values | None:
        values = super().stated(settings, scene)
        if values is None:
            return None
        size = np.array(scene.domain.size)
        if len(values) != len(size) or np.any((values < 0.0) | (values > size)):
            expected = f"{scene.dimension} coordinates [m] in the domain {size.tolist()}"
            raise InputError(f"expected {expected}, got {values.tolist()}", key="values")
        return values

    def exact(self, positions: NDArray[np.floating]) -> Values:
        return np.array(measures.toe(positions))

    def smooth(self, positions: Tensor, volumes: Tensor) -> Tensor:
        points, share = positions.double(), volumes.double() / volumes.double().sum()
        x = points[:, 0]
        known, weights = x.detach(), share.detach()
        low, high = float(known.min()) - 40.0 * self.width, float(known.max()) + 40.0 * self.width

        def surplus(threshold: float) -> float:
            return float(weights @ torch.sigmoid((known - threshold) / self.width)) - measures.TOE_FRACTION

        found = scipy.optimize.brentq(surplus, low, high, xtol=1e-14, rtol=1e-14)
        belongs = torch.sigmoid((x - found) / self.width)
        # A step of Newton's at the root changes its value by rounding alone and gives it its gradient.
        slope = (weights @ (belongs * (1.0 - belongs)).detach()) / self.width
        threshold = found + (share @ belongs - measures.TOE_FRACTION) / slope
        weight = share * torch.sigmoid((x - threshold) / self.width)
        return (weight / weight.sum()) @ points

    def front(self, values: Values) -> float:
        return float(values[0])

    def tolerance(self, loop: LoopSettings, cell: float, target: Target, scatter: float) -> float:
        asked = max(loop.toe_within * cell, 2.0 * scatter)
        return math.hypot(asked, 2.0 * target.noise * math.sqrt(self.components))

    def values_text(self, values: Values) -> str:
        return f"toe at ({', '.join(f'{value:.3f}' for value in values)}) m"

    def caption(self, deposit: NDArray[np.floating]) -> str:
        return self.values_text(self.exact(deposit))

    def mark(self, axis: Axes, deposit: NDArray[np.floating], colour: str, target: Values | None) -> None:
        across = 1 if deposit.shape[1] == 2 else 2
        own = self.exact(deposit)
        axis.plot(own[0], own[across], "o", color=colour, markeredgecolor="white", markersize=8, zorder=5)
        if target is not None:
            axis.plot(target[0], target[across], "+", color="#222222", markersize=13, markeredgewidth=2, zorder=6)

    def legend(self) -> list[Line2D]:
        own = {"marker": "o", "color": "#777777", "markeredgecolor": "white", "markersize": 8}
        target = {"marker": "+", "color": "#222222", "markeredgewidth": 2.0, "markersize": 12}
        return [
            Line2D([], [], linestyle="", label="toe of this deposit", **own),  # type: ignore[arg-type]
            Line2D([], [], linestyle="", label="target toe", **target),  # type: ignore[arg-type]
        ]
