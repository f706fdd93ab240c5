"""The share of the material that came to rest beyond a line across the flow."""

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from datasets.errors import InputError
from datasets.particles import particle_volumes
from datasets.scene import Scene
from inverse.observations.observation import Observation, Values
from inverse.settings import ObservationSettings

SCATTER = 0.005
"""Standard deviation of the share from flow to flow [-], before an ensemble has measured it."""


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
        return np.full(len(values), SCATTER)

    def text(self, values: Values) -> str:
        return f"{100.0 * values[0]:.2f} % beyond {self.line:g} m"
