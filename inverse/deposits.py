"""Pictures of deposits: in 2D from the side, in 3D from above, with baffles and what was observed of them."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Literal

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle
from numpy.typing import NDArray

from datasets import files, measures
from datasets.scene import Scene
from inverse.found import Found
from inverse.observations.passed import Passed
from inverse.observations.profile import Profile
from inverse.observations.toe import Toe
from inverse.settings import ObservationSettings

Deposit = NDArray[np.floating]
COLOURS = {"target": "#222222", "surrogate": "#d95f02", "MPM": "#1b6ca8"}
"""One colour per deposit, the same in every picture."""
STYLES: dict[str, Literal[":", "-", "--"]] = {"start": ":", "found": "-", "truth": "--"}
"""Outline of a baffle that stands where the search started, where it was found and where it is in truth."""
INKS = {"start": "#777777", "found": "#1b6ca8", "truth": "#222222"}
HEIGHTS = "viridis"
"""Colours of the heights in a picture from above."""
LINE = "#b2182b"
WIDTH = 10.0
"""Of a picture [inches]."""
RESOLUTION = 100
"""Pixels per inch."""


def save(figure: Figure, path: Path) -> None:
    """Write a picture."""
    with files.replacing(path) as part:
        figure.savefig(part, dpi=RESOLUTION)
    plt.close(figure)


def draw_deposits(path: Path, found: Found) -> None:
    """The deposits of the target and of the answer, each by itself, and their height profiles over each other."""
    problem, scenes = found.problem, standings(found)
    deposits = shown(found)
    top = 1.08 * max(float(deposit[:, 1].max()) for deposit in deposits.values())
    flat = (top if problem.scene.dimension == 2 else problem.scene.domain.size[2]) / problem.scene.domain.size[0]
    # Of the height of a panel a part is its title and the names of its axis.
    height = float(np.clip(0.85 * WIDTH * flat, 1.0, 3.4)) + 0.75
    rows = len(deposits) + 1
    figure, axes = plt.subplots(rows, 1, figsize=(WIDTH, rows * height), layout="constrained")
    for axis, (name, deposit) in zip(axes, deposits.items(), strict=False):
        # The baffles that were in the way of this deposit are filled.
        filled = "truth" if name == "target" and "truth" in scenes else "found"
        paint(axis, deposit, COLOURS[name], scenes, filled, top)
        mark(axis, found, deposit, COLOURS[name])
        axis.set_title(f"{name}: {caption(found, deposit)}", loc="left", fontsize=9)
    profiles(axes[-1], found, deposits, scenes["found"])
    if problem.scene.dimension == 3:
        bar = figure.colorbar(ScalarMappable(Normalize(0.0, top), HEIGHTS), ax=list(axes[:-1]), shrink=0.6, aspect=30)
        bar.set_label("height [m]", fontsize=8)
    if handles := explanation(found, scenes):
        figure.legend(handles=handles, loc="outside lower center", ncols=len(handles), fontsize=8, frameon=False)
    save(figure, path)


def shown(found: Found) -> dict[str, Deposit]:
    """The deposits that are known, by their names."""
    target = found.target.deposit
    return ({} if target is None else {"target": target}) | {found.forward: found.deposit}


def standings(found: Found) -> dict[str, Scene]:
    """The scene with its baffles as they were at the start, as found and, where it is known, as in truth."""
    problem, truth = found.problem, found.target.truth
    scenes = {"start": problem.scene_at(problem.initial), "found": problem.scene_at(found.answer)}
    if truth:
        scenes["truth"] = problem.scene_at(np.array([truth[name] for name in problem.names]))
    # One that never moved is drawn once.
    moved = any(scene.baffles != scenes["found"].baffles for scene in scenes.values())
    return scenes if moved else {"found": scenes["found"]}


def paint(axis: Axes, deposit: Deposit, colour: str, scenes: Mapping[str, Scene], filled: str, top: float) -> None:
    """A deposit, positions [m], shape [N, D], in the box, of which heights up to `top` [m] are seen.

    The baffles of each of `scenes` are outlines, those of `filled` are filled.
    """
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
            corner, extent = (baffle.lower[0], baffle.lower[across]), (baffle.size[0], baffle.size[across])
            axis.add_patch(
                Rectangle(
                    corner,
                    *extent,
                    facecolor="#d9d9d9" if name == filled else "none",
                    edgecolor=INKS[name],
                    linestyle=STYLES[name],
                    linewidth=1.3,
                    zorder=4,
                )
            )
    axis.set(xlim=(0.0, size[0]), ylim=(0.0, top if across == 1 else size[2]), aspect="equal")
    axis.set_xlabel("x [m]", fontsize=8)
    axis.set_ylabel(f"{'xyz'[across]} [m]", fontsize=8)
    axis.tick_params(labelsize=8)


def caption(found: Found, deposit: Deposit) -> str:
    """What was observed of a deposit, in a few words."""
    observation = found.target.observation
    if isinstance(observation, Passed | Toe):
        return f"{observation.kind} {observation.text(observation.exact(deposit))}"
    return f"front at {measures.front(deposit):.4f} m"


def mark(axis: Axes, found: Found, deposit: Deposit, colour: str) -> None:
    """Mark on a picture of a deposit what was observed."""
    observation, across = found.target.observation, deposit.shape[1] - 1
    if isinstance(observation, Passed):
        axis.axvline(observation.line, color=LINE, linestyle="--", linewidth=1.2, zorder=5)
    elif isinstance(observation, Toe):
        own, target = observation.exact(deposit), found.target.values
        axis.plot(own[0], own[across], "o", color=colour, markeredgecolor="white", markersize=8, zorder=5)
        axis.plot(target[0], target[across], "+", color="#222222", markersize=13, markeredgewidth=2, zorder=6)
    else:
        axis.axvline(measures.front(deposit), color=colour, linewidth=0.9)


def explanation(found: Found, scenes: Mapping[str, Scene]) -> list[Patch | Line2D]:
    """What outlines and marks mean."""
    names = {"start": "baffle at the start", "found": "baffle found", "truth": "baffle in truth"}
    handles: list[Patch | Line2D] = [
        Patch(facecolor="none", edgecolor=INKS[each], linestyle=STYLES[each], label=names[each])
        for each in scenes
        if scenes[each].baffles
    ]
    if handles:
        handles.append(Patch(facecolor="#d9d9d9", label="in the way of this deposit"))
    if isinstance(found.target.observation, Toe):
        handles.append(Line2D([], [], linestyle="", marker="o", color="#777777", label="toe of this deposit"))
        handles.append(Line2D([], [], linestyle="", marker="+", color="#222222", label="target toe"))
    if isinstance(found.target.observation, Passed):
        handles.append(Line2D([], [], linestyle="--", color=LINE, label="line"))
    return handles


def profiles(axis: Axes, found: Found, deposits: Mapping[str, Deposit], scene: Scene) -> None:
    """The height profiles of all deposits, and what is known of a target."""
    target = found.target
    profile = Profile(
        ObservationSettings(kind="profile", spacing=min(2.0 * scene.domain.cell, 0.5 * scene.domain.size[0])), scene
    )
    for name, deposit in deposits.items():
        style = "-" if name == "target" else "--" if name == "surrogate" else "-."
        axis.plot(profile.stations, profile.heights(deposit), style, color=COLOURS[name], label=name, linewidth=1.4)
    if target.deposit is None and target.profile is not None:
        axis.plot(*target.profile, ".", color=COLOURS["target"], label="target")
    elif target.deposit is None and not math.isnan(target.front):
        axis.axvline(target.front, color=COLOURS["target"], linestyle=":", label="target's front")
    for baffle in scene.baffles:
        axis.axvspan(baffle.lower[0], baffle.lower[0] + baffle.size[0], color="#bbbbbb", alpha=0.35, linewidth=0)
    axis.set(xlim=(0.0, scene.domain.size[0]))
    axis.set_ylim(bottom=0.0)
    axis.set_xlabel("x [m]", fontsize=8)
    axis.set_ylabel("height [m]", fontsize=8)
    axis.tick_params(labelsize=8)
    what = "height profiles" if scene.dimension == 2 else "from the side: mean height over z"
    axis.set_title(what, loc="left", fontsize=9)
    axis.legend(fontsize=8, frameon=False)
