"""`report.md` of a single inversion, and the sentences and tables that it shares with the loop's report."""

from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from tabulate import tabulate

from datasets import files
from inverse.forward.interface import Evaluation
from inverse.observations import Values
from inverse.optimise import best
from inverse.parameters import Vector
from inverse.problem import Problem
from inverse.report import course, pictures
from inverse.result import Found, Result, peak_memory_mib

MANY = 2
"""With more parameters than these they are drawn side by side as well."""
WIDE = 4
"""With more parameters than these the table of the search leaves them to the pictures and to `result.json`."""
STAGES = 6
"""So many deposits on the way are drawn."""
OBSERVATION = ("observed", "distance to the target", "loss")
"""Columns of `observation_row`."""

DepositAt = Callable[[Vector], NDArray[np.floating]]


def write(result: Result, deposit_at: DepositAt, folder: Path, *, forward: str = "surrogate") -> None:
    """Write `report.md` and its pictures into `folder`.

    deposit_at: predicts final positions [m], shape [N, D], at parameters [U]; forward: the forward model, a key of
    `pictures.COLOURS`.
    """
    problem, target = result.problem, result.target
    deposits = {forward: deposit_at(result.answer)}
    if target.deposit is not None:
        deposits = {"target": target.deposit, **deposits}
    pictures.draw_deposits(folder / "deposit.png", problem, target, result.answer, deposits)
    course.draw(folder / "iterations.png", problem, result.evaluations, target.truth, forward=forward)
    records = result.evaluations
    stages = [
        (f"evaluation {index + 1}, loss {records[index].loss:.1e}", records[index].parameters)
        for index in picked(result.evaluations)
    ]
    shown = [(title, values, deposit_at(values)) for title, values in stages]
    pictures.draw_stages(folder / "stages.png", problem, target, shown, pictures.COLOURS[forward])
    first = records[0]
    rows = [
        observation_row(result, "target", target.values, None),
        observation_row(result, f"{forward}, at the start", first.observation, first.loss),
        observation_row(result, f"{forward}, at the answer", result.predicted, result.loss),
    ]
    lines = [
        f"# {problem.name}: {result.verdict}",
        question(problem),
        f"The {forward} alone answers: nothing has checked it. `python -m validation.loop` does.",
        *answer(result),
        *found_picture(result, folder),
        "## Against the target",
        markdown_table(["", *OBSERVATION], rows),
        "![deposits](deposit.png)",
        "## How it was found",
        search_table(result),
        "![iterations](iterations.png)",
        f"What the {forward} predicted on the way{over_target(result)}:",
        "![stages](stages.png)",
        *cost(result),
    ]
    files.write_text(folder / "report.md", "\n\n".join(lines) + "\n")


def picked(evaluations: Sequence[Evaluation], count: int = STAGES) -> list[int]:
    """Indices of up to `count` of the `evaluations`, the first and the best among them."""
    last = int(np.nanargmin([each.loss for each in evaluations]))
    return sorted({round(index) for index in np.linspace(0, last, min(count, last + 1))})


def question(problem: Problem) -> str:
    """What was asked, in a sentence."""
    alike: dict[str, list[str]] = {}
    for each in problem.parameters:
        alike.setdefault(f"[{each.lower:g}, {each.upper:g}] {each.kind.unit}", []).append(f"`{each.name}`")
    names = "; ".join(f"{', '.join(each)} in {bounds}" for bounds, each in alike.items())
    what = problem.observed.label
    if problem.observation.line is not None:
        what += f" x = {problem.observation.line:g} m"
    if problem.observations:
        counted = Counter(each.name or each.kind for each in problem.observations)
        what = ", ".join(name if count == 1 else f"{name} ({count})" for name, count in counted.items())
    return f"Unknown: {names}. Observed: {what}."


def answer(result: Found) -> list[str]:
    """The parameters in a table: start, found with its half-width, truth and error where they are known."""
    truth, widths = result.target.truth, result.certainty
    uncertainty = "may move by" if result.problem.target.minimise else "certain to (95 %)"
    rows = []
    for each in result.problem.parameters:
        name, kind, value = each.name, each.kind, result.unknowns[each.name]
        row = {"unknown": f"`{name}`", "start": kind.text(each.initial), "found": f"**{kind.text(value)}**"}
        if widths:
            row[uncertainty] = f"± {kind.text(widths[name])}"
        if truth:
            row |= {"truth": kind.text(truth[name]), "error": kind.text(value - truth[name])}
            # A position has no zero of its own, and a velocity may be near its.
            if kind.unit in ("deg", "Pa") and name in result.error_pct:
                row["error"] += f" ({result.error_pct[name]:.2f} %)"
        if truth and widths:
            row["truth inside"] = "yes" if name in result.inside else "**no**"
        rows.append(row)
    return [markdown_table(list(rows[0]), [list(row.values()) for row in rows])]


def found_picture(result: Found, folder: Path) -> list[str]:
    """Draw what was found beside the truth, where there are many parameters, and show it."""
    if len(result.unknowns) <= MANY:
        return []
    path = folder / "unknowns.png"
    course.draw_found(path, result.problem, result.unknowns, result.certainty, result.target.truth)
    return ["![unknowns](unknowns.png)"]


def observation_row(result: Found, model: str, values: Values | None, loss: float | None) -> list[str]:
    """What `model` predicts, its distance from the target, and the loss."""
    observation = result.target.observation
    text = "-" if values is None else observation.values_text(values)
    if loss is None:
        return [model, text, "-", "-"]
    distance = observation.misfit_text(loss, result.problem.scene.domain.cell)
    return [model, text, distance, f"{loss:.2e} {observation.misfit_unit()}".removesuffix(" -")]


def over_target(result: Found) -> str:
    """What is said of the target in a picture of deposits."""
    drawn = result.target.deposit is not None and result.problem.scene.dimension == 2
    return ", over the target's profile" if drawn else ""


def search_table(result: Result) -> str:
    """What the minimisation began and ended with."""
    columns = result.problem.parameters if len(result.problem.parameters) <= WIDE else ()
    unit, minimum = result.problem.observed.misfit_unit(), best(result.evaluations)
    values = result.problem.named(minimum.parameters)
    head = ["evaluations", f"loss at its start [{unit}]", "its minimum loss", *(f"`{each.name}`" for each in columns)]
    losses = [f"{result.evaluations[0].loss:.2e}", f"{minimum.loss:.2e}"]
    row = [str(len(result.evaluations)), *losses, *(each.kind.number(values[each.name]) for each in columns)]
    return markdown_table(head, [row])


def cost(result: Result) -> list[str]:
    """What it cost."""
    seconds = result.seconds
    head = ["evaluations", "forward", "backward", "per iteration", "in the MPM", "total", "peak memory"]
    times = [f"{seconds[key]:.2f} s" for key in ("forward", "backward", "per_iteration", "mpm", "total")]
    row = [str(len(result.evaluations)), *times, f"{peak_memory_mib():.0f} MiB"]
    return ["## Cost", markdown_table(head, [row])]


def markdown_table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table in Markdown of cells that are text already."""
    return tabulate(rows, headers=head, tablefmt="pipe", disable_numparse=True)
