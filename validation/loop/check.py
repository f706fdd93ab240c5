"""Checks: runs of the MPM at proposed parameters, compared with the target; and all that a search has done so far."""

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from datasets import measures
from datasets.trajectory import Trajectory
from inverse.forward.interface import Evaluation, Simulate, SurrogateSource
from inverse.observations import Observation, Target, Values
from inverse.optimise import Bounds
from inverse.parameters import Vector
from inverse.problem import Problem
from inverse.result import Minimum, Round
from mpm import ALL, LAST, Recording, simulate_many
from validation.runs import RunStore

ENSEMBLE, DIFFERENCES, TWIN = "ensemble-", "slope-", "target-"
"""What the files of runs that are no checks begin with."""


@dataclass(frozen=True, kw_only=True)
class Check:
    """An MPM run at proposed parameters."""

    parameters: Vector
    """Shape [U]."""
    trajectory: Trajectory
    observation: Values
    """Exact, shape [M]."""
    front: float
    """[m]."""
    front_error: float
    """Relative, with its sign; nan where the target has no front."""
    misfit: float
    """From the target [unit^2]."""


@dataclass(frozen=True, kw_only=True)
class Answer:
    """Parameters and the checks there, which differ in their jitter seed; their mean is compared with the target."""

    parameters: Vector
    checks: tuple[Check, ...]

    @staticmethod
    def at(check: Check) -> "Answer":
        """A single check."""
        return Answer(parameters=check.parameters, checks=(check,))

    @property
    def observation(self) -> Values:
        """Mean observation, shape [M]."""
        return np.asarray(np.mean([check.observation for check in self.checks], axis=0))

    @property
    def front_error(self) -> float:
        """Mean relative error of the front, with its sign; nan where the target has none."""
        return float(np.mean([check.front_error for check in self.checks]))


@dataclass(frozen=True, kw_only=True)
class Task:
    """What a loop is given: nothing in it changes on the way."""

    problem: Problem
    target: Target
    source: SurrogateSource
    folder: Path
    """Where MPM runs are stored."""
    simulate: Simulate = simulate_many

    @property
    def observation(self) -> Observation:
        """The observation operator."""
        return self.target.observation

    @cached_property
    def bounds(self) -> Bounds:
        """The box of the parameters."""
        return Bounds.from_problem(self.problem)

    @cached_property
    def prior_scatter(self) -> float:
        """Expected scatter of an observed number over jitter seeds, root mean square [unit]."""
        expected = self.observation.prior_scatter(self.target.values, self.problem.scene.domain.cell)
        return float(np.sqrt(np.mean(expected**2)))

    @property
    def deposit_or_all(self) -> Recording:
        """What an observation requires of a run: the last frame, unless it is one over time."""
        return ALL if self.observation.over_time else LAST

    def store(self, label: str = "") -> RunStore:
        """The MPM, with runs stored under names that begin with `label`."""
        return RunStore(self.folder, self.simulate, label=label)

    def check(self, parameters: Vector, seed: int | None = None) -> Check:
        """Run the MPM at `parameters`, with another jitter `seed` than the scene's if so asked."""
        (trajectory,) = self.store()([self.problem.scene_at(parameters, seed)])
        return self.compare(parameters, trajectory)

    def compare(self, parameters: Vector, trajectory: Trajectory) -> Check:
        """An MPM run at `parameters`, compared with the target."""
        deposit = trajectory.positions[-1]
        observation = self.observation.observe(trajectory)
        return Check(
            parameters=parameters,
            trajectory=trajectory,
            observation=observation,
            front=measures.front(deposit),
            front_error=self.target.front_error(deposit),
            misfit=self.target.misfit(observation),
        )

    def is_within(self, answer: Answer, *, scatter: float = 0.0, front_scatter: float = 0.0) -> bool:
        """Whether the MPM at `answer` is within the tolerance; for the scatter see `Observation.is_within`."""
        return self.observation.is_within(
            self.problem.loop,
            self.problem.scene.domain.cell,
            self.target,
            answer.observation,
            front_error=answer.front_error,
            scatter=scatter,
            front_scatter=front_scatter,
        )

    def is_confirmed(self, check: Check) -> bool:
        """Whether a single check is within the tolerance, without any allowance for scatter."""
        return self.is_within(Answer.at(check))

    def distance(self, one: Vector, other: Vector) -> float:
        """Largest difference of two vectors of parameters, each entry as a fraction of its range."""
        return float(np.max(np.abs(one - other) / self.bounds.range))

    def rounded(self, parameters: Vector) -> Vector:
        """`parameters` to a millionth of the range, inside the bounds: a stored run is found again by its scene."""
        digits = 6 - np.ceil(np.log10(self.bounds.range)).astype(int)
        values = [round(float(value), int(count)) for value, count in zip(parameters, digits, strict=True)]
        return self.bounds.clip(np.array(values))


@dataclass(frozen=True, kw_only=True)
class History:
    """What a search has proposed and checked so far."""

    rounds: tuple[Round, ...] = ()
    """Minimisations on the surrogate; the first on the surrogate as it is."""
    other_starts: tuple[Round, ...] = ()
    """Of the first, those that did not end lowest."""
    other_minima: tuple[Minimum, ...] = ()
    checks: tuple[Check, ...] = ()
    members: tuple[Check, ...] = ()
    """Runs of ensembles."""

    @property
    def nearest(self) -> Check:
        """The check of the smallest misfit."""
        return min(self.checks, key=lambda check: check.misfit)

    def checked(self, check: Check) -> "History":
        """With one more check."""
        return dataclasses.replace(self, checks=(*self.checks, check))

    def surveyed(self, members: Sequence[Check]) -> "History":
        """With one more ensemble."""
        return dataclasses.replace(self, members=(*self.members, *members))

    def proposed(self, evaluations: Sequence[Evaluation]) -> "History":
        """With one more round."""
        stage = Round(number=len(self.rounds), evaluations=tuple(evaluations))
        return dataclasses.replace(self, rounds=(*self.rounds, stage))

    def budget(self, problem: Problem) -> int:
        """Checks that are left."""
        return problem.loop.mpm_runs - len(self.checks)
