"""Pictures: loss over seconds for each problem, seconds over unknowns, seconds and memory over points."""

from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from datasets import files
from validation.bench.efficiency.crossing import costs_over_points, crossing, seconds_over_unknowns
from validation.bench.efficiency.cuts import AD, FD_GNS, FD_MPM
from validation.bench.efficiency.rows import OverPoints, OverUnknowns, Race

COLOURS = {AD: "#1b6ca8", FD_GNS: "#7a9a01", FD_MPM: "#d95f02"}
RACERS = ("#1b6ca8", "#d95f02", "#7a9a01", "#c2408a", "#6b7a8f", "#222222", "#b8860b", "#4fb3bf")
MARKERS = "os^Dv*PX"
STYLES = {1: "-", 10: "--"}
"""By number of unknowns."""


def draw_race(path: Path, race: Race) -> None:
    """What the MPM shows of each method's best answer, over the seconds that it took."""
    figure, axis = plt.subplots(figsize=(8.2, 4.6), layout="constrained")
    for place, row in enumerate(race.rows):
        seconds = [each.seconds for each in row.curve]
        # An answer stays until there is a better one, or the search ends.
        ends = [*seconds, max(row.seconds, seconds[-1])]
        losses = [each.loss for each in row.curve]
        colour = RACERS[place % len(RACERS)]
        axis.plot(ends, [*losses, losses[-1]], drawstyle="steps-post", color=colour, linewidth=1.2)
        marker = MARKERS[place % len(MARKERS)]
        axis.plot(seconds, losses, marker, color=colour, markersize=5, label=row.method)
    if race.floor:
        axis.axhline(race.floor, color="#222222", linewidth=0.8, linestyle=":", label="the truth itself")
    axis.set_xlabel("seconds")
    axis.set_ylabel("loss that the MPM shows at the answer")
    axis.set_title(race.problem, loc="left", fontsize=10)
    finish(figure, axis, path)


def draw_unknowns(path: Path, over: OverUnknowns) -> None:
    """Seconds per gradient over the unknowns; a ring where they were multiplied, a cross where AD gets cheaper."""
    figure, axis = plt.subplots(figsize=(7.2, 4.6), layout="constrained")
    curves = {method: seconds_over_unknowns(over.gradients, method) for method in COLOURS}
    multiplied = {(each.method, each.unknowns) for each in over.gradients if each.multiplied}
    for method, curve in curves.items():
        axis.plot(*zip(*curve, strict=True), "-", color=COLOURS[method], linewidth=1.2, label=method)
        for unknowns, seconds in curve:
            hollow = (method, unknowns) in multiplied
            axis.plot(unknowns, seconds, "o", color=COLOURS[method], mfc="none" if hollow else COLOURS[method])
    for other in (FD_GNS, FD_MPM):
        found = crossing(curves[AD], curves[other])
        if not found.never and not found.everywhere:
            mark(axis, found.first, curves[AD], f"{found.first:.2g} unknowns", above=other == FD_GNS)
    axis.set_xlabel("unknowns")
    axis.set_ylabel("seconds per gradient")
    finish(figure, axis, path)


def draw_points(path: Path, over: OverPoints) -> None:
    """Seconds and memory of a gradient over the points, with one unknown and with ten."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(11.0, 4.6), layout="constrained")
    for unknowns in sorted({each.unknowns for each in over.costs}):
        style = STYLES.get(unknowns, ":")
        curves = {}
        for method, colour in COLOURS.items():
            curve = costs_over_points(over.costs, method, unknowns)
            points = [number for number, _ in curve]
            label = f"{method}, {unknowns} unknown{'s' if unknowns > 1 else ''}"
            curves[method] = [(number, cost.seconds) for number, cost in curve]
            left.plot(points, [cost.seconds for _, cost in curve], style, color=colour, linewidth=1.2, label=label)
            right.plot(points, [cost.memory / 1.0e9 for _, cost in curve], style, color=colour, linewidth=1.2)
            for number, cost in curve:
                fill = "none" if cost.measured else colour
                left.plot(number, cost.seconds, "o", color=colour, mfc=fill, markersize=5)
                right.plot(number, cost.memory / 1.0e9, "o", color=colour, mfc=fill, markersize=5)
        for one, other in ((AD, FD_MPM), (FD_MPM, AD), (AD, FD_GNS), (FD_GNS, AD)):
            found = crossing(curves[one], curves[other])
            if not found.never and not found.everywhere:
                mark(left, found.first, curves[one], f"{found.first:,.2g} points")
    right.set_xlabel("points")
    right.set_ylabel("peak memory above the start [GB]")
    right.set_xscale("log")
    right.set_yscale("log")
    plain(right)
    left.set_xlabel("points")
    left.set_ylabel("seconds per gradient")
    finish(figure, left, path)


def mark(axis: Axes, number: float, curve: list[tuple[float, float]], text: str, *, above: bool = False) -> None:
    """A cross on a curve, straight between its points on logarithmic axes, and `text` below it or above."""
    x, y = np.log(np.array(curve)).T
    height = float(np.exp(np.interp(np.log(number), x, y)))
    axis.plot(number, height, "x", color="#222222", markersize=9, zorder=5)
    shift, side = ((-7, 14), "right") if above else ((7, -12), "left")
    axis.annotate(text, (number, height), xytext=shift, textcoords="offset points", fontsize=8, ha=side)


def finish(figure: Figure, axis: Axes, path: Path) -> None:
    """Logarithmic axes, a legend, and the file."""
    axis.set_xscale("log")
    axis.set_yscale("log")
    axis.legend(fontsize=7.5, frameon=False)
    plain(axis)
    with files.replacing(path) as part:
        figure.savefig(part, dpi=130)
    plt.close(figure)


def plain(axis: Axes) -> None:
    """A light grid and two spines."""
    axis.grid(color="#e6e6e6", linewidth=0.6)
    axis.set_axisbelow(True)
    axis.spines[["top", "right"]].set_visible(False)
