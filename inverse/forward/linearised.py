"""The MPM instead of a learned surrogate: its observation, linearised by differences around its last run.

    y(u) = y_k + J (u - u_k),    J_i = (y(u_k + h_i e_i) - y(u_k - h_i e_i)) / 2 h_i

The first model, before any run is there to be linearised around, is a parabola in each unknown through the problem's
start and a run on either side of it (a response surface: Box & Wilson, On the experimental attainment of optimum
conditions, J. Roy. Statist. Soc. B 13 (1951) 1-45, section 4, without the mixed terms). Runs of one model share their
jitter seed, so that little of their chance is in a difference.

When to use it: where the flow is none that the surrogate has learnt (`gns.card`), where an unknown or an observation is
nothing it knows, or where the unknowns are few (docs/efficiency.md).
"""

import dataclasses
from collections.abc import Sequence
from functools import cached_property

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from datasets.scene import Scene
from datasets.trajectory import Trajectory
from inverse.forward.interface import Simulate
from inverse.observations.deposit import Observation, Values
from inverse.parameters.parameters import Vector, kind, with_unknowns
from inverse.problem import Problem

STEP = 0.05
"""Of a difference, as a fraction of an unknown's range (2 degrees): it changes more than the MPM scatters by."""
FAR = 0.7
"""How far to the bounds the first model looks, as a fraction of the way."""

Matrix = NDArray[np.float64]


class Quadratic:
    """y(u) = y_k + J (u - u_k) + C (u - u_k)^2, the square of each component by itself: a differentiable forward."""

    def __init__(self, source: "MpmSource", centre: Vector, beginning: Trajectory, *, first: bool) -> None:
        self.source, self.centre, self.beginning, self.first = source, centre, beginning, first
        self.shown = source.observation.observe(beginning)

    @cached_property
    def terms(self) -> tuple[Matrix, Matrix]:
        """J and C, both of shape [M, U], by two runs of the MPM in each unknown."""
        return self.source.terms(self.centre, self.shown, self.beginning.scene.seed, first=self.first)

    def predict(self, unknowns: Tensor) -> Tensor:
        """The observation, float64 of shape [M], of unknowns, float64 of shape [U]."""
        slope, bend = (torch.from_numpy(each) for each in self.terms)
        moved = unknowns - torch.from_numpy(self.centre)
        return torch.from_numpy(self.shown) + slope @ moved + bend @ moved**2

    def observe(self, unknowns: Sequence[Vector]) -> list[Values]:
        """The observation [M] of each vector of unknowns [U]; where the MPM has been, without any further run."""
        seen = []
        for each in unknowns:
            moved = each - self.centre
            if not np.any(moved):
                seen.append(self.shown)
                continue
            slope, bend = self.terms
            seen.append(self.shown + slope @ moved + bend @ moved**2)
        return seen

    def wanted(self, target: Values) -> Values:
        """All of it."""
        return target

    def deposit(self, unknowns: Vector) -> NDArray[np.floating]:
        """Where the particles of the run that it is linearised around come to rest [m], shape [N, D]."""
        return np.asarray(self.beginning.positions[-1])


class MpmSource:
    """Makes models of a problem's observation from runs of the MPM."""

    def __init__(self, problem: Problem, observation: Observation, simulate: Simulate) -> None:
        self.problem, self.observation, self.simulate = problem, observation, simulate
        self.runs = 0
        """Of the MPM so far, besides those that a model is made around."""

    def first_frames(self, scene: Scene) -> Scene | None:
        """None: it needs no frames of another run."""
        return None

    def start(self, beginning: Trajectory | None) -> Quadratic:
        """The model around `beginning`, whole runs; where there is none yet, around the problem's start."""
        if beginning is not None:
            names = self.problem.names
            centre = np.array([kind(name).read(beginning.scene) for name in names])
            return Quadratic(self, centre, beginning, first=False)
        (beginning,) = self.simulate([self._scene(self.problem.initial, self.problem.scene.seed)])
        self.runs += 1
        return Quadratic(self, self.problem.initial, beginning, first=True)

    def terms(self, centre: Vector, shown: Values, seed: int, *, first: bool) -> tuple[Matrix, Matrix]:
        """J and C around `centre` [U], where the MPM with this jitter seed shows `shown` [M]; C of the first alone."""
        lower, upper = np.array(self.problem.bounds).T
        places = []
        for index, (low, high) in enumerate(zip(lower, upper, strict=True)):
            for bound, sign in ((low, -1.0), (high, 1.0)):
                step = FAR * abs(bound - centre[index]) if first else STEP * (high - low)
                moved = centre.copy()
                moved[index] = np.clip(centre[index] + sign * step, low, high)
                places.append(moved)
        runs = self.simulate([self._scene(place, seed) for place in places])
        self.runs += len(runs)
        changes = [self.observation.observe(run) - shown for run in runs]
        slope, bend = np.zeros((len(shown), len(centre))), np.zeros((len(shown), len(centre)))
        for index in range(len(centre)):
            behind, ahead = (places[2 * index + side][index] - centre[index] for side in (0, 1))
            less, more = changes[2 * index], changes[2 * index + 1]
            if behind == 0.0 or ahead == 0.0 or not first:
                slope[:, index] = (more - less) / (ahead - behind)
                continue
            bend[:, index] = (more / ahead - less / behind) / (ahead - behind)
            slope[:, index] = more / ahead - bend[:, index] * ahead
        return slope, bend

    def _scene(self, unknowns: Vector, seed: int) -> Scene:
        return dataclasses.replace(with_unknowns(self.problem.scene, self.problem.names, unknowns), seed=seed)
