"""Pictures: front errors, profiles and energies of 2D flows; deposits from above and series over time in 3D."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Rectangle
from numpy.typing import NDArray

from datasets import measures
from datasets.scene import Scene
from datasets.trajectory import Floats
from gns.initial import Start
from gns.score import SPACING
from validation.bench.surrogate.comparison import Comparison, FlowSeries, Series, by_variant
from validation.bench.surrogate.page import COLUMN_CRITERIA, Columns, Scenes, joined
from validation.bench.surrogate.scenes import TRAINED
from validation.report.plots import BLUE, GREEN, GREY, INK, LIGHT_BLUE, ORANGE, figure, pane

COLOURS = (ORANGE, GREEN, GREY)
"""By model."""
STYLES = {Start.FROM_REST: "--", Start.FROM_MPM_FRAMES: "-"}
PIXEL = 0.05
"""Edge of a cell of the map of depths [m], so that a few nodes of the surrogate are in one."""


def colours(comparisons: Sequence[Comparison]) -> dict[str, str]:
    """A colour per model."""
    names = list(dict.fromkeys(each.model for each in comparisons))
    return {name: COLOURS[index % len(COLOURS)] for index, name in enumerate(names)}


def draw_fronts(path: Path, found: Columns) -> None:
    """Front error over the angle of friction, a panel per aspect ratio; the MPM's scatter as a band, the criteria."""
    shades, aspects = colours(joined(found.values())), list(dict.fromkeys(column.aspect for column in found))
    with figure(path, columns=len(aspects), size=(2.8, 3.4)) as axes:
        for number, aspect in enumerate(aspects):
            axis = pane(axes, 0, number)
            columns = sorted((each for each in found if each.aspect == aspect), key=lambda each: each.friction_deg)
            angles = [each.friction_deg for each in columns]
            scatter = 100.0 * np.array([found[each][0].scatter for each in columns])
            axis.fill_between(angles, -scatter, scatter, color=LIGHT_BLUE, linewidth=0, label="MPM's scatter")
            for low, high, trained in ((10, TRAINED[0], False), (*TRAINED, True), (TRAINED[1], 50, False)):
                for sign in (-1.0, 1.0):
                    axis.plot([low, high], [100.0 * sign * COLUMN_CRITERIA[trained]] * 2, ":", color=INK, linewidth=0.9)
            for index, (model, start) in enumerate(by_variant(found[columns[0]])):
                errors = [100.0 * found[each][index].front_error for each in columns]
                axis.plot(
                    angles, errors, STYLES[start] + "o", ms=3, color=shades[model], label=f"{model}, {start}", lw=1.1
                )
            axis.axhline(0.0, color=INK, linewidth=0.7)
            axis.set_title(f"height / length {aspect:g}")
            axis.set_xlabel("angle of friction [°]")
        pane(axes).set_ylabel("front error, all particles [%]")
        pane(axes, 0, len(aspects) - 1).legend(fontsize=6)


def draw_profiles(path: Path, found: Scenes) -> None:
    """Height profiles of deposits by name, the MPM's filled."""
    shades, across = colours(joined(found.values())), min(2, len(found))
    with figure(path, rows=-(-len(found) // across), columns=across, size=(5.0, 2.4)) as axes:
        for axis, (name, group) in zip(axes.flat, found.items(), strict=False):
            stations = measures.profile_stations(group[0].scene, SPACING)
            axis.fill_between(stations, 100.0 * group[0].mpm.profile, color=LIGHT_BLUE, linewidth=0, label="MPM")
            axis.axvline(group[0].front, color=BLUE, linewidth=0.8, label="MPM's front")
            for each in group:
                line(axis, stations, 100.0 * each.surrogate.profile, each, shades)
            axis.set_title(name)
            axis.set_xlabel("x [m]")
            axis.set_ylabel("height [cm]")
        pane(axes).legend()


def draw_energies(path: Path, found: Scenes) -> None:
    """Kinetic (above) and potential energy (below) over time, a column of panels per scene."""
    with figure(path, rows=2, columns=len(found), size=(3.4, 2.3)) as axes:
        for column, (name, group) in enumerate(found.items()):
            draw_series(pane(axes, 0, column), group, f"{name}: kinetic energy [%]")
            draw_series(pane(axes, 1, column), group, f"{name}: potential energy [%]")
        pane(axes).legend()


def draw_times(path: Path, found: Scenes) -> None:
    """Front, upstream depth and both energies over time, a row per scene."""
    with figure(path, rows=len(found), columns=len(SERIES), size=(3.2, 2.5)) as axes:
        for row, (name, group) in enumerate(found.items()):
            for column, what in enumerate(SERIES):
                draw_series(pane(axes, row, column), group, f"{name}: {what}")
        pane(axes).legend()


SERIES: dict[str, Callable[[FlowSeries], Series]] = {
    "front [m]": lambda flow: flow.front,
    "upstream depth [cm]": lambda flow: 100.0 * flow.depth,
    "kinetic energy [%]": lambda flow: 100.0 * flow.kinetic,
    "potential energy [%]": lambda flow: 100.0 * flow.potential,
}


def draw_series(axis: Axes, group: Sequence[Comparison], title: str) -> None:
    """One series of the rollouts and of the MPM, named at the end of the title."""
    name = title.split(": ")[-1]
    shades = colours(group)

    def over_time(flow: FlowSeries, step: float) -> tuple[Series, Series]:
        values = SERIES[name](flow)
        # A mean over a step belongs to its middle.
        times: Series = step * (np.arange(len(values), dtype=np.float64) + 0.5 * (len(values) < len(flow.front)))
        return times, values

    axis.plot(*over_time(group[0].mpm, group[0].step), color=BLUE, linewidth=2.2, alpha=0.5, label="MPM")
    for each in group:
        line(axis, *over_time(each.surrogate, each.step), each, shades)
    axis.set_title(title)
    axis.set_xlabel("time [s]")


def line(axis: Axes, x: Series, y: Series, each: Comparison, shades: Mapping[str, str]) -> None:
    """A line in the colour of the model and the style of the start."""
    axis.plot(x, y, STYLES[each.start], color=shades[each.model], linewidth=1.0, label=f"{each.model}, {each.start}")


def draw_maps(path: Path, found: Scenes) -> None:
    """Depth of the deposits from above, the MPM's and each model's from rest, same particles; a row per scene."""
    rest = {name: [each for each in group if each.start is Start.FROM_REST] for name, group in found.items()}
    with figure(path, rows=len(rest), columns=1 + max(map(len, rest.values())), size=(4.2, 2.9)) as axes:
        for row, (name, group) in enumerate(rest.items()):
            flows = [(f"{name}, MPM", group[0], group[0].mpm)]
            flows += [(f"{name}, {each.model}, {each.start}", each, each.surrogate) for each in group]
            top = 100.0 * float(depth_map(group[0].mpm.deposit, group[0].volume, group[0].scene).max())
            for column, (title, each, flow) in enumerate(flows):
                axis = pane(axes, row, column)
                length, _, width = each.scene.domain.size
                depths = 100.0 * depth_map(flow.deposit, each.volume, each.scene).T
                shown = np.ma.masked_equal(depths, 0.0)
                box = (0.0, length, 0.0, width)
                image = axis.imshow(shown, origin="lower", extent=box, vmin=0.0, vmax=top, cmap="viridis")
                for baffle in each.scene.baffles:
                    corner, size = (baffle.lower[0], baffle.lower[2]), (baffle.size[0], baffle.size[2])
                    axis.add_patch(Rectangle(corner, *size, facecolor=GREY, edgecolor=INK, zorder=3))
                axis.axvline(flow.front[-1], color=ORANGE, linewidth=1.0, label="front")
                axis.set_title(title)
                axis.set_xlabel("x [m]")
                axis.set_ylabel("z [m]")
                axis.grid(visible=False)
            axis.figure.colorbar(image, ax=list(axes[row]), label="depth [cm]", shrink=0.8)


def depth_map(positions: Floats, volume: Floats, scene: Scene) -> NDArray[np.float64]:
    """Depth at the initial density over cells seen from above [m], shape [x, z]."""
    length, _, width = scene.domain.size
    counts = [round(length / PIXEL), round(width / PIXEL)]
    edges = [(0.0, length), (0.0, width)]
    sums, _, _ = np.histogram2d(positions[:, 0], positions[:, 2], counts, range=edges, weights=volume)
    return np.asarray(sums * counts[0] * counts[1] / (length * width))
