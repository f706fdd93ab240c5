"""Observations of a deposit: front, runout, toe, the share beyond a line, every particle."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import scipy.optimize
import torch
from numpy.typing import NDArray
from torch import Tensor

from datasets.errors import require
from datasets.flow import measures
from datasets.scene import Scene
from datasets.scene.particles import particle_volumes
from inverse.observations.observation import Observation, SmoothObservation, Values, fitted_tail
from inverse.observations.settings import LengthsSettings, ObservationSettings, SeriesSettings

SHARE_SCATTER = 0.005  # standard deviation of a share from flow to flow [-], before an ensemble has measured it


class Front(SmoothObservation):
    """The x that 99.5 % of the volume is behind, by a fit (`measures.front`)."""

    kind = "front"
    label = "the front, the x that 99.5 % of the volume is behind"

    def __init__(self, scene: Scene, settings: "FrontSettings") -> None:
        super().__init__(scene, settings)
        self.limits = (0.0, scene.domain.size[0])

    def smooth(self, positions: Tensor, volumes: Tensor) -> Tensor:
        return fitted_tail(positions[:, 0], volumes).reshape(1)

    def front(self, values: Values) -> float:
        return self.at_end(values)


@dataclass(frozen=True, kw_only=True)
class FrontSettings(SeriesSettings, LengthsSettings):
    """Settings of `Front` [m]; the table has time and front."""

    operator_type = Front
    places: ClassVar = {"value": 0, "values": 0}
    columns: ClassVar = {"time": "times", "front": "values"}


class Runout(Observation):
    """The largest x; smoothly its mean under weights exp(x / width), the width a quarter of a cell."""

    kind = "runout"
    label = "the runout, the largest x of the deposit"

    def __init__(self, scene: Scene, settings: "RunoutSettings") -> None:
        super().__init__(scene, settings)
        self.limits, self.width = (0.0, scene.domain.size[0]), 0.25 * scene.domain.cell

    def exact(self, positions: NDArray[np.floating]) -> Values:
        return np.array([measures.runout(positions)])

    def smooth(self, positions: Tensor, volumes: Tensor) -> Tensor:
        x = positions[:, 0].double()
        return (torch.softmax(x / self.width, 0) * x).sum().reshape(1)


@dataclass(frozen=True, kw_only=True)
class RunoutSettings(ObservationSettings):
    value: float | None = None  # [m]

    operator_type = Runout
    places: ClassVar = {"value": 0}


class Toe(Observation):
    """The centroid of the furthest 10 % of the particles, D numbers; the misfit is |c - c_target|^2, as in the paper.
    In the smooth form, a particle at x has the weight 1 / (1 + exp((t - x) / width)), with a width of half a cell and
    the t for which the weighted volume is a tenth: a soft rank, in which the weight of a particle that falls back goes
    to the others."""

    kind = "toe"
    label = "the toe, the centroid of the furthest 10 % of the particles"

    def __init__(self, scene: Scene, settings: "ToeSettings") -> None:
        super().__init__(scene, settings)
        self.width, self.count, self.components = 0.5 * scene.domain.cell, scene.dimension, scene.dimension
        self.limits = (0.0, np.array(scene.domain.size))

    def exact(self, positions: NDArray[np.floating]) -> Values:
        return np.array(measures.toe(positions))

    def smooth(self, positions: Tensor, volumes: Tensor) -> Tensor:
        points, share = positions.double(), volumes.double() / volumes.double().sum()
        x = points[:, 0]
        fixed, weights = x.detach(), share.detach()
        low, high = float(fixed.min()) - 40.0 * self.width, float(fixed.max()) + 40.0 * self.width

        def surplus(threshold: float) -> float:
            return float(weights @ torch.sigmoid((fixed - threshold) / self.width)) - measures.TOE_FRACTION

        root = scipy.optimize.brentq(surplus, low, high, xtol=1e-14, rtol=1e-14)
        belongs = torch.sigmoid((x - root) / self.width)
        # A Newton step at the root changes its value only by rounding, and gives it its gradient.
        slope = (weights @ (belongs * (1.0 - belongs)).detach()) / self.width
        threshold = root + (share @ belongs - measures.TOE_FRACTION) / slope
        weight = share * torch.sigmoid((x - threshold) / self.width)
        return (weight / weight.sum()) @ points


@dataclass(frozen=True, kw_only=True)
class ToeSettings(ObservationSettings):
    values: tuple[float, ...] | None = None  # its coordinates [m]

    operator_type = Toe
    places: ClassVar = {"values": None}


class Passed(Observation):
    """Share of the volume beyond x = `line` [m]; smooth weight of a particle: 1 / (1 + exp((line - x) / width))."""

    kind = "passed"
    label = "the share of the material that came to rest beyond the line"
    unit = ""
    limits = (0.0, 1.0)

    def __init__(self, scene: Scene, settings: "PassedSettings") -> None:
        super().__init__(scene, settings)
        length, line, width = scene.domain.size[0], settings.line, settings.width
        require(0.0 < line < length, "line", f"a length in (0, {length:g}) m", line)
        require(width is None or 0.0 < width <= length, "width", f"a length in (0, {length:g}] m", width)
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


@dataclass(frozen=True, kw_only=True)
class PassedSettings(ObservationSettings):
    value: float | None = None  # a share [-]
    line: float  # the x beyond which a particle has passed [m]
    width: float | None = None
    """Length over which the share is smoothed for gradients [m]; default: a cell of the scene."""

    operator_type = Passed
    places: ClassVar = {"line": 0}


class FinalPositions(SmoothObservation):
    """The final position of every followed particle, N D numbers; misfit as in the paper: mean |p - p_target|^2."""

    kind = "deposit"
    label = "the final position of every particle of the deposit"
    every_particle = True

    def __init__(self, scene: Scene, settings: "DepositSettings") -> None:
        super().__init__(scene, settings)
        self.components = scene.dimension

    def smooth(self, positions: Tensor, volumes: Tensor) -> Tensor:
        return positions.double().flatten()

    def of_particles(self, values: Values, indices: NDArray[np.int64]) -> Values:
        return np.asarray(values.reshape(-1, self.components)[indices].ravel())

    def text(self, values: Values) -> str:
        return f"{len(values) // self.components} particles"


@dataclass(frozen=True, kw_only=True)
class DepositSettings(ObservationSettings):
    """Settings of `FinalPositions`, whose numbers come from a twin or a trajectory."""

    operator_type = FinalPositions
    robust = False
