"""Maps and profiles as pictures: over the contours of the ground, with outlines and units."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from datasets.files import replacing
from datasets.maps.files import Georeference, outline
from datasets.maps.plan import PlanMaps

Floats = NDArray[np.float64]

WIDTH, HIGHEST = 9.0, 9.0
"""Of a picture [inches]."""
CONTOURS = 12
"""About as many contour lines of the ground."""


def draw_map(
    path: Path, maps: PlanMaps, values: Floats, georeference: Georeference, *, label: str, colours: str, title: str
) -> None:
    """One map in 3D, shape [X, Z], where it is covered; over the ground, with the outlines of deposit and release.

    label: what the colours show, with its unit; colours: a colour map of matplotlib.
    """
    from matplotlib.figure import Figure

    covered = (maps.thickness if values is maps.thickness else maps.depth) > maps.threshold
    x, z = maps.coordinates[0] + georeference.east, maps.coordinates[1] + georeference.north
    cell = float(maps.edges[0][1])
    figure = Figure(figsize=(WIDTH, min(HIGHEST, 1.3 + 0.8 * WIDTH * len(z) / len(x))), layout="constrained")
    axis = figure.add_subplot(aspect="equal")
    if np.ptp(maps.ground) > 0.0:
        axis.contour(x, z, maps.ground.T, levels=CONTOURS, colors="grey", linewidths=0.6)
    image = axis.pcolormesh(x, z, np.ma.masked_where(~covered, values).T, cmap=colours, vmin=0.0, shading="nearest")
    figure.colorbar(image, label=label)
    for name, thickness, style in (("release", maps.start, "--"), ("deposit", maps.thickness, "-")):
        polygons = () if thickness is None else outline(thickness, cell, georeference, maps.threshold).geoms
        for index, polygon in enumerate(polygons):
            label = f"{name}, over {maps.threshold:.3g} m" if index == 0 else ""
            axis.plot(*polygon.exterior.xy, color="black", linestyle=style, linewidth=1.0, label=label)
    if axis.lines:
        figure.legend(loc="outside lower center", ncols=2, frameon=False)
    local = georeference.crs is None
    axis.set(xlabel="x [m]" if local else "easting [m]", ylabel="z [m]" if local else "northing [m]")
    axis.set_title(title, fontsize="small")
    axis.ticklabel_format(useOffset=False, style="plain")
    with replacing(path) as part:
        figure.savefig(part, dpi=120)


def draw_profile(path: Path, maps: PlanMaps, titles: Sequence[str]) -> None:
    """In 2D: the deposit on the ground, the largest depth and the start, and below the largest velocity over x."""
    from matplotlib.figure import Figure

    (x,) = maps.coordinates
    figure = Figure(figsize=(WIDTH, 5.6), layout="constrained")
    top, below = figure.subplots(2, sharex=True)
    top.fill_between(x, 0.0, maps.ground, color="tan")
    top.fill_between(x, maps.ground, maps.ground + maps.thickness, color="orange", label="deposit")
    for name, thickness, style in (("largest depth", maps.depth, "-"), ("start", maps.start, "--")):
        if thickness is not None:
            top.plot(x, np.where(thickness > 0.0, maps.ground + thickness, np.nan), style, label=name)
    top.set(ylabel="elevation [m]", title=titles[0])
    top.legend(frameon=False)
    if maps.velocity is not None:
        below.plot(x, np.where(maps.depth > maps.threshold, maps.velocity, np.nan))
        below.set(title=titles[1])
    below.set(xlabel="x [m]", ylabel="velocity [m/s]")
    with replacing(path) as part:
        figure.savefig(part, dpi=120)
