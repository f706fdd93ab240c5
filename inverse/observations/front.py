"""How far the flow got along x: front, runout, toe, and the share beyond a line."""

from typing import ClassVar

import numpy as np
import scipy.optimize
import torch
from numpy.typing import NDArray
from torch import Tensor

from datasets import measures
from datasets.errors import InputError
from datasets.particles import particle_volumes
from datasets.scene import Scene
from inverse.observations.observation import Observation, Values, fitted_tail
from inverse.settings import ObservationSettings

SHARE_SCATTER = 0.005
"""Standard deviation of a share from flow to flow [-], before an ensemble has measured it."""


class Front(Observation):
    """The x that 99.5 % of the particles are behind."""

    kind = "front"
    label = "the front, the x that 99.5 % of the particles are behind"
    sources = ("value", "values", "csv")
    options = ("times", "unit")
    columns: ClassVar = {"time": "times", "front": "values"}
    scalar = True

    def __init__(self, settings: ObservationSettings, scene: Scene) -> None:
        super().__init__(settings, scene)
        self.limits = (0.0, scene.domain.size[0])

    def exact(self, positions: NDArray[np.floating]) -> Values:
        return np.array([measures.front(positions)])

    def smooth(self, positions: Tensor, volumes: Tensor) -> Tensor:
        return fitted_tail(positions[:, 0], volumes).reshape(1)

    def front(self, values: Values) -> float:
        return float(values[-1])


class Runout(Observation):
    """The largest x; smoothly, the mean of x under weights exp(x / width) over the particles.

    The width is a quarter of a cell: particles further than a cell behind the first hardly count.
    """

    kind = "runout"
    label = "the runout, the largest x of the deposit"
    scalar = True

    def __init__(self, settings: ObservationSettings, scene: Scene) -> None:
        super().__init__(settings, scene)
        self.limits, self.width = (0.0, scene.domain.size[0]), 0.25 * scene.domain.cell

    def exact(self, positions: NDArray[np.floating]) -> Values:
        return np.array([measures.runout(positions)])

    def smooth(self, positions: Tensor, volumes: Tensor) -> Tensor:
        x = positions[:, 0].double()
        return (torch.softmax(x / self.width, 0) * x).sum().reshape(1)


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


class Passed(Observation):
    """The share of the volume that came to rest beyond x = `line` [m].

    Smoothly, a particle at x counts as 1 / (1 + exp((line - x) / width)).
    """

    kind = "passed"
    label = "the share of the material that came to rest beyond the line"
    unit = ""
    options = ("line", "width")
    scalar = True
    limits = (0.0, 1.0)

    def __init__(self, settings: ObservationSettings, scene: Scene) -> None:
        super().__init__(settings, scene)
        length, line, width = scene.domain.size[0], settings.line, settings.width
        if line is None or not 0.0 < line < length:
            raise InputError(f"expected a length in (0, {length:g}) m, got {line}", key="line")
        if width is not None and not 0.0 < width <= length:
            raise InputError(f"expected a length in (0, {length:g}] m, got {width}", key="width")
        self.line, self.width = line, width or scene.domain.cell

    def exact(self, positions: NDArray[np.floating]) -> Values:
        volumes = particle_volumes(self.scene, len(positions))
        return np.array([np.average(positions[:, 0].astype(np.float64) > self.line, weights=volumes)])

    def smooth(self, positions: Tensor, volumes: Tensor) -> Tensor:
        share = volumes.double() / volumes.double().sum()
        return (share @ torch.sigmoid((positions[:, 0].double() - self.line) / self.width)).reshape(1)

    def prior_scatter(self, values: Values) -> Values:
        return np.full(len(values), SHARE_SCATTER)

    def text(self, values: Values) -> str:
        return f"{100.0 * values[0]:.2f} % beyond {self.line:g} m"
