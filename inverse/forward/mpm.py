"""The MPM as a forward model: exact observations of whole runs, side by side on all cores."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from inverse.forward.interface import Simulate
from inverse.observations import Observation, Values
from inverse.parameters import Vector
from inverse.problem import Problem
from mpm import ALL, LAST


class MpmForward:
    """Runs the problem's scene, with its own jitter seed, at given parameters."""

    def __init__(self, problem: Problem, observation: Observation, simulate: Simulate) -> None:
        self.problem, self.observation, self.simulate = problem, observation, simulate

    def observe(self, parameters: Sequence[Vector], /) -> list[Values]:
        """The exact observation [M] of an MPM run at each vector of parameters [U]."""
        record = ALL if self.observation.over_time else LAST
        trajectories = self.simulate([self.problem.scene_at(values) for values in parameters], record=record)
        return [self.observation.observe(trajectory) for trajectory in trajectories]

    def deposit(self, parameters: Vector, /) -> NDArray[np.floating]:
        """Final positions of the particles [m], shape [N, D]."""
        (trajectory,) = self.simulate([self.problem.scene_at(parameters)], record=LAST)
        return np.asarray(trajectory.positions[-1])

    def select(self, target: Values, /) -> Values:
        """All of it."""
        return target
