"""The toe of a deposit: the centroid of the furthest 10 % of the particles."""

import numpy as np
import scipy.optimize
import torch
from numpy.typing import NDArray
from torch import Tensor

from datasets import measures
from datasets.scene import Scene
from inverse.observations.observation import Observation, Values
from inverse.settings import ObservationSettings


class Toe(Observation):
    """The centroid of the furthest 10 % of the particles, D numbers; the misfit is the paper's |c - c_target|^2.

    Smoothly, a particle at x belongs to them by 1 / (1 + exp((t - x) / width)), with the t at which the volume of all
    that belong is a tenth: a soft rank. The share of a particle that falls back goes to the others, and its part in the
    centroid's y and z as well, which fixed weights by rank would leave out. The width is half a cell.
    """

    kind = "toe"
    label = "the toe, the centroid of the furthest 10 % of the particles"
    sources = ("values",)

    def __init__(self, settings: ObservationSettings, scene: Scene) -> None:
        super().__init__(settings, scene)
        self.width, self.components = 0.5 * scene.domain.cell, scene.dimension
        self.limits = (0.0, np.array(scene.domain.size))

    @property
    def count(self) -> int:
        return self.components

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
