"""`result.json`: what an inversion found, how certain it is and what it cost."""

import math
import resource
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any

from datasets.files import write_json
from inverse.forward.interface import Evaluation
from inverse.observations import Target, Values
from inverse.parameters import Vector
from inverse.problem import Problem

MAX_NUMBERS = 100
"""Longest observation that is written out: a whole deposit has thousands of numbers, in every iteration."""
IDENTIFIABLE = 0.3
"""Half-width over the range, up to which a combination of parameters is identifiable: a uniform prior has 0.475."""


class Verdict(StrEnum):
    """What the MPM says of the answer."""

    CONFIRMED = "confirmed"
    """One answer, which the observation identifies, meets the target."""
    AMBIGUOUS = "ambiguous"
    """Several separate answers meet it, or a whole range of them."""
    UNCONFIRMED = "unconfirmed"
    UNREACHABLE = "unreachable"
    """No parameters between the bounds meet it."""


class Purpose(StrEnum):
    """Why an MPM run was made."""

    WAVE = "wave"
    """Where it narrows the posterior most."""
    CHECK = "check"
    """At an answer."""
    START = "start"
    """Of a design, at the problem's start."""
    CELLS = "cells"
    """At an answer on cells twice as large."""


@dataclass(frozen=True, kw_only=True)
class RunRecord:
    """One MPM run."""

    purpose: Purpose
    unknowns: dict[str, float]
    observation: Values
    front: float
    """[m]."""
    front_error_pct: float
    """Against the target."""
    loss: float
    """[m^2]."""
    seconds: float
    file: str
    """Beside result.json."""

    def as_json(self) -> dict[str, Any]:
        """As `result.json` has it."""
        return {
            "purpose": self.purpose.value,
            "unknowns": self.unknowns,
            "observation": plain(self.observation),
            "front": self.front,
            "front_error_pct": self.front_error_pct,
            "loss": self.loss,
            "seconds": self.seconds,
            "file": self.file,
        }


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
    """What an inversion found of its parameters."""

    problem: Problem
    target: Target
    verdict: Verdict
    answer: Vector
    certainty: dict[str, float] | None
    """Half-widths at 95 %, where the MPM was asked."""
    front_error_pct: float | None = None
    """Of the MPM at the answer."""
    total_seconds: float

    @property
    def unknowns(self) -> dict[str, float]:
        """The answer by name."""
        return self.problem.named(self.answer)

    @property
    def inside(self) -> list[str]:
        """The parameters whose true value is known and lies within their half-width."""
        truth, widths = self.target.truth, self.certainty
        if not truth or not widths:
            return []
        return [name for name, value in self.unknowns.items() if abs(value - truth[name]) <= widths[name]]

    @property
    def error_pct(self) -> dict[str, float]:
        """Relative errors that are known: of each parameter in a twin experiment, of the front where the MPM ran."""
        errors = {
            name: 100.0 * abs(value - self.target.truth[name]) / abs(self.target.truth[name])
            for name, value in self.unknowns.items()
            if self.target.truth and self.target.truth[name] != 0.0
        }
        if self.front_error_pct is not None and math.isfinite(self.front_error_pct):
            errors["front"] = abs(self.front_error_pct)
        return errors


@dataclass(frozen=True, kw_only=True)
class Result(Found):
    """What an inversion by one forward model found; the keys of its `result.json` are in docs/formats.md."""

    predicted: Values
    """What the forward model predicts at the answer, shape [m]; of a deposit, its own particles."""
    loss: float
    evaluations: Sequence[Evaluation]
    """All of the loss, in order."""
    mpm_seconds: float = 0.0

    @property
    def seconds(self) -> dict[str, float]:
        """Mean seconds of an iteration's forward and backward pass, seconds in the MPM and in all."""
        evaluations = self.evaluations
        forward = sum(evaluation.forward_s for evaluation in evaluations) / len(evaluations)
        backward = sum(evaluation.backward_s for evaluation in evaluations) / len(evaluations)
        return {
            "forward": forward,
            "backward": backward,
            "per_iteration": forward + backward,
            "mpm": self.mpm_seconds,
            "total": self.total_seconds,
        }

    def write(self, folder: Path) -> None:
        """Write `result.json` into `folder`."""
        raw = self.target.observation.raw
        write_json(
            folder / "result.json",
            {
                "problem": self.problem.name,
                "verdict": self.verdict.value,
                "unknowns": self.unknowns,
                "certainty": self.certainty,
                "answers": [{"unknowns": self.unknowns, "half_widths": None, "weight": 1.0, "misfit": None}],
                "truth": self.target.truth,
                "error_pct": self.error_pct,
                "observation": {
                    "target": plain(raw(self.target.values)),
                    "surrogate": plain(raw(self.predicted)),
                    "mpm": None,
                }
                | self.target.observation.record(),
                "loss": {"surrogate": self.loss, "mpm": None, "initial": self.evaluations[0].loss},
                "mpm_runs": [],
                "iterations": [
                    {
                        "unknowns": self.problem.named(evaluation.parameters),
                        "observation": plain(evaluation.observation),
                        "loss": evaluation.loss,
                        "gradient": None if evaluation.gradient is None else self.problem.named(evaluation.gradient),
                        "seconds": {"forward": evaluation.forward_s, "backward": evaluation.backward_s},
                    }
                    for evaluation in self.evaluations
                ],
                "seconds": self.seconds,
                "peak_memory_mib": peak_memory_mib(),
            },
        )


def combinations_record(combinations: Sequence[Combination]) -> list[dict[str, Any]]:
    """`combinations` as JSON has them."""
    return [
        {"weights": each.weights, "half_width": each.half_width, "identifiable": each.identifiable}
        for each in combinations
    ]


def plain(values: Values) -> float | list[Any] | None:
    """An observation as JSON has it: a number where it is one number, null where it is a whole deposit."""
    if len(values) > MAX_NUMBERS:
        return None
    return float(values[0]) if len(values) == 1 else [float(value) for value in values]


def peak_memory_mib() -> float:
    """The largest resident memory of this process so far [MiB]."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
