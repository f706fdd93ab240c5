"""The MPM as a forward model: exact observations of whole runs, in parallel on all cores."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from datasets.scene.particles import particle_count
from inverse.forward import Simulate
from inverse.observations import Observation, Values
from inverse.observations.observation import recording
from inverse.parameters import Vector
from inverse.problem import Problem
from mpm import LAST

PARTICLES = 400  # most particles of a whole deposit: their covariance is a dense matrix


class MpmForward:
    """Runs the problem's scene with its own jitter seed; in a whole deposit it follows `PARTICLES` random particles."""

    def __init__(
        self, problem: Problem, observation: Observation, simulate: Simulate, *, band: Values | None = None
    ) -> None:
        """band: standard deviation of each number due to the error of the cells, shape [M]; default: none."""
        self.band = band
        self.problem, self.observation, self.simulate = problem, observation, simulate
        self.indices = np.arange(particle_count(problem.scene) if observation.every_particle else 0)
        if len(self.indices) > PARTICLES:
            self.indices = np.sort(np.random.default_rng(0).choice(self.indices, PARTICLES, replace=False))

    def observe(self, parameters: Sequence[Vector], /) -> list[Values]:
        """The exact observation [m] of an MPM run at each vector of parameters [U]."""
        scenes = [self.problem.scene_at(values) for values in parameters]
        trajectories = self.simulate(scenes, record=recording([self.observation]))
        flows = [self.problem.clocked(*pair) for pair in zip(trajectories, parameters, strict=True)]
        return [self.select(self.observation.observe(flow)) for flow in flows]

    def errors(self, parameters: Vector, /) -> NDArray[np.float64]:
        """Columns of the covariance of its errors at parameters [U], from its band: shape [K, m]."""
        return np.zeros((0, 1)) if self.band is None else np.diag(self.select(self.band))

    def deposit(self, parameters: Vector, /) -> NDArray[np.floating]:
        """Final positions of the particles [m], shape [N, D]."""
        (trajectory,) = self.simulate([self.problem.scene_at(parameters)], record=LAST)
        return np.asarray(trajectory.positions[-1])

    def select(self, target: Values, /) -> Values:
        return self.observation.of_particles(target, self.indices)
