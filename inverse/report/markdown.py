"""`report.md` of a single inversion, and the words and tables that it shares with other reports."""

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from datasets import files
from inverse.observations.deposit import Values
from inverse.optimise import best
from inverse.parameters.parameters import Vector, kind
from inverse.problem import Observable, Problem
from inverse.report import course, pictures
from inverse.report.course import loss_unit
from inverse.report.pictures import seen
from inverse.result import Result, Round, peak_memory_mib

Deposit = NDArray[np.floating]

OBSERVED = {
    Observable.FRONT: "the front of the deposit, the x that 99.5 % of its points are behind",
    Observable.RUNOUT: "the runout, the largest x of the deposit",
    Observable.PROFILE: "the height profile of the deposit",
    Observable.TOE: "the toe, the centroid of the furthest 10 % of the points",
    Observable.DEPOSIT: "where every point of the deposit came to rest",
    Observable.PASSED: "the share of the material that came to rest beyond the line",
    Observable.SEVERAL: "several things",
}
MANY = 2
"""With more unknowns than these they are drawn side by side as well."""
WIDE = 4
"""With more unknowns than these the tables of rounds and runs leave them to the pictures and to `result.json`."""
STAGES = 6
"""So many deposits on the way are drawn."""


def write(
    result: Result,
    deposit: Deposit,
    folder: Path,
    *,
    forward: str = "surrogate",
    stages: Sequence[tuple[str, Vector, Deposit]] = (),
) -> None:
    """Write `report.md` and its pictures into `folder`.

    deposit: of the prediction [m], shape [N, D]; forward: what predicted, a key of `pictures.COLOURS`; stages: title,
    unknowns [U] and deposit [m], shape [N, D], of predictions on the way.
    """
    problem, target = result.problem, result.target
    deposits = {forward: deposit}
    if target.deposit is not None:
        deposits = {"target": target.deposit, **deposits}
    pictures.draw_deposits(folder / "deposit.png", problem, target, result.answer, deposits)
    course.draw(folder / "iterations.png", problem, result.rounds, target.truth, forward=forward)
    lines = [
        f"# {problem.name}: {result.verdict}",
        "",
        question(problem),
        "",
        f"The {forward} alone answers: nothing has checked it. `python -m validation.loop` does.",
        "",
        *answer(result),
        "",
        *found_picture(result, folder),
        "## Against the target",
        "",
        *table(
            ["", *OBSERVATION],
            [
                observation_row(problem, "target", target.values, None),
                observation_row(problem, f"{forward}, at the start", *_first(result)),
                observation_row(problem, f"{forward}, at the answer", result.surrogate, result.loss_surrogate),
            ],
        ),
        "",
        "![deposits](deposit.png)",
        "",
        "## How it was found",
        "",
        *rounds_table(result),
        "",
        "![iterations](iterations.png)",
        "",
    ]
    if stages:
        pictures.draw_stages(folder / "stages.png", problem, target, stages, pictures.COLOURS[forward])
        lines += [f"What the {forward} predicted on the way{over_target(result)}:", "", "![stages](stages.png)", ""]
    files.write_text(folder / "report.md", "\n".join([*lines, *price(result)]) + "\n")


def picked(rounds: Sequence[Round], most: int = STAGES) -> list[int]:
    """Places of some evaluations among those of all `rounds`, the first and the best among them."""
    records = [evaluation for stage in rounds for evaluation in stage.evaluations]
    last = int(np.nanargmin([record.loss for record in records]))
    return sorted({round(place) for place in np.linspace(0, last, min(most, last + 1))})


def question(problem: Problem) -> str:
    """What was asked, in a sentence."""
    alike: dict[str, list[str]] = {}
    for unknown in problem.unknowns:
        alike.setdefault(f"[{unknown.lower:g}, {unknown.upper:g}] {kind(unknown.name).unit}", []).append(unknown.name)
    names = "; ".join(f"{', '.join(code(each))} in {bounds}" for bounds, each in alike.items())
    what = OBSERVED[problem.observation.kind]
    if problem.observation.kind is Observable.PASSED:
        what += f" x = {problem.observation.line:g} m"
    if problem.observations:
        counted = Counter(str(each.name or each.kind) for each in problem.observations)
        what = ", ".join(name if count == 1 else f"{name} ({count})" for name, count in counted.items())
    return f"Unknown: {names}. Observed: {what}."


def quantity(name: str, value: float) -> str:
    """A value of an unknown with its unit."""
    return f"{number(name, value)} {kind(name).unit}".removesuffix(" -")


def number(name: str, value: float) -> str:
    """A value of an unknown without its unit."""
    return f"{value:z.{kind(name).digits}f}"


def answer(result: Result, alone: Mapping[str, float] | None = None) -> list[str]:
    """The unknowns in a table: start, found with its half-width, truth and error where they are known.

    alone: what the surrogate had found before the MPM corrected it.
    """
    truth, widths = result.target.truth, result.certainty
    worth = "may move by" if result.problem.target.least else "certain to (95 %)"
    head = ["unknown", "start", "found", *([worth] if widths else [])]
    head += [*(["truth", "error"] if truth else []), *(["truth inside"] if truth and widths else [])]
    rows = []
    for unknown in result.problem.unknowns:
        name, value = unknown.name, result.unknowns[unknown.name]
        row = [f"`{name}`", quantity(name, unknown.initial), f"**{quantity(name, value)}**"]
        row += [f"± {quantity(name, widths[name])}"] if widths else []
        row += known(result, name)
        if truth and widths:
            row.append("yes" if name in result.inside else "**no**")
        rows.append([*row, *([quantity(name, alone[name])] if alone else [])])
    return table([*head, *(["the surrogate alone"] if alone else [])], rows)


def known(result: Result, name: str) -> list[str]:
    """Truth and error of an unknown, where the truth is known; the relative error where it means something."""
    if not result.target.truth:
        return []
    truth = result.target.truth[name]
    error = quantity(name, result.unknowns[name] - truth)
    # A position has no zero of its own, and a velocity may be near its.
    if kind(name).unit in ("deg", "Pa") and name in result.error_pct:
        error += f" ({result.error_pct[name]:.2f} %)"
    return [quantity(name, truth), error]


def found_picture(result: Result, folder: Path, alone: Mapping[str, float] | None = None) -> list[str]:
    """Draw what was found beside the truth, where there are many unknowns, and show it."""
    if len(result.unknowns) <= MANY:
        return []
    path = folder / "unknowns.png"
    course.draw_found(path, result.problem, result.unknowns, result.certainty, result.target.truth, alone)
    return ["![unknowns](unknowns.png)", ""]


OBSERVATION = ("observed", "away from the target", "loss")


def observation_row(problem: Problem, who: str, values: Values | None, loss: float | None) -> list[str]:
    """What `who` shows, how far from the target, and the loss."""
    said = "-" if values is None else seen(problem, values)
    if loss is None:
        return [who, said, "-", "-"]
    return [who, said, away(problem, loss), f"{loss:.2e} {loss_unit(problem)}".removesuffix(" -")]


def away(problem: Problem, loss: float) -> str:
    """How far from the target a loss is: a length, also in cells, or a share."""
    root = math.sqrt(loss)
    if problem.observation.kind is Observable.SEVERAL:
        return f"{root:.3g} standard deviations"
    if problem.observation.kind is Observable.PASSED:
        return f"{100.0 * root:.2f} % of the material"
    return f"{length(root)} ({root / problem.scene.domain.cell:.2g} cells)"


def length(value: float) -> str:
    """A length [m] in millimetres."""
    return f"{1e3 * value:.3g} mm"


def over_target(result: Result) -> str:
    """What is said of the target in a picture of deposits."""
    return ", over the target's profile" if result.target.deposit is not None and _flat(result) else ""


def rounds_table(result: Result) -> list[str]:
    """What each minimisation began and ended with."""
    unit = loss_unit(result.problem)
    head = ["round", "evaluations", f"loss at its start [{unit}]", "its least loss", *code(told(result.problem))]
    rows = []
    for stage in result.rounds:
        least = best(list(stage.evaluations))
        values = [number(name, value) for name, value in zip(told(result.problem), least.unknowns, strict=False)]
        losses = [f"{stage.evaluations[0].loss:.2e}", f"{least.loss:.2e}"]
        rows.append([str(stage.number), str(len(stage.evaluations)), *losses, *values])
    return table(head, rows)


def told(problem: Problem) -> list[str]:
    """The unknowns that have a column of their own in a table of many rows."""
    return problem.names if len(problem.names) <= WIDE else []


def price(result: Result) -> list[str]:
    """What it cost."""
    seconds = result.seconds
    return [
        "## Price",
        "",
        *table(
            ["evaluations", "forward", "backward", "per iteration", "in the MPM", "total", "peak memory"],
            [
                [
                    str(len(result.evaluations)),
                    *(f"{seconds[key]:.2f} s" for key in ("forward", "backward", "per_iteration", "mpm", "total")),
                    f"{peak_memory_mib():.0f} MiB",
                ]
            ],
        ),
    ]


def code(names: Sequence[str]) -> list[str]:
    """Names as Markdown shows names of keys."""
    return [f"`{name}`" for name in names]


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """A table in Markdown."""
    return [f"| {' | '.join(row)} |" for row in (head, ["---"] * len(head), *rows)]


def _first(result: Result) -> tuple[Values, float]:
    first = result.evaluations[0]
    return first.observation, first.loss


def _flat(result: Result) -> bool:
    return result.problem.scene.dimension == 2
