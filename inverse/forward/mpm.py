"""The MPM as a forward: exact observations of whole runs, side by side on all cores. It has no gradient of its own."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from datasets.scene import Scene
from inverse.forward.interface import Simulate
from inverse.observations.deposit import Observation, Values
from inverse.parameters.parameters import Vector, with_unknowns
from inverse.problem import Problem
from mpm.output.request import ALL, LAST


class MpmForward:
    """Runs the problem's scene, with its own jitter seed, at the unknowns asked for."""

    def __init__(self, problem: Problem, observation: Observation, simulate: Simulate) -> None:
        self.problem, self.observation, self.simulate = problem, observation, simulate
        self.runs = 0

    def scene(self, unknowns: Vector) -> Scene:
        """The problem's scene at `unknowns`."""
        return with_unknowns(self.problem.scene, self.problem.names, unknowns)

    def observe(self, unknowns: Sequence[Vector]) -> list[Values]:
        """The exact observation [M] of an MPM run at each vector of unknowns [U]."""
        self.runs += len(unknowns)
        record = ALL if self.observation.over_time else LAST
        trajectories = self.simulate([self.scene(values) for values in unknowns], record=record)
        return [self.observation.observe(trajectory) for trajectory in trajectories]

    def deposit(self, unknowns: Vector) -> NDArray[np.floating]:
        """Where the points come to rest [m], shape [N, D]."""
        (trajectory,) = self.simulate([self.scene(unknowns)], record=LAST)
        return np.asarray(trajectory.positions[-1])
