"""`result.json`: what an inversion found, how certain it is and what it cost."""

import math
import resource
from collections.abc import Sequence
from dataclasses import dataclass, field
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


class Verdict(StrEnum):
    """What the MPM says of the answer."""

    CONFIRMED = "confirmed"
    UNCONFIRMED = "unconfirmed"
    NOT_IDENTIFIABLE = "not-identifiable"
    """It fits, but other parameters within the bounds fit as well."""
    UNREACHABLE = "unreachable"


class Purpose(StrEnum):
    """Why an MPM run was made."""

    CHECK = "check"
    """At parameters that the (corrected) surrogate proposed; counts against the loop's budget."""
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
    start: int = 0
    """Of round 0: which of the starting points it began at; 0 is the problem's `initial`."""


@dataclass(frozen=True, kw_only=True)
class Minimum:
    """Another minimum of the surrogate, which the loop did not follow."""

    parameters: Vector
    loss: float
    """Of the uncorrected surrogate [m^2]."""


@dataclass(frozen=True, kw_only=True)
class Combination:
    """A direction in the space of the parameters, and how well the observation constrains it."""

    weights: dict[str, float]
    """Of each parameter, in fractions of its range; together of length 1."""
    singular_value: float
    """What a step of the whole range does to the observation, over the scatter and the noise of it [-]."""
    half_width: float
    """At 95 %, as a fraction of the range."""

    @property
    def identifiable(self) -> bool:
        """Whether the observation constrains it: to half of the range at least."""
        return self.half_width <= 0.5


@dataclass(frozen=True, kw_only=True)
class Identifiability:
    """How well the observation constrains the parameters together, near the answer."""

    combinations: Sequence[Combination]
    """Best constrained first, as many as parameters."""
    half_a_cell: dict[str, float] | None
    """Standard deviation of each parameter if each number observed had one of half a cell; None for a share."""
    scatter: dict[str, float]
    """Standard deviation of each parameter by the MPM's scatter of a single flow alone."""
    noise: dict[str, float]
    """The same by the stated noise of the measurement alone."""


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
    """What the uncorrected surrogate predicts at the answer, shape [m]; of a deposit, its own particles."""
    mpm: Values | None
    """What the MPM observes there [m]."""
    front_error_pct: float | None
    """Of the MPM at the answer."""
    loss_surrogate: float
    loss_mpm: float | None
    rounds: Sequence[Round]
    other_starts: Sequence[Round] = field(default_factory=list)
    """Round 0 from the starting points that did not lead to the answer."""
    other_minima: Sequence[Minimum] = field(default_factory=list)
    """Where those ended, if elsewhere."""
    identifiability: Identifiability | None = None
    discrepancy: float | None = None
    """By which factor the half-widths are wider because the fit is worse than noise and chance allow; 1 where it is
    not, None where it cannot be computed."""
    mpm_runs: Sequence[RunRecord] = field(default_factory=list)
    mpm_seconds: float = 0.0
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
    def checks(self) -> list[RunRecord]:
        """The MPM runs that count against the budget."""
        return [run for run in self.mpm_runs if run.purpose is Purpose.CHECK]

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

    @property
    def answers(self) -> list[dict[str, Any]]:
        """Every answer that the observation is known to allow: unknowns, half-widths, weight and misfit in the MPM."""
        return [{"unknowns": self.unknowns, "half_widths": self.certainty, "weight": 1.0, "misfit": self.loss_mpm}]

    @property
    def evaluations(self) -> list[Evaluation]:
        """Every evaluation of the surrogate's loss, in order; those of other starts come last."""
        return [evaluation for stage in self._stages for evaluation in stage.evaluations]

    @property
    def _stages(self) -> list[Round]:
        return [*self.rounds, *self.other_starts]

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
        first = next(stage for stage in self._stages if (stage.number, stage.start) == (0, 0)).evaluations[0]
        raw = self.target.observation.raw
        write_json(
            folder / "result.json",
            {
                "problem": self.problem.name,
                "verdict": self.verdict.value,
                "unknowns": self.unknowns,
                "certainty": self.certainty,
                "answers": self.answers,
                "identifiability": None
                if self.identifiability is None
                else identifiability_record(self.identifiability),
                "discrepancy": self.discrepancy,
                "truth": self.target.truth,
                "error_pct": self.error_pct,
                "observation": {
                    "target": plain(raw(self.target.values)),
                    "surrogate": plain(raw(self.surrogate)),
                    "mpm": None if self.mpm is None else plain(raw(self.mpm)),
                }
                | self.target.observation.record(),
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
                "other_minima": [
                    {"unknowns": self.problem.named(minimum.parameters), "loss": minimum.loss}
                    for minimum in self.other_minima
                ],
                "iterations": [
                    {
                        "round": stage.number,
                        "start": stage.start,
                        "unknowns": self.problem.named(evaluation.parameters),
                        "observation": plain(evaluation.observation),
                        "loss": evaluation.loss,
                        "gradient": None if evaluation.gradient is None else self.problem.named(evaluation.gradient),
                        "seconds": {"forward": evaluation.forward_s, "backward": evaluation.backward_s},
                    }
                    for stage in self._stages
                    for evaluation in stage.evaluations
                ],
                "seconds": self.seconds,
                "peak_memory_mib": peak_memory_mib(),
            },
        )


def identifiability_record(identifiability: Identifiability) -> dict[str, Any]:
    """`identifiability` as JSON has it."""
    return {
        "singular_values": [combination.singular_value for combination in identifiability.combinations],
        "combinations": [
            {"weights": each.weights, "half_width": each.half_width, "identifiable": each.identifiable}
            for each in identifiability.combinations
        ],
        "half_a_cell": identifiability.half_a_cell,
        "scatter": identifiability.scatter,
        "noise": identifiability.noise,
    }


def plain(values: Values) -> float | list[Any] | None:
    """An observation as JSON has it: a number where it is one number, null where it is a whole deposit."""
    if len(values) > MAX_NUMBERS:
        return None
    return float(values[0]) if len(values) == 1 else [float(value) for value in values]


def peak_memory_mib() -> float:
    """The largest resident memory of this process so far [MiB]."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
