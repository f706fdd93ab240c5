"""The MPM instead of a learned surrogate: its observation, linearised by differences around its last run.

    y(u) = y_k + J (u - u_k),    J_i = (y(u_k + h_i e_i) - y(u_k - h_i e_i)) / 2 h_i

The first model, before any run is there to be linearised around, is a parabola in each parameter through the problem's
start and a run on either side of it (a response surface: Box & Wilson, On the experimental attainment of optimum
conditions, J. Roy. Statist. Soc. B 13 (1951) 1-45, section 4, without the mixed terms). Runs of one model share their
jitter seed, so that little of their chance is in a difference.

When to use it: where the flow is outside of the training range of the surrogate (`gns.card`), where a parameter or an
observation is none that it predicts, or where the parameters are few (docs/efficiency.md).
"""

from collections.abc import Sequence
from functools import cached_property

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from datasets.trajectory import Trajectory
from inverse.forward.interface import Simulate
from inverse.observations import Observation, Values
from inverse.parameters import Vector
from inverse.problem import Problem

STEP = 0.05
"""Of a difference, as a fraction of a parameter's range (2 degrees): it changes more than the MPM scatters by."""
FAR = 0.7
"""Distance of the first model's runs from the start, as a fraction of that to the bounds."""

Matrix = NDArray[np.float64]


class Quadratic:
    """y(u) = y_k + J (u - u_k) + C (u - u_k)^2, the square of each component by itself: a differentiable forward."""

    def __init__(self, source: "MpmSource", centre: Vector, beginning: Trajectory, *, first: bool) -> None:
        self.source, self.centre, self.beginning, self.first = source, centre, beginning, first
        self.shown = source.observation.observe(beginning)

    @cached_property
    def terms(self) -> tuple[Matrix, Matrix]:
        """J and C, both of shape [M, U], by two runs of the MPM in each parameter."""
        return self.source.terms(self.centre, self.shown, self.beginning.scene.seed, first=self.first)

    def predict(self, parameters: Tensor, /) -> Tensor:
        """The observation, float64 of shape [M], of parameters, float64 of shape [U]."""
        slope, bend = (torch.from_numpy(each) for each in self.terms)
        moved = parameters - torch.from_numpy(self.centre)
        return torch.from_numpy(self.shown) + slope @ moved + bend @ moved**2

    def observe(self, parameters: Sequence[Vector], /) -> list[Values]:
        """The observation [M] at each vector of parameters [U]; at the centre without any further run."""
        return [self._at(values - self.centre) for values in parameters]

    def _at(self, moved: Vector) -> Values:
        if not np.any(moved):
            return self.shown
        slope, bend = self.terms
        return np.asarray(self.shown + slope @ moved + bend @ moved**2)

    def select(self, target: Values, /) -> Values:
        """All of it."""
        return target

    def deposit(self, parameters: Vector, /) -> NDArray[np.floating]:
        """Final positions of the particles of the run that it is linearised around [m], shape [N, D]."""
        return np.asarray(self.beginning.positions[-1])


class MpmSource:
    """Makes models of a problem's observation from runs of the MPM."""

    def __init__(self, problem: Problem, observation: Observation, simulate: Simulate) -> None:
        self.problem, self.observation, self.simulate = problem, observation, simulate

    def start(self, beginning: Trajectory | None) -> Quadratic:
        """The model around `beginning`, whole runs; where there is none yet, around the problem's start."""
        if beginning is not None:
            centre = np.array([kind.read(beginning.scene) for kind in self.problem.kinds])
            return Quadratic(self, centre, beginning, first=False)
        (beginning,) = self.simulate([self.problem.scene_at(self.problem.initial)])
        return Quadratic(self, self.problem.initial, beginning, first=True)

    def terms(self, centre: Vector, shown: Values, seed: int, *, first: bool) -> tuple[Matrix, Matrix]:
        """J and C around `centre` [U], where a run with this jitter seed gives `shown` [M]; C of the first alone."""
        lower, upper = np.array(self.problem.bounds).T
        points = []
        for index, (low, high) in enumerate(zip(lower, upper, strict=True)):
            for bound, sign in ((low, -1.0), (high, 1.0)):
                step = FAR * abs(bound - centre[index]) if first else STEP * (high - low)
                moved = centre.copy()
                moved[index] = np.clip(centre[index] + sign * step, low, high)
                points.append(moved)
        runs = self.simulate([self.problem.scene_at(values, seed) for values in points])
        changes = [self.observation.observe(run) - shown for run in runs]
        slope, bend = np.zeros((len(shown), len(centre))), np.zeros((len(shown), len(centre)))
        for index in range(len(centre)):
            behind, ahead = (points[2 * index + end][index] - centre[index] for end in (0, 1))
            less, more = changes[2 * index], changes[2 * index + 1]
            if behind == 0.0 or ahead == 0.0 or not first:
                slope[:, index] = (more - less) / (ahead - behind)
                continue
            bend[:, index] = (more / ahead - less / behind) / (ahead - behind)
            slope[:, index] = more / ahead - bend[:, index] * ahead
        return slope, bend
