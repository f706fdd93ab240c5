"""Pictures of what was found: parameters, posterior, fields."""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from numpy.typing import NDArray

from inverse.deposits import COLOURS, WIDTH, save
from inverse.fields import FoundField
from inverse.parameters.field import LABELS
from inverse.result import Result

Floats = NDArray[np.float64]

PAIRS = 5
"""Parameters up to which every pair is drawn; of more, each by itself."""
BINS = 40
ANSWER = "tab:red"
BESIDE: dict[str, Any] = {"loc": "upper left", "bbox_to_anchor": (1.0, 1.0)}
"""A legend to the right of its panel."""


def units_of(found: Result) -> list[str]:
    """The units of the numbers, in the order of the problem."""
    return list(dict.fromkeys(kind.unit for kind in found.problem.kinds))


def draw_unknowns(path: Path, found: Result) -> None:
    """Every number side by side, a panel for each unit: start, found with its half-width, truth."""
    units, truth = units_of(found), found.target.truth
    size = (WIDTH, 0.4 + 3.2 * len(units))
    figure, grid = plt.subplots(len(units), 1, figsize=size, layout="constrained", squeeze=False)
    for unit, axis in zip(units, grid[:, 0], strict=True):
        own = [index for index, each in enumerate(found.problem.numbers) if each.kind.unit == unit]
        every, x = [found.problem.numbers[index] for index in own], np.arange(len(own))
        if truth:
            # Steps as wide as their columns: the profile of the truth over the layers.
            axis.hlines([truth[each.name] for each in every], x - 0.4, x + 0.4, color="black", label="truth")
        starts = [each.start for each in every]
        axis.plot(x - 0.2, starts, "_", color="#888888", markersize=9, markeredgewidth=1.5, label="start")
        for number, answer in enumerate(found.answers):
            label = "" if number else "found, with its half-width (95 %)"
            style = {"fmt": "o", "color": COLOURS["MPM"], "capsize": 4, "label": label}
            axis.errorbar(x + 0.1 + 0.15 * number, answer.parameters[own], yerr=answer.half_widths[own], **style)
        axis.set_xticks(x, [each.name.replace(".", "\n") for each in every])
        axis.set(xlim=(-0.6, len(own) - 0.4), ylabel=f"[{unit}]")
        axis.grid(axis="y", color="#e5e5e5")
        axis.legend(**BESIDE)
    save(figure, path)


def draw_posterior(path: Path, found: Result) -> None:
    """Prior and posterior of every number and, of a few, the samples of every pair."""
    count = len(found.problem.numbers)
    pairs = count <= PAIRS
    rows, columns = (count, count) if pairs else (-(-count // 4), 4)
    side = min(WIDTH, 3.2 * count + 1.0)
    size = (side, 0.85 * side + 0.4) if pairs else (WIDTH, 2.0 * rows + 0.4)
    figure, grid = plt.subplots(rows, columns, figsize=size, layout="constrained", squeeze=False)
    for row, column in np.ndindex(rows, columns):
        index = row if pairs else columns * row + column
        pane: Any = grid[row, column]
        if index >= count or (pairs and column > row):
            pane.axis("off")
        elif pairs and column < row:
            pair(pane, found, column, row)
        else:
            marginal(pane, found, index)
    handles, labels = grid[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(handles))
    save(figure, path)


def marginal(axis: Axes, found: Result, index: int) -> None:
    """Prior and posterior of one number."""
    assert found.posterior is not None, "an optimiser has none"
    each, truth, weights = found.problem.numbers[index], found.target.truth or {}, found.posterior.samples.weights
    style: dict[str, Any] = {"bins": BINS, "range": each.bounds, "density": True, "color": COLOURS["MPM"]}
    axis.hist(found.samples[:, index], weights=weights, label="posterior", **style)
    axis.axhline(1.0 / each.range, color="#888888", linestyle=":", linewidth=1.0, label="prior")
    for number, answer in enumerate(found.answers):
        axis.axvline(answer.parameters[index], color=ANSWER, linewidth=0.8, label="" if number else "answer")
    if each.name in truth:
        axis.axvline(truth[each.name], color="black", linestyle="--", linewidth=1.0, label="truth")
    axis.set(xlim=each.bounds, yticks=[], xlabel=f"{each.name} [{each.kind.unit}]")


def pair(axis: Axes, found: Result, first: int, second: int) -> None:
    """The samples of two numbers."""
    across, up = (found.problem.numbers[index] for index in (first, second))
    truth, samples = found.target.truth or {}, found.samples
    axis.scatter(samples[:, first], samples[:, second], s=2.0, alpha=0.3, color=COLOURS["MPM"], linewidths=0)
    for answer in found.answers:
        axis.plot(answer.parameters[first], answer.parameters[second], "x", color=ANSWER)
    if across.name in truth:
        axis.plot(truth[across.name], truth[up.name], "+", color="black", markersize=10)
    axis.set(xlim=across.bounds, ylim=up.bounds)
    axis.set(xlabel=f"{across.name} [{across.kind.unit}]", ylabel=f"{up.name} [{up.kind.unit}]")


def draw_field(path: Path, found: FoundField) -> None:
    """A field over the body, from the side, in 3D on the middle plane across z; over one axis a curve with its band."""
    grid = found.unknown.grid
    varying = [axis for axis in range(min(2, len(grid.nodes))) if grid.nodes[axis] > 1]
    label = f"{LABELS[found.unknown.settings.quantity]} [{found.unknown.unit}]"
    if len(varying) < 2:
        draw_curve(path, found, varying[0] if varying else 0, label)
        return
    arrays = found.arrays
    seen = [arrays[name][found.unknown.inside] for name in ("mean", "truth") if name in arrays]
    between = (float(np.min(seen)), float(np.max(seen)))
    panels: list[tuple[str, Floats, tuple[float, float], str]] = [
        (f"most probable: {label}", arrays["mean"], between, "viridis"),
        (f"standard deviation: {label}", arrays["deviation"], (0.0, float(arrays["prior_deviation"].max())), "magma_r"),
        ("share of the prior's variance removed [-]", arrays["removed"], (0.0, 1.0), "Greens"),
    ]
    if found.truth is not None:
        panels.insert(0, (f"truth: {label}", found.truth, between, "viridis"))
    flat = float(np.ptp(grid.axes[1]) / np.ptp(grid.axes[0]))
    height = float(np.clip(0.4 * WIDTH * flat, 0.8, 4.0)) + 0.9
    figure, axes = plt.subplots(2, 2, figsize=(WIDTH, 2.0 * height), layout="constrained")
    for axis, (title, values, limits, colours) in zip(axes.ravel(), panels, strict=False):
        pane = np.where(found.unknown.inside, values, np.nan).reshape(grid.nodes)
        pane = pane if pane.ndim == 2 else pane[:, :, grid.nodes[2] // 2]
        image = axis.pcolormesh(*grid.axes[:2], pane.T, shading="nearest", cmap=colours, vmin=limits[0], vmax=limits[1])
        figure.colorbar(image, ax=axis, shrink=0.9)
        axis.set(aspect="equal", xlabel="x [m]", ylabel="y [m]", title=title)
    for axis in axes.ravel()[len(panels) :]:
        axis.set_visible(False)
    save(figure, path)


def draw_curve(path: Path, found: FoundField, axis: int, label: str) -> None:
    """A field that varies along one axis."""
    figure, panel = plt.subplots(figsize=(0.6 * WIDTH, 3.0), layout="constrained")
    grid = found.unknown.grid
    lines = np.moveaxis(np.arange(grid.count).reshape(grid.nodes), axis, 0)
    along, first = grid.axes[axis], lines.reshape(len(lines), -1)[:, 0]
    line = {name: values[first] for name, values in found.arrays.items()}
    panel.fill_between(along, line["lower"], line["upper"], alpha=0.3, color=COLOURS["MPM"], label="95 %")
    panel.plot(along, line["mean"], color=COLOURS["MPM"], label="most probable")
    if "truth" in line:
        panel.plot(along, line["truth"], color=COLOURS["target"], label="truth")
    panel.set(xlabel=f"{'xyz'[axis]} [m]", ylabel=label)
    panel.legend()
    save(figure, path)
