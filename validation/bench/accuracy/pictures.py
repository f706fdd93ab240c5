"""Pictures of error against cost, and of each scene's front over the cells."""

import math
from collections.abc import Sequence
from pathlib import Path

from validation.bench.accuracy.flows import OWN_STEP
from validation.bench.accuracy.scores import Outcome
from validation.bench.accuracy.studies import OWN_PARTICLES, Findings, own
from validation.report.plots import BLUE, GREEN, GREY, INK, ORANGE, figure

COLUMNS = 5
"""Panes in a row."""
TICKS = (0.5, 1, 2, 3, 5, 10, 20, 30, 50)
"""Of errors [%]."""


def draw_cost(path: Path, findings: Sequence[Findings]) -> None:
    """Error against particle-steps, a pane per dimension: each scene, their rms, the bound."""
    with figure(path, columns=len(findings), size=(6.2, 5.0)) as axes:
        for axis, each in zip(axes[0], findings, strict=True):
            main = [each.at(own(cells)) for cells in each.study.cells]
            steps = [outcome.particle_steps for outcome in main]
            for name in each.study.scenes:
                axis.plot(steps, [100.0 * outcome.scores[name].error for outcome in main], color=GREY, linewidth=0.5)
            axis.plot(steps, [100.0 * outcome.error for outcome in main], "o-", color=BLUE, label="rms of the scenes")
            bounds = [100.0 * each.bound(outcome.resolution) for outcome in main]
            axis.plot(steps, bounds, "s-", color=ORANGE, label="bound for nine of ten scenes")
            labels = [(f"{o.resolution.cells:g} cells", x, y) for o, x, y in zip(main, steps, bounds, strict=True)]
            for outcome in each.outcomes:
                if outcome not in main:
                    axis.plot(outcome.particle_steps, 100.0 * outcome.error, "x", color=GREEN)
                    labels.append((difference(outcome), outcome.particle_steps, 100.0 * outcome.error))
            for label, x, y in labels:
                axis.annotate(label, (x, y), xytext=(3, 4), textcoords="offset points", fontsize=7)
            axis.set(xscale="log", yscale="log", xlabel="particle-steps of a run, mean of the scenes")
            axis.set(ylabel="error over the extent", title=f"{each.study.dimension}D, grey: each scene")
            axis.set_yticks(TICKS, [f"{tick:g} %" for tick in TICKS])
            axis.minorticks_off()
            axis.legend()


def difference(outcome: Outcome) -> str:
    """What of a resolution differs from that of the reference, besides the cells."""
    what = outcome.resolution
    step = f"step {what.step_fraction:g}" if what.step_fraction != OWN_STEP else ""
    return step + (f"{what.particles_per_axis} per axis" if what.particles_per_axis != OWN_PARTICLES else "")


def draw_scenes(path: Path, findings: Sequence[Findings]) -> None:
    """Signed error of the front over the cells, a pane per scene; error bars are the scatter over the jitters."""
    panes = [(each, name) for each in findings for name in each.study.scenes]
    with figure(path, rows=math.ceil(len(panes) / COLUMNS), columns=COLUMNS, size=(3.0, 2.8)) as axes:
        for axis in axes.flat[1:]:
            axis.sharey(axes[0, 0])
        for axis in axes.flat[len(panes) :]:
            axis.set_visible(False)
        for axis, (each, name) in zip(axes.flat, panes, strict=False):
            axis.axhline(0.0, color=INK, linewidth=0.8)
            kinds = dict.fromkeys(difference(outcome) for outcome in each.outcomes)
            for kind, style in zip(kinds, ("o-", "s--", "^:"), strict=False):
                some = [outcome for outcome in each.outcomes if difference(outcome) == kind]
                scatter = [outcome.scores[name].scatter for outcome in some]
                axis.errorbar(
                    [outcome.resolution.cells for outcome in some],
                    [100.0 * outcome.scores[name].bias for outcome in some],
                    yerr=[100.0 * (0.0 if math.isnan(width) else width) for width in scatter],
                    fmt=style,
                    markersize=3.5,
                    linewidth=1.0,
                    label=kind or "usual",
                )
            axis.set(xscale="log", xlabel="cells across the smallest side", ylabel="front's error [%]")
            axis.set_xticks(each.study.cells, [f"{tick:g}" for tick in each.study.cells], fontsize=7)
            axis.minorticks_off()
            axis.set_title(f"{each.study.dimension}D: {name}", fontsize=9)
        axes[0, 0].legend()
