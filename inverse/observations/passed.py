"""The share of the material that came to rest beyond a line across the flow."""

import math
from typing import Self

import numpy as np
import torch
from matplotlib.axes import Axes
from numpy.typing import NDArray
from torch import Tensor

from datasets.errors import InputError
from datasets.particles import particle_volumes
from datasets.scene import Scene
from inverse.observations.observation import DepositObservation, Values
from inverse.observations.target import Target
from inverse.settings import LoopSettings, ObservationSettings

SCATTER = 0.005
"""Standard deviation of the share from flow to flow [-], before an ensemble has measured it."""


class Passed(DepositObservation):
    """The share of the volume that came to rest beyond x = `line` [m].

    Smoothly, a particle at x counts as 1 / (1 + exp((line - x) / width)).
    """

    kind = "passed"
    label = "the share of the material that came to rest beyond the line"
    unit = ""
    options = ("line", "width")
    scalar = True
    distance_unit = (100.0, "% of the material")
    change_unit = (100.0, "% of the material")

    def __init__(self, scene: Scene, line: float, width: float) -> None:
        self.scene, self.line, self.width = scene, line, width

    @classmethod
    def build(cls, settings: ObservationSettings, scene: Scene) -> Self:
        length, line, width = scene.domain.size[0], settings.line, settings.width
        if line is None or not 0.0 < line < length:
            raise InputError(f"expected a length in (0, {length:g}) m, got {line}", key="line")
        if width is not None and not 0.0 < width <= length:
            raise InputError(f"expected a length in (0, {length:g}] m, got {width}", key="width")
        return cls(scene, line, width or scene.domain.cell)

    def check_value(self, value: float, scene: Scene) -> None:
        if not 0.0 <= value <= 1.0:
            raise InputError(f"expected a share in [0, 1], got {value}", key="value")

    def exact(self, positions: NDArray[np.floating]) -> Values:
        volumes = particle_volumes(self.scene, len(positions))
        return np.array([np.average(positions[:, 0].astype(np.float64) > self.line, weights=volumes)])

    def smooth(self, positions: Tensor, volumes: Tensor) -> Tensor:
        share = volumes.double() / volumes.double().sum()
        return (share @ torch.sigmoid((positions[:, 0].double() - self.line) / self.width)).reshape(1)

    def distance(self, values: Values, target: Values) -> float:
        """Difference of the shares [-]."""
        return float(abs(values[0] - target[0]))

    def tolerance(self, loop: LoopSettings, cell: float, target: Target, scatter: float) -> float:
        return max(loop.passed_within, 2.0 * scatter)

    def prior_scatter(self, values: Values, cell: float) -> Values:
        return np.full(len(values), SCATTER)

    def values_text(self, values: Values) -> str:
        return f"{100.0 * values[0]:.2f} % beyond {self.line:g} m"

    @classmethod
    def misfit_text(cls, misfit: float, cell: float) -> str:
        return f"{100.0 * math.sqrt(misfit):.2f} % of the material"

    def caption(self, deposit: NDArray[np.floating]) -> str:
        return self.values_text(self.exact(deposit))

    def mark(self, axis: Axes, deposit: NDArray[np.floating], colour: str, target: Values | None) -> None:
        axis.axvline(self.line, color="#b2182b", linestyle="--", linewidth=1.2, zorder=5)

    def mark_profile(self, axis: Axes) -> None:
        axis.axvline(self.line, color="#b2182b", linestyle="--", linewidth=1.2)
