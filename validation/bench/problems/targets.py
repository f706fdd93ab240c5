"""The criteria of each inverse problem (`targets.toml`), and whether an outcome is within them."""

from dataclasses import dataclass
from pathlib import Path

from datasets.records import Record, from_mapping, read_toml
from inverse.found import Verdict
from inverse.observations import KINDS
from validation.bench.problems.outcome import Outcome


@dataclass(frozen=True, kw_only=True)
class Criteria(Record):
    """What an outcome is compared with; None: not at all."""

    verdict: Verdict = Verdict.CONFIRMED
    front_error_pct: float | None = None
    """Largest relative error of the front in the MPM."""
    unknown_error_pct: float | None = None
    """Largest relative error of a parameter; for one observed number, where its half-width is no wider."""
    loss: float | None = None
    """Largest loss in the MPM [m^2]."""
    inside: bool = False
    """Whether every true value is to be within its half-width."""
    seconds: float | None = None
    """Most seconds in all, of a process that has compiled its kernels."""


@dataclass(frozen=True, kw_only=True)
class Family(Record):
    """Problems of one section."""

    title: str
    problems: tuple[str, ...]
    pictures: tuple[str, ...] = ()
    """Of each problem, without their ending, that the page shows."""
    criteria: Criteria


@dataclass(frozen=True, kw_only=True)
class _File(Record):
    families: tuple[Family, ...]


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """One criterion and the outcome."""

    criterion: str
    outcome: str
    is_within: bool | None
    """None where it does not apply."""

    def __str__(self) -> str:
        text = f"{self.criterion}: {self.outcome}"
        return f"**missed: {text}**" if self.is_within is False else text


def read_families() -> tuple[Family, ...]:
    """All families, in the order of the page."""
    return from_mapping(_File, read_toml(Path(__file__).with_suffix(".toml"))).families


def compare(outcome: Outcome, criteria: Criteria) -> list[Comparison]:
    """Compare `outcome` with every criterion that there is."""
    result = outcome.result
    found: list[tuple[str, str, bool | None]] = [
        (f"verdict {criteria.verdict}", result["verdict"], result["verdict"] == criteria.verdict),
    ]
    found += _at_most("front", outcome.front_error_pct, criteria.front_error_pct, "{:.2f} %", "{:g} %")
    found += _at_most("loss", result["loss"]["mpm"], criteria.loss, "{:.2e}", "{:.0e} m^2")
    if outcome.errors and (most := criteria.unknown_error_pct) is not None:
        error = outcome.percent(outcome.errors)
        known = not KINDS[outcome.problem.observations[0].kind].scalar or outcome.percent(outcome.half_widths) <= most
        text = f"parameter <= {most:g} %" + ("" if known else " (half-width wider: does not apply)")
        found.append((text, f"{error:.2f} %", error <= most if known else None))
    if outcome.errors and criteria.inside:
        count, inside = len(outcome.errors), len(outcome.inside)
        is_within = inside == count if outcome.half_widths else None
        found.append(("truth within the half-width", f"{inside} of {count}", is_within))
    found += _at_most("in all", result["seconds"]["total"], criteria.seconds, "{:.1f} s", "{:g} s")
    return [Comparison(criterion=text, outcome=got, is_within=within) for text, got, within in found]


def _at_most(
    what: str, value: float | None, most: float | None, form: str, limit: str
) -> list[tuple[str, str, bool | None]]:
    if most is None:
        return []
    got, is_within = ("-", None) if value is None else (form.format(value), value <= most)
    return [(f"{what} <= {limit.format(most)}", got, is_within)]
