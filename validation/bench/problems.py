"""`python -m validation.bench problems`: every shipped inverse problem, with its criteria and the paper's figures."""

import hashlib
import math
import shutil
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from datasets.errors import InputError, WorkFailed, suggestion
from datasets.files import make_folder, read_json, read_toml, write_csv, write_text
from datasets.schema import Record, from_mapping
from gns import library
from inverse.answer import Verdict
from inverse.problem import Problem, read_problem
from inverse.settings import Surrogate
from validation.bench.page import Keep, Out, Row, between, emphasised, tables, write_page
from validation.plots import BLUE, GREY, INK, ORANGE, RED, figure
from validation.run_store import kept

RESULT, KEY = "result.json", "made-of.txt"  # of a problem: the loop's result, and a digest of its inputs
ENDED = (0, 1)  # confirmed, and not
LISTED = 4  # a problem with more numbers has one row on the page
ALONE, LED, COARSE = "MPM alone", "surrogate leads", "larger cells lead"  # the ways to an answer
COLOURS = {ALONE: BLUE, LED: ORANGE}


@dataclass(frozen=True, kw_only=True)
class Criteria(Record):
    """The criteria for an outcome."""

    verdict: Verdict = Verdict.CONFIRMED
    front_error_pct: float = math.inf  # largest relative error of the front in the MPM
    unknown_error_pct: float = math.inf  # largest relative error of a number, unless its half-width is larger
    loss: float = math.inf  # largest loss in the MPM [m^2]
    inside: bool = False  # whether every true value has to be within its interval


@dataclass(frozen=True, kw_only=True)
class Paper(Record):
    """Results of the reference paper for a problem; lengths in metres, angles in degrees."""

    values: tuple[float, ...] = ()
    loss: float | None = None


@dataclass(frozen=True, kw_only=True)
class Section(Record):
    """Problems of one section of the page."""

    title: str
    problems: tuple[str, ...]
    pictures: tuple[str, ...] = ()  # PROBLEM/PICTURE on the page, without the ending
    again: tuple[Surrogate, ...] = ()
    """Each problem is also solved with each of these surrogates instead of its own setting."""
    criteria: Criteria


SHIPPED = read_toml(Path(__file__).with_suffix(".toml"))
FAMILIES = [from_mapping(Section, each) for each in SHIPPED["families"]]  # in the order of the page
PAPER = {name: from_mapping(Paper, each) for name, each in SHIPPED["paper"].items()}  # its figures, by problem


@dataclass(frozen=True, kw_only=True)
class AnsweredNumber:
    """The result for an unknown number; None for values that are not known."""

    unknown: str
    unit: str
    truth: float | None
    paper: float | None
    surrogate: float | None  # the surrogate's own answer, before any run of the MPM
    found: float  # the median of the posterior
    low: float  # its 2.5 % quantile
    high: float  # its 97.5 % quantile
    others: tuple[tuple[float, float, float], ...] = ()  # the same three of the other separate answers
    inside: bool
    """Whether the true value is known and lies within the interval of the answer that holds most true values."""

    def off(self, value: float | None) -> float:
        """A value minus the true one; nan if one of them is not known."""
        return math.nan if value is None or self.truth is None else value - self.truth


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """A result with the problem and its criteria."""

    problem: Problem
    criteria: Criteria
    result: dict[str, Any]  # `result.json`

    @property
    def paper(self) -> Paper:
        return PAPER.get(self.problem.name, Paper())

    @property
    def surrogate(self) -> dict[str, Any]:
        return self.result.get("surrogate") or {}

    @property
    def way(self) -> str:
        """How the answer was found."""
        asked = self.problem.surrogate is Surrogate.COARSE
        return (COARSE if asked else LED) if self.surrogate.get("asked") else ALONE

    @property
    def numbers(self) -> list[AnsweredNumber]:
        result, names, truth = self.result, self.problem.names, self.result.get("truth") or {}
        paper, surrogate = dict(zip(names, self.paper.values, strict=False)), self.surrogate.get("unknowns", {})
        answers = [result, *result.get("answers", [])[1:]]

        def held(answer: Mapping[str, Any]) -> set[str]:
            """The unknowns whose true values lie within the intervals of an answer."""
            intervals = answer["interval"].items()
            return {name for name, (low, high) in intervals if name in truth and low <= truth[name] <= high}

        # All from one answer: mixed values of two answers are no answer.
        inside, numbers = max(map(held, answers), key=len), []
        for name, kind in zip(names, self.problem.kinds, strict=True):
            (value, low, high), *others = [(answer["unknowns"][name], *answer["interval"][name]) for answer in answers]
            references = {"truth": truth.get(name), "paper": paper.get(name), "surrogate": surrogate.get(name)}
            values = {"found": value, "low": low, "high": high, "others": tuple(others), "inside": name in inside}
            numbers.append(AnsweredNumber(unknown=name, unit=kind.unit, **references, **values))
        return numbers

    @property
    def missed(self) -> list[str]:
        """The missed criteria, with the results."""
        asked, result = self.criteria, self.result
        numbers = [number for number in self.numbers if number.truth is not None]
        front, loss = result["error_pct"].get("front") or 0.0, result["loss"].get("mpm") or 0.0
        inside, most = sum(number.inside for number in numbers), asked.unknown_error_pct
        scales = [(number, 100.0 / abs(number.truth)) for number in numbers if number.truth]
        error = max((abs(number.off(number.found)) * scale for number, scale in scales), default=0.0)
        width = max((0.5 * (number.high - number.low) * scale for number, scale in scales), default=0.0)
        checks = {
            f"verdict {result['verdict']}, expected {asked.verdict}": result["verdict"] == asked.verdict,
            f"front {front:.2f} % off, at most {asked.front_error_pct:g} %": front <= asked.front_error_pct,
            f"misfit {loss:.1e} m², at most {asked.loss:.0e} m²": loss <= asked.loss,
            f"number {error:.2f} % off, at most {most:g} %": error <= most or most < width,
            f"{inside} of {len(numbers)} true values in their intervals": not asked.inside or inside == len(numbers),
        }
        return [text for text, met in checks.items() if not met]


Outcomes = Mapping[str, Outcome]  # of one problem, by the way to them


def bench(*, out: Out, keep: Keep = None, only: tuple[str, ...] = ()) -> str:
    """Solve every shipped problem that has no result in KEEP, each with a `python -m validation.loop`.

    A result is kept in KEEP/NAME, one with the surrogate in KEEP/NAME-gns, one without in KEEP/NAME-none, until the
    problem or the surrogate's weights change. Raises WorkFailed, after writing the page, if a problem could not be run.

    Args:
        only: Problems to solve; the page shows all results in KEEP.
    """
    names = [name for family in FAMILIES for name in family.problems]
    if unknown := [name for name in only if name not in names]:
        expected = f"expected the name of a shipped problem: {suggestion(unknown[0], names)}"
        raise InputError(expected, where=unknown[0], key="--only")
    failed, pictures, by_family = list[str](), list[str](), dict[str, list[Outcomes]]()
    with kept(keep) as folder:
        for family in FAMILIES:
            for name in family.problems:
                ways, asked = dict[str, Outcome](), read_problem(name)
                again = ((replace(asked, surrogate=way), f"{name}-{way}") for way in family.again)
                for problem, place in ((asked, name), *again):
                    result = current_result(problem, folder / place)
                    if result is None and name in (only or names):
                        solve(problem, folder / place)
                        if (result := current_result(problem, folder / place)) is None:
                            failed.append(place)
                    if result is not None:
                        outcome = Outcome(problem=problem, criteria=family.criteria, result=result)
                        ways.setdefault(outcome.way, outcome)
                if ways:
                    by_family.setdefault(family.title, []).append(ways)
            for picture in family.pictures:
                source, target = folder / f"{picture}.png", out / "pictures" / f"{picture.replace('/', '-')}.png"
                if source.exists():
                    make_folder(target.parent)
                    pictures.append(Path(shutil.copyfile(source, target)).stem)
    every = [ways for problems in by_family.values() for ways in problems]
    write_numbers(out / "problems.csv", [outcome for ways in every for outcome in ways.values()])
    draw(out / "pictures" / "problems.png", every)
    families = "\n\n".join(section(*item) for item in by_family.items())
    shown = "\n\n".join(f"![{name}](pictures/{name}.png)" for name in pictures)
    said = write_page(out, "problems", conclusion(every), families=families, pictures=shown)
    if failed:
        raise WorkFailed(f"could not be run: {', '.join(failed)}")
    return said


def made_of(problem: Problem) -> str:
    """Digest of the problem and of the weights of a surrogate that may be used."""
    # Independent of the problem's folder.
    text = repr(problem).replace(repr(problem.folder), repr(Path()))
    asked = problem.surrogate is not Surrogate.NONE
    weights = library.shipped(problem.scene).read_bytes() if asked else b""
    return hashlib.sha256(text.encode() + weights).hexdigest()[:16]


def current_result(problem: Problem, folder: Path) -> dict[str, Any] | None:
    """The result in `folder` of the problem as it is now."""
    key = folder / KEY
    return read_json(folder / RESULT) if key.exists() and key.read_text() == made_of(problem) else None


def solve(problem: Problem, folder: Path) -> None:
    """Solve a problem with the loop in its own process; if that fails, `folder` contains no current result."""
    if (folder / KEY).exists():
        # Runs of another problem or other weights would make this one seem cheaper.
        shutil.rmtree(folder)
    # If this run fails, an older result must not count as its result.
    (folder / RESULT).unlink(missing_ok=True)
    arguments = ["-m", "validation.loop", problem.name, "--out", str(folder), "--surrogate", problem.surrogate]
    if subprocess.run([sys.executable, *arguments], check=False).returncode in ENDED:
        write_text(folder / KEY, made_of(problem))


def section(title: str, problems: Sequence[Outcomes]) -> str:
    """The section of a family: its table, without empty columns, and the missed criteria."""
    every = [outcome for ways in problems for outcome in ways.values()]
    fields = [field_row(outcome, field) for outcome in every for field in outcome.result.get("fields", ())]
    table = fields or [row for ways in problems for row in rows(ways)]
    filled = {key for row in table for key, cell in row.items() if cell != ""}
    table = [{key: cell for key, cell in row.items() if key in filled} for row in table]
    short = [outcome for outcome in every if outcome.missed]
    missed = [f"- `{outcome.problem.name}`, {outcome.way}: {'; '.join(outcome.missed)}" for outcome in short]
    return "\n\n".join([f"## {title}", tables([table]), "\n".join(missed)]).rstrip()


def conclusion(solved: Sequence[Outcomes]) -> list[str]:
    """Counts of met criteria and of truths in intervals, the paper's columns, fields, and the cost."""
    outcomes = [outcome for ways in solved for outcome in ways.values()]
    if not outcomes:
        return ["No problem has been solved yet."]
    good = sum(not outcome.missed for outcome in outcomes)
    said = [f"{good} of {len(outcomes)} answers to {len(solved)} problems meet all of their criteria."]
    if inside := [number.inside for outcome in outcomes for number in outcome.numbers if number.truth is not None]:
        said.append(f"The 95 % intervals contain {sum(inside)} of {len(inside)} true values.")
    sizes: dict[str, list[float]] = {way: [] for way in (*COLOURS, "paper")}
    for outcome in outcomes:
        if outcome.problem.names == ["friction_deg"] and outcome.paper.values:
            (number,) = outcome.numbers
            sizes[outcome.way].append(abs(number.off(number.found)))
            sizes["paper"].append(abs(number.off(number.paper)))
    if errors := ", ".join(f"{between(values, '.1f')}° ({way})" for way, values in sizes.items() if values):
        said.append(f"From the front of the paper's columns, the friction angle is found with an error of {errors}.")
    if fields := [field for outcome in outcomes for field in outcome.result.get("fields", ())]:
        values = sum(field["values"] for field in fields)
        held = sum(field["values"] * field["truth_in_band"]["all"] for field in fields) / values
        said.append(
            f"{held:.0%} of the {values} values of {len(fields)} unknown fields lie within their 95 % bands; the"
            f" observation identifies {between([field['identified'] for field in fields], '.0%')} of a field."
        )
    both = [ways for ways in solved if len(ways) == len(COLOURS)] or solved
    runs = {way: [len(ways[way].result["mpm_runs"]) for ways in both if way in ways] for way in COLOURS}
    cost = " and ".join(f"{between(counts, '.0f')} MPM runs ({way})" for way, counts in runs.items() if counts)
    return [*said, f"Where a problem was solved both ways, an answer takes {cost}."]


def rows(ways: Outcomes) -> list[Row]:
    """The rows of a problem: one for each number, or one for many."""
    problem, numbers = next((outcome.problem, outcome.numbers) for outcome in ways.values())
    results, many, table = [ways[way].result for way in COLOURS if way in ways], len(numbers) > LISTED, list[Row]()
    for index, (number, kind) in enumerate(zip(numbers[:1] if many else numbers, problem.kinds, strict=False)):
        name = f"`{problem.name}`" if index == 0 else ""
        row = {"problem": name if many or len(numbers) == 1 else f"{name} {number.unknown}"}
        row["true value"] = "-" if number.truth is None else "" if many else kind.text(number.truth)
        row["paper"] = "" if number.paper is None else f"{number.paper:g}"
        row |= {way: cell(ways[way], index, kind.digits, many=many) if way in ways else "" for way in COLOURS}
        row["MPM runs"] = " / ".join(str(len(result["mpm_runs"])) for result in results) if index == 0 else ""
        seconds = " / ".join(f"{result['seconds']['processors']:.0f}" for result in results)
        table.append(row | {"CPU s": seconds if index == 0 else ""})
    return table


def cell(outcome: Outcome, index: int, digits: int, *, many: bool) -> str:
    """A found number with its interval; of many numbers, how many true values are within their intervals."""
    number, verdict = outcome.numbers[index], outcome.result["verdict"]
    answers = [(number.found, number.low, number.high), *number.others]
    text = " or ".join(f"{value:.{digits}f} [{low:.{digits}f}, {high:.{digits}f}]" for value, low, high in answers)
    if many:
        text = f"{sum(answered.inside for answered in outcome.numbers)} of {len(outcome.numbers)} in their intervals"
    shown = index == 0 and verdict != Verdict.CONFIRMED.value
    return emphasised(f"{verdict}: {text}" if shown else text, not outcome.missed)


def field_row(outcome: Outcome, field: Mapping[str, Any]) -> Row:
    error = [field["error"][key] for key in ("prior_identified", "identified")]
    unit = f" [{field['unit']}]" if field["unit"] else ""
    return {
        "problem": f"`{outcome.problem.name}` {field['name']}{unit}",
        "found by": outcome.way,
        "values": field["values"],
        "identified": f"{field['identified']:.0%}",
        "their rms error, prior and found": ", ".join("-" if value is None else f"{value:.3g}" for value in error),
        "truth within 95 %": f"{field['truth_in_band']['all']:.0%}",
        "verdict": outcome.result["verdict"],
        "MPM runs": outcome.result["run_count"],
        "reverse passes": outcome.result.get("reverse_passes", 0),
        "CPU s": f"{outcome.result['seconds']['processors']:.0f}",
    }


def write_numbers(path: Path, outcomes: Sequence[Outcome]) -> None:
    """A line for each number of each answer, and for each field."""
    lines: list[dict[str, object]] = []
    for outcome in outcomes:
        result, errors = outcome.result, outcome.surrogate.get("mpm_error", {})
        common = {
            "problem": outcome.problem.name,
            "way": outcome.way,
            "verdict": result["verdict"],
            "missed": "; ".join(outcome.missed),
            "mpm_runs": len(result["mpm_runs"]),
            "processor_seconds": result["seconds"]["processors"],
            "misfit_m2": result["loss"].get("mpm"),
            "front_error_pct": result["error_pct"].get("front"),
            "surrogate_misfit_m2": errors.get("misfit"),
            "surrogate_front_error_pct": errors.get("front_pct"),
            "paper_misfit_m2": outcome.paper.loss,
        }
        lines += [common | asdict(number) for number in outcome.numbers]
        for field in result.get("fields", ()):
            flat = {f"{key}_{part}": field[key][part] for key in ("error", "truth_in_band") for part in field[key]}
            whole = {key: field[key] for key in ("unit", "values", "identified")}
            lines.append(common | {"unknown": field["name"]} | whole | flat)
    header = list(dict.fromkeys(key for line in lines for key in line))
    write_csv(path, header, ([line.get(key) for key in header] for line in lines))


def draw(path: Path, solved: Sequence[Outcomes]) -> None:
    """Plot the paper's problems: each answer minus the true value, a pane for each unit."""
    panes: dict[str, list[tuple[str, dict[str, AnsweredNumber]]]] = {}
    for ways in solved:
        one = next(iter(ways.values()))
        for index, number in enumerate(one.numbers if one.paper != Paper() else ()):
            label = one.problem.name if len(one.numbers) == 1 else number.unknown
            panes.setdefault(number.unit, []).append((label, {way: ways[way].numbers[index] for way in ways}))
    with figure(path, rows=max(1, len(panes)), size=(7.0, 2.4)) as axes:
        for axis, (unit, shown) in zip(axes[:, 0], panes.items(), strict=False):
            axis.axvline(0.0, color=INK, linewidth=0.8, label="true value")
            for row, (_, numbers) in enumerate(shown):
                for shift, (way, answer) in zip((-0.15, 0.15), numbers.items(), strict=False):
                    ends = [[answer.found - answer.low], [answer.high - answer.found]]
                    style = {"color": COLOURS[way], "fmt": "o", "ms": 4, "capsize": 2, "label": f"{way}, 95 %"}
                    axis.errorbar(answer.off(answer.found), row + shift, xerr=ends, **style)
                    style = {"color": GREY, "ms": 4, "mfc": "none", "label": "surrogate alone"}
                    axis.plot(answer.off(answer.surrogate), row, "D", **style)
                    axis.plot(answer.off(answer.paper), row, "x", color=RED, label="paper")
            axis.set_yticks(range(len(shown)), [label for label, _ in shown])
            axis.set(xlabel=f"value less the true one [{unit}]")
            axis.invert_yaxis()
            handles = dict(zip(*reversed(axis.get_legend_handles_labels()), strict=True))
            if axis is axes[0, 0]:
                axis.legend(handles.values(), handles, ncols=5, loc="lower left", bbox_to_anchor=(-0.2, 1.0))
