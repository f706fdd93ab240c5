"""Pictures of 3D flows against baffles: deposits from above, and front, upstream depth and energy over time."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Rectangle
from numpy.typing import NDArray

from datasets.scene import Scene
from datasets.trajectory import Floats
from validation.bench.surrogate.courses import Comparison
from validation.bench.surrogate.pictures import INK, MPM, STYLES, colours, draw_energy, finish, stage
from validation.bench.surrogate.rollouts import Start

PIXEL = 0.05
"""Edge of a cell of the map of depths [m]: several points of the surrogate stand in one."""
STEEL = "#8d9aa8"


def draw_maps(path: Path, found: Mapping[str, Sequence[Comparison]]) -> None:
    """Depth of the deposits from above, the MPM's and each model's from rest, on the same points; a row per scene."""
    rest = {name: [each for each in group if each.start is Start.REST] for name, group in found.items()}
    figure, axes = stage(len(rest), 1 + max(len(group) for group in rest.values()), (4.2, 2.9))
    for row, (name, group) in enumerate(rest.items()):
        first = group[0]
        maps = {f"{name}, MPM": (first, first.mpm.deposit, first.mpm.front[-1])}
        for each in group:
            maps[f"{name}, {each.model} {each.start}"] = (each, each.surrogate.deposit, each.surrogate.front[-1])
        depths = {title: depth_map(deposit, each.volume, each.scene) for title, (each, deposit, _) in maps.items()}
        top = 100.0 * float(depths[f"{name}, MPM"].max())
        for axis, (title, (each, _, front)) in zip(axes[row], maps.items(), strict=False):
            length, _, width = each.scene.domain.size
            image = axis.imshow(
                np.ma.masked_equal(100.0 * depths[title].T, 0.0),
                origin="lower",
                extent=(0.0, length, 0.0, width),
                vmin=0.0,
                vmax=top,
                cmap="viridis",
            )
            draw_baffles(axis, each.scene)
            axis.axvline(front, color="#d95f02", linewidth=1.0, label="front")
            axis.set_title(title, loc="left", fontsize=9)
            axis.set_xlabel("x [m]", fontsize=8)
            axis.set_ylabel("z [m]", fontsize=8)
            axis.grid(visible=False)
        figure.colorbar(image, ax=list(axes[row]), label="depth [cm]", shrink=0.8)
    finish(path, figure, axes[0, 0])


def depth_map(positions: Floats, volume: Floats, scene: Scene) -> NDArray[np.float64]:
    """Depth at the initial density over cells seen from above [m], shape [x, z]."""
    length, _, width = scene.domain.size
    counts = [round(length / PIXEL), round(width / PIXEL)]
    sums, _, _ = np.histogram2d(
        positions[:, 0], positions[:, 2], counts, range=[(0.0, length), (0.0, width)], weights=volume
    )
    return np.asarray(sums * counts[0] * counts[1] / (length * width))


def draw_baffles(axis: Axes, scene: Scene) -> None:
    """The baffles from above."""
    for baffle in scene.baffles:
        corner = (baffle.lower[0], baffle.lower[2])
        axis.add_patch(Rectangle(corner, baffle.size[0], baffle.size[2], facecolor=STEEL, edgecolor=INK, zorder=3))


def draw_times(path: Path, found: Mapping[str, Sequence[Comparison]]) -> None:
    """Front, upstream depth and both energies over time, a row per scene."""
    shades = colours([each for group in found.values() for each in group])
    figure, axes = stage(len(found), 4, (3.0, 2.3))
    for row, (name, group) in enumerate(found.items()):
        for each in group:
            colour, style = shades[each.model], STYLES[each.start]
            label = f"{each.model}, {each.start}"
            mpm, ours = each.mpm, each.surrogate
            times = each.step * np.arange(len(mpm.front))
            axes[row, 0].plot(times, mpm.front, color=MPM, linewidth=2.2, alpha=0.5, label="MPM")
            axes[row, 0].plot(times, ours.front, style, color=colour, linewidth=1.0, label=label)
            if mpm.depth is not None and ours.depth is not None:
                axes[row, 1].plot(times, 100.0 * mpm.depth, color=MPM, linewidth=2.2, alpha=0.5)
                axes[row, 1].plot(times, 100.0 * ours.depth, style, color=colour, linewidth=1.0)
            draw_energy(axes[row, 2], each, colour, kinetic=True)
            draw_energy(axes[row, 3], each, colour, kinetic=False)
        titles = ("front [m]", "upstream depth [cm]", "kinetic energy [%]", "potential energy [%]")
        for axis, title in zip(axes[row], titles, strict=True):
            axis.set_title(f"{name}: {title}", loc="left", fontsize=9)
            axis.set_xlabel("time [s]", fontsize=8)
    finish(path, figure, axes[0, 0])
