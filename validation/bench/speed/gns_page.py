"""`docs/speed-gns.md` and its picture."""

from collections.abc import Mapping, Sequence
from datetime import date
from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import torch

from datasets import files
from inverse.report.markdown import table
from validation.bench.accuracy.page import paragraph
from validation.bench.speed import columns as dams
from validation.bench.speed.gns_rates import (
    BATCH,
    MOST_BYTES,
    ONCE,
    Case,
    Cost,
    Costs,
    Family,
    Kind,
    LeftOut,
    Measure,
    edges,
    ratio,
)
from validation.bench.speed.whole_second import PEERS, SCENE, Second
from validation.report.machine import GNS, machine

COLOURS = {Kind.OURS: "#1b6ca8", Kind.TEXTBOOK: "#d95f02", Kind.PAPER: "#7a9a01"}
TITLES = {
    Measure.FORWARD: "forward",
    Measure.GRADIENT: "forward and backward",
    Measure.TRAINING: f"training step of {BATCH} samples",
}
PICTURE = "speed-gns.png"

HOW = f"""
    A dam of sand at rest, {dams.ACROSS[2]} points high in 2D and {dams.ACROSS[3]} x {dams.ACROSS[3]} across in
    3D, as long as its points ask for. One step of each network on the same dam, neighbours sought anew.
    **Forward**: no gradient. **Forward and backward**: the gradient with respect to the friction, weights
    frozen, of a step in the middle of a rollout. **Training step**: {BATCH} dams (points and edges are those of
    one), the gradient of all weights, one update by Adam.
"""
TEXTBOOK = f"""
    The **textbook** is the network of Sanchez-Gonzalez et al. 2020 in plain PyTorch (`validation/bench/speed/textbook.py`):
    latents on edges, a perceptron on the concatenation of both ends and the edge, `index_add`. Here it has the
    width, the layers, the hidden layers and the radius of our model, which has its background grid on top;
    **{Kind.PAPER}** is the paper's size, with two hidden layers, on the same points. All run in one process
    under the same settings of PyTorch. Their columns are ratios to ours: "x 5" is five times as slow.
"""
SECOND = f"""
    The paper's tall column (`{SCENE}`), from rest. Ours is run through all its steps; its gradient keeps the
    activations of as many steps as half a GiB holds and computes the others again. The textbook's seconds are
    those of one step times the steps, its gradient with a checkpoint at every step, as the paper does it
    (forward, and again with the backward pass); its memory is that of one step. The last line is the paper's
    network at the paper's resolution: every point of the MPM, steps of {1000.0 * PEERS.step:g} ms, radius
    {1000.0 * PEERS.radius:g} mm.
"""


def page(families: Sequence[Family], costs: Costs, seconds: Sequence[Second], *, rounds: int, longest: float) -> str:
    """The page, from what was measured."""
    parts = [
        "# The speed of the graph network simulator",
        "",
        *paragraph(f"""
            `python -m validation.bench.speed.bench gns --rounds {rounds} --longest {longest:g}`,
            {date.today().isoformat()}, on {machine(GNS)}; {threads()}. Medians of rounds (here {rounds}) in
            which all are measured in turn, in brackets the least and the greatest; what takes more than
            {ONCE:g} s is measured once.
        """),
        f"![seconds per step over points]({PICTURE})",
        "",
        "## A whole second",
        "",
        *paragraph(SECOND),
        *second_table(seconds),
        "",
        "## Seconds per step",
        "",
        *paragraph(HOW),
        *paragraph(TEXTBOOK),
        *paragraph(f"""
            Left out is what would take more than {MOST_BYTES / 1.0e9:g} GB, and of the textbook's what would take more
            than {longest:g} s; what the next smaller size lets one expect stands in its place (~).
        """),
    ]
    for family in families:
        parts += [f"### {family.name}", "", about(family), "", *times_table(family, costs), ""]
        parts += ["Peak memory [MB] of the same above what was held before:", "", *memory_table(family, costs), ""]
    return "\n".join(parts)


def threads() -> str:
    """How many threads PyTorch uses."""
    count = torch.get_num_threads()
    return f"{count} thread{'s' if count > 1 else ''}"


def about(family: Family) -> str:
    """What the networks of a table are."""
    settings = family.settings
    sizes = ", ".join(f"{kind} {family.parameters(kind):,}" for kind in family.networks)
    return (
        f"{settings.dimension}D, {settings.width} x {settings.layers}, radius {1000.0 * settings.radius:g} mm, "
        f"steps of {1000.0 * settings.step:g} ms. Weights: {sizes}."
    )


def times_table(family: Family, costs: Costs) -> list[str]:
    """A line per size: our seconds of each measure, and the others' ratios to them."""
    head = ["points", "edges"]
    for measure in Measure:
        head += [f"{TITLES[measure]} [s]", *others(family)]
    rows = []
    for points in sizes(family, costs):
        row = [f"{points:,}", f"{edges(family.settings, points):,}"]
        for measure in Measure:
            ours = cost(family, costs, Kind.OURS, measure, points)
            row.append(ours.spread.written(4) if isinstance(ours, Cost) else ours.reason)
            for kind in others(family):
                row.append(against(cost(family, costs, kind, measure, points), ours))
        rows.append(row)
    return table(head, rows)


def memory_table(family: Family, costs: Costs) -> list[str]:
    """A line per size: megabytes of each measure and network."""
    head = ["points"]
    for measure in Measure:
        head += [f"{TITLES[measure]}: {Kind.OURS}", *others(family)]
    rows = []
    for points in sizes(family, costs):
        found = [cost(family, costs, kind, measure, points) for measure in Measure for kind in family.networks]
        rows.append([f"{points:,}", *(megabytes(each) for each in found)])
    return table(head, rows)


def second_table(seconds: Sequence[Second]) -> list[str]:
    """A line per network."""
    head = ["", "points", "steps", "forward [s]", "with gradient [s]", "peak memory [MB]"]
    rows = []
    for each in seconds:
        digits = 2 if each.run else 0
        rows.append(
            [
                each.name + ("" if each.run else " (estimated)"),
                f"{each.points:,}",
                str(each.steps),
                each.forward.written(digits),
                each.gradient.written(digits),
                "-" if each.peak is None else f"{each.peak / 1.0e6:,.0f}",
            ]
        )
    return table(head, rows)


def others(family: Family) -> list[Kind]:
    """The networks that ours is measured against."""
    return [kind for kind in family.networks if kind is not Kind.OURS]


def sizes(family: Family, costs: Costs) -> list[int]:
    """Points of the lines of a table."""
    return list(dict.fromkeys(case.points for case in costs if case.family == family.name))


def cost(family: Family, costs: Costs, kind: Kind, measure: Measure, points: int) -> Cost | LeftOut:
    """Of one cell."""
    return costs[Case(family=family.name, kind=kind, measure=measure, points=points)]


def against(theirs: Cost | LeftOut, ours: Cost | LeftOut) -> str:
    """Their seconds over ours, where both were measured."""
    if isinstance(theirs, LeftOut):
        return theirs.reason
    return f"x {ratio(theirs, ours).written(1)}" if isinstance(ours, Cost) else "-"


def megabytes(found: Cost | LeftOut) -> str:
    """The peak of a cell."""
    if isinstance(found, LeftOut):
        return found.reason
    return "-" if found.peak is None else f"{found.peak / 1.0e6:,.0f}"


def draw(path: Path, families: Sequence[Family], costs: Costs) -> None:
    """Seconds per step over points, a row per model and a panel per measure."""
    figure, axes = plt.subplots(
        len(families),
        len(Measure),
        figsize=(10.0, 3.1 * len(families)),
        layout="constrained",
        squeeze=False,
        sharey=True,
    )
    for row, family in zip(axes, families, strict=True):
        for axis, measure in zip(row, Measure, strict=True):
            for kind in family.networks:
                points, times = line(family, costs, kind, measure)
                label = f"textbook, {kind}" if kind is Kind.PAPER else str(kind)
                axis.plot(points, times, "o-", color=COLOURS[kind], markersize=4, linewidth=1.2, label=label)
            axis.set_xscale("log")
            axis.set_yscale("log")
            axis.grid(color="#e6e6e6", linewidth=0.6)
            axis.spines[["top", "right"]].set_visible(False)
            axis.set_title(f"{family.name}: {TITLES[measure]}", loc="left", fontsize=9)
        row[0].set_ylabel("seconds per step")
    for axis in axes[-1]:
        axis.set_xlabel("points")
    axes[0, 0].legend(fontsize=8, frameon=False)
    with files.replacing(path) as part:
        figure.savefig(part, dpi=130)
    plt.close(figure)


def line(
    family: Family, costs: Mapping[Case, Cost | LeftOut], kind: Kind, measure: Measure
) -> tuple[list[int], list[float]]:
    """Points and median seconds of what was measured."""
    found = [(points, cost(family, costs, kind, measure, points)) for points in sizes(family, costs)]
    known = [(points, each.spread.middle) for points, each in found if isinstance(each, Cost)]
    return [points for points, _ in known], [middle for _, middle in known]
