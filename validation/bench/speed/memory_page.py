"""`docs/memory.md` and its picture."""

from collections.abc import Sequence
from datetime import date
from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
from matplotlib.axes import Axes

from datasets import files
from inverse.report.markdown import table
from validation.bench.accuracy.page import paragraph
from validation.bench.speed import columns as dams
from validation.bench.speed.gradient_run import Took
from validation.report.machine import GNS, machine

PICTURE = "memory.png"
PAPER_POINTS, PAPER_STEPS, PAPER_BYTES = 20_000, 400, 16.0e9
"""Where the reference paper's gradient no longer fits (its last figure and the discussion with it)."""
BAR_BYTES = 6.0e9
"""What ours is allowed there."""
COLOURS = ("#9ecae1", "#4a90c2", "#d95f02", "#1b6ca8", "#222222", "#7a9a01")
Missing = Sequence[tuple[int, int, str]]
"""Points, steps, and why that is not there."""


def page(done: Sequence[Took], missing: Missing, *, model: str, threads: int, full: bool) -> str:
    """The page, from what was run and what was not."""
    flag = " --full" if full else ""
    plain = [each for each in done if each.kept == 0]
    parts = [
        "# Memory of a gradient through a rollout",
        "",
        *paragraph(f"""
            `python -m validation.bench.speed.bench memory{flag}`, {date.today().isoformat()}, on {machine(GNS)}; {threads}
            thread{"s" if threads > 1 else ""}. Model `{model}`: forward through a dam's flow, then the gradient
            of the last mean position with respect to the friction, weights frozen. The dam is {dams.ACROSS[2]}
            points high and as long as its points ask for. Each case is a process of its own; its memory is the
            greatest resident size above what it held before (interpreter, PyTorch, model, points). A step
            leaves only its state behind; its activations are computed again in the backward pass, so that those
            of one step are held at a time.
        """),
        f"![peak memory over points]({PICTURE})",
        "",
        *paragraph(verdict(plain)),
        "## Peak memory over points and steps",
        "",
        "In MB, and the seconds of the whole gradient in brackets.",
        "",
        *grid(plain, missing),
        "",
        *paragraph("""
            What it is made of: the activations of a step, counted by `gns.unroll.step_activation_bytes`; and what a
            further step adds, between the fewest and the most steps that were run.
        """),
        *shares(plain),
        "",
    ]
    kept = budget(done)
    if kept:
        told = "Steps whose activations stay (`kept_steps`) need not be computed again."
        parts += ["## What a memory budget buys", "", told, "", *kept, ""]
    return "\n".join(parts)


def verdict(plain: Sequence[Took]) -> str:
    """What becomes of the paper's hardest case."""
    most = f"{PAPER_BYTES / 1.0e9:g} GB at about {PAPER_POINTS:,} points, up to {PAPER_STEPS} steps"
    paper = f"The paper's code runs out of {most}"
    ours = next((each for each in plain if (each.points, each.steps) == (PAPER_POINTS, PAPER_STEPS)), None)
    if ours is None:
        return f"{paper}. That case was not run here (`--full` runs it)."
    held = "within" if ours.peak <= BAR_BYTES else "beyond"
    return f"""
        {paper}. Ours goes through {ours.points:,} points and {ours.steps} steps in {ours.seconds / 60.0:.1f} minutes
        with {gigabytes(ours.extra)} GB, {gigabytes(ours.peak)} GB the whole process:
        {held} the {BAR_BYTES / 1.0e9:g} GB that it may take.
    """


def grid(plain: Sequence[Took], missing: Missing) -> list[str]:
    """A line per number of points, a column per number of steps: megabytes and seconds."""
    found = {(each.points, each.steps): f"{megabytes(each.extra)} ({each.seconds:.0f} s)" for each in plain}
    found |= {(points, steps): reason for points, steps, reason in missing if (points, steps) not in found}
    every = sorted({points for points, _ in found}), sorted({steps for _, steps in found})
    rows = [[f"{points:,}", *(found.get((points, steps), "-") for steps in every[1])] for points in every[0]]
    return table(["points", *(f"{steps} steps" for steps in every[1])], rows)


def shares(plain: Sequence[Took]) -> list[str]:
    """Per number of points, at its most steps: what was measured and what was known."""
    rows = []
    for points in sorted({each.points for each in plain}):
        most = max((each for each in plain if each.points == points), key=lambda each: each.steps)
        least = min((each for each in plain if each.points == points), key=lambda each: each.steps)
        per_step = "-"
        if most.steps > least.steps:
            per_step = f"{(most.extra - least.extra) / (most.steps - least.steps) / 1.0e6:.2f}"
        rows.append([f"{points:,}", f"{most.activations / 1.0e6:,.0f}", megabytes(least.extra), per_step])
    return table(
        ["points", "activations of a step [MB]", "peak at the fewest steps [MB]", "each further step [MB]"], rows
    )


def budget(done: Sequence[Took]) -> list[str]:
    """Memory and seconds over the steps that are kept, for what was run with some."""
    places = {(each.points, each.steps) for each in done if each.kept}
    some = sorted(
        (each for each in done if (each.points, each.steps) in places),
        key=lambda each: (each.points, each.steps, each.kept),
    )
    head = [
        "points",
        "steps",
        "kept",
        "peak memory [MB]",
        "forward [s]",
        "backward [s]",
        "seconds over those with none kept",
    ]
    none = {(each.points, each.steps): each.seconds for each in some if not each.kept}
    rows = [
        [
            f"{each.points:,}",
            str(each.steps),
            str(each.kept),
            megabytes(each.extra),
            f"{each.forward:.1f}",
            f"{each.backward:.1f}",
            f"x {each.seconds / none[each.points, each.steps]:.2f}" if (each.points, each.steps) in none else "-",
        ]
        for each in some
    ]
    return table(head, rows) if rows else []


def megabytes(size: int) -> str:
    """Bytes as megabytes."""
    return f"{size / 1.0e6:,.0f}"


def gigabytes(size: int) -> str:
    """Bytes as gigabytes."""
    return f"{size / 1.0e9:.2f}"


def draw(path: Path, done: Sequence[Took]) -> None:
    """Peak memory over points with a line per number of steps, and what keeping activations buys."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(10.5, 4.4), layout="constrained", width_ratios=(3, 2))
    draw_points(left, [each for each in done if each.kept == 0])
    draw_kept(right, done)
    for axis in (left, right):
        axis.grid(color="#e6e6e6", linewidth=0.6)
        axis.set_axisbelow(True)
        axis.spines[["top", "right"]].set_visible(False)
    with files.replacing(path) as part:
        figure.savefig(part, dpi=130)
    plt.close(figure)


def draw_points(axis: Axes, plain: Sequence[Took]) -> None:
    """Peak memory over points."""
    for steps, colour in zip(sorted({each.steps for each in plain}), COLOURS, strict=False):
        some = sorted((each for each in plain if each.steps == steps), key=lambda each: each.points)
        axis.plot(
            [each.points for each in some],
            [each.extra / 1.0e9 for each in some],
            "o-",
            color=colour,
            markersize=4,
            linewidth=1.2,
            label=f"{steps} steps",
        )
    axis.axhline(PAPER_BYTES / 1.0e9, color="#c2408a", linewidth=0.8, linestyle="--")
    axis.plot(PAPER_POINTS, PAPER_BYTES / 1.0e9, "x", color="#c2408a", markersize=8, label="the paper's code fails")
    axis.axhline(BAR_BYTES / 1.0e9, color="#6b7a8f", linewidth=0.8, linestyle=":", label=f"{BAR_BYTES / 1.0e9:g} GB")
    axis.set_xscale("log")
    axis.set_yscale("log")
    axis.set_xlabel("points")
    axis.set_ylabel("peak memory above the start [GB]")
    axis.legend(fontsize=8, frameon=False)


def draw_kept(axis: Axes, done: Sequence[Took]) -> None:
    """Seconds over memory as more activations are kept."""
    places = sorted({(each.points, each.steps) for each in done if each.kept})
    for place in places:
        some = sorted((each for each in done if (each.points, each.steps) == place), key=lambda each: each.kept)
        axis.plot([each.extra / 1.0e9 for each in some], [each.seconds for each in some], "o-", color=COLOURS[3])
        for each in some:
            axis.annotate(
                f"{each.kept} kept",
                (each.extra / 1.0e9, each.seconds),
                xytext=(5, 5),
                textcoords="offset points",
                fontsize=8,
            )
        axis.set_title(f"{place[0]:,} points, {place[1]} steps", loc="left", fontsize=9)
    axis.set_ylim(bottom=0.0)
    axis.set_xlim(left=0.0)
    axis.set_xlabel("peak memory above the start [GB]")
    axis.set_ylabel("seconds, forward and backward")
