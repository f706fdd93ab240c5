"""Pictures of a result: deposits with their observations, parameters, posterior, fields."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from numpy.typing import NDArray
from shapely import get_parts

from datasets import files
from datasets.flow import measures
from datasets.geometry.ground import ground_raster
from datasets.scene import Scene
from datasets.scene.grid_field import Floats
from datasets.scene.particles import particle_volumes
from inverse.fields.posterior import FieldPosterior
from inverse.observations.deposit import Passed, Toe
from inverse.observations.outline import Boundary
from inverse.observations.profile import ProfileSettings
from inverse.parameters.field import LABELS
from inverse.residuals import NORMAL, OUTLIER, Residuals, residuals
from inverse.result import Result

Deposit = NDArray[np.floating]
COLOURS = {"target": "#222222", "surrogate": "#d95f02", "MPM": "#1b6ca8"}
"""One colour per deposit, the same in every picture."""
LINES: dict[str, Literal[":", "-", "--"]] = {"at the start": ":", "found": "-", "in truth": "--"}  # of a baffle
INKS = {"at the start": "#777777", "found": "#1b6ca8", "in truth": "#222222"}
HEIGHTS = "viridis"  # colours of the heights in a plan view
CONTOURS = 12  # approximate number of contour lines of the ground
LINE = "#b2182b"
WIDTH = 10.0  # of a picture [inches]
RESOLUTION = 100  # pixels per inch
SMALL = ("axes.labelsize", "xtick.labelsize", "ytick.labelsize", "legend.fontsize")
STYLE: dict[str, Any] = dict.fromkeys(SMALL, 8)
STYLE |= {"axes.titlesize": 9, "axes.titlelocation": "left", "legend.frameon": False}
PAIRS = 5  # largest number of parameters for which every pair is drawn; of more, each is drawn alone
BINS = 40
ANSWER = "tab:red"


@matplotlib.rc_context(STYLE)  # type: ignore[arg-type]
def write(result: Result, folder: Path) -> list[str]:
    """Write every picture of a result into `folder`, and return the names of the files."""
    figures = {"deposit.png": plot(result)}
    if len(result.problem.numbers) > 2:
        figures["unknowns.png"] = unknowns(result)
    figures |= {f"{field_posterior.stem}.png": field(field_posterior) for field_posterior in result.fields}
    if fits := residuals(result):
        figures["fit.png"] = fit(fits)
    if result.posterior is not None:
        figures["posterior.png"] = posterior(result)
    for name, figure in figures.items():
        with files.replacing(folder / name) as part:
            figure.savefig(part, dpi=RESOLUTION)
        plt.close(figure)
    return [*figures]


@matplotlib.rc_context(STYLE)  # type: ignore[arg-type]
def plot(result: Result) -> Figure:
    """Plot the deposits of the target and of the answer in separate panels, and their height profiles in one."""
    scene, scenes, target = result.problem.scene, standings(result), result.target.deposit
    lying = ({} if target is None else {"target": target}) | {result.forward: result.deposit}
    # In plan, colours are heights above the ground; from the side, the ground is drawn.
    ground = measures.ground_of(scenes["found"]) if scene.dimension == 3 else lambda plan: np.zeros(len(plan))
    shown = {name: measures.above(deposit, ground) for name, deposit in lying.items()}
    top = 1.08 * max(float(deposit[:, 1].max()) for deposit in shown.values())
    flat = (top if scene.dimension == 2 else scene.domain.size[2]) / scene.domain.size[0]
    # The height of a panel includes its title and axis labels.
    height = float(np.clip(0.85 * WIDTH * flat, 1.0, 3.4)) + 0.75
    rows = len(shown) + 1
    figure, axes = plt.subplots(rows, 1, figsize=(WIDTH, rows * height), layout="constrained")
    for axis, (name, deposit) in zip(axes, shown.items(), strict=False):
        # The baffles that this flow met are drawn filled.
        filled = "in truth" if name == "target" and "in truth" in scenes else "found"
        paint(axis, deposit, COLOURS[name], scenes, filled, top)
        surroundings(axis, result, scenes["found"])
        axis.set_title(f"{name}: {mark(axis, result, deposit, COLOURS[name])}")
    profiles(axes[-1], result, lying, scenes["found"])
    if scene.dimension == 3:
        bar = figure.colorbar(ScalarMappable(Normalize(0.0, top), HEIGHTS), ax=list(axes[:-1]), shrink=0.6, aspect=30)
        bar.set_label("height above the ground [m]")
    drawn = [axis.get_legend_handles_labels() for axis in axes[:-1]]
    if labels := {label: handle for handles, names in drawn for handle, label in zip(handles, names, strict=True)}:
        figure.legend(labels.values(), labels.keys(), loc="outside lower center", ncols=len(labels))
    figure.suptitle(f"{result.problem.name}: {result.verdict}")
    return figure


def standings(result: Result) -> dict[str, Scene]:
    """The scene with its baffles at the start of the search, as found and, if known, in truth."""
    problem, truth = result.problem, result.target.truth
    scenes = {"at the start": problem.scene_at(problem.initial), "found": problem.scene_at(result.answer)}
    if truth:
        scenes["in truth"] = problem.scene_at(np.array([truth[name] for name in problem.names]))
    # Baffles that never moved are drawn once.
    moved = any(scene.baffles != scenes["found"].baffles for scene in scenes.values())
    return scenes if moved else {"found": scenes["found"]}


def paint(axis: Axes, deposit: Deposit, colour: str, scenes: Mapping[str, Scene], filled: str, top: float) -> None:
    """Draw a deposit [m], shape [N, D], up to `top` [m], and the baffles of `scenes`; those of `filled` are filled."""
    size = scenes["found"].domain.size
    across = len(size) - 1
    if across == 1:
        dots = 12_000.0 / len(deposit)
        axis.scatter(deposit[:, 0], deposit[:, 1], s=dots, color=colour, alpha=0.8, linewidths=0, rasterized=True)
    else:
        x, y, z = deposit[np.argsort(deposit[:, 1])].T
        dots = float(np.clip(40_000.0 / len(deposit), 3.0, 14.0))
        axis.scatter(x, z, c=y, s=dots, cmap=HEIGHTS, vmin=0.0, vmax=top, linewidths=0, rasterized=True)
    for name, scene in scenes.items():
        for baffle in scene.baffles:
            box = Rectangle((baffle.lower[0], baffle.lower[across]), baffle.size[0], baffle.size[across], zorder=4)
            box.set(facecolor="#d9d9d9" if name == filled else "none", edgecolor=INKS[name], linewidth=1.3)
            box.set(linestyle=LINES[name], label=f"baffle {name}")
            axis.add_patch(box)
    axis.set(xlim=(0.0, size[0]), ylim=(0.0, top if across == 1 else size[2]), aspect="equal")
    axis.set(xlabel="x [m]", ylabel=f"{'xyz'[across]} [m]")


def surroundings(axis: Axes, result: Result, scene: Scene) -> None:
    """Draw the ground, in plan as contour lines, and the observed outlines."""
    heights = ground_raster(scene, scene.domain.cell)[0]
    axes = [scene.domain.cell * np.arange(count) for count in heights.shape]
    if np.ptp(heights) > 0.0 and scene.dimension == 2:
        axis.plot(axes[0], heights, color="#777777", linewidth=1.0)
    elif np.ptp(heights) > 0.0:
        axis.contour(*axes, heights.T, levels=CONTOURS, colors="#bbbbbb", linewidths=0.6)
    for part in result.target.observation.parts:
        if isinstance(part.observation, Boundary):
            for polygon in get_parts(part.observation.region):
                axis.plot(*polygon.exterior.xy, color=LINE, linewidth=1.5, zorder=5, label="observed outline")


def mark(axis: Axes, result: Result, deposit: Deposit, colour: str) -> str:
    """Mark the observed quantity in a picture of a deposit, and return its text."""
    observation, across = result.target.observation, deposit.shape[1] - 1
    if isinstance(observation, Passed):
        axis.axvline(observation.line, color=LINE, linestyle="--", linewidth=1.2, zorder=5, label="line")
    elif isinstance(observation, Toe):
        toe, target = observation.exact(deposit), result.target.values
        style: dict[str, Any] = {"linestyle": "", "markeredgecolor": "white", "markersize": 8, "zorder": 5}
        axis.plot(toe[0], toe[across], "o", color=colour, label="toe of this deposit", **style)
        axis.plot(target[0], target[across], "k+", markersize=13, markeredgewidth=2, zorder=6, label="target toe")
    else:
        front = measures.front(deposit, particle_volumes(result.problem.scene, len(deposit)))
        axis.axvline(front, color=colour, linewidth=0.9)
        return f"front at {front:.4f} m"
    return f"{observation.kind} {observation.text(observation.exact(deposit))}"


def profiles(axis: Axes, result: Result, shown: Mapping[str, Deposit], scene: Scene) -> None:
    """Plot the height profiles of all deposits, and the target's profile or front if it has no deposit."""
    target, domain = result.target, scene.domain
    spacing = min(2.0 * domain.cell, 0.5 * domain.size[0])
    profile = ProfileSettings(spacing=spacing).operator(scene)
    for name, deposit in shown.items():
        style = "-" if name == "target" else "--" if name == "surrogate" else "-."
        axis.plot(profile.stations, profile.heights(deposit), style, color=COLOURS[name], label=name, linewidth=1.4)
    if target.deposit is None and target.profile is not None:
        axis.plot(target.profile.x, target.profile.height, ".", color=COLOURS["target"], label="target")
    elif target.deposit is None and not math.isnan(target.front):
        axis.axvline(target.front, color=COLOURS["target"], linestyle=":", label="target's front")
    for baffle in scene.baffles:
        axis.axvspan(baffle.lower[0], baffle.lower[0] + baffle.size[0], color="#bbbbbb", alpha=0.35, linewidth=0)
    axis.set(xlim=(0.0, domain.size[0]), xlabel="x [m]", ylabel="height [m]")
    axis.set_ylim(bottom=0.0)
    axis.set_title("height profiles" if scene.dimension == 2 else "from the side: mean height over z")
    axis.legend()


def unknowns(result: Result) -> Figure:
    """Plot all unknown numbers, a panel for each unit: start, found value with its interval, truth."""
    units, truth = list(dict.fromkeys(kind.unit for kind in result.problem.kinds)), result.target.truth
    size = (WIDTH, 0.4 + 3.2 * len(units))
    figure, grid = plt.subplots(len(units), 1, figsize=size, layout="constrained", squeeze=False)
    for unit, axis in zip(units, grid[:, 0], strict=True):
        indices = [index for index, parameter in enumerate(result.problem.numbers) if parameter.kind.unit == unit]
        every, x = [result.problem.numbers[index] for index in indices], np.arange(len(indices))
        if truth:
            # Each line is as wide as its column, so that the truth forms a step profile.
            axis.hlines([truth[parameter.name] for parameter in every], x - 0.4, x + 0.4, color="black", label="truth")
        starts = [parameter.start for parameter in every]
        axis.plot(x - 0.2, starts, "_", color="#888888", markersize=9, markeredgewidth=1.5, label="start")
        for number, answer in enumerate(result.answers):
            label = "" if number else "found, with its interval (95 %)"
            style = {"fmt": "o", "color": COLOURS["MPM"], "capsize": 4, "label": label}
            value, ends = answer.parameters[indices], answer.interval[:, indices]
            wide = np.maximum([value - ends[0], ends[1] - value], 0.0)
            axis.errorbar(x + 0.1 + 0.15 * number, value, yerr=wide, **style)
        axis.set_xticks(x, [parameter.name.replace(".", "\n") for parameter in every])
        axis.set(xlim=(-0.6, len(indices) - 0.4), ylabel=f"[{unit}]")
        axis.grid(axis="y", color="#e5e5e5")
        axis.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
    return figure


def posterior(result: Result) -> Figure:
    """Plot prior and posterior of every number and, for few numbers, the samples of every pair."""
    count = len(result.problem.numbers)
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
            pair(pane, result, column, row)
        else:
            marginal(pane, result, index)
    handles, labels = grid[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(handles))
    return figure


def marginal(axis: Axes, result: Result, index: int) -> None:
    assert result.posterior is not None, "an optimiser has none"
    parameter, truth = result.problem.numbers[index], result.target.truth or {}
    weights = result.posterior.samples.weights
    style: dict[str, Any] = {"bins": BINS, "range": parameter.bounds, "density": True, "color": COLOURS["MPM"]}
    axis.hist(result.samples[:, index], weights=weights, label="posterior", **style)
    line: dict[str, Any] = {"color": "#888888", "linestyle": ":", "linewidth": 1.0, "label": "prior"}
    if parameter.prior is None:
        axis.axhline(1.0 / parameter.range, **line)
    else:
        values = np.linspace(*parameter.bounds, 201)
        axis.plot(values, np.exp(parameter.marginal.log_density(values)) / parameter.range, **line)
    for number, answer in enumerate(result.answers):
        axis.axvline(answer.parameters[index], color=ANSWER, linewidth=0.8, label="" if number else "answer")
    if parameter.name in truth:
        axis.axvline(truth[parameter.name], color="black", linestyle="--", linewidth=1.0, label="truth")
    axis.set(xlim=parameter.bounds, yticks=[], xlabel=f"{parameter.name} [{parameter.kind.unit}]")


def pair(axis: Axes, result: Result, first: int, second: int) -> None:
    across, up = (result.problem.numbers[index] for index in (first, second))
    truth, samples = result.target.truth or {}, result.samples
    axis.scatter(samples[:, first], samples[:, second], s=2.0, alpha=0.3, color=COLOURS["MPM"], linewidths=0)
    for answer in result.answers:
        axis.plot(answer.parameters[first], answer.parameters[second], "x", color=ANSWER)
    if across.name in truth:
        axis.plot(truth[across.name], truth[up.name], "+", color="black", markersize=10)
    axis.set(xlim=across.bounds, ylim=up.bounds)
    axis.set(xlabel=f"{across.name} [{across.kind.unit}]", ylabel=f"{up.name} [{up.kind.unit}]")


def fit(found: Sequence[Residuals]) -> Figure:
    """Plot a panel for each observation: numbers with noise over time or place, predicted median and band."""
    size = (WIDTH, 0.4 + 2.6 * len(found))
    figure, axes = plt.subplots(len(found), 1, figsize=size, layout="constrained", squeeze=False)
    for axis, each in zip(axes[:, 0], found, strict=True):
        label, places = each.part.observation.places
        order = np.argsort(places, kind="stable")
        at, low, middle, high = places[order], each.lower[order], each.median[order], each.upper[order]
        if len(np.unique(at)) == len(at) > 2:
            axis.fill_between(at, low, high, color=COLOURS["MPM"], alpha=0.25, linewidth=0.0, label="predicted, 95 %")
            axis.plot(at, middle, color=COLOURS["MPM"], linewidth=1.2, label="median")
        else:
            ends = np.maximum([middle - low, high - middle], 0.0)
            style: dict[str, Any] = {"fmt": "_", "color": COLOURS["MPM"], "linewidth": 5, "alpha": 0.4}
            axis.errorbar(at, middle, yerr=ends, label="predicted, 95 %", **style)
        style = {"fmt": "k.", "capsize": 3, "linewidth": 0.9, "label": "observed, noise 95 %"}
        axis.errorbar(places, each.observed, yerr=NORMAL * each.noise, **style)
        outside = np.abs(each.standardised) > OUTLIER
        axis.plot(places[outside], each.observed[outside], "o", color="tab:red", fillstyle="none", label="outlier")
        unit = each.part.observation.unit
        axis.set(xlabel=label, ylabel=f"[{unit or '-'}]", title=each.part.name)
        axis.legend(loc="best")
    return figure


def field(posterior: FieldPosterior) -> Figure:
    """Plot a field from the side, in 3D on the middle plane, or in plan; for one axis or zones, see `curve`."""
    grid, axes_of = posterior.unknown.grid, posterior.unknown.axes
    varying = [axis for axis in range(min(2, len(grid.nodes))) if grid.nodes[axis] > 1]
    label = f"{LABELS[posterior.unknown.settings.quantity]} [{posterior.unknown.unit or '-'}]"
    if len(varying) < 2:
        return curve(posterior, varying[0] if varying else 0, label)
    arrays = posterior.arrays
    seen = [arrays[name][posterior.unknown.inside] for name in ("mean", "truth") if name in arrays]
    between = (float(np.min(seen)), float(np.max(seen)))
    panels: list[tuple[str, Floats, tuple[float, float], str]] = [
        (f"most probable: {label}", arrays["mean"], between, "viridis"),
        (f"standard deviation: {label}", arrays["deviation"], (0.0, float(arrays["prior_deviation"].max())), "magma_r"),
        ("share of the prior variance removed [-]", arrays["removed"], (0.0, 1.0), "Greens"),
    ]
    if posterior.truth is not None:
        panels.insert(0, (f"truth: {label}", posterior.truth, between, "viridis"))
    flat = float(np.ptp(grid.axes[1]) / np.ptp(grid.axes[0]))
    height = float(np.clip(0.4 * WIDTH * flat, 0.8, 4.0)) + 0.9
    figure, axes = plt.subplots(2, 2, figsize=(WIDTH, 2.0 * height), layout="constrained")
    for axis, (title, values, limits, colours) in zip(axes.ravel(), panels, strict=False):
        pane = np.where(posterior.unknown.inside, values, np.nan).reshape(grid.nodes)
        pane = pane if pane.ndim == 2 else pane[:, :, grid.nodes[2] // 2]
        image = axis.pcolormesh(*grid.axes[:2], pane.T, shading="nearest", cmap=colours, vmin=limits[0], vmax=limits[1])
        figure.colorbar(image, ax=axis, shrink=0.9)
        axis.set(aspect="equal", xlabel=f"{axes_of[0]} [m]", ylabel=f"{axes_of[1]} [m]", title=title)
    for axis in axes.ravel()[len(panels) :]:
        axis.set_visible(False)
    return figure


def curve(posterior: FieldPosterior, axis: int, label: str) -> Figure:
    """Plot a field along one axis with its band, or an error bar for each zone."""
    figure, panel = plt.subplots(figsize=(0.6 * WIDTH, 3.0), layout="constrained")
    grid = posterior.unknown.grid
    lines = np.moveaxis(np.arange(grid.count).reshape(grid.nodes), axis, 0)
    along, first = grid.axes[axis], lines.reshape(len(lines), -1)[:, 0]
    line = {name: values[first] for name, values in posterior.arrays.items()}
    if (zones := posterior.unknown.zones) is not None:
        ends = np.abs(np.stack([line["lower"], line["upper"]]) - line["mean"])
        style: dict[str, Any] = {"fmt": "o", "color": COLOURS["MPM"], "capsize": 3, "label": "most probable, 95 %"}
        panel.errorbar(along, line["mean"], yerr=ends, **style)
        panel.set_xticks(along, [f"{number:g}" for number in zones.numbers])
    else:
        panel.fill_between(along, line["lower"], line["upper"], alpha=0.3, color=COLOURS["MPM"], label="95 %")
        panel.plot(along, line["mean"], color=COLOURS["MPM"], label="most probable")
    if "truth" in line:
        panel.plot(along, line["truth"], "-" if zones is None else "x", color=COLOURS["target"], label="truth")
    panel.set(xlabel=f"{posterior.unknown.axes[axis]} [m]" if zones is None else "zone", ylabel=label)
    panel.legend()
    return figure
