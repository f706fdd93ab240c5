"""Pictures of fields: truth, most probable field, width, share of the variance removed; and the observed numbers."""

from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from inverse.fields.result import FieldResult, FoundField
from inverse.fields.unknown import LABELS
from inverse.report.pictures import COLOURS, WIDTH, save

Floats = NDArray[np.float64]


def draw_field(path: Path, found: FoundField) -> None:
    """A field over the body, from the side, in 3D on the middle plane across z; over one axis a curve with its band."""
    grid, unit = found.unknown.grid, found.unknown.unit
    varying = [axis for axis in range(min(2, len(grid.nodes))) if grid.nodes[axis] > 1]
    label = f"{LABELS[found.unknown.settings.quantity]} [{unit}]"
    if len(varying) < 2:
        draw_curve(path, found, varying[0] if varying else 0, label)
        return
    shown = [values[found.unknown.inside] for values in (found.mean, found.truth) if values is not None]
    values_between = (float(np.min(shown)), float(np.max(shown)))
    panels: list[tuple[str, Floats, tuple[float, float], str]] = [
        (f"most probable: {label}", found.mean, values_between, "viridis"),
        (f"standard deviation: {label}", found.deviation, (0.0, float(found.prior_deviation.max())), "magma_r"),
        ("share of the prior's variance removed [-]", found.removed, (0.0, 1.0), "Greens"),
    ]
    if found.truth is not None:
        panels.insert(0, (f"truth: {label}", found.truth, values_between, "viridis"))
    flat = float(np.ptp(grid.axes[1]) / np.ptp(grid.axes[0]))
    height = float(np.clip(0.4 * WIDTH * flat, 0.8, 4.0)) + 0.9
    figure, axes = plt.subplots(2, 2, figsize=(WIDTH, 2.0 * height), layout="constrained")
    for axis, (title, values, limits, colours) in zip(axes.ravel(), panels, strict=False):
        paint(figure, axis, found, values, title, limits, colours)
    for axis in axes.ravel()[len(panels) :]:
        axis.set_visible(False)
    save(figure, path)


def paint(
    figure: Figure, axis: Axes, found: FoundField, values: Floats, title: str, limits: tuple[float, float], colours: str
) -> None:
    """Values [K] at the nodes beside the body."""
    grid = found.unknown.grid
    shape = grid.nodes
    pane = np.where(found.unknown.inside, values, np.nan).reshape(shape)
    if len(shape) == 3:
        pane = pane[:, :, shape[2] // 2]
    image = axis.pcolormesh(
        grid.axes[0], grid.axes[1], pane.T, shading="nearest", cmap=colours, vmin=limits[0], vmax=limits[1]
    )
    figure.colorbar(image, ax=axis, shrink=0.9)
    axis.set_title(title, loc="left", fontsize=9)
    axis.set_aspect("equal")
    axis.set_xlabel("x [m]", fontsize=8)
    axis.set_ylabel("y [m]", fontsize=8)
    axis.tick_params(labelsize=8)


def draw_curve(path: Path, found: FoundField, axis: int, label: str) -> None:
    """A field that varies along one axis."""
    figure, panel = plt.subplots(figsize=(0.6 * WIDTH, 3.0), layout="constrained")
    grid = found.unknown.grid
    lines = np.moveaxis(np.arange(grid.count).reshape(grid.nodes), axis, 0)
    first = lines.reshape(len(lines), -1)[:, 0]
    along = grid.axes[axis]
    panel.fill_between(along, found.lower[first], found.upper[first], alpha=0.3, color=COLOURS["MPM"], label="95 %")
    panel.plot(along, found.mean[first], color=COLOURS["MPM"], label="most probable")
    if found.truth is not None:
        panel.plot(along, found.truth[first], color=COLOURS["target"], label="truth")
    panel.set_xlabel(f"{'xyz'[axis]} [m]")
    panel.set_ylabel(label)
    panel.legend(fontsize=8)
    save(figure, path)


def draw_observation(path: Path, result: FieldResult) -> None:
    """Residuals of the check's run and of the mean of the search, in standard deviations of one run."""
    figure, axis = plt.subplots(figsize=(WIDTH, 2.6), layout="constrained")
    deviation, numbers = result.noise.deviation, np.arange(len(result.target.values))
    axis.axhspan(-2.0, 2.0, color="#dddddd", zorder=0)
    axis.bar(numbers, (result.predicted - result.target.values) / deviation, color=COLOURS["MPM"], alpha=0.6)
    axis.plot(numbers, (result.shown - result.target.values) / deviation, "k.", label="run with another seed")
    for part in getattr(result.target.observation, "parts", ()):
        axis.axvline(part.numbers.start - 0.5, color="#888888", linewidth=0.6)
        axis.text(part.numbers.start, axis.get_ylim()[1], part.name, fontsize=8, va="top")
    axis.set_xlabel("number")
    axis.set_ylabel("standard deviations")
    axis.legend(fontsize=8)
    save(figure, path)
