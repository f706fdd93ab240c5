"""What is asked of each inverse problem (`bars.toml`), and whether an outcome has it."""

import math
from dataclasses import dataclass
from pathlib import Path

from datasets.records import Record, from_mapping, read_toml
from inverse.result import Verdict
from validation.loop.outcomes import Outcome


@dataclass(frozen=True, kw_only=True)
class Bars(Record):
    """What is asked of a problem; None: nothing."""

    verdict: Verdict = Verdict.CONFIRMED
    front_error_pct: float | None = None
    """Largest relative error of the front in the MPM."""
    unknown_error_pct: float | None = None
    """Largest relative error of an unknown; by a front, of those whose half-width is no wider."""
    loss: float | None = None
    """Largest loss in the MPM [m^2]."""
    inside: bool = False
    """Whether every true value has to lie within its half-width."""
    seconds_per_iteration: float | None = None
    mpm_runs: int = 8
    """Most MPM runs besides the ensemble."""


@dataclass(frozen=True, kw_only=True)
class Family(Record):
    """Problems that are told together."""

    title: str
    problems: tuple[str, ...]
    pictures: tuple[str, ...] = ()
    """Of each problem, without their ending, that the document shows."""
    bars: Bars


@dataclass(frozen=True, kw_only=True)
class _File(Record):
    families: tuple[Family, ...]


@dataclass(frozen=True, kw_only=True)
class Mark:
    """One thing asked, and what came out."""

    asked: str
    got: str
    met: bool | None
    """None where it cannot be judged."""


def read_families() -> tuple[Family, ...]:
    """All families, in the order of the document."""
    return from_mapping(_File, read_toml(Path(__file__).with_suffix(".toml"))).families


def judge(outcome: Outcome, bars: Bars) -> list[Mark]:
    """Hold `outcome` against `bars`."""
    marks = [
        Mark(asked=f"verdict {bars.verdict}", got=outcome.verdict, met=outcome.verdict == bars.verdict),
        Mark(asked=f"MPM runs <= {bars.mpm_runs}", got=str(outcome.checks), met=outcome.checks <= bars.mpm_runs),
    ]
    front = outcome.front_error_pct
    if bars.front_error_pct is not None:
        met = None if front is None else abs(front) <= bars.front_error_pct
        marks.append(Mark(asked=f"front <= {bars.front_error_pct:g} %", got=_percent(front), met=met))
    if bars.loss is not None:
        loss = outcome.loss
        met = None if loss is None else loss <= bars.loss
        marks.append(Mark(asked=f"loss <= {bars.loss:.0e} m^2", got="-" if loss is None else f"{loss:.2e}", met=met))
    if outcome.truth:
        marks += _of_truth(outcome, bars)
    if bars.seconds_per_iteration is not None:
        took = outcome.seconds["per_iteration"]
        asked = f"iteration <= {bars.seconds_per_iteration:g} s"
        marks.append(Mark(asked=asked, got=f"{took:.1f} s", met=took <= bars.seconds_per_iteration))
    return marks


def _of_truth(outcome: Outcome, bars: Bars) -> list[Mark]:
    """What a twin experiment can be asked."""
    marks = []
    if bars.unknown_error_pct is not None:
        most = bars.unknown_error_pct
        error = max(outcome.error_pct(name) for name in outcome.unknowns)
        known = max(outcome.half_width_pct(name) for name in outcome.unknowns) <= most
        # One number cannot tell an unknown better than its own chance.
        judged = outcome.many or known
        asked = f"unknown <= {most:g} %" + ("" if judged else " (half-width wider: not asked)")
        marks.append(Mark(asked=asked, got=f"{error:.2f} %", met=error <= most if judged else None))
    if bars.inside:
        count, inside = len(outcome.unknowns), len(outcome.inside)
        met = inside == count if outcome.certainty else None
        marks.append(Mark(asked="truth within the half-width", got=f"{inside} of {count}", met=met))
    return marks


def _percent(value: float | None) -> str:
    return "-" if value is None or not math.isfinite(value) else f"{value:.2f} %"
