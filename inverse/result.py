"""`result.json`: what an inversion found, what it is worth and what it cost."""

import resource
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import Any

from datasets.files import write_json
from inverse.forward import Evaluation
from inverse.observations import Values
from inverse.problem import Problem
from inverse.target import Target
from inverse.unknowns import Vector

MOST_NUMBERS = 100
"""Longest observation that is written out: a whole deposit has thousands of numbers, in every iteration."""


class Verdict(StrEnum):
    """What the MPM says of the answer."""

    CONFIRMED = "confirmed"
    UNCONFIRMED = "unconfirmed"
    UNREACHABLE = "unreachable"


class Purpose(StrEnum):
    """Why an MPM run was made."""

    CHECK = "check"
    """At unknowns that the (corrected) surrogate proposed; counts against the loop's budget."""
    ENSEMBLE = "ensemble"
    """With another jitter seed, for the certainty."""


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


@dataclass(frozen=True, kw_only=True)
class Round:
    """One minimisation on the surrogate; round 0 on the surrogate as it is, later ones corrected by the MPM."""

    number: int
    evaluations: Sequence[Evaluation]


@dataclass(frozen=True, kw_only=True)
class Result:
    """What `result.json` holds; its keys are in docs/formats.md."""

    problem: Problem
    target: Target
    verdict: Verdict
    answer: Vector
    certainty: dict[str, float] | None
    """Half-widths at 95 %, where the MPM was asked."""
    surrogate: Values
    """What the uncorrected surrogate observes at the answer, shape [m]; of a deposit, its own points."""
    mpm: Values | None
    """What the MPM observes there [m]."""
    front_error_pct: float | None
    """Of the MPM at the answer."""
    loss_surrogate: float
    loss_mpm: float | None
    rounds: Sequence[Round]
    mpm_runs: Sequence[RunRecord] = field(default_factory=list)
    mpm_seconds: float = 0.0
    total_seconds: float

    @property
    def unknowns(self) -> dict[str, float]:
        """The answer by name."""
        return named(self.problem, self.answer)

    @property
    def error_pct(self) -> dict[str, float]:
        """Relative errors that are known: of each unknown in a twin experiment, of the front where the MPM ran."""
        errors = {
            name: 100.0 * abs(value - self.target.truth[name]) / abs(self.target.truth[name])
            for name, value in self.unknowns.items()
            if self.target.truth and self.target.truth[name] != 0.0
        }
        if self.front_error_pct is not None:
            errors["front"] = abs(self.front_error_pct)
        return errors

    @property
    def evaluations(self) -> list[Evaluation]:
        """Every evaluation of loss and gradient, in order."""
        return [evaluation for stage in self.rounds for evaluation in stage.evaluations]

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
        first = self.evaluations[0]
        write_json(
            folder / "result.json",
            {
                "problem": self.problem.name,
                "verdict": self.verdict.value,
                "unknowns": self.unknowns,
                "certainty": self.certainty,
                "truth": self.target.truth,
                "error_pct": self.error_pct,
                "observation": {
                    "target": plain(self.target.values),
                    "surrogate": plain(self.surrogate),
                    "mpm": None if self.mpm is None else plain(self.mpm),
                },
                "loss": {"surrogate": self.loss_surrogate, "mpm": self.loss_mpm, "initial": first.loss},
                "mpm_runs": [
                    {
                        "purpose": run.purpose.value,
                        "unknowns": run.unknowns,
                        "observation": plain(run.observation),
                        "front": run.front,
                        "front_error_pct": run.front_error_pct,
                        "loss": run.loss,
                        "seconds": run.seconds,
                        "file": run.file,
                    }
                    for run in self.mpm_runs
                ],
                "iterations": [
                    {
                        "round": stage.number,
                        "unknowns": named(self.problem, evaluation.unknowns),
                        "observation": plain(evaluation.observation),
                        "loss": evaluation.loss,
                        "gradient": None if evaluation.gradient is None else named(self.problem, evaluation.gradient),
                        "seconds": {"forward": evaluation.forward_s, "backward": evaluation.backward_s},
                    }
                    for stage in self.rounds
                    for evaluation in stage.evaluations
                ],
                "seconds": self.seconds,
                "peak_memory_mib": peak_memory_mib(),
            },
        )


def named(problem: Problem, values: Vector) -> dict[str, float]:
    """The entries of a vector of unknowns by name."""
    return {unknown.name: float(value) for unknown, value in zip(problem.unknowns, values, strict=True)}


def plain(values: Values) -> float | list[Any] | None:
    """An observation as JSON has it: a number where it is one number, null where it is a whole deposit."""
    if len(values) > MOST_NUMBERS:
        return None
    return float(values[0]) if len(values) == 1 else [float(value) for value in values]


def peak_memory_mib() -> float:
    """The largest resident memory of this process so far [MiB]."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
