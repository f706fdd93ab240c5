"""Pictures of error against cost, and of each scene's front over the cells."""

import math
from collections.abc import Sequence
from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
from matplotlib.axes import Axes

from datasets import files
from validation.bench.accuracy.flows import OWN_STEP
from validation.bench.accuracy.scores import Outcome
from validation.bench.accuracy.studies import OWN_PARTICLES, Findings, own

INK = "#222222"
LINES = ("#1b6ca8", "#d95f02", "#7a9a01", "#7570b3", "#c2408a")
STYLES = ("o-", "s--", "^:")
COLUMNS = 5
"""Panels in a row."""


def draw_cost(path: Path, findings: Sequence[Findings]) -> None:
    """Error against particle-steps, a panel per dimension: each scene, their rms, the promise."""
    figure, axes = plt.subplots(
        1, len(findings), figsize=(6.2 * len(findings), 5.0), layout="constrained", squeeze=False
    )
    for axis, each in zip(axes[0], findings, strict=True):
        main = [each.at(own(cells)) for cells in each.study.cells]
        steps = [outcome.particle_steps for outcome in main]
        for name in each.study.scenes:
            errors = [100.0 * outcome.scores[name].error for outcome in main]
            axis.plot(steps, errors, color="#b8c4d0", linewidth=0.8)
        axis.plot(steps, [100.0 * outcome.error for outcome in main], "o-", color=LINES[0], label="rms over the scenes")
        promised = [100.0 * each.promised(outcome.resolution) for outcome in main]
        axis.plot(steps, promised, "s-", color=LINES[1], label="promised: nine of ten scenes")
        for outcome, x, y in zip(main, steps, promised, strict=True):
            label = f"{outcome.resolution.cells:g} cells"
            axis.annotate(label, (x, y), xytext=(3, 4), textcoords="offset points", fontsize=7)
        others = [outcome for outcome in each.outcomes if outcome not in main]
        for outcome in others:
            what = outcome.resolution
            label = f"step {what.step_fraction:g}" if what.step_fraction != OWN_STEP else ""
            label += f"{what.particles_per_axis} per axis" if what.particles_per_axis != OWN_PARTICLES else ""
            axis.plot(outcome.particle_steps, 100.0 * outcome.error, "x", color=LINES[2])
            axis.annotate(
                label,
                (outcome.particle_steps, 100.0 * outcome.error),
                xytext=(4, -8),
                textcoords="offset points",
                fontsize=7,
            )
        percents(axis)
        axis.set_xscale("log")
        plain(axis)
        axis.set_title(f"{each.study.dimension}D, grey: each scene", loc="left", fontsize=10)
        axis.set_xlabel("particle-steps of a run, mean over the scenes")
        axis.legend(fontsize=8, frameon=False)
    axes[0, 0].set_ylabel("error over the reach")
    with files.replacing(path) as part:
        figure.savefig(part, dpi=140)
    plt.close(figure)


def draw_scenes(path: Path, findings: Sequence[Findings]) -> None:
    """Signed error of the front over the cells, a panel per scene; bars are the scatter over the jitters."""
    panels = [(each, name) for each in findings for name in each.study.scenes]
    rows = math.ceil(len(panels) / COLUMNS)
    figure, axes = plt.subplots(
        rows, COLUMNS, figsize=(3.0 * COLUMNS, 2.8 * rows), sharey=True, layout="constrained", squeeze=False
    )
    for axis in axes.flat[len(panels) :]:
        axis.set_visible(False)
    for axis, (each, name) in zip(axes.flat, panels, strict=False):
        axis.axhline(0.0, color=INK, linewidth=0.8)
        kinds = dict.fromkeys(kind_of(o) for o in each.outcomes)
        for (step, particles), style, colour in zip(kinds, STYLES, LINES, strict=False):
            some = [o for o in each.outcomes if kind_of(o) == (step, particles)]
            scatter = [o.scores[name].scatter for o in some]
            axis.errorbar(
                [o.resolution.cells for o in some],
                [100.0 * o.scores[name].bias for o in some],
                yerr=[100.0 * (0.0 if math.isnan(width) else width) for width in scatter],
                fmt=style,
                color=colour,
                markersize=3.5,
                linewidth=1.0,
                elinewidth=0.8,
                label=f"step {step:g}, {particles} per axis",
            )
        axis.set_xscale("log")
        ticks = each.study.cells
        axis.set_xticks(ticks, [f"{tick:g}" for tick in ticks], fontsize=7)
        plain(axis)
        axis.set_title(f"{each.study.dimension}D: {name}", loc="left", fontsize=9)
        axis.set_xlabel("cells across the smallest side", fontsize=8)
    axes[0, 0].set_ylabel("front's error over the reach [%]")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=6, fontsize=8, frameon=False)
    with files.replacing(path) as part:
        figure.savefig(part, dpi=120)
    plt.close(figure)


def kind_of(outcome: Outcome) -> tuple[float, int]:
    """Step and particles per axis."""
    return outcome.resolution.step_fraction, outcome.resolution.particles_per_axis


def percents(axis: Axes) -> None:
    """A logarithmic axis of per cents."""
    axis.set_yscale("log")
    ticks = [0.5, 1, 2, 3, 5, 10, 20, 30, 50]
    axis.set_yticks(ticks, [f"{number:g} %" for number in ticks])


def plain(axis: Axes) -> None:
    """No frame, a light grid."""
    axis.minorticks_off()
    axis.grid(color="#e6e6e6", linewidth=0.6)
    axis.set_axisbelow(True)
    axis.spines[["top", "right"]].set_visible(False)
