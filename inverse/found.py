"""What an inversion found, how certain it is and what it cost: data for the report, for pictures, for `result.json`."""

import math
import resource
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from enum import StrEnum
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from datasets import measures
from datasets.scene import Scene
from datasets.trajectory import Trajectory
from inverse.fields import FoundField
from inverse.noise import Fit
from inverse.observations import Values
from inverse.parameters import Vector
from inverse.posterior.answers import half_widths
from inverse.posterior.information import Information
from inverse.posterior.posterior import Posterior
from inverse.posterior.settings import CONSTANTS
from inverse.problem import Problem
from inverse.target import Target

MAX_NUMBERS = 100
"""Longest observation that is written out: a whole deposit has thousands of numbers, in every iteration."""
IDENTIFIABLE = 0.3
"""Half-width over the range, up to which a combination of parameters is identifiable: a uniform prior has 0.475."""
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


class Purpose(StrEnum):
    """Why an MPM run was made."""

    WAVE = "wave"
    """Where it narrows the posterior most."""
    CHECK = "check"
    """At an answer."""
    START = "start"
    """Of a design, at the problem's start."""
    KNOWN = "known"
    """Before, for another target."""
    CELLS = "cells"
    """At an answer on cells twice as large."""


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
        return self.target.front_error(self.trajectory.positions[-1])

    @property
    def misfit(self) -> float:
        """From the target [unit^2]."""
        return self.target.misfit(self.observation)

    def as_json(self, problem: Problem) -> dict[str, Any]:
        """As `result.json` has it."""
        return {
            "purpose": self.purpose.value,
            "unknowns": problem.named(self.parameters),
            "observation": plain(self.observation),
            "front": measures.front(self.trajectory.positions[-1]),
            "front_error_pct": 100.0 * self.front_error,
            "loss": self.misfit,
            "seconds": self.seconds,
            "file": self.file,
        }


@dataclass(frozen=True, kw_only=True)
class Answer:
    """Parameters that the observation allows, with the runs of the MPM there."""

    parameters: Vector
    """Shape [U]."""
    half_widths: Vector | None = None
    """At 95 %, shape [U]."""
    weight: float = 1.0
    """Share of the posterior."""
    checks: tuple[MpmRun, ...] = ()
    fit: Fit | None = None
    """Of the checks beside the target; None of a design, and where the MPM was not asked."""

    @property
    def observation(self) -> Values:
        """Mean of the checks, shape [M]."""
        return np.asarray(np.mean([each.observation for each in self.checks], axis=0))

    @property
    def confirmed(self) -> bool:
        """Whether the MPM there lies within the predictive interval."""
        return self.fit is not None and self.fit.inside


@dataclass(frozen=True, kw_only=True)
class Combination:
    """A direction in the space of the parameters, and how well the observation constrains it."""

    weights: dict[str, float]
    """Of each parameter, in fractions of its range; together of length 1."""
    half_width: float
    """At 95 %, as a fraction of the range."""

    @property
    def identifiable(self) -> bool:
        """Whether the observation constrains it: to three tenths of the range at least."""
        return self.half_width <= IDENTIFIABLE


@dataclass(frozen=True, kw_only=True)
class Found:
    """What an inversion found."""

    problem: Problem
    target: Target
    verdict: Verdict
    answers: tuple[Answer, ...]
    """Every separate answer that the observation allows; those that the MPM confirms first, then by weight."""
    forward: str
    """What has the last word: "surrogate" or "MPM"."""
    predicted: Values
    """What it shows at the first answer, shape [m]; of a deposit by the surrogate, its own particles."""
    deposit: NDArray[np.floating]
    """Its deposit there [m], shape [N, D]."""
    iterations: Sequence[dict[str, Any]] = ()
    """On the way there, as `result.json` has them: evaluations of the loss, waves of runs or Gauss-Newton steps."""
    mpm_runs: tuple[MpmRun, ...] = ()
    posterior: Posterior | None = None
    """Of numbers, over the whole box."""
    further: tuple[Information, ...] = ()
    """Where the answer is ambiguous: the measurements of a deposit that would decide most."""
    fields: tuple[FoundField, ...] = ()
    notes: tuple[str, ...] = ()
    """What else is to be known of the uncertainty, in sentences."""
    surrogate: dict[str, Any] | None = None
    """Whether a learned surrogate was asked, and why."""
    seconds: dict[str, float] = field(default_factory=dict)
    """[s], of each part of the work, and `total`."""
    record: dict[str, Any] = field(default_factory=dict)
    """Further keys of `result.json`."""

    @property
    def answer(self) -> Vector:
        """The first answer, shape [U]."""
        return self.answers[0].parameters

    @property
    def unknowns(self) -> dict[str, float]:
        """The first answer by name; of a field its mean over the body."""
        return self.problem.named(self.answer) | {each.name: each.average(each.arrays["mean"]) for each in self.fields}

    @property
    def certainty(self) -> dict[str, float] | None:
        """Half-widths at 95 %, where there is a posterior; of a field their mean over the body."""
        widths = self.answers[0].half_widths
        if widths is None:
            return None
        bands = {each.name: each.average(each.arrays["upper"] - each.arrays["lower"]) for each in self.fields}
        return self.problem.named(widths) | {name: 0.5 * band for name, band in bands.items()}

    @property
    def misfit(self) -> float:
        """At the first answer."""
        values = self.target.values
        return math.nan if len(values) != len(self.predicted) else self.target.misfit(self.predicted)

    @property
    def inside(self) -> list[str]:
        """The numbers whose true value is known and lies within their half-width."""
        truth, widths = self.target.truth, self.answers[0].half_widths
        if not truth or widths is None:
            return []
        both = zip(self.problem.named(self.answer).items(), widths, strict=True)
        return [name for (name, value), width in both if abs(value - truth[name]) <= width]

    @property
    def error_pct(self) -> dict[str, float]:
        """Relative errors that are known: of each number in a twin experiment, of the front where the MPM ran."""
        truth = self.target.truth or {}
        found = self.problem.named(self.answer)
        errors = {name: 100.0 * abs(found[name] - true) / abs(true) for name, true in truth.items() if true != 0.0}
        if self.answers[0].checks and math.isfinite(self.target.front):
            errors["front"] = 100.0 * abs(float(np.mean([each.front_error for each in self.answers[0].checks])))
        return errors

    @property
    def remarks(self) -> list[str]:
        """What a user must know of the flow at the first answer (`datasets.remarks`)."""
        checks = self.answers[0].checks
        return list(checks[0].trajectory.summary.get("remarks", [])) if checks else []

    @property
    def scene(self) -> Scene:
        """The scene with what was found."""
        return self.problem.scene_at(self.answer, fields=[each.field for each in self.fields])

    @property
    def samples(self) -> NDArray[np.float64]:
        """Of the posterior, in the units of the parameters' names, shape [S, U]."""
        assert self.posterior is not None, "an optimiser has no samples"
        box = self.problem.box
        return box.lower + box.range * self.posterior.samples.points

    @cached_property
    def combinations(self) -> list[Combination]:
        """The principal directions of the posterior, best known first, in fractions of the ranges."""
        if self.posterior is None:
            return []
        samples = self.posterior.samples
        _, vectors = np.linalg.eigh(samples.covariance)
        widths = half_widths(samples.points @ vectors, samples.weights, samples.mean @ vectors)
        upright = (vector * np.sign(vector[np.argmax(np.abs(vector))]) for vector in vectors.T)
        return [
            Combination(weights=self.problem.named(vector), half_width=float(width))
            for width, vector in zip(widths, upright, strict=True)
        ]

    def as_json(self) -> dict[str, Any]:
        """As `result.json` has it."""
        raw, problem, first = self.target.observation.raw, self.problem, self.answers[0]
        key = "mpm" if self.forward == "MPM" else "surrogate"
        same = len(self.predicted) == len(self.target.values)
        shown = plain(raw(self.predicted) if same else self.predicted)
        answers = [
            {
                "unknowns": problem.named(each.parameters),
                "half_widths": None if each.half_widths is None else problem.named(each.half_widths),
                "weight": each.weight,
                "misfit": self.target.misfit(each.observation) if each.checks else None,
            }
            for each in self.answers
        ]
        found: dict[str, Any] = {
            "problem": problem.name,
            "verdict": self.verdict.value,
            "unknowns": self.unknowns,
            "certainty": self.certainty,
            "answers": answers,
            "truth": self.target.truth,
            "error_pct": self.error_pct,
            "observation": {"target": plain(raw(self.target.values)), key: shown} | self.target.observation.record(),
            "loss": {key: self.misfit if same else self.iterations[-1].get("loss")},
            "mpm_runs": [each.as_json(problem) for each in self.mpm_runs],
            "iterations": list(self.iterations),
            "surrogate": self.surrogate,
            "remarks": self.remarks,
            "seconds": self.seconds,
            "peak_memory_mib": peak_memory_mib(),
        }
        if fit := first.fit:
            keys = ("residual", "inside", "ratio", "allowed", "noise", "scatter", "cells")
            found |= {"check": {key: getattr(fit, key) for key in keys}, "discrepancy": fit.factor}
        if self.posterior is not None:
            samples = self.posterior.samples
            found["combinations"] = [asdict(each) | {"identifiable": each.identifiable} for each in self.combinations]
            sampling = {"difference": samples.difference, "acceptance": samples.acceptance}
            found["sampling"] = sampling | {"log_evidence": samples.evidence}
        if self.fields:
            found["fields"] = [each.as_json() for each in self.fields]
        return found | self.record


def judge(problem: Problem, answers: Sequence[Answer], *, excluded: bool = False) -> Verdict:
    """The verdict on the answers, in their order; excluded: no parameters between the bounds fit."""
    first = answers[0]
    if not first.confirmed:
        share = (first.parameters - problem.box.lower) / problem.box.range
        at_bound = bool(np.any((share < AT_BOUND) | (share > 1.0 - AT_BOUND)))
        return Verdict.UNREACHABLE if excluded and at_bound else Verdict.UNCONFIRMED
    return Verdict.AMBIGUOUS if len(answers) > 1 or unidentified(problem, first) else Verdict.CONFIRMED


def unidentified(problem: Problem, answer: Answer) -> list[str]:
    """The numbers whose interval is most of the prior's.

    The interval is cut off at the bounds. Of a parameter that is positive, half as much will do where the half-width is
    above the value itself.
    """
    names = []
    assert answer.half_widths is not None, "an answer of the posterior"
    for each, value, width in zip(problem.numbers, answer.parameters, answer.half_widths, strict=True):
        lower, upper = each.bounds
        length = (min(value + width, upper) - max(value - width, lower)) / each.range
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
