"""What a design leaves: `design.json`, `report.md` and a picture."""

from pathlib import Path
from typing import Any

import numpy as np
from tabulate import tabulate

from datasets.files import write_json, write_text
from validation.design.reliability import Reliability
from validation.design.search import Design
from validation.plots import BLUE, GREY, ORANGE, figure

STATIONS = 25
"""Along each variable, in the picture."""


def save(found: Design, folder: Path) -> None:
    write_json(folder / "design.json", record(found))
    draw(found, folder / "design.png")
    write_text(folder / "report.md", report(found))


def record(found: Design) -> dict[str, Any]:
    """`design.json`."""
    problem, reliability = found.problem, found.reliability
    values = problem.box.at(found.points)[:, len(problem.variables) :].tolist()
    names = [each.name for each in problem.uncertain]
    return {
        "problem": problem.name,
        "verdict": found.verdict,
        "design": found.design,
        "cost": reliability.price,
        "limit": {"quantity": problem.limit.quantity, "below": problem.limit.below, "unit": problem.unit},
        "probability": {
            "asked": problem.limit.probability,
            "required": problem.required,
            "emulator": reliability.expected,
            "cautious": reliability.cautious,
            "mpm": 1.0 - found.exceeding / len(found.responses),
            "interval": found.interval,
        },
        "exceeding": found.exceeding,
        "allowed": problem.allowed,
        "checks": [
            {"uncertain": dict(zip(names, row, strict=True)), "response": float(response)}
            for row, response in zip(values, found.responses, strict=True)
        ],
        "waves": [each.as_json() for each in found.search.waves],
        "runs": found.spent,
        "seconds": found.seconds,
        "remark": found.remark or None,
    }


def summary(found: Design) -> list[str]:
    """The outcome in sentences, for the terminal and the report."""
    problem, limit, known, checks = found.problem, found.problem.limit, found.reliability, len(found.responses)
    both = zip(problem.kinds, found.design.items(), strict=False)
    design = ", ".join(f"{name} = {kind.text(value)}" for kind, (name, value) in both)
    cost = f"; cost {known.price:.4g}" if problem.cost else ""
    low, high = found.interval
    lines = [
        f"{problem.name}: {found.verdict}",
        f"design: {design}{cost}",
        f"{limit.quantity} below {limit.below:g} {problem.unit}: asked of {100.0 * limit.probability:g} % of the flows",
        f"by the emulator of {100.0 * known.expected:.1f} % ({100.0 * known.cautious:.1f} % where its mean is a "
        "standard deviation too small)",
        f"by the MPM of {checks - found.exceeding} of {checks} fresh flows, so of {100.0 * low:.1f} to "
        f"{100.0 * high:.1f} % (95 %): {found.exceeding} exceed it where {problem.allowed} may, the largest is "
        f"{found.responses.max():.4g} {problem.unit}",
        f"{found.spent} runs for the emulator, {len(found.search.runs) - found.spent} of checks, {found.seconds:.0f} s",
    ]
    return [*lines, found.remark] if found.remark else lines


def report(found: Design) -> str:
    """`report.md`."""
    problem, (title, *lines) = found.problem, summary(found)
    keys = ("runs", "probability", "cautious")
    waves = [each["design"] | {key: each[key] for key in keys} for each in map(Reliability.as_json, found.search.waves)]
    ranges = [{"number": each.name, "lower": each.lower, "upper": each.upper} for each in problem.numbers]
    parts = [
        f"# {title}",
        "\n".join(f"- {line}" for line in lines),
        "![probability over the variables, responses of the check over what is uncertain](design.png)",
        tabulate(ranges, "keys", "pipe"),
        tabulate(waves, "keys", "pipe", floatfmt=".4g"),
    ]
    return "\n\n".join(parts) + "\n"


def draw(found: Design, path: Path) -> None:
    """P by the emulator along each variable through the design; responses of the check over what is uncertain."""
    problem, reliability, known = found.problem, found.reliability, len(found.problem.variables)
    values, limit = problem.box.at(found.points), problem.limit
    colours = np.where(found.responses >= limit.below, ORANGE, BLUE)
    with figure(path, rows=2, columns=max(known, len(problem.uncertain)), size=(3.2, 3.0)) as axes:
        for axis in axes.flat:
            axis.set_visible(False)
        for index, (axis, name) in enumerate(zip(axes[0], found.design, strict=False)):
            designs = np.tile(reliability.best, (STATIONS, 1))
            designs[:, index] = np.linspace(0.0, 1.0, STATIONS)
            along = problem.box.lower[index] + problem.box.range[index] * designs[:, index]
            axis.plot(along, reliability.probability(designs))
            axis.axhline(limit.probability, color=GREY, linestyle="--")
            axis.axvline(found.design[name], color=ORANGE)
            axis.set(xlabel=name, ylabel="probability", ylim=(0.0, 1.02), visible=True)
        for axis, each, row in zip(axes[1], problem.uncertain, values[:, known:].T, strict=False):
            axis.scatter(row, found.responses, s=10, c=colours)
            axis.axhline(limit.below, color=GREY, linestyle="--")
            axis.set(xlabel=each.name, ylabel=f"{limit.quantity} [{problem.unit}]", visible=True)
