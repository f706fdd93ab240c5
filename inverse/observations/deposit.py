"""The whole deposit: the final position of every particle."""

import math
from typing import Self

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from datasets import measures
from datasets.errors import InputError
from datasets.particles import particle_count
from datasets.scene import Scene
from datasets.trajectory import Trajectory
from inverse.observations.observation import DepositObservation, Values
from inverse.observations.target import Target
from inverse.settings import LoopSettings, ObservationSettings


class Deposit(DepositObservation):
    """The final position of every particle, N D numbers; the misfit is the paper's mean of |p - p_target|^2.

    The surrogate follows some of the particles: they are compared with the same ones of the target.
    """

    kind = "deposit"
    label = "the final position of every particle of the deposit"
    sources = ()
    source = "a trajectory"
    jointly = False
    every_particle = True
    distance_unit = (1e3, "mm, root mean square over the particles")

    def __init__(self, scene: Scene) -> None:
        self.components = scene.dimension

    @classmethod
    def build(cls, settings: ObservationSettings, scene: Scene) -> Self:
        return cls(scene)

    def check_run(self, run: Trajectory, scene: Scene) -> None:
        count = particle_count(scene)
        if run.positions.shape[1] != count:
            raise InputError(
                f"expected the {count} particles of the problem's scene for a target of kind deposit, got "
                f"{run.positions.shape[1]}"
            )

    def exact(self, positions: NDArray[np.floating]) -> Values:
        return np.asarray(positions.astype(np.float64).ravel())

    def smooth(self, positions: Tensor, volumes: Tensor) -> Tensor:
        return positions.double().flatten()

    def front(self, values: Values) -> float:
        return measures.front(values.reshape(-1, self.components))

    def of_particles(self, values: Values, indices: NDArray[np.int64]) -> Values:
        return np.asarray(values.reshape(-1, self.components)[indices].ravel())

    def tolerance(self, loop: LoopSettings, cell: float, target: Target, scatter: float) -> float:
        """Besides the scatter: particles of two flows at the same parameters lie that far from each other."""
        return math.hypot(loop.deposit_within * cell, scatter, 2.0 * target.noise * math.sqrt(self.components))

    def values_text(self, values: Values) -> str:
        return f"{len(values) // self.components} particles"
