"""`python -m validation.bench speed-gns`: a step of the GNS beside the textbook's network, and a whole second."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import torch

from datasets.errors import InputError
from validation.bench.speed import columns
from validation.bench.speed.networks import (
    BATCH,
    LONGEST,
    MOST_BYTES,
    ONCE,
    PAPER,
    QUICK_SIZES,
    SCENE,
    SIZES,
    Costs,
    Family,
    Kind,
    Measure,
    RolloutCost,
    StepCase,
    StepCost,
    edges,
    families,
    measured,
    ratio,
    rollout_costs,
)
from validation.report.machine import GNS
from validation.report.page import Page, Row
from validation.report.plots import BLUE, GREEN, ORANGE, figure, pane

COLOURS = {Kind.OURS: BLUE, Kind.TEXTBOOK: ORANGE, Kind.PAPER: GREEN}
PICTURE = "speed-gns.png"
STEPS = f"""
    A column of sand at rest, {columns.ACROSS[2]} nodes high in 2D and {columns.ACROSS[3]} x {columns.ACROSS[3]} across
    in 3D, as long as its nodes require. One step of each network on the same column, with its neighbour search.
    **Forward**: no gradient. **Forward and backward**: the gradient with respect to the friction, weights frozen, of a
    step in the middle of a rollout. **Training step**: {BATCH} columns (nodes and edges are those of one), the gradient
    of all weights, one update by Adam.

    The **textbook** is the network of Sanchez-Gonzalez et al. 2020 in plain PyTorch
    (`validation/bench/speed/textbook.py`): latents on edges, a perceptron on the concatenation of both ends and the
    edge, `index_add`. Here it has the width, the layers, the hidden layers and the radius of our model, which has its
    background grid on top; **{Kind.PAPER}** is the paper's size, with two hidden layers, on the same nodes. All run in
    one process on one thread. Their columns are ratios to ours.
"""
SECOND = f"""
    The paper's tall column (`{SCENE}`), from rest. Ours is run through all its steps; its gradient keeps the
    activations of as many steps as half a GiB holds and computes the others again. The textbook's seconds are those of
    one step times the steps, its gradient with a checkpoint at every step, as the paper does it (forward, and again
    with the backward pass). The last line is the paper's network at the paper's
    resolution: every particle of the MPM, steps of {1000.0 * PAPER.step:g} ms, radius {1000.0 * PAPER.radius:g} mm.
"""


def bench(out: Path, *, quick: bool, keep: Path, rounds: int = 3) -> str:
    """Measure seconds of a step beside a textbook's network, over sizes; about four minutes.

    Parameters
    ----------
    out
        Folder for speed-gns.md and its picture.
    quick
        Small sizes, one round.
    keep
        Not used: times are of one run.
    rounds
        How often everything is measured, in turn; the tables give the median and the range.
    """
    if rounds < 1:
        raise InputError(f"expected at least 1, got {rounds}", key="--rounds")
    rounds = 1 if quick else rounds
    torch.set_num_threads(1)
    torch.manual_seed(0)
    models = families()
    costs = measured(models, rounds, QUICK_SIZES if quick else SIZES)
    command = f"python -m validation.bench speed-gns --rounds {rounds}"
    text = page(models, costs, rollout_costs(models, rounds), command=command, quick=quick)
    draw(out / PICTURE, models, costs)
    return text.write(out / "speed-gns.md")


def page(
    models: Sequence[Family],
    costs: Costs,
    seconds: Sequence[RolloutCost],
    *,
    command: str,
    quick: bool = False,
) -> Page:
    """The page, from what was measured."""
    text = Page(
        "The speed of the graph network simulator",
        command=command,
        conclusion=conclusion(models, costs, seconds),
        packages=GNS,
        quick=quick,
    )
    text.text(f"""
        Medians of rounds in which all are measured in turn, in brackets minimum and maximum; what takes more than
        {ONCE:g} s is measured once.
    """)
    text.picture(PICTURE, "seconds per step over nodes")
    text.section("A whole second")
    text.text(SECOND)
    text.table([rollout_row(each) for each in seconds])
    text.section("Seconds per step")
    text.text(STEPS)
    text.text(f"""
        Left out is what would take more than {MOST_BYTES / 1.0e9:g} GB, and of the textbook's what would take more than
        {LONGEST:g} s; there the cost expected from the next smaller size is given (~).
    """)
    for each in models:
        settings = each.settings
        text.section(each.name, level=3)
        weights = ", ".join(f"{kind} {each.parameters(kind):,}" for kind in each.networks)
        text.text(
            f"{settings.dimension}D, {settings.width} x {settings.layers}, radius {1000.0 * settings.radius:g} mm,"
            f" steps of {1000.0 * settings.step:g} ms. Weights: {weights}."
        )
        text.table(time_rows(each, costs))
    return text


def conclusion(models: Sequence[Family], costs: Costs, seconds: Sequence[RolloutCost]) -> list[str]:
    """A whole second, beside the paper's network; ratios of steps per model."""
    ours, paper = min((each for each in seconds if each.run), key=lambda each: each.forward.median), seconds[-1]
    found = [
        f"One second of flow takes {ours.forward.median:.2g} s with `{ours.name}`, with its gradient"
        f" {ours.gradient.median:.2g} s; {paper.name} {paper.forward.median:,.0f} s and"
        f" {paper.gradient.median:,.0f} s, extrapolated."
    ]
    for each in models[:4]:
        ratios = [
            ratio(theirs, ours).median
            for case, theirs in costs.items()
            if case.family == each.name and case.kind is Kind.TEXTBOOK
            for ours in [costs[replace(case, kind=Kind.OURS)]]
            if theirs.seconds and ours.seconds
        ]
        found.append(
            f"The textbook's network of the size of `{each.name}` takes {min(ratios):.1f} to {max(ratios):.1f} times as"
            " long per step."
        )
    return found


def rollout_row(each: RolloutCost) -> Row:
    """A whole second of a network."""
    digits = 2 if each.run else 0
    return {
        "": each.name + ("" if each.run else " (extrapolated)"),
        "nodes": f"{each.nodes:,}",
        "steps": each.steps,
        "forward [s]": each.forward.written(digits),
        "with gradient [s]": each.gradient.written(digits),
    }


def sizes(each: Family, costs: Costs) -> list[int]:
    """Nodes of the lines of a table."""
    return list(dict.fromkeys(case.nodes for case in costs if case.family == each.name))


def cost(each: Family, costs: Costs, kind: Kind, measure: Measure, nodes: int) -> StepCost:
    """Of one cell."""
    return costs[StepCase(family=each.name, kind=kind, measure=measure, nodes=nodes)]


def time_rows(each: Family, costs: Costs) -> list[Row]:
    """A line per size: our seconds of each measure, and the others' ratios to them."""
    rows: list[Row] = []
    for nodes in sizes(each, costs):
        row = {"nodes": f"{nodes:,}", "edges": f"{edges(each.settings, nodes):,}"}
        for measure in Measure:
            ours = cost(each, costs, Kind.OURS, measure, nodes)
            row[f"{measure} [s]"] = ours.left_out or ours.spread.written(4)
            for kind in each.others:
                theirs = cost(each, costs, kind, measure, nodes)
                compared = "-" if ours.left_out or theirs.left_out else f"x {ratio(theirs, ours).written(1)}"
                row[f"{measure}: {kind}"] = theirs.left_out or compared
        rows.append(row)
    return rows


def draw(path: Path, models: Sequence[Family], costs: Costs) -> None:
    """Seconds per step over nodes, a row per model and a panel per measure."""
    with figure(path, rows=len(models), columns=len(Measure), size=(3.4, 3.0)) as axes:
        for row, each in enumerate(models):
            for number, measure in enumerate(Measure):
                axis = pane(axes, row, number)
                for kind in each.networks:
                    found = {nodes: cost(each, costs, kind, measure, nodes) for nodes in sizes(each, costs)}
                    known = {nodes: one.spread.median for nodes, one in found.items() if one.seconds}
                    label = f"textbook, {kind}" if kind is Kind.PAPER else str(kind)
                    axis.plot(list(known), list(known.values()), "o-", color=COLOURS[kind], ms=4, lw=1.2, label=label)
                axis.set_xscale("log")
                axis.set_yscale("log")
                axis.set_title(f"{each.name}: {measure}")
                axis.set_xlabel("nodes")
            pane(axes, row).set_ylabel("seconds per step")
        pane(axes).legend()
