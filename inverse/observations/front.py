"""How far the flow got along x: the front, in the end or at given times, and the runout."""

from typing import ClassVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from datasets import measures
from datasets.scene import Scene
from inverse.observations.observation import Observation, Values, fitted_tail
from inverse.settings import ObservationSettings


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
