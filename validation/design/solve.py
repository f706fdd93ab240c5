"""A robust design by the MPM, from a problem to the files of its result: `design.json`, `report.md` and a picture."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from datasets.files import write_json, write_text
from datasets.flow.trajectory import Trajectory
from datasets.markdown import markdown_table
from inverse.forward import Simulate
from inverse.posterior import Matrix, Row
from mpm import ALL, LAST, simulate_many
from validation.design.predictor import predictor
from validation.design.problem import DesignProblem, read_design
from validation.design.race import RacedDesign, raced
from validation.design.reliability import Reliability
from validation.design.search import Design, designed
from validation.plots import BLUE, GREY, ORANGE, figure
from validation.run_store import RunStore, caveats, kept

STATIONS = 25
"""Along each variable, in the picture."""


def find_design(
    problem: DesignProblem | str | Path, out: Path | str | None = None, *, simulate: Simulate = simulate_many
) -> Design | RacedDesign:
    """The cheapest design that keeps the limit as often as asked, checked by the MPM.

    >>> from validation import find_design
    >>> found = find_design("two-barriers", "out/design")
    >>> print(found.verdict, found.design, found.exceeding, found.interval)

    problem: one built in Python, the path of a TOML file or the name of a shipped one. out: folder for `design.json`,
    `report.md`, a picture and every flow, where an interrupted command goes on; without it nothing is written.
    simulate: in place of the MPM. Raises InputError, and WorkFailed where a run of the MPM blows up or another process
    writes into `out`.
    """
    asked = problem if isinstance(problem, DesignProblem) else read_design(problem)
    limit = asked.limit
    with kept(out) as folder:
        store = RunStore(folder / "mpm" / limit.folder, simulate, label="design-", reduce=limit.kept)
        flows = list[Trajectory]()

        def respond(points: Matrix, first: int) -> Row:
            flows[:] = store(asked.scenes_at(points, first), record=ALL if limit.force else LAST)
            return np.array([each.summary[limit.quantity] for each in flows])

        if asked.surrogate == "none":
            found: Design | RacedDesign = designed(asked, respond)
        else:
            found = raced(asked, predictor(asked, simulate), respond)
        # The last flows are those of the check.
        remarks = caveats(flows)
        # On deposits, which a force does not depend on.
        if remarks and not limit.force:
            found = replace(found, remark=remarks[0])
        if out is not None:
            write_json(folder / "design.json", record(found))
            write_text(folder / "report.md", report(found))
            if isinstance(found, Design):
                draw(found, folder / "design.png")
            else:
                draw_race(found, folder / "design.png")
    return found


def record(found: Design | RacedDesign) -> dict[str, Any]:
    """`design.json`."""
    problem, own = found.problem, dict[str, Any]()
    if isinstance(found, Design):
        expected = {"emulator": found.expected, "cautious": found.reliability.cautious}
        values = problem.box.at(found.points)[:, len(problem.variables) :].tolist()
        names = [each.name for each in problem.uncertain]
        own["checks"] = [
            {"uncertain": dict(zip(names, row, strict=True)), "response": float(response)}
            for row, response in zip(values, found.responses, strict=True)
        ]
        own["waves"] = [each.as_json() for each in found.search.waves]
    else:
        expected = {"predicted": found.expected}
        own["checks"] = found.responses.tolist()
        own["pairs"] = {"predicted": found.pairs[0].tolist(), "mpm": found.pairs[1].tolist()}
        own |= {"predictions": found.race.spent, "designs": len(found.race.entries), "predicting": found.predicting}
    return {
        "problem": problem.name,
        "verdict": found.verdict,
        "design": found.design,
        "cost": found.price,
        "limit": {"quantity": problem.limit.quantity, "below": problem.limit.below, "unit": problem.unit},
        "probability": {
            "asked": problem.limit.probability,
            "required": problem.required,
            **expected,
            "mpm": 1.0 - found.exceeding / len(found.responses),
            "interval": found.interval,
        },
        "exceeding": found.exceeding,
        "allowed": problem.allowed,
        **own,
        "runs": found.spent,
        "seconds": found.seconds,
        "remark": found.remark or None,
    }


def summary(found: Design | RacedDesign) -> list[str]:
    """The outcome in sentences, for the terminal and the report."""
    problem, limit, checks = found.problem, found.problem.limit, len(found.responses)
    both = zip(problem.kinds, found.design.items(), strict=False)
    design = ", ".join(f"{name} = {kind.text(value)}" for kind, (name, value) in both)
    cost = f"; cost {found.price:.4g}" if problem.cost else ""
    low, high = found.interval
    if isinstance(found, Design):
        known = found.reliability
        before = (
            f"by the emulator of {100.0 * known.expected:.1f} % ({100.0 * known.cautious:.1f} % where its mean is a "
            "standard deviation too small)"
        )
        spent = f"{found.spent} runs for the emulator, {len(found.search.runs) - found.spent} of checks"
    else:
        race, share = found.race, 100.0 * found.expected
        before = (
            f"by {len(found.winner.responses)} of {race.spent} predictions, over {len(race.entries)} designs, of "
            f"{share:.1f} %; the MPM differs from predictions by {race.errors.mean():+.3g} {problem.unit} on average "
            f"and {race.errors.std():.3g} about that, which is counted"
        )
        spent = f"{found.spent} runs of the MPM; the predictions took {found.predicting:.0f} of"
    lines = [
        f"{problem.name}: {found.verdict}",
        f"design: {design}{cost}",
        f"{limit.quantity} below {limit.below:g} {problem.unit}: asked of {100.0 * limit.probability:g} % of the flows",
        before,
        f"by the MPM of {checks - found.exceeding} of {checks} fresh flows, so of {100.0 * low:.1f} to "
        f"{100.0 * high:.1f} % (95 %): {found.exceeding} exceed it where {problem.allowed} may, the largest is "
        f"{found.responses.max():.4g} {problem.unit}",
        f"{spent}{',' if isinstance(found, Design) else ''} {found.seconds:.0f} s",
    ]
    return [*lines, found.remark] if found.remark else lines


def report(found: Design | RacedDesign) -> str:
    """`report.md`: the outcome; the ranges and the waves, or the designs of the most predictions."""
    problem, (title, *lines) = found.problem, summary(found)
    if isinstance(found, Design):
        shown = "probability over the variables, responses of the check over what is uncertain"
        ranges = [{"number": each.name, "lower": each.lower, "upper": each.upper} for each in problem.numbers]
        parts = [markdown_table(ranges, disable_numparse=False)]
        keys, waves = ("runs", "probability", "cautious"), map(Reliability.as_json, found.search.waves)
        rows = [each["design"] | {key: each[key] for key in keys} for each in waves]
    else:
        shown, race = "probability of the designs; what the MPM says of the same flows as the predictions", found.race
        parts = ["## Designs of the most predictions"]
        rows = [
            problem.named(each.design)
            | {"predictions": len(each.responses), "probability": race.probability(each)}
            | ({"cost": float(problem.price(each.design))} if problem.cost else {})
            for each in sorted(race.settled, key=race.rank)
        ]
    parts = ["\n".join(f"- {line}" for line in lines), f"![{shown}](design.png)", *parts]
    return "\n\n".join([f"# {title}", *parts, markdown_table(rows, disable_numparse=False, floatfmt=".4g")]) + "\n"


def draw_race(found: RacedDesign, path: Path) -> None:
    """P of each design over its cost, and the MPM over the predictions of the same flows."""
    problem, race = found.problem, found.race
    with figure(path, rows=1, columns=2, size=(3.6, 3.2)) as axes:
        left, right = axes.flat
        prices = problem.price(np.stack([each.design for each in race.entries]))
        sizes = [4.0 + len(each.responses) / 16.0 for each in race.entries]
        left.scatter(prices, [race.probability(each) for each in race.entries], s=sizes, c=BLUE)
        left.scatter(found.price, found.expected, c=ORANGE)
        left.axhline(problem.required, color=GREY, linestyle="--")
        left.set(xlabel="cost", ylabel="probability", ylim=(0.0, 1.02))
        right.scatter(*found.pairs, s=10, c=BLUE)
        ends = [float(min(map(np.min, found.pairs))), float(max(map(np.max, found.pairs)))]
        right.plot(ends, ends, color=GREY)
        right.axhline(problem.limit.below, color=GREY, linestyle="--")
        names = f"{problem.limit.quantity} [{problem.unit}]"
        right.set(xlabel=f"predicted {names}", ylabel=f"MPM, {names}")


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
            axis.plot(problem.values(designs)[:, index], reliability.probability(designs))
            axis.axhline(limit.probability, color=GREY, linestyle="--")
            axis.axvline(found.design[name], color=ORANGE)
            axis.set(xlabel=name, ylabel="probability", ylim=(0.0, 1.02), visible=True)
        for axis, each, row in zip(axes[1], problem.uncertain, values[:, known:].T, strict=False):
            axis.scatter(row, found.responses, s=10, c=colours)
            axis.axhline(limit.below, color=GREY, linestyle="--")
            axis.set(xlabel=each.name, ylabel=f"{limit.quantity} [{problem.unit}]", visible=True)
