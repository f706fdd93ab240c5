"""Answers: parameters that the observation allows, the MPM runs at these parameters, and the verdict on them."""

import resource
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from datasets.flow import measures
from datasets.flow.trajectory import Trajectory
from inverse.noise import Fit
from inverse.observations import Values
from inverse.observations.target import Target
from inverse.parameters import Vector
from inverse.posterior.settings import CONSTANTS
from inverse.problem import Problem
from inverse.search.waves import ModelRun

MAX_NUMBERS = 100  # longest observation in files: a whole deposit would add thousands of numbers per iteration
IDENTIFIABLE = 0.3  # largest half-width, over the range, of an identifiable combination of parameters
UNIFORM = 0.475  # half-width of a uniform prior, over the range
CLOSE = 0.35  # largest distance between an answer and its checks, in half-widths


class Verdict(StrEnum):
    """The verdict of the MPM on the answer."""

    CONFIRMED = "confirmed"  # one answer, which the observation identifies and the MPM predicts within its interval
    AMBIGUOUS = "ambiguous"  # the MPM lies within it at several separate answers, or over a whole range of parameters
    UNCONFIRMED = "unconfirmed"
    UNREACHABLE = "unreachable"  # the MPM lies within it for no parameters within the bounds

    @property
    def confirms(self) -> bool:
        return self in (Verdict.CONFIRMED, Verdict.AMBIGUOUS)


class Purpose(StrEnum):
    """The purpose of an MPM run."""

    WAVE = "wave"  # where it narrows the posterior most
    CHECK = "check"  # at an answer
    KNOWN = "known"  # made before, for another target
    CELLS = "cells"  # at an answer on cells of another size, to estimate the error of the scene's cells


@dataclass(frozen=True, kw_only=True)
class MpmRun(ModelRun):
    """An MPM run with its own jitter seed."""

    purpose: Purpose
    parameters: Vector  # shape [U]
    trajectory: Trajectory
    seconds: float = 0.0
    file: str = ""  # beside `result.json`

    @classmethod
    def of(cls, flow: Trajectory, parameters: Vector, problem: Problem, target: Target, **others: Any) -> "MpmRun":
        """The run of a flow with `parameters` [U], observed in the same way as the target; others: further fields."""
        point, numbers = problem.box.shares(parameters), target.observation.observe(problem.clocked(flow, parameters))
        return cls(parameters=parameters, point=point, numbers=numbers, trajectory=flow, **others)

    def as_json(self, problem: Problem, target: Target) -> dict[str, Any]:
        front = measures.front(self.trajectory.positions[-1], self.trajectory.volumes)
        run = {"purpose": self.purpose.value, "unknowns": problem.named(self.parameters)}
        seen = {"front": front, "front_error_pct": 100.0 * target.front_error(self.trajectory)}
        cost = {"loss": target.misfit(self.numbers), "seconds": self.seconds, "file": self.file}
        return {**run, "observation": plain(self.numbers), **seen, **cost}


@dataclass(frozen=True, kw_only=True)
class Answer:
    """Parameters that the observation allows, with the MPM runs at these parameters."""

    parameters: Vector  # shape [U]
    interval: Values  # quantiles of 2.5 and 97.5 % within the bounds, shape [2, U]
    weight: float = 1.0  # share of the posterior
    checks: tuple[MpmRun, ...] = ()
    carried: Values | None = None  # change of the observation from the checks to the answer, by the emulator, shape [M]
    fit: Fit | None = None  # of the checks to the target; None without MPM runs

    @property
    def half_widths(self) -> Vector:
        """Half of the interval's width, shape [U]."""
        return np.asarray(0.5 * (self.interval[1] - self.interval[0]))

    def holds(self, values: Vector) -> NDArray[np.bool_]:
        """Which of values [U] lie within the interval, shape [U]."""
        return np.asarray((self.interval[0] <= values) & (values <= self.interval[1]))

    @property
    def checked(self) -> Values:
        """Mean of the checks, shape [M]."""
        return np.asarray(np.mean([run.numbers for run in self.checks], axis=0))

    @property
    def observation(self) -> Values:
        """The same, carried over to the answer, shape [M]."""
        return self.checked if self.carried is None else self.checked + self.carried

    @property
    def near(self) -> bool:
        """Whether the flows of the checks, if any, are those of the answer: their parameters are close to it."""
        if self.carried is None or not self.checks:
            return True
        off = (self.checks[0].parameters - self.parameters) / np.maximum(self.half_widths, 1e-12)
        return bool(np.sqrt((off**2).mean()) <= CLOSE)

    @property
    def confirmed(self) -> bool:
        return self.fit is not None and self.fit.inside


@dataclass(frozen=True, kw_only=True)
class Combination:
    """A direction in the space of the parameters, and how well the observation constrains it."""

    weights: dict[str, float]  # of each parameter, in fractions of its range; a unit vector
    half_width: float  # at 95 %, as a fraction of the range
    prior: float = UNIFORM  # half-width of the prior, as a fraction of the range

    @property
    def identifiable(self) -> bool:
        """Whether the observation constrains it: half-width of at most `IDENTIFIABLE`, less for a narrower prior."""
        return self.half_width <= IDENTIFIABLE * min(1.0, self.prior / UNIFORM)


def judge(problem: Problem, answers: Sequence[Answer], *, unreachable: bool = False) -> Verdict:
    """The verdict on the ordered answers; unreachable: only parameters beyond the bounds would fit."""
    first = answers[0]
    if not first.confirmed:
        return Verdict.UNREACHABLE if unreachable else Verdict.UNCONFIRMED
    return Verdict.AMBIGUOUS if len(answers) > 1 or unidentified(problem, first) else Verdict.CONFIRMED


def unidentified(problem: Problem, answer: Answer) -> list[str]:
    """The numbers whose interval covers most of the prior's, or half as much if a positive number may be near 0."""
    names, widths = [], zip(answer.parameters, answer.half_widths, problem.prior_widths, strict=True)
    for number, (value, width, prior) in zip(problem.numbers, widths, strict=True):
        length = 2.0 * width / prior
        relative = number.kind.positive and width > abs(value) and length > 0.5 * CONSTANTS.most_of_the_prior
        if relative or length > CONSTANTS.most_of_the_prior:
            names.append(number.name)
    return names


def plain(values: Values) -> float | list[Any] | None:
    """An observation for JSON: a number if it has one number, null if it is a whole deposit."""
    if len(values) > MAX_NUMBERS:
        return None
    return float(values[0]) if len(values) == 1 else [*map(float, values)]


def peak_memory_mib() -> float:
    """The largest resident memory of this process so far [MiB]."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
