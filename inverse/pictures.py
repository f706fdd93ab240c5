"""Pictures of what was found: parameters, posterior, predicted deposits, the way there, fields."""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from inverse.deposits import COLOURS, WIDTH, paint, save, shown, standings
from inverse.fields import FoundField
from inverse.found import Found
from inverse.parameters.field import LABELS
from inverse.parameters.parameter import Parameter

Floats = NDArray[np.float64]

PAIRS = 5
"""Parameters up to which every pair is drawn; of more, each by itself."""
BINS = 40
FEW = 6
"""Up to so many lines have colours of their own; more of them follow a ramp."""
ANSWER = "tab:red"


def summary(found: Found) -> Figure:
    """The deposit observed and found, and the parameters with their half-widths within their bounds."""
    units, deposits = units_of(found), shown(found)
    heights = [3.0 * len(deposits), *([2.0] * len(units))]
    figure, axes = plt.subplots(
        len(deposits) + len(units), 1, figsize=(8.0, sum(heights) + 1.0), layout="constrained", squeeze=False
    )
    top = 1.08 * max(float(deposit[:, 1].max()) for deposit in deposits.values())
    for axis, (name, deposit) in zip(axes[:, 0], deposits.items(), strict=False):
        paint(axis, deposit, COLOURS[name], standings(found), "found", top)
        axis.set_title(name, loc="left", fontsize=9)
    for axis, unit in zip(axes[len(deposits) :, 0], units, strict=True):
        paint_unknowns(axis, found, unit)
    figure.suptitle(f"{found.problem.name}: {found.verdict}")
    return figure


def draw_unknowns(path: Path, found: Found) -> None:
    """Every number side by side: start, found with its half-width, truth."""
    units = units_of(found)
    size = (WIDTH, 0.4 + 3.2 * len(units))
    figure, grid = plt.subplots(len(units), 1, figsize=size, layout="constrained", squeeze=False)
    for unit, axis in zip(units, grid[:, 0], strict=True):
        paint_unknowns(axis, found, unit)
    save(figure, path)


def paint_unknowns(axis: Axes, found: Found, unit: str) -> None:
    """The numbers of one unit."""
    every = found.problem.numbers
    own = [index for index, each in enumerate(every) if each.kind.unit == unit]
    truth, x = found.target.truth, np.arange(len(own))
    if truth:
        # Steps as wide as their columns: the profile of the truth over the layers.
        true = [truth[every[index].name] for index in own]
        axis.hlines(true, x - 0.4, x + 0.4, color="black", label="truth")
    starts = [every[index].start for index in own]
    axis.plot(x - 0.2, starts, "_", color="#888888", markersize=9, markeredgewidth=1.5, label="start")
    for number, answer in enumerate(found.answers):
        widths = None if answer.half_widths is None else answer.half_widths[own]
        label = "found" if widths is None else "found, with its half-width (95 %)"
        at = x + 0.1 + 0.15 * number
        axis.errorbar(
            at,
            answer.parameters[own],
            yerr=widths,
            fmt="o",
            color=COLOURS["MPM"],
            capsize=4,
            label="" if number else label,
        )
    axis.set_xticks(x, [every[index].name.replace(".", "\n") for index in own], fontsize=8)
    axis.set_xlim(-0.6, len(own) - 0.4)
    axis.set_ylabel(f"[{unit}]")
    axis.grid(axis="y", color="#e5e5e5")
    axis.legend(fontsize=8, frameon=False, loc="upper left", bbox_to_anchor=(1.0, 1.0))


def units_of(found: Found) -> list[str]:
    """The units of the numbers, in the order of the problem."""
    return list(dict.fromkeys(kind.unit for kind in found.problem.kinds))


def draw_course(path: Path, found: Found) -> None:
    """The numbers over the evaluations of the loss or, with bands, over the runs of the MPM; true values dashed."""
    records, every, truth = found.iterations, found.problem.numbers, found.target.truth or {}
    waves = "mean" in records[0]
    x = [each["mpm_runs"] for each in records] if waves else list(range(1, len(records) + 1))
    units = units_of(found)
    rows = len(units) + (not waves)
    figure, grid = plt.subplots(
        rows, 1, figsize=(WIDTH, 0.6 + 2.7 * rows), sharex=True, layout="constrained", squeeze=False
    )
    axes = list(grid[:, 0])
    if not waves:
        losses = [max(each["loss"], 1e-14) for each in records]
        axes[0].semilogy(x, losses, ".-", color=COLOURS[found.forward], label=found.forward)
        axes[0].set_ylabel("loss")
    for each, colour in zip(every, ramp(len(every)), strict=True):
        axis = axes[units.index(each.kind.unit) + (not waves)]
        values = np.array([record["mean" if waves else "unknowns"][each.name] for record in records])
        axis.plot(x, values, ".-", color=colour, label=each.name)
        if waves:
            band = 1.96 * np.array([record["deviation"][each.name] for record in records])
            low, high = np.maximum(values - band, each.bounds[0]), np.minimum(values + band, each.bounds[1])
            axis.fill_between(x, low, high, color=colour, alpha=0.15, label="95 %" if len(every) == 1 else "")
        if each.name in truth:
            label = "truth" if len(every) == 1 else ""
            axis.axhline(truth[each.name], color=colour, linestyle="--", linewidth=1.0, alpha=0.8, label=label)
        axis.set_ylabel(f"[{each.kind.unit}]")
    axes[-1].set_xlabel("runs of the MPM" if waves else "evaluation")
    for axis in axes:
        axis.tick_params(labelsize=8)
        axis.legend(fontsize=8, frameon=False, loc="upper left", bbox_to_anchor=(1.0, 1.0))
    save(figure, path)


def ramp(count: int) -> list[tuple[float, ...]]:
    """A colour for each of `count` parameters."""
    if count <= FEW:
        return [colormaps["Dark2"](number) for number in (0, 2, 3, 4, 5, 7)[:count]]  # The surrogate's orange is not.
    return [colormaps["turbo"](0.05 + 0.9 * number / (count - 1)) for number in range(count)]


def draw_posterior(path: Path, found: Found) -> None:
    """Prior and posterior of every number, and the samples of every pair."""
    assert found.posterior is not None, "an optimiser has none"
    every, samples, weights = found.problem.numbers, found.samples, found.posterior.samples.weights
    count = len(every)
    if count > PAIRS:
        rows = -(-count // 4)
        figure, grid = plt.subplots(rows, 4, figsize=(WIDTH, 2.0 * rows + 0.4), layout="constrained")
        for axis in grid.ravel()[count:]:
            axis.axis("off")
        for index, axis in enumerate(grid.ravel()[:count]):
            marginal(axis, found, samples[:, index], weights, index)
    else:
        side = min(WIDTH, 3.2 * count + 1.0)
        figure, grid = plt.subplots(
            count, count, figsize=(side, 0.85 * side + 0.4), layout="constrained", squeeze=False
        )
        for row, column in np.ndindex(count, count):
            pane: Any = grid[row, column]
            if column > row:
                pane.axis("off")
            elif column == row:
                marginal(pane, found, samples[:, row], weights, row)
            else:
                pair(pane, found, samples[:, [column, row]], (column, row))
    handles, labels = grid.ravel()[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(handles), fontsize=8, frameon=False)
    save(figure, path)


def marginal(axis: Axes, found: Found, samples: Floats, weights: Floats, index: int) -> None:
    """Prior and posterior of one number, samples and weights [S]."""
    each, truth = found.problem.numbers[index], found.target.truth or {}
    colour = COLOURS["MPM"]
    axis.hist(samples, bins=BINS, range=each.bounds, weights=weights, density=True, color=colour, label="posterior")
    axis.axhline(1.0 / each.range, color="#888888", linestyle=":", linewidth=1.0, label="prior")
    for number, answer in enumerate(found.answers):
        label = "" if number else "answer"
        axis.axvline(answer.parameters[index], color=ANSWER, linewidth=0.8, label=label)
    if each.name in truth:
        axis.axvline(truth[each.name], color="black", linestyle="--", linewidth=1.0, label="truth")
    axis.set_xlim(*each.bounds)
    axis.set_yticks([])
    axis.set_xlabel(f"{each.name} [{each.kind.unit}]", fontsize=8)
    axis.tick_params(labelsize=8)


def pair(axis: Axes, found: Found, samples: Floats, which: tuple[int, int]) -> None:
    """The samples [S, 2] of two numbers."""
    across, up = (found.problem.numbers[index] for index in which)
    truth = found.target.truth or {}
    axis.scatter(samples[:, 0], samples[:, 1], s=2.0, alpha=0.3, color=COLOURS["MPM"], linewidths=0)
    for answer in found.answers:
        axis.plot(answer.parameters[which[0]], answer.parameters[which[1]], "x", color=ANSWER)
    if across.name in truth:
        axis.plot(truth[across.name], truth[up.name], "+", color="black", markersize=10)
    axis.set(xlim=across.bounds, ylim=up.bounds)
    axis.set_xlabel(name_of(across), fontsize=8)
    axis.set_ylabel(name_of(up), fontsize=8)
    axis.tick_params(labelsize=8)


def name_of(parameter: Parameter) -> str:
    """Of an axis."""
    return f"{parameter.name} [{parameter.kind.unit}]"


def draw_field(path: Path, found: FoundField) -> None:
    """A field over the body, from the side, in 3D on the middle plane across z; over one axis a curve with its band."""
    grid = found.unknown.grid
    varying = [axis for axis in range(min(2, len(grid.nodes))) if grid.nodes[axis] > 1]
    label = f"{LABELS[found.unknown.settings.quantity]} [{found.unknown.unit}]"
    if len(varying) < 2:
        draw_curve(path, found, varying[0] if varying else 0, label)
        return
    seen = [values[found.unknown.inside] for values in (found.mean, found.truth) if values is not None]
    between = (float(np.min(seen)), float(np.max(seen)))
    panels: list[tuple[str, Floats, tuple[float, float], str]] = [
        (f"most probable: {label}", found.mean, between, "viridis"),
        (f"standard deviation: {label}", found.deviation, (0.0, float(found.prior_deviation.max())), "magma_r"),
        ("share of the prior's variance removed [-]", found.removed, (0.0, 1.0), "Greens"),
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
        axis.set_title(title, loc="left", fontsize=9)
        axis.set(aspect="equal", xlabel="x [m]", ylabel="y [m]")
    for axis in axes.ravel()[len(panels) :]:
        axis.set_visible(False)
    save(figure, path)


def draw_curve(path: Path, found: FoundField, axis: int, label: str) -> None:
    """A field that varies along one axis."""
    figure, panel = plt.subplots(figsize=(0.6 * WIDTH, 3.0), layout="constrained")
    grid = found.unknown.grid
    lines = np.moveaxis(np.arange(grid.count).reshape(grid.nodes), axis, 0)
    first, along = lines.reshape(len(lines), -1)[:, 0], grid.axes[axis]
    panel.fill_between(along, found.lower[first], found.upper[first], alpha=0.3, color=COLOURS["MPM"], label="95 %")
    panel.plot(along, found.mean[first], color=COLOURS["MPM"], label="most probable")
    if found.truth is not None:
        panel.plot(along, found.truth[first], color=COLOURS["target"], label="truth")
    panel.set(xlabel=f"{'xyz'[axis]} [m]", ylabel=label)
    panel.legend(fontsize=8)
    save(figure, path)


def draw_residuals(path: Path, found: Found) -> None:
    """What is shown at the answer less the target, of several observations, in standard deviations."""
    figure, axis = plt.subplots(figsize=(WIDTH, 2.6), layout="constrained")
    residual = found.predicted - found.target.values
    axis.axhspan(-2.0, 2.0, color="#dddddd", zorder=0, label="two standard deviations")
    axis.plot(
        np.arange(len(residual)), residual, ".", color=COLOURS[found.forward], label=f"{found.forward} less target"
    )
    for part in getattr(found.target.observation, "parts", ()):
        axis.axvline(part.numbers.start - 0.5, color="#888888", linewidth=0.6)
        axis.text(part.numbers.start, axis.get_ylim()[1], part.name, fontsize=8, va="top")
    axis.set(xlabel="number", ylabel="standard deviations", xlim=(-0.5, len(residual) - 0.5))
    axis.legend(fontsize=8)
    save(figure, path)
