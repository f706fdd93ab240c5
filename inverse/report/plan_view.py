"""A 3D deposit from above: its particles, coloured by their height, and the baffles."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import NDArray

from datasets.scene import Scene
from inverse.report.side_view import INKS, STYLES, outlines

COLOURS = "viridis"


def paint(axis: Axes, deposit: NDArray[np.floating], scenes: Mapping[str, Scene], filled: str, *, top: float) -> None:
    """Positions [m], shape [N, 3], the highest above the others; colours end at the height `top` [m].

    The baffles of each of `scenes` are outlines, those of `filled` are filled.
    """
    order = np.argsort(deposit[:, 1])
    x, y, z = deposit[order].T
    size = float(np.clip(40_000.0 / len(deposit), 3.0, 14.0))
    axis.scatter(x, z, c=y, s=size, cmap=COLOURS, vmin=0.0, vmax=top, linewidths=0, rasterized=True)
    outlines(axis, scenes, filled, across=2)


def scale(figure: Figure, axes: Sequence[Axes], *, top: float) -> None:
    """One colour bar for all panels."""
    shades = ScalarMappable(Normalize(0.0, top), COLOURS)
    bar = figure.colorbar(shades, ax=list(axes), shrink=0.6, pad=0.01, aspect=30)
    bar.set_label("height [m]", fontsize=8)
    bar.ax.tick_params(labelsize=8)


def explain(figure: Figure, scenes: Mapping[str, Scene], marks: Sequence[Line2D]) -> None:
    """What the outlines and marks mean, below the panels."""
    names = {"start": "baffle at the start", "found": "baffle found", "truth": "baffle in truth"}
    handles: list[Patch | Line2D] = [
        Patch(
            facecolor="none",
            edgecolor=INKS[name],
            linestyle=STYLES[name],
            label=names[name] if len(scenes) > 1 else "baffle",
        )
        for name in scenes
        if scenes[name].baffles
    ]
    if handles:
        handles.append(Patch(facecolor="#d9d9d9", label="in the way of this deposit"))
    handles += marks
    if handles:
        figure.legend(handles=handles, loc="outside lower center", ncols=len(handles), fontsize=8, frameon=False)
