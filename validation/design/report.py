"""What a design leaves: `design.json`, `report.md` and a picture."""

from pathlib import Path
from typing import Any

import numpy as np
from tabulate import tabulate

from datasets.files import write_json, write_text
from inverse.posterior import Matrix
from validation.design.problem import ASSURANCE
from validation.design.search import Design
from validation.report.plots import BLUE, GREY, ORANGE, figure

STATIONS = 25
"""Along each variable, in the picture."""
PICTURE = "design.png"


def save(found: Design, folder: Path) -> None:
    """Write the files of a design."""
    write_json(folder / "design.json", record(found))
    draw(found, folder / PICTURE)
    write_text(folder / "report.md", report(found))


def record(found: Design) -> dict[str, Any]:
    """`design.json`."""
    problem, search = found.problem, found.search
    values = problem.box.at(found.points)[:, len(problem.variables) :]
    names = [each.name for each in problem.uncertain]
    return {
        "problem": problem.name,
        "verdict": found.verdict,
        "design": found.design,
        "cost": float(problem.price(search.best[None])[0]) if problem.cost else None,
        "limit": {"quantity": problem.limit.quantity, "below": problem.limit.below, "unit": problem.limit.unit},
        "probability": {
            "asked": problem.limit.probability,
            "required": problem.required,
            "emulator": search.expected,
            "deviation": search.deviation,
            "mpm": 1.0 - found.exceeding / len(found.responses),
            "interval": found.interval,
        },
        "exceeding": found.exceeding,
        "allowed": problem.allowed,
        "checks": [
            {"uncertain": dict(zip(names, row.tolist(), strict=True)), "response": float(response)}
            for row, response in zip(values, found.responses, strict=True)
        ],
        "waves": search.waves,
        "runs": search.spent,
        "seconds": found.seconds,
        "remark": found.remark or None,
    }


def summary(found: Design) -> list[str]:
    """The outcome in sentences, for the terminal and the report."""
    problem, limit, search, checks = found.problem, found.problem.limit, found.search, len(found.responses)
    unit = f" {limit.unit}".rstrip()
    kinds = zip(problem.kinds, found.design.items(), strict=False)
    listed = ", ".join(f"{name} = {kind.text(value)}" for kind, (name, value) in kinds)
    cost = f"; cost {problem.price(search.best[None])[0]:.4g}" if problem.cost else ""
    low, high = found.interval
    lines = [
        f"{problem.name}: {found.verdict}",
        f"design: {listed}{cost}",
        f"{limit.quantity} below {limit.below:g}{unit}: asked of {100.0 * limit.probability:g} % of the flows, by the "
        f"emulator {100.0 * search.expected:.1f} % (± {100.0 * search.deviation:.1f} %, one standard deviation)",
        f"the MPM: {checks - found.exceeding} of {checks} fresh flows, so {100.0 * low:.1f} to {100.0 * high:.1f} % "
        f"(95 %); at most {problem.allowed} may exceed the limit, {found.exceeding} did",
        f"{search.spent} runs for the emulator, {len(search.points) - search.spent + checks} of checks; "
        f"{found.seconds:.0f} s",
    ]
    return [*lines, found.remark] if found.remark else lines


def report(found: Design) -> str:
    """`report.md`."""
    problem, limit = found.problem, found.problem.limit
    title, *lines = summary(found)
    chosen = [
        {"variable": each.name, "between": f"{each.lower:g}, {each.upper:g}", "design": kind.text(value)}
        for each, kind, value in zip(problem.variables, problem.kinds, found.design.values(), strict=False)
    ]
    values = problem.box.at(found.points)[:, len(problem.variables) :]
    uncertain = [
        {
            "uncertain": each.name,
            "between": f"{each.lower:g}, {each.upper:g}",
            "of the check": f"{row.mean():.4g} ± {row.std():.3g}",
        }
        for each, row in zip(problem.uncertain, values.T, strict=True)
    ]
    waves = [
        {"runs": each["runs"], **each["design"], "probability": each["probability"], "deviation": each["deviation"]}
        for each in found.search.waves
    ]
    quantiles = np.quantile(found.responses, [0.0, 0.5, limit.probability, 1.0])
    asked = f"{100.0 * limit.probability:g} %"
    spread = " / ".join(f"{value:.4g}" for value in quantiles)
    parts = [
        f"# {title}",
        "\n".join(f"- {line}" for line in lines),
        f"![probability over the variables, responses of the check]({PICTURE})",
        tabulate(chosen, "keys", "pipe"),
        tabulate(uncertain, "keys", "pipe"),
        f"{limit.quantity} of the check, least / median / {asked} / largest: {spread} {limit.unit}",
        "## Search",
        f"Looked for: {100.0 * problem.required:.1f} % by the emulator, more than the {asked} asked, so that a design "
        f"passes its check in {100.0 * ASSURANCE:g} % of the cases where the emulator is right.",
        tabulate(waves, "keys", "pipe", floatfmt=".4g"),
    ]
    return "\n\n".join(parts) + "\n"


def draw(found: Design, path: Path) -> None:
    """P by the emulator along each variable through the design; responses of the check over what is uncertain."""
    problem, search = found.problem, found.search
    shares, known = np.linspace(0.0, 1.0, STATIONS), len(problem.variables)
    values = problem.box.at(found.points)[:, known:]
    exceeds = found.responses >= problem.limit.below
    columns = max(known, len(problem.uncertain))
    with figure(path, rows=2, columns=columns, size=(3.2, 3.0)) as axes:
        for index, (axis, each) in enumerate(zip(axes[0], problem.variables, strict=False)):
            designs: Matrix = np.tile(search.best, (STATIONS, 1))
            designs[:, index] = shares
            axis.plot(problem.box.lower[index] + problem.box.range[index] * shares, search.probability(designs))
            axis.axhline(problem.limit.probability, color=GREY, linestyle="--")
            axis.axvline(found.design[each.name], color=ORANGE)
            axis.set(xlabel=each.name, ylabel="probability", ylim=(0.0, 1.02))
        for axis, each, row in zip(axes[1], problem.uncertain, values.T, strict=False):
            axis.scatter(row, found.responses, s=10, c=np.where(exceeds, ORANGE, BLUE))
            axis.axhline(problem.limit.below, color=GREY, linestyle="--")
            axis.set(xlabel=each.name, ylabel=f"{problem.limit.quantity} [{problem.limit.unit or '-'}]")
        for axis in (*axes[0, known:], *axes[1, len(problem.uncertain) :]):
            axis.set_visible(False)
