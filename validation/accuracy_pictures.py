"""Pictures of error against price, and of each scene's front over the cells."""

import math
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.colors import BoundaryNorm
from matplotlib.lines import Line2D

from datasets import files
from validation.scores import Outcome
from validation.studies import POINTS, STEPS, Findings, worth

MARKERS = {1: "^", 2: "o", 3: "s"}
"""By points per axis."""
SIZES = dict(zip(STEPS, (70.0, 34.0, 14.0), strict=True))
"""By step: a long step is a large mark."""
INK = "#222222"
LINES = dict(zip(STEPS, ("#1b6ca8", "#d95f02", "#7a9a01"), strict=True))


def draw_front(path: Path, findings: Sequence[Findings]) -> None:
    """Error against seconds, a panel per dimension, with the line of what is worth its price."""
    figure, axes = plt.subplots(
        1, len(findings), figsize=(6.2 * len(findings), 5.4), layout="constrained", squeeze=False
    )
    for axis, each in zip(axes[0], findings, strict=True):
        cells = sorted({outcome.resolution.cells for outcome in each.outcomes})
        between = [math.sqrt(a * b) for a, b in pairwise(cells)]
        edges = [cells[0] ** 2 / between[0], *between, cells[-1] ** 2 / between[-1]]
        norm = BoundaryNorm(edges, 256)
        for points in POINTS:
            for step in STEPS:
                some = [
                    outcome
                    for outcome in each.outcomes
                    if (outcome.resolution.particles_per_axis, outcome.resolution.step_fraction) == (points, step)
                    and outcome.resolution.precision == "f32"
                ]
                marks = axis.scatter(
                    [outcome.seconds for outcome in some],
                    [100.0 * outcome.error for outcome in some],
                    s=SIZES[step],
                    c=[outcome.resolution.cells for outcome in some],
                    marker=MARKERS[points],
                    cmap="viridis_r",
                    norm=norm,
                    edgecolors="white",
                    linewidths=0.5,
                    zorder=3,
                )
        double = [outcome for outcome in each.outcomes if outcome.resolution.precision == "f64"]
        axis.scatter(
            [outcome.seconds for outcome in double],
            [100.0 * outcome.error for outcome in double],
            s=SIZES[STEPS[0]],
            facecolors="none",
            edgecolors=INK,
            linewidths=0.8,
            zorder=2,
        )
        draw_worth(axis, worth(each.outcomes))
        bar = figure.colorbar(marks, ax=axis, ticks=cells, pad=0.02, aspect=40, spacing="uniform")
        bar.ax.minorticks_off()
        bar.ax.set_yticklabels([f"{number:g}" for number in cells])
        bar.set_label("cells across the smallest side", fontsize=8)
        bar.ax.tick_params(labelsize=7)
        axis.set_xscale("log")
        axis.set_yscale("log")
        percents = [1, 2, 3, 5, 10, 20, 30, 50]
        axis.set_yticks(percents, [f"{number} %" for number in percents])
        axis.minorticks_off()
        lowest, highest = (100.0 * pick(outcome.error for outcome in each.outcomes) for pick in (min, max))
        axis.set_ylim(lowest / 1.4, highest * 1.3)
        axis.grid(color="#e6e6e6", linewidth=0.6)
        axis.set_axisbelow(True)
        axis.spines[["top", "right"]].set_visible(False)
        axis.set_title(each.study.title, loc="left", fontsize=10)
        axis.set_xlabel("seconds of a run, one thread")
    axes[0, 0].set_ylabel("error over the reach, rms over the scenes")
    figure.legend(handles=legend(), loc="outside lower center", ncols=8, fontsize=8, frameon=False)
    with files.replacing(path) as part:
        figure.savefig(part, dpi=140)
    plt.close(figure)


def draw_worth(axis: Axes, front: Sequence[Outcome]) -> None:
    """The Pareto front as steps, the least error that can be had for a price, with the cells of each."""
    seconds = [outcome.seconds for outcome in front]
    errors = [100.0 * outcome.error for outcome in front]
    axis.step([*seconds, 3.0 * seconds[-1]], [*errors, errors[-1]], where="post", color=INK, linewidth=1.0, zorder=1)
    for outcome, x, y in zip(front, seconds, errors, strict=True):
        label = f"{outcome.resolution.cells:g}"
        axis.annotate(label, (x, y), xytext=(-5, -5), textcoords="offset points", fontsize=7, ha="right", va="top")


def legend() -> list[Line2D]:
    """What the marks mean."""

    def mark(marker: str, area: float, label: str, *, hollow: bool = False) -> Line2D:
        face = "none" if hollow else "#6b7a8f"
        edge = INK if hollow else "white"
        return Line2D([], [], ls="", marker=marker, ms=area**0.5, mfc=face, mec=edge, mew=0.8, label=label)

    return [
        *(mark(marker, 40.0, f"{points} per axis") for points, marker in MARKERS.items()),
        *(mark("o", area, f"step {step:g}") for step, area in SIZES.items()),
        mark("o", SIZES[STEPS[0]], "f64", hollow=True),
        Line2D([], [], color=INK, linewidth=1.0, label="worth its price"),
    ]


def draw_scenes(path: Path, findings: Sequence[Findings]) -> None:
    """Signed error of the front over the cells, a panel per scene; bars are the scatter over the jitter seeds."""
    panels = [(each, name) for each in findings for name in each.scenes]
    figure, axes = plt.subplots(
        1, len(panels), figsize=(3.0 * len(panels), 3.6), sharey=True, layout="constrained", squeeze=False
    )
    for axis, (each, name) in zip(axes[0], panels, strict=True):
        axis.axhline(0.0, color=INK, linewidth=0.8)
        for points, style in ((2, "o-"), (3, "s--")):
            for step in STEPS:
                some = sorted(
                    (
                        outcome
                        for outcome in each.outcomes
                        if (outcome.resolution.particles_per_axis, outcome.resolution.step_fraction) == (points, step)
                        and outcome.resolution.precision == "f32"
                    ),
                    key=lambda outcome: outcome.resolution.cells,
                )
                axis.errorbar(
                    [outcome.resolution.cells for outcome in some],
                    [100.0 * outcome.scores[name].bias for outcome in some],
                    yerr=[100.0 * outcome.scores[name].scatter for outcome in some],
                    fmt=style,
                    color=LINES[step],
                    markersize=3.5,
                    linewidth=1.0 if points == 2 else 0.7,
                    alpha=1.0 if points == 2 else 0.6,
                    elinewidth=0.8,
                    label=f"step {step:g}, {points} per axis",
                )
        axis.set_xscale("log")
        ticks = sorted({outcome.resolution.cells for outcome in each.outcomes})
        axis.set_xticks(ticks, [f"{tick:g}" for tick in ticks], fontsize=7)
        axis.minorticks_off()
        axis.grid(color="#e6e6e6", linewidth=0.6)
        axis.spines[["top", "right"]].set_visible(False)
        axis.set_title(name, loc="left", fontsize=9)
        axis.set_xlabel("cells across the smallest side", fontsize=8)
    axes[0, 0].set_ylabel("front's error over the reach [%]")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=6, fontsize=8, frameon=False)
    with files.replacing(path) as part:
        figure.savefig(part, dpi=140)
    plt.close(figure)
