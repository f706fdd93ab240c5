"""Maps and profiles as pictures: over the shaded relief and the contours of the ground, with outlines and units."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from datasets.files import replacing
from datasets.geometry.surface import solids_of
from datasets.maps.files import Georeference, outline
from datasets.maps.plan import PlanMaps, ground
from datasets.scene import Scene

# matplotlib takes a while to import: only who draws pays for it.
if TYPE_CHECKING:
    from matplotlib.axes import Axes

Floats = NDArray[np.float64]

WIDTH, HIGHEST = 9.0, 9.0
"""Of a picture [inches]."""
SUN = (315.0, 40.0)
"""Azimuth and altitude of the light on the relief [deg]: from the upper left, as maps have it."""
STEEL, INK, SAND, EARTH, SKY = "#8d9aa8", "#222222", "#d9b26f", "#b5aa98", "#1b6ca8"
"""Colours of baffles, of lines, of the deposit, of the ground and of what is largest over time."""
CONTOURS = 12
"""About as many contour lines of the ground."""
FLAT = 1.0e-9
"""Relief over the length of the map below which there is none to draw."""


def draw_map(
    path: Path,
    maps: PlanMaps,
    values: Floats,
    scene: Scene,
    georeference: Georeference,
    *,
    label: str,
    colours: str,
    title: str,
) -> None:
    """One map in 3D, shape [X, Z], where it is covered; over the ground, with the outlines of deposit and release.

    label: what the colours show, with its unit; colours: a colour map of matplotlib.
    """
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

    covered = (maps.thickness if values is maps.thickness else maps.depth) > maps.threshold
    cell = float(maps.edges[0][1])
    width, length = (cell * count for count in values.shape)
    extent = (georeference.east, georeference.east + width, georeference.north, georeference.north + length)
    figure = Figure(figsize=(WIDTH, min(HIGHEST, 1.3 + 0.8 * WIDTH * length / width)), layout="constrained")
    axis = figure.add_subplot(aspect="equal")
    _draw_relief(axis, ground(scene, maps.edges, terrain_alone=True), maps, georeference, extent)
    shown = np.ma.masked_where(~covered, values)
    image = axis.imshow(shown.T, cmap=colours, extent=extent, origin="lower", vmin=0.0, alpha=0.9, zorder=2)
    figure.colorbar(image, cax=axis.inset_axes((1.02, 0.0, 0.025, 1.0)), label=label)
    handles = []
    lines: list[tuple[str, Floats | None, Literal["-", "--"]]] = [
        ("release", maps.start, "--"),
        ("deposit", maps.thickness, "-"),
    ]
    for name, thickness, style in lines:
        if thickness is not None:
            for polygon in outline(thickness, cell, georeference, maps.threshold).geoms:
                for ring in (polygon.exterior, *polygon.interiors):
                    axis.plot(*ring.xy, color=INK, linestyle=style, linewidth=1.0, zorder=4)
            handles.append(Line2D([], [], color=INK, linestyle=style, label=f"{name}, over {maps.threshold:.3g} m"))
    for corners in boxes_in_plan(scene):
        x, z = corners.T
        axis.fill(
            georeference.east + x, georeference.north + z, facecolor=STEEL, edgecolor=INK, linewidth=0.8, zorder=3
        )
    figure.legend(handles=handles, loc="outside lower center", ncols=2, frameon=False, fontsize=9)
    axis.set_xlim(extent[:2])
    axis.set_ylim(extent[2:])
    local = georeference.crs is None
    axis.set_xlabel("x [m]" if local else "easting [m]")
    axis.set_ylabel("z [m]" if local else "northing [m]")
    axis.ticklabel_format(useOffset=False, style="plain")
    axis.set_title(title, loc="left", fontsize=10)
    with replacing(path) as part:
        figure.savefig(part, dpi=120)


def _draw_relief(
    axis: "Axes", ground: Floats, maps: PlanMaps, georeference: Georeference, extent: tuple[float, float, float, float]
) -> None:
    """The ground [m], shape [X, Z], shaded, with labelled contours; nothing where it is level."""
    from matplotlib.colors import LightSource
    from matplotlib.ticker import MaxNLocator

    cell = float(maps.edges[0][1])
    relief, length = float(np.ptp(ground)), cell * max(ground.shape)
    axis.set_facecolor("#f2f0ec")
    if relief <= FLAT * length:
        return
    # Low relief is exaggerated until it can be seen.
    exaggeration = max(1.0, 0.2 * length / relief)
    shade = LightSource(*SUN).hillshade(ground.T[::-1], vert_exag=exaggeration, dx=cell, dy=cell)
    axis.imshow(shade, cmap="gray", extent=extent, origin="upper", vmin=-1.1, vmax=1.05, zorder=0)
    levels = MaxNLocator(CONTOURS).tick_values(ground.min(), ground.max())[1:-1]
    if len(levels) > 0:
        x, z = maps.coordinates
        lines = axis.contour(
            georeference.east + x,
            georeference.north + z,
            ground.T,
            levels=levels,
            colors="#6b6459",
            linewidths=0.6,
            zorder=1,
        )
        axis.clabel(lines, levels[::2], fontsize=7, fmt=lambda level: f"{level:g} m")


def boxes_in_plan(scene: Scene) -> list[Floats]:
    """Corners of the baffles and the solids that are boxes [m], seen from above, x and z, shape [4, 2] each."""
    found = []
    for solid in solids_of(scene)[0]:
        if solid.lower is None or solid.size is None:
            continue
        low, size = np.array(solid.lower)[[0, 2]], np.array(solid.size)[[0, 2]]
        corners = (np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]) - 0.5) * size
        angle = math.radians(solid.turned_deg)
        turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
        found.append(low + 0.5 * size + corners @ turn.T)
    return found


def draw_profile(path: Path, maps: PlanMaps, titles: Sequence[str]) -> None:
    """In 2D: the deposit on the ground, the largest depth and the start, and below the largest velocity over x."""
    from matplotlib.figure import Figure

    (x,) = maps.coordinates
    rows = 1 if maps.velocity is None else 2
    figure = Figure(figsize=(WIDTH, 2.8 * rows), layout="constrained")
    axes = figure.subplots(rows, sharex=True, squeeze=False)[:, 0]
    top, ground = axes[0], maps.ground
    top.fill_between(x, 0.0, ground, color=EARTH, linewidth=0.0)
    top.fill_between(x, ground, ground + maps.thickness, color=SAND, linewidth=0.0, label="deposit")
    top.plot(x, ground + maps.thickness, color=INK, linewidth=1.2)
    deepest = np.where(maps.depth > 0.0, ground + maps.depth, np.nan)
    top.plot(x, deepest, color=SKY, linewidth=1.0, label="largest depth")
    if maps.start is not None:
        top.plot(
            x, np.where(maps.start > 0.0, ground + maps.start, np.nan), "--", color=INK, linewidth=1.0, label="start"
        )
    top.plot(x, ground, color=INK, linewidth=0.8)
    top.set_ylabel("elevation [m]")
    top.set_ylim(bottom=0.0)
    top.legend(frameon=False, fontsize=9)
    top.set_title(titles[0], loc="left", fontsize=10)
    if maps.velocity is not None:
        covered = maps.depth > maps.threshold
        axes[1].plot(x, np.where(covered, maps.velocity, np.nan), color=SKY, linewidth=1.2)
        axes[1].set_ylabel("velocity [m/s]")
        axes[1].set_ylim(0.0, max(1.1 * float(maps.velocity.max()), 1e-6))
        axes[1].set_title(titles[1], loc="left", fontsize=10)
    for axis in axes:
        axis.grid(alpha=0.25)
    axes[-1].set_xlim(x[0], x[-1])
    axes[-1].set_xlabel("x [m]")
    with replacing(path) as part:
        figure.savefig(part, dpi=120)
