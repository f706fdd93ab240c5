"""A 2D deposit from the side: its particles and the baffles."""

from collections.abc import Mapping
from typing import Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Rectangle
from numpy.typing import NDArray

from datasets.scene import Scene

STYLES: dict[str, Literal[":", "-", "--"]] = {"start": ":", "found": "-", "truth": "--"}
"""Outline of a baffle that stands where the search started, where it was found and where it is in truth."""
INKS = {"start": "#777777", "found": "#1b6ca8", "truth": "#222222"}


def paint(axis: Axes, deposit: NDArray[np.floating], colour: str, scenes: Mapping[str, Scene], filled: str) -> None:
    """Positions [m], shape [N, 2], as points; the baffles of each of `scenes`, those of `filled` filled."""
    size = 12_000.0 / len(deposit)
    axis.scatter(deposit[:, 0], deposit[:, 1], s=size, color=colour, alpha=0.8, linewidths=0, rasterized=True)
    outlines(axis, scenes, filled, across=1)


def outlines(axis: Axes, scenes: Mapping[str, Scene], filled: str, *, across: int) -> None:
    """The baffles of each of `scenes`, along x and the axis `across`; those of `filled` are filled."""
    for name, scene in scenes.items():
        for baffle in scene.baffles:
            corner, size = (baffle.lower[0], baffle.lower[across]), (baffle.size[0], baffle.size[across])
            colour = "#d9d9d9" if name == filled else "none"
            axis.add_patch(
                Rectangle(
                    corner,
                    *size,
                    facecolor=colour,
                    edgecolor=INKS[name],
                    linestyle=STYLES[name],
                    linewidth=1.3,
                    zorder=4,
                )
            )
