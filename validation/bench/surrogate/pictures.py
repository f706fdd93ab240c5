"""Pictures of 2D flows: front error over angle, deposits, energy over time."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from datasets import files, measures
from gns.score import SPACING
from validation.bench.surrogate.columns import BARS, Found
from validation.bench.surrogate.courses import Comparison
from validation.bench.surrogate.held_out import by_way
from validation.bench.surrogate.rollouts import Start
from validation.bench.surrogate.scenes import TRAINED

INK, GRID, MPM, SAND = "#222222", "#e6e6e6", "#1b6ca8", "#d5dfe8"
COLOURS = ("#d95f02", "#7a9a01", "#c2408a", "#7570b3")
"""By model."""
STYLES = {Start.FRAMES: "-", Start.REST: "--"}


def colours(comparisons: Sequence[Comparison]) -> dict[str, str]:
    """A colour per model."""
    names = list(dict.fromkeys(each.model for each in comparisons))
    return {name: COLOURS[index % len(COLOURS)] for index, name in enumerate(names)}


def stage(rows: int, columns: int, size: tuple[float, float]) -> tuple[Figure, np.ndarray]:
    """A figure of panels, each of `size` [inches], shape [rows, columns]."""
    figure, axes = plt.subplots(
        rows, columns, figsize=(size[0] * columns, size[1] * rows), layout="constrained", squeeze=False
    )
    for axis in axes.flat:
        axis.grid(color=GRID, linewidth=0.6)
        axis.set_axisbelow(True)
        axis.spines[["top", "right"]].set_visible(False)
        axis.tick_params(labelsize=8)
    return figure, axes


def finish(path: Path, figure: Figure, labelled: Axes) -> None:
    """The legend of a panel, which is that of all, and the file."""
    handles, labels = labelled.get_legend_handles_labels()
    unique = dict(zip(labels, handles, strict=True))
    # About two inches to a label.
    across = max(1, int(figure.get_figwidth() / 2.2))
    figure.legend(
        list(unique.values()), list(unique), loc="outside lower center", ncols=across, fontsize=8, frameon=False
    )
    with files.replacing(path) as part:
        figure.savefig(part, dpi=110)
    plt.close(figure)


def draw_fronts(path: Path, found: Found) -> None:
    """Front error over the angle of friction, a panel per aspect ratio; the MPM's scatter as a band, the bars."""
    everything = [each for group in found.values() for each in group]
    shades, aspects = colours(everything), list(dict.fromkeys(column.aspect for column in found))
    figure, axes = stage(1, len(aspects), (2.7, 3.2))
    for axis in axes[0, 1:]:
        axis.sharey(axes[0, 0])
    for axis, aspect in zip(axes[0], aspects, strict=True):
        columns = sorted((each for each in found if each.aspect == aspect), key=lambda each: each.friction_deg)
        angles = [each.friction_deg for each in columns]
        scatter = 100.0 * np.array([found[each][0].scatter for each in columns])
        axis.fill_between(angles, -scatter, scatter, color=SAND, linewidth=0, label="MPM's scatter over jitter seeds")
        for low, high, trained in ((10, TRAINED[0], False), (*TRAINED, True), (TRAINED[1], 50, False)):
            for sign in (-1.0, 1.0):
                bar = 100.0 * sign * BARS[trained]
                axis.plot([low, high], [bar, bar], ":", color=INK, linewidth=0.9, label="bar")
        for index, (model, start) in enumerate(by_way(found[columns[0]])):
            errors = [100.0 * found[each][index].front_error for each in columns]
            axis.plot(
                angles,
                errors,
                STYLES[start],
                marker="o",
                markersize=3.0,
                color=shades[model],
                linewidth=1.1,
                label=f"{model}, {start}",
            )
        axis.axhline(0.0, color=INK, linewidth=0.7)
        axis.set_title(f"height / length {aspect:g}", loc="left", fontsize=9)
        axis.set_xlabel("angle of friction [°]", fontsize=8)
    axes[0, 0].set_ylabel("front error, all points [%]", fontsize=8)
    finish(path, figure, axes[0, 0])


def draw_profiles(path: Path, found: Mapping[str, Sequence[Comparison]]) -> None:
    """Height profiles of deposits by name, the MPM's filled."""
    shades = colours([each for group in found.values() for each in group])
    across = min(2, len(found))
    figure, axes = stage(-(-len(found) // across), across, (5.0, 2.3))
    for axis, (name, group) in zip(axes.flat, found.items(), strict=False):
        stations = measures.profile_stations(group[0].scene, SPACING)
        axis.fill_between(stations, 100.0 * group[0].mpm.profile, color=SAND, linewidth=0, label="MPM")
        axis.axvline(group[0].front, color=MPM, linewidth=0.8, label="MPM's front")
        for each in group:
            axis.plot(
                stations,
                100.0 * each.surrogate.profile,
                STYLES[each.start],
                color=shades[each.model],
                linewidth=1.0,
                label=f"{each.model}, {each.start}",
            )
        axis.set_title(name, loc="left", fontsize=9)
        axis.set_xlabel("x [m]", fontsize=8)
        axis.set_ylabel("height [cm]", fontsize=8)
    for axis in list(axes.flat)[len(found) :]:
        figure.delaxes(axis)
    finish(path, figure, axes[0, 0])


def draw_energies(path: Path, found: Mapping[str, Sequence[Comparison]]) -> None:
    """Kinetic (above) and potential energy (below) over time, a column of panels per scene."""
    shades = colours([each for group in found.values() for each in group])
    figure, axes = stage(2, len(found), (3.4, 2.1))
    for column, (name, group) in enumerate(found.items()):
        for each in group:
            draw_energy(axes[0, column], each, shades[each.model], kinetic=True)
            draw_energy(axes[1, column], each, shades[each.model], kinetic=False)
        axes[0, column].set_title(name, loc="left", fontsize=9)
        axes[1, column].set_xlabel("time [s]", fontsize=8)
    axes[0, 0].set_ylabel("kinetic energy [%]", fontsize=8)
    axes[1, 0].set_ylabel("potential energy [%]", fontsize=8)
    finish(path, figure, axes[0, 0])


def draw_energy(axis: Axes, each: Comparison, colour: str, *, kinetic: bool) -> None:
    """One energy of a rollout and of the MPM on the same points, over all energy at the start [%]."""
    mpm, ours = (course.kinetic if kinetic else course.potential for course in (each.mpm, each.surrogate))
    # A mean over a step belongs to its middle.
    times = each.step * (np.arange(len(mpm)) + 0.5 * kinetic)
    axis.plot(times, 100.0 * mpm, color=MPM, linewidth=2.2, alpha=0.5, label="MPM")
    axis.plot(
        times,
        100.0 * ours,
        STYLES[each.start],
        color=colour,
        linewidth=1.0,
        label=f"{each.model}, {each.start}",
    )
