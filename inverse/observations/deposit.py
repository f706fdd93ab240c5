"""The whole deposit: the final position of every particle."""

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from datasets import measures
from datasets.errors import InputError
from datasets.particles import particle_count
from datasets.scene import Scene
from datasets.trajectory import Trajectory
from inverse.observations.observation import Observation, Values
from inverse.settings import ObservationSettings


class Deposit(Observation):
    """The final position of every particle, N D numbers; the misfit is the paper's mean of |p - p_target|^2.

    The surrogate follows some of the particles: they are compared with the same ones of the target.
    """

    kind = "deposit"
    label = "the final position of every particle of the deposit"
    sources = ()
    every_particle = True

    def __init__(self, settings: ObservationSettings, scene: Scene) -> None:
        super().__init__(settings, scene)
        self.components = scene.dimension

    def check_run(self, run: Trajectory) -> None:
        count = particle_count(self.scene)
        if run.positions.shape[1] != count:
            got = f"got {run.positions.shape[1]}"
            raise InputError(f"expected the {count} particles of the problem's scene for a deposit, {got}")

    def exact(self, positions: NDArray[np.floating]) -> Values:
        return np.asarray(positions.astype(np.float64).ravel())

    def smooth(self, positions: Tensor, volumes: Tensor) -> Tensor:
        return positions.double().flatten()

    def front(self, values: Values) -> float:
        return measures.front(values.reshape(-1, self.components))

    def of_particles(self, values: Values, indices: NDArray[np.int64]) -> Values:
        return np.asarray(values.reshape(-1, self.components)[indices].ravel())

    def text(self, values: Values) -> str:
        return f"{len(values) // self.components} particles"
