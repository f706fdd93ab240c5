"""`python -m validation.bench problems`: every shipped inverse problem, beside its criteria and the paper's figures."""

import hashlib
import math
import shutil
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from datasets.errors import InputError, WorkFailed
from datasets.files import read_json, read_toml, write_text
from datasets.records import Record, from_mapping
from gns import library
from inverse.answer import Verdict
from inverse.problem import Problem, read_problem
from inverse.settings import Surrogate
from validation.report.page import GNS, MPM, Page, Row, between

RESULT, KEY = "result.json", "made-of.txt"
"""In the folder of a problem: what the loop wrote, and a digest of what it was made of."""
ENDED = (0, 1)
"""Exit statuses of a loop that came to an end: confirmed, and not."""
QUICK = ("friction-short-21",)
"""Problems of a quick page."""
NAMED = 4
"""With more numbers than these the range of their half-widths is given."""
PICTURES = "pictures"


@dataclass(frozen=True, kw_only=True)
class Criteria(Record):
    """What an outcome is compared with."""

    verdict: Verdict = Verdict.CONFIRMED
    front_error_pct: float = math.inf
    """Largest relative error of the front in the MPM."""
    unknown_error_pct: float = math.inf
    """Largest relative error of a number, where its half-width is no wider."""
    loss: float = math.inf
    """Largest loss in the MPM [m^2]."""
    inside: bool = False
    """Whether every true value is to be within its interval."""


@dataclass(frozen=True, kw_only=True)
class Family(Record):
    title: str
    problems: tuple[str, ...]
    pictures: tuple[str, ...] = ()
    """PROBLEM/PICTURE that the page shows, without the ending."""
    second: Surrogate | None = None
    """Each problem is solved a second time, with this in place of what it asks for."""
    criteria: Criteria

    def inversions(self) -> list[tuple[Problem, str]]:
        """What is solved, in turn: problems, and the names of their folders."""
        found = []
        for name in self.problems:
            problem = read_problem(name)
            found.append((problem, name))
            if self.second is not None:
                found.append((replace(problem, surrogate=self.second), f"{name}-{self.second}"))
        return found


@dataclass(frozen=True, kw_only=True)
class Shipped(Record):
    """`problems.toml`."""

    paper: dict[str, str]
    """What the reference paper reports of a problem."""
    families: tuple[Family, ...]


def read_shipped() -> Shipped:
    """The families in the order of the page, and the paper's figures."""
    return from_mapping(Shipped, read_toml(Path(__file__).with_suffix(".toml")))


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """A result with the problem and the criteria that belong to it."""

    problem: Problem
    criteria: Criteria
    result: dict[str, Any]
    """The contents of `result.json`."""

    @property
    def half_widths(self) -> dict[str, float]:
        return {name: self.result["certainty"][name] for name in self.problem.names}

    @property
    def errors(self) -> dict[str, float]:
        """Errors of the numbers in their units; empty where the truth is not known."""
        truth = self.result.get("truth") or {}
        return {name: abs(self.result["unknowns"][name] - value) for name, value in truth.items()}

    @property
    def surrogate(self) -> bool:
        return bool((self.result.get("surrogate") or {}).get("asked"))

    def text(self, name: str, value: float) -> str:
        return self.problem.kinds[self.problem.names.index(name)].text(value)

    @property
    def inside(self) -> int:
        """How many true values are within their interval."""
        ends, truth = self.result["interval"], self.result["truth"]
        return sum(ends[name][0] <= truth[name] <= ends[name][1] for name in self.errors)

    def percent(self, values: Mapping[str, float]) -> float:
        """The largest of `values` by number over the true values [%]."""
        truth = self.result["truth"]
        return max((100.0 * values[each] / abs(truth[each]) if truth[each] else math.inf) for each in truth)

    @property
    def missed(self) -> list[str]:
        """Criteria that it does not meet, with what came out."""
        asked, result, count = self.criteria, self.result, len(self.errors)
        front, loss = result["error_pct"].get("front") or 0.0, result["loss"].get("mpm") or 0.0
        error, most = self.percent(self.errors) if count else 0.0, asked.unknown_error_pct
        checks = {
            f"verdict {asked.verdict}": result["verdict"] == asked.verdict,
            f"front within {asked.front_error_pct:g} %: {front:.2f} %": front <= asked.front_error_pct,
            f"loss of {asked.loss:.0e} m²: {loss:.1e}": loss <= asked.loss,
            f"number within {most:g} %: {error:.2f} %": error <= most or most < self.percent(self.half_widths),
            f"truth within the interval: {self.inside} of {count}": not asked.inside or self.inside == count,
        }
        return [text for text, met in checks.items() if not met]


def bench(out: Path, *, quick: bool, keep: Path, only: tuple[str, ...] = ()) -> str:
    """Solve every shipped problem, fields included, that has no result in `keep`; the dear ones take most of the time.

    Each is a `python -m validation.loop` of its own in KEEP/NAME; of those that are solved with a surrogate and without
    the second one is in KEEP/NAME-gns or KEEP/NAME-none.
    A result is kept unless the problem or the surrogate's weights have changed since. An answer that the MPM does not
    confirm is part of the page. Raises WorkFailed, once the page is written, where a problem could not be run.

    Parameters
    ----------
    quick
        One problem.
    only
        Solve these alone; the page has all that there are.
    """
    shipped = read_shipped()
    families = shipped.families
    names = [name for family in families for name in family.problems]
    for name in only:
        if name not in names:
            raise InputError("expected the name of a shipped problem", where=name, key="--only")
    requested, failed = only or (QUICK if quick else tuple(names)), []
    found: dict[str, list[Outcome]] = {}
    for family in families:
        for problem, name in family.inversions():
            folder = keep / name
            if problem.name in requested and not is_current(problem, folder) and not ran(problem, folder):
                failed.append(name)
            if is_current(problem, folder):
                outcome = Outcome(problem=problem, criteria=family.criteria, result=read_json(folder / RESULT) or {})
                found.setdefault(family.title, []).append(outcome)
    pictures = [name for family in families for each in family.pictures if (name := copied(keep, each, out))]
    conclusion = page(found, pictures, shipped.paper, quick=quick).write(out / "problems.md")
    if failed:
        raise WorkFailed(f"could not be run: {', '.join(failed)}")
    return conclusion


def made_of(problem: Problem) -> str:
    """Digest of the problem and of the weights of a surrogate that may be asked."""
    text, asked = repr(replace(problem, folder=Path())), problem.surrogate is not Surrogate.NONE
    weights = library.shipped(problem.scene.dimension).read_bytes() if asked else b""
    return hashlib.sha256(text.encode() + weights).hexdigest()[:16]


def is_current(problem: Problem, folder: Path) -> bool:
    """Whether `folder` has a result of the problem as it is now."""
    key = folder / KEY
    return key.exists() and (folder / RESULT).exists() and key.read_text() == made_of(problem)


def ran(problem: Problem, folder: Path) -> bool:
    """Run the loop on a shipped problem in a process of its own; whether it came to its end."""
    if (folder / KEY).exists():
        # Made of another problem or other weights: runs that it kept would cost this one no seconds.
        shutil.rmtree(folder)
    # An older result is not this one's, should this one fail.
    (folder / RESULT).unlink(missing_ok=True)
    arguments = ["-m", "validation.loop", problem.name, "--out", str(folder), "--surrogate", problem.surrogate]
    if subprocess.run([sys.executable, *arguments], check=False).returncode not in ENDED:
        return False
    write_text(folder / KEY, made_of(problem))
    return True


def copied(keep: Path, picture: str, out: Path) -> str:
    """Copy PROBLEM/PICTURE beside the page; its name there, empty where there is none."""
    source, target = keep / f"{picture}.png", f"{PICTURES}/{picture.replace('/', '-')}.png"
    if not source.exists():
        return ""
    (out / PICTURES).mkdir(parents=True, exist_ok=True)
    shutil.copyfile(source, out / target)
    return target


def page(
    found: Mapping[str, Sequence[Outcome]], pictures: Sequence[str], paper: Mapping[str, str], *, quick: bool
) -> Page:
    """The page of all problems that were `found`, by their families' titles."""
    outcomes = [each for group in found.values() for each in group]
    said = conclusion(outcomes)
    result = Page("The inverse problems", "problems --out docs", said, packages=MPM | GNS, quick=quick)
    result.text("""
        Each problem is solved by one `python -m validation.loop`. Targets of twin experiments are runs of the MPM with
        another initial jitter than the inversion's. Loss and front are those of the MPM at the answer; numbers are
        medians with their 95 % intervals, of a problem with more than one answer those of the heaviest. The paper
        (Choi and Kumar 2024) takes its targets from its own MPM; its front is the largest x, here the x that 99.5 % of
        the volume is behind. The surrogate's own answer is found by its gradient alone, before any run of the MPM,
        which then shows the loss and the front there.
    """)
    for title, group in found.items():
        result.section(title)
        fields = [field_row(each, field) for each in group for field in each.result.get("fields", ())]
        result.table(fields or [row(each, paper) for each in group])
    if any("fields" in each.result for each in outcomes):
        result.text("""
            Of a field: root mean square errors over its values, of the prior's mean and of what was found; identified
            are values of whose prior variance the observation removes more than half.
        """)
    for name in pictures:
        result.picture(name, Path(name).stem)
    return result


def conclusion(outcomes: Sequence[Outcome]) -> list[str]:
    """What was confirmed, which criteria were missed, errors beside the paper's, half-widths, cost."""
    if not outcomes:
        return ["No problem has been solved yet."]
    expected = sum(each.result["verdict"] == each.criteria.verdict for each in outcomes)
    missed = [f"`{each.problem.name}`" for each in outcomes if each.missed]
    known = [each for each in outcomes if each.errors]
    truths = sum(len(each.errors) for each in known)
    sentences = [
        f"{expected} of {len(outcomes)} problems have the verdict that they should have; criteria are missed by "
        f"{', '.join(missed) or 'none'}."
    ]
    if truths:
        inside = sum(each.inside for each in known)
        sentences.append(f"{inside} of {truths} true values are within their 95 % intervals.")
    fields = [field for each in outcomes for field in each.result.get("fields", ())]
    if fields:
        values = sum(each["values"] for each in fields)
        held = sum(each["values"] * each["truth_in_band"]["all"] for each in fields) / values
        identified = between([each["identified"] for each in fields], ".0%")
        sentences.append(
            f"Of {values} values of {len(fields)} fields {held:.0%} lie within their 95 % bands; the observation "
            f"identifies {identified} of a field."
        )
    runs = [len(each.result["mpm_runs"]) for each in outcomes]
    seconds = [each.result["seconds"]["total"] for each in outcomes]
    sentences.append(f"A problem takes {between(runs, '.0f')} MPM runs and {between(seconds, '.0f')} s.")
    if both := both_ways(outcomes, lambda result: len(result["mpm_runs"])):
        with_it, without = ([each[asked] for each in both] for asked in (True, False))
        text = (
            f"Where both ways were gone, it takes {between(with_it, '.0f')} MPM runs with a surrogate that leads, "
            f"{between(without, '.0f')} without"
        )
        dear = {each.problem.name for each in outcomes if each.surrogate and each.problem.surrogate is Surrogate.AUTO}
        asked = [each for each in outcomes if each.problem.name in dear]
        times = both_ways(asked, lambda result: result["seconds"]["total"])
        if ratios := [each[True] / each[False] for each in times]:
            text += f"; where a run of the MPM is dear, {between(ratios, '.0%')} of the seconds"
        sentences.append(f"{text}.")
    return sentences


def both_ways(outcomes: Sequence[Outcome], figure: Callable[[dict[str, Any]], float]) -> list[dict[bool, float]]:
    """A figure of the results of each problem that was solved with a surrogate (True) and without (False)."""
    ways: dict[str, dict[bool, float]] = {}
    for each in outcomes:
        ways.setdefault(each.problem.name, {})[each.surrogate] = figure(each.result)
    return [each for each in ways.values() if len(each) == len((True, False))]


def row(outcome: Outcome, paper: Mapping[str, str]) -> Row:
    result = outcome.result
    front, loss = result["error_pct"].get("front"), result["loss"].get("mpm")
    return {
        "problem": f"`{outcome.problem.name}`",
        "the paper": paper.get(outcome.problem.name, ""),
        "verdict": result["verdict"],
        "the surrogate's own": own_text(outcome),
        "found": found_text(outcome),
        "largest error": error_text(outcome),
        "truth inside": f"{outcome.inside} of {len(outcome.errors)}" if outcome.errors else "-",
        "front off by": "-" if front is None else f"{front:.2f} %",
        "loss": "-" if loss is None else f"{loss:.1e}",
        "missed": "; ".join(outcome.missed) or "-",
        "MPM runs": len(result["mpm_runs"]),
        "s": f"{result['seconds']['total']:.0f}",
    }


def own_text(outcome: Outcome) -> str:
    """The surrogate's own first answer, and what the MPM shows there."""
    said = outcome.result.get("surrogate") or {}
    if "unknowns" not in said:
        return "-"
    names, error = outcome.problem.names, said["mpm_error"]
    texts = [outcome.text(each, said["unknowns"][each]) for each in names] if len(names) <= NAMED else []
    front = [f"front {error['front_pct']:.2f} % off"] if "front_pct" in error else []
    return ", ".join([*texts, f"loss {error['misfit']:.1e}", *front])


def found_text(outcome: Outcome) -> str:
    """The numbers found, or the range of their half-widths."""
    widths = outcome.half_widths
    if len(widths) > NAMED:
        low, high = min(widths, key=widths.__getitem__), max(widths, key=widths.__getitem__)
        return f"{len(widths)} numbers, ± {outcome.text(low, widths[low])} to {outcome.text(high, widths[high])}"
    return "<br>".join(
        (f"`{each}` " if len(widths) > 1 else "")
        + outcome.text(each, outcome.result["unknowns"][each])
        + f" ({' to '.join(outcome.text(each, end) for end in outcome.result['interval'][each])})"
        for each in widths
    )


def error_text(outcome: Outcome) -> str:
    """The largest error of a number, by its half-width."""
    errors, widths = outcome.errors, outcome.half_widths
    if not errors:
        return "-"
    worst = max(errors, key=lambda each: errors[each] / widths[each])
    text = outcome.text(worst, errors[worst])
    return f"{text} of `{worst}`" if len(errors) > 1 else f"{text} ({outcome.percent(errors):.2f} %)"


def field_row(outcome: Outcome, field: Mapping[str, Any]) -> Row:
    result, error = outcome.result, field["error"]

    def number(value: float | None) -> str:
        return "-" if value is None else f"{value:.3g}"

    return {
        "problem": f"`{outcome.problem.name}`",
        "field": f"{field['name']} [{field['unit']}]",
        "verdict": result["verdict"],
        "values": field["values"],
        "identified": f"{field['identified']:.0%}",
        "error, prior": number(error["prior"]),
        "error": number(error["posterior"]),
        "identified, prior": number(error["prior_identified"]),
        "identified, error": number(error["identified"]),
        "width": number(field["deviation"]["posterior"]),
        "within 95 %": f"{field['truth_in_band']['all']:.0%}",
        "MPM runs": len(result["mpm_runs"]),
        "s": f"{result['seconds']['total']:.0f}",
    }
