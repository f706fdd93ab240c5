"""What a result is made of: runs of the MPM, answers, fields, and the verdict on them."""

import resource
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from datasets import measures
from datasets.field import Field
from datasets.trajectory import Trajectory
from inverse.noise import Fit
from inverse.observations import Values
from inverse.parameters import Vector
from inverse.parameters.field import BAND, UnknownField
from inverse.posterior.settings import CONSTANTS
from inverse.problem import Problem
from inverse.target import Target

MAX_NUMBERS = 100
"""Longest observation that is written out: a whole deposit has thousands of numbers, in every iteration."""
IDENTIFIABLE = 0.3
"""Half-width over the range, up to which a combination of parameters is identifiable."""
UNIFORM = 0.475
"""The same of a uniform prior."""
IDENTIFIED = 0.5
"""Share of the prior's variance beyond whose removal the observation identifies a value of a field."""
AT_BOUND = 0.02
"""Distance from a bound, as a fraction of the range, at which an answer lies at it."""


class Verdict(StrEnum):
    """What the MPM says of the answer."""

    CONFIRMED = "confirmed"
    """One answer, which the observation identifies; the MPM there lies within the predictive interval."""
    AMBIGUOUS = "ambiguous"
    """So does it at several separate answers, or over a whole range of them."""
    UNCONFIRMED = "unconfirmed"
    UNREACHABLE = "unreachable"
    """It does so for no parameters between the bounds."""

    @property
    def confirms(self) -> bool:
        """Whether the MPM confirms an answer, the only one or not."""
        return self in (Verdict.CONFIRMED, Verdict.AMBIGUOUS)


class Purpose(StrEnum):
    """Why an MPM run was made."""

    WAVE = "wave"
    """Where it narrows the posterior most."""
    CHECK = "check"
    """At an answer."""
    KNOWN = "known"
    """Before, for another target."""
    CELLS = "cells"
    """At an answer on half the cells, in 3D on cells twice as large."""


@dataclass(frozen=True, kw_only=True)
class MpmRun:
    """A run of the MPM, with a jitter seed of its own, compared with the target."""

    purpose: Purpose
    parameters: Vector
    """Shape [U]."""
    trajectory: Trajectory
    target: Target
    seconds: float = 0.0
    file: str = ""
    """Beside `result.json`."""

    @cached_property
    def observation(self) -> Values:
        """Exact, shape [M]."""
        return self.target.observation.observe(self.trajectory)

    @property
    def front_error(self) -> float:
        """Relative, with its sign; nan where the target has no front."""
        return self.target.front_error(self.trajectory)

    def as_json(self, problem: Problem) -> dict[str, Any]:
        """As `result.json` has it."""
        return {
            "purpose": self.purpose.value,
            "unknowns": problem.named(self.parameters),
            "observation": plain(self.observation),
            "front": measures.front(self.trajectory.positions[-1], self.trajectory.volumes),
            "front_error_pct": 100.0 * self.front_error,
            "loss": self.target.misfit(self.observation),
            "seconds": self.seconds,
            "file": self.file,
        }


@dataclass(frozen=True, kw_only=True)
class Answer:
    """Parameters that the observation allows, with the runs of the MPM there."""

    parameters: Vector
    """Shape [U]."""
    interval: Values
    """Quantiles of 2.5 and 97.5 % within the bounds, shape [2, U]."""
    weight: float = 1.0
    """Share of the posterior."""
    checks: tuple[MpmRun, ...] = ()
    fit: Fit | None = None
    """Of the checks beside the target; None where the MPM was not asked."""

    @property
    def half_widths(self) -> Vector:
        """Half of the interval's width, shape [U]."""
        return np.asarray(0.5 * (self.interval[1] - self.interval[0]))

    def holds(self, values: Vector) -> NDArray[np.bool_]:
        """Which of values [U] lie within the interval, shape [U]."""
        return np.asarray((self.interval[0] <= values) & (values <= self.interval[1]))

    @property
    def observation(self) -> Values:
        """Mean of the checks, shape [M]."""
        return np.asarray(np.mean([each.observation for each in self.checks], axis=0))

    @property
    def confirmed(self) -> bool:
        """Whether the MPM there lies within the predictive interval."""
        return self.fit is not None and self.fit.inside


@dataclass(frozen=True, kw_only=True)
class FoundField:
    """A field at its K nodes as it was found, in its unit; statistics are over the nodes beside the body alone."""

    unknown: UnknownField
    latent: Values
    """u of `inverse.parameters.field`, the most probable one, shape [K]."""
    width: Values
    """Standard deviation of u that is left, shape [K]."""
    draws: Values
    """Samples of the field, shape [draws, K]."""
    truth: Values | None
    """Where known, shape [K]."""

    @property
    def name(self) -> str:
        """As the problem calls it."""
        return self.unknown.name

    @property
    def stem(self) -> str:
        """Of its files."""
        return self.name.replace(".", "-")

    @property
    def field(self) -> Field:
        """As a scene has it."""
        return self.unknown.field(self.latent)

    @cached_property
    def arrays(self) -> dict[str, Values]:
        """What is known at each node by name, shape [K] each.

        `deviation` and `prior_deviation` are widths of bands of 95 % over those of one standard deviation, `removed` is
        the share of the prior's variance that the observation removes.
        """
        unknown, latent, width = self.unknown, self.latent, self.width
        found = {
            "mean": unknown.values(latent),
            "lower": unknown.values(latent - BAND * width),
            "upper": unknown.values(latent + BAND * width),
            "deviation": unknown.deviation(latent, width),
            "prior_deviation": unknown.deviation(np.zeros_like(latent), unknown.prior.deviation),
            "removed": np.asarray(1.0 - (width / unknown.prior.deviation) ** 2),
            "inside": unknown.inside.astype(np.float64),
        }
        return found if self.truth is None else found | {"truth": self.truth}

    @property
    def saved(self) -> dict[str, Values]:
        """The arrays of `field.npz`; there the names of those of field k begin with `k_`."""
        grid = self.unknown.grid
        return {"positions": grid.positions, "nodes": np.array(grid.nodes), "draws": self.draws} | self.arrays

    @property
    def identified(self) -> NDArray[np.bool_]:
        """Which nodes beside the body the observation identifies, shape [K]."""
        return (self.arrays["removed"] > IDENTIFIED) & self.unknown.inside

    def average(self, values: Values) -> float:
        """Mean of values [K] beside the body."""
        return float(values[self.unknown.inside].mean())

    def identified_box(self) -> list[tuple[float, float]] | None:
        """Between which coordinates the identified nodes lie along each axis [m]; None where there are none."""
        if not self.identified.any():
            return None
        here = self.unknown.grid.positions[self.identified]
        return [(float(low), float(high)) for low, high in zip(here.min(axis=0), here.max(axis=0), strict=True)]

    def error(self, where: NDArray[np.bool_], values: Values | float | None = None) -> float | None:
        """Root mean square error of the found field, or of other `values`, at nodes `where` [K]; None if unknown."""
        if self.truth is None or not where.any():
            return None
        return measures.rms(((self.arrays["mean"] if values is None else values) - self.truth)[where])

    def covered(self, where: NDArray[np.bool_]) -> float | None:
        """Share of the true values at nodes `where` [K] that the bands hold; None where they are not known."""
        if self.truth is None or not where.any():
            return None
        inside = (self.arrays["lower"] <= self.truth) & (self.truth <= self.arrays["upper"])
        return float(np.mean(inside[where]))

    def as_json(self) -> dict[str, Any]:
        """As `result.json` has it."""
        inside, identified, mean = self.unknown.inside, self.identified, self.unknown.settings.mean
        deviation = self.arrays["deviation"]
        return {
            "name": self.name,
            "unit": self.unknown.unit,
            "nodes": list(self.unknown.grid.nodes),
            "values": int(inside.sum()),
            "identified": float(identified[inside].mean()),
            "identified_between": self.identified_box(),
            "variance_removed": self.average(self.arrays["removed"]),
            "deviation": {
                "prior": self.average(self.arrays["prior_deviation"]),
                "posterior": self.average(deviation),
                "identified": float(deviation[identified].mean()) if identified.any() else None,
            },
            "error": {
                "prior": self.error(inside, mean),
                "posterior": self.error(inside),
                "prior_identified": self.error(identified, mean),
                "identified": self.error(identified),
            },
            "truth_in_band": {"all": self.covered(inside), "identified": self.covered(identified)},
        }


@dataclass(frozen=True, kw_only=True)
class Combination:
    """A direction in the space of the parameters, and how well the observation constrains it."""

    weights: dict[str, float]
    """Of each parameter, in fractions of its range; together of length 1."""
    half_width: float
    """At 95 %, as a fraction of the range."""
    prior: float = UNIFORM
    """The same of a stated prior."""

    @property
    def identifiable(self) -> bool:
        """Whether the observation constrains it: to three tenths of the range at least, or that share of the prior."""
        return self.half_width <= IDENTIFIABLE * min(1.0, self.prior / UNIFORM)


def judge(problem: Problem, answers: Sequence[Answer], *, excluded: bool = False) -> Verdict:
    """The verdict on the answers, in their order; excluded: no parameters between the bounds fit."""
    first = answers[0]
    if not first.confirmed:
        share = problem.box.shares(first.parameters)
        at_bound = bool(np.any((share < AT_BOUND) | (share > 1.0 - AT_BOUND)))
        return Verdict.UNREACHABLE if excluded and at_bound else Verdict.UNCONFIRMED
    return Verdict.AMBIGUOUS if len(answers) > 1 or unidentified(problem, first) else Verdict.CONFIRMED


def unidentified(problem: Problem, answer: Answer) -> list[str]:
    """The numbers whose interval is most of the prior's.

    Of a positive one half as much will do where the half-width is above the value itself.
    """
    names = []
    both = zip(answer.parameters, answer.half_widths, problem.prior_widths, strict=True)
    for each, (value, width, prior) in zip(problem.numbers, both, strict=True):
        length = 2.0 * width / prior
        relative = each.kind.positive and width > abs(value) and length > 0.5 * CONSTANTS.most_of_the_prior
        if relative or length > CONSTANTS.most_of_the_prior:
            names.append(each.name)
    return names


def plain(values: Values) -> float | list[Any] | None:
    """An observation as JSON has it: a number where it is one number, null where it is a whole deposit."""
    if len(values) > MAX_NUMBERS:
        return None
    return float(values[0]) if len(values) == 1 else [float(value) for value in values]


def peak_memory_mib() -> float:
    """The largest resident memory of this process so far [MiB]."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
