"""The runout of a deposit: the largest x."""

from typing import Self

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from datasets import measures
from datasets.scene import Scene
from inverse.observations.observation import DepositObservation, Values
from inverse.observations.target import Target
from inverse.settings import LoopSettings, ObservationSettings


class Runout(DepositObservation):
    """The largest x; smoothly, the mean of x under weights exp(x / width) over the particles.

    The width is a quarter of a cell: particles further than a cell behind the first hardly count.
    """

    kind = "runout"
    label = "the runout, the largest x of the deposit"
    scalar = True
    along_flow = True
    distance_unit = (100.0, "% of the runout")

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

    def front(self, values: Values) -> float:
        return float(values[0])

    def distance(self, values: Values, target: Values) -> float:
        """Relative to the target's [-]."""
        return float(np.abs(values - target).sum() / np.abs(target).sum())

    def tolerance(self, loop: LoopSettings, cell: float, target: Target, scatter: float) -> float:
        return max(loop.runout_within, 2.0 * scatter)

    def caption(self, deposit: NDArray[np.floating]) -> str:
        return self.values_text(self.exact(deposit))
