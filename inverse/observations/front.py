"""How far the flow got along x: the front, in the end or at given times, and the runout."""

from typing import Self

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from datasets import measures
from datasets.scene import Scene
from inverse.observations.measured_profile import read_columns, require_inside
from inverse.observations.observation import (
    Context,
    Measurement,
    Observation,
    Values,
    harrell_davis,
    require_times,
)
from inverse.settings import ObservationSettings


class Front(Observation):
    """The x that 99.5 % of the particles are behind."""

    kind = "front"
    label = "the front, the x that 99.5 % of the particles are behind"
    sources = ("value", "values", "csv")
    options = ("times", "unit")
    scalar = True

    def __init__(self, times: Values | None = None) -> None:
        """times: of each number [s], shape [M]; the end where absent."""
        self.times = times

    @classmethod
    def build(cls, settings: ObservationSettings, scene: Scene) -> Self:
        return cls(None if settings.times is None else require_times(np.array(settings.times), scene))

    @classmethod
    def read(cls, settings: ObservationSettings, context: Context) -> Measurement:
        if settings.csv is None:
            return super().read(settings, context)
        scene = context.scene
        times, fronts = read_columns(context.folder / settings.csv, ("time", "front"))
        fronts = require_inside(fronts * settings.unit.metres, scene.domain.size[0])
        return Measurement(observation=cls(require_times(times, scene)), values=fronts)

    @property
    def count(self) -> int:
        return 1 if self.times is None else len(self.times)

    def exact(self, positions: NDArray[np.floating]) -> Values:
        return np.array([measures.front(positions)])

    def smooth(self, positions: Tensor, volumes: Tensor) -> Tensor:
        return harrell_davis(positions[:, 0], volumes, measures.FRONT_QUANTILE).reshape(1)

    def front(self, values: Values) -> float:
        return float(values[-1])


class Runout(Observation):
    """The largest x; smoothly, the mean of x under weights exp(x / width) over the particles.

    The width is a quarter of a cell: particles further than a cell behind the first hardly count.
    """

    kind = "runout"
    label = "the runout, the largest x of the deposit"
    scalar = True

    def __init__(self, scene: Scene) -> None:
        self.width = 0.25 * scene.domain.cell

    @classmethod
    def build(cls, settings: ObservationSettings, scene: Scene) -> Self:
        return cls(scene)

    def exact(self, positions: NDArray[np.floating]) -> Values:
        return np.array([measures.runout(positions)])

    def smooth(self, positions: Tensor, volumes: Tensor) -> Tensor:
        x = positions[:, 0].double()
        return (torch.softmax(x / self.width, 0) * x).sum().reshape(1)
