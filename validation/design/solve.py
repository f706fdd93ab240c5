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
from mpm.output.outcome import still_moves
from validation.design.predictor import predictor
from validation.design.problem import DesignProblem, read_design
from validation.design.race import RacedDesign, raced
from validation.design.reliability import Reliability
from validation.design.search import Design, designed
from validation.plots import BLUE, GREY, ORANGE, figure
from validation.run_store import RunStore, caveats, kept

STATIONS = 25  # points along each variable in the picture


def find_design(
    problem: DesignProblem | str | Path, out: Path | str | None = None, *, simulate: Simulate = simulate_many
) -> Design | RacedDesign:
    """Find the cheapest design that keeps the limit with the given probability, checked by the MPM.

    >>> from validation import find_design
    >>> found = find_design("two-barriers", "out/design")
    >>> print(found.verdict, found.design, found.exceeding, found.interval)

    problem: one built in Python, the path of a TOML file or a shipped name. out: folder for `design.json`, `report.md`,
    a picture and every flow; an interrupted call resumes there. Without it nothing is written. simulate: replaces the
    MPM. Raises InputError, and WorkFailed if an MPM run blows up or another process writes into `out`.
    """
    asked = problem if isinstance(problem, DesignProblem) else read_design(problem)
    limit = asked.limit
    with kept(out) as folder:
        store = RunStore(folder / "mpm" / limit.folder, simulate, label="design-", reduce=limit.kept)
        flows = list[Trajectory]()

        def respond(points: Matrix, first: int) -> Row:
            flows[:] = store(asked.scenes_at(points, first), record=ALL if limit.force else LAST)
            return np.array([flow.summary[limit.quantity] for flow in flows])

        if asked.surrogate == "none":
            outcome: Design | RacedDesign = designed(asked, respond)
        else:
            outcome = raced(asked, predictor(asked, simulate), respond)
        # The last flows are those of the check.
        remarks = caveats(flows)
        # The remarks are on deposits, on which a force does not depend.
        if remarks and not limit.force:
            moving = [still_moves(flow.summary) and flow.summary[limit.quantity] < limit.below for flow in flows]
            outcome = replace(outcome, remark=remarks[0], moving=sum(moving))
        if out is not None:
            write_json(folder / "design.json", record(outcome))
            write_text(folder / "report.md", report(outcome))
            if isinstance(outcome, Design):
                draw(outcome, folder / "design.png")
            else:
                draw_race(outcome, folder / "design.png")
    return outcome


def record(outcome: Design | RacedDesign) -> dict[str, Any]:
    """`design.json`."""
    problem, extra = outcome.problem, dict[str, Any]()
    if isinstance(outcome, Design):
        expected = {"emulator": outcome.expected, "cautious": outcome.reliability.cautious}
        values = problem.box.at(outcome.points)[:, len(problem.variables) :].tolist()
        names = [number.name for number in problem.uncertain]
        extra["checks"] = [
            {"uncertain": dict(zip(names, row, strict=True)), "response": float(response)}
            for row, response in zip(values, outcome.responses, strict=True)
        ]
        extra["waves"] = [wave.as_json() for wave in outcome.search.waves]
    else:
        expected, race = {"predicted": outcome.expected}, outcome.race
        extra["checks"] = outcome.responses.tolist()
        extra["pairs"] = {"predicted": outcome.pairs[0].tolist(), "mpm": outcome.pairs[1].tolist()}
        extra |= {"predictions": race.spent, "designs": len(race.entries), "predicting": outcome.predicting}
    return {
        "problem": problem.name,
        "verdict": outcome.verdict,
        "design": outcome.design,
        "cost": outcome.price,
        "limit": {"quantity": problem.limit.quantity, "below": problem.limit.below, "unit": problem.unit},
        "probability": {
            "asked": problem.limit.probability,
            "required": problem.required,
            **expected,
            "mpm": 1.0 - outcome.exceeding / len(outcome.responses),
            "interval": outcome.interval,
        },
        "exceeding": outcome.exceeding,
        "moving": outcome.moving,
        "allowed": problem.allowed,
        **extra,
        "runs": outcome.spent,
        "seconds": outcome.seconds,
        "remark": outcome.remark or None,
    }


def summary(outcome: Design | RacedDesign) -> list[str]:
    """The outcome in sentences, for the terminal and the report."""
    problem, limit, checks = outcome.problem, outcome.problem.limit, len(outcome.responses)
    both = zip(problem.kinds, outcome.design.items(), strict=False)
    design = ", ".join(f"{name} = {kind.text(value)}" for kind, (name, value) in both)
    cost = f"; cost {outcome.price:.4g}" if problem.cost else ""
    low, high = outcome.interval
    on_map = problem.scene.domain.origin is not None and not limit.force
    if isinstance(outcome, Design):
        model = outcome.reliability
        before = (
            f"kept in {100.0 * model.expected:.1f} % of flows by the emulator ({100.0 * model.cautious:.1f} % if its "
            "mean is a standard deviation too small)"
        )
        spent = f"{outcome.spent} runs for the emulator, {len(outcome.search.runs) - outcome.spent} for checks"
    else:
        race, share = outcome.race, 100.0 * outcome.expected
        before = (
            f"kept in {share:.1f} % of flows by {len(outcome.winner.responses)} of {race.spent} predictions over "
            f"{len(race.entries)} designs; this includes the error of predictions against the MPM, on average "
            f"{race.errors.mean():+.3g} {problem.unit} with a standard deviation of {race.errors.std():.3g}"
        )
        spent = f"{outcome.spent} runs of the MPM; the predictions took {outcome.predicting:.0f} of"
    lines = [
        f"{problem.name}: {outcome.verdict}",
        f"design: {design}{cost}",
        f"{limit.quantity} below {limit.below:.10g} {problem.unit}: limit for {100.0 * limit.probability:g} % of flows",
        before,
        f"kept in {checks - outcome.exceeding} of {checks} new MPM flows, so in {100.0 * low:.1f} to "
        f"{100.0 * high:.1f} % of flows (95 %): {outcome.exceeding} exceed it where {problem.allowed} may, the largest "
        f"is {outcome.responses.max():{'.1f' if on_map else '.4g'}} {problem.unit}",
        f"{spent}{',' if isinstance(outcome, Design) else ''} {outcome.seconds:.0f} s",
    ]
    if outcome.moving:
        lines.append(f"{outcome.moving} of these flows still move and may yet exceed it: choose a longer duration")
    return [*lines, *problem.remarks, *filter(None, [outcome.remark])]


def report(outcome: Design | RacedDesign) -> str:
    """`report.md`: the outcome; the ranges and the waves, or the designs of the most predictions."""
    problem, (title, *lines) = outcome.problem, summary(outcome)
    if isinstance(outcome, Design):
        shown = "probability over the variables, responses of the check over what is uncertain"
        ranges = [{"number": number.name, "lower": number.lower, "upper": number.upper} for number in problem.numbers]
        parts = [markdown_table(ranges, disable_numparse=False)]
        keys, waves = ("runs", "probability", "cautious"), map(Reliability.as_json, outcome.search.waves)
        rows = [wave["design"] | {key: wave[key] for key in keys} for wave in waves]
    else:
        shown, race = "probability of the designs; what the MPM says of the same flows as the predictions", outcome.race
        parts = ["## Designs of the most predictions"]
        rows = [
            problem.named(entry.design)
            | {"predictions": len(entry.responses), "probability": race.probability(entry)}
            | ({"cost": float(problem.price(entry.design))} if problem.cost else {})
            for entry in sorted(race.settled, key=race.rank)
        ]
    parts = ["\n".join(f"- {line}" for line in lines), f"![{shown}](design.png)", *parts]
    return "\n\n".join([f"# {title}", *parts, markdown_table(rows, disable_numparse=False, floatfmt=".4g")]) + "\n"


def draw_race(outcome: RacedDesign, path: Path) -> None:
    """Plot P of each design over its cost, and the MPM's responses over the predictions of the same flows."""
    problem, race = outcome.problem, outcome.race
    with figure(path, rows=1, columns=2, size=(3.6, 3.2)) as axes:
        left, right = axes.flat
        prices = problem.price(np.stack([entry.design for entry in race.entries]))
        sizes = [4.0 + len(entry.responses) / 16.0 for entry in race.entries]
        left.scatter(prices, [race.probability(entry) for entry in race.entries], s=sizes, c=BLUE)
        left.scatter(outcome.price, outcome.expected, c=ORANGE)
        left.axhline(problem.required, color=GREY, linestyle="--")
        left.set(xlabel="cost", ylabel="probability", ylim=(0.0, 1.02))
        right.scatter(*outcome.pairs, s=10, c=BLUE)
        ends = [float(min(map(np.min, outcome.pairs))), float(max(map(np.max, outcome.pairs)))]
        right.plot(ends, ends, color=GREY)
        right.axhline(problem.limit.below, color=GREY, linestyle="--")
        names = f"{problem.limit.quantity} [{problem.unit}]"
        right.set(xlabel=f"predicted {names}", ylabel=f"MPM, {names}")


def draw(outcome: Design, path: Path) -> None:
    """Plot P along each variable through the design, and the check's responses over the uncertain numbers."""
    problem, reliability, count = outcome.problem, outcome.reliability, len(outcome.problem.variables)
    values, limit = problem.box.at(outcome.points), problem.limit
    colours = np.where(outcome.responses >= limit.below, ORANGE, BLUE)
    with figure(path, rows=2, columns=max(count, len(problem.uncertain)), size=(3.2, 3.0)) as axes:
        for axis in axes.flat:
            axis.set_visible(False)
        for index, (axis, name) in enumerate(zip(axes[0], outcome.design, strict=False)):
            designs = np.tile(reliability.best, (STATIONS, 1))
            designs[:, index] = np.linspace(0.0, 1.0, STATIONS)
            axis.plot(problem.values(designs)[:, index], reliability.probability(designs))
            axis.axhline(limit.probability, color=GREY, linestyle="--")
            axis.axvline(outcome.design[name], color=ORANGE)
            axis.set(xlabel=name, ylabel="probability", ylim=(0.0, 1.02), visible=True)
        for axis, number, row in zip(axes[1], problem.uncertain, values[:, count:].T, strict=False):
            axis.scatter(row, outcome.responses, s=10, c=colours)
            axis.axhline(limit.below, color=GREY, linestyle="--")
            axis.set(xlabel=number.name, ylabel=f"{limit.quantity} [{problem.unit}]", visible=True)
