"""Pictures of deposits: in 2D from the side, in 3D from above, with baffles and what was observed of them."""

import math
from collections.abc import Mapping
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

from datasets import files, measures
from datasets.scene import Scene
from inverse.observations.front import Passed, Toe
from inverse.observations.profile import Profile
from inverse.result import Result
from inverse.settings import ObservationSettings

Deposit = NDArray[np.floating]
COLOURS = {"target": "#222222", "surrogate": "#d95f02", "MPM": "#1b6ca8"}
"""One colour per deposit, the same in every picture."""
OUTLINES: dict[str, tuple[Literal[":", "-", "--"], str, str]] = {
    "start": (":", "#777777", "baffle at the start"),
    "found": ("-", "#1b6ca8", "baffle found"),
    "truth": ("--", "#222222", "baffle in truth"),
}
"""Line, colour and meaning of the outline of a baffle."""
HEIGHTS = "viridis"
"""Colours of the heights in a picture from above."""
LINE = "#b2182b"
WIDTH = 10.0
"""Of a picture [inches]."""
RESOLUTION = 100
"""Pixels per inch."""
STYLE: dict[str, Any] = {
    "axes.labelsize": 8,
    "axes.titlesize": 9,
    "axes.titlelocation": "left",
    "xtick.labelsize": 8,
    "ytick.labelsize": 8,
    "legend.fontsize": 8,
    "legend.frameon": False,
}


def save(figure: Figure, path: Path) -> None:
    """Write a picture."""
    with files.replacing(path) as part:
        figure.savefig(part, dpi=RESOLUTION)
    plt.close(figure)


@matplotlib.rc_context(STYLE)  # type: ignore[arg-type]
def deposits(found: Result) -> Figure:
    """The deposits of the target and of the answer, each by itself, and their height profiles over each other."""
    scene, scenes, target = found.problem.scene, standings(found), found.target.deposit
    shown = ({} if target is None else {"target": target}) | {found.forward: found.deposit}
    top = 1.08 * max(float(deposit[:, 1].max()) for deposit in shown.values())
    flat = (top if scene.dimension == 2 else scene.domain.size[2]) / scene.domain.size[0]
    # Of the height of a panel a part is its title and the names of its axis.
    height = float(np.clip(0.85 * WIDTH * flat, 1.0, 3.4)) + 0.75
    rows = len(shown) + 1
    figure, axes = plt.subplots(rows, 1, figsize=(WIDTH, rows * height), layout="constrained")
    for axis, (name, deposit) in zip(axes, shown.items(), strict=False):
        # The baffles that were in the way of this deposit are filled.
        filled = "truth" if name == "target" and "truth" in scenes else "found"
        paint(axis, deposit, COLOURS[name], scenes, filled, top)
        axis.set_title(f"{name}: {mark(axis, found, deposit, COLOURS[name])}")
    profiles(axes[-1], found, shown, scenes["found"])
    if scene.dimension == 3:
        bar = figure.colorbar(ScalarMappable(Normalize(0.0, top), HEIGHTS), ax=list(axes[:-1]), shrink=0.6, aspect=30)
        bar.set_label("height [m]")
    drawn = [axis.get_legend_handles_labels() for axis in axes[:-1]]
    if labels := {label: handle for handles, names in drawn for handle, label in zip(handles, names, strict=True)}:
        figure.legend(labels.values(), labels.keys(), loc="outside lower center", ncols=len(labels))
    figure.suptitle(f"{found.problem.name}: {found.verdict}")
    return figure


def standings(found: Result) -> dict[str, Scene]:
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
        line, ink, label = OUTLINES[name]
        for baffle in scene.baffles:
            box = Rectangle((baffle.lower[0], baffle.lower[across]), baffle.size[0], baffle.size[across], zorder=4)
            box.set(facecolor="#d9d9d9" if name == filled else "none", edgecolor=ink, linestyle=line, linewidth=1.3)
            box.set_label(label)
            axis.add_patch(box)
    axis.set(xlim=(0.0, size[0]), ylim=(0.0, top if across == 1 else size[2]), aspect="equal")
    axis.set(xlabel="x [m]", ylabel=f"{'xyz'[across]} [m]")


def mark(axis: Axes, found: Result, deposit: Deposit, colour: str) -> str:
    """Mark on a picture of a deposit what was observed of it, and say it in a few words."""
    observation, across = found.target.observation, deposit.shape[1] - 1
    if isinstance(observation, Passed):
        axis.axvline(observation.line, color=LINE, linestyle="--", linewidth=1.2, zorder=5, label="line")
    elif isinstance(observation, Toe):
        own, target = observation.exact(deposit), found.target.values
        style: dict[str, Any] = {"linestyle": "", "markeredgecolor": "white", "markersize": 8, "zorder": 5}
        axis.plot(own[0], own[across], "o", color=colour, label="toe of this deposit", **style)
        axis.plot(target[0], target[across], "k+", markersize=13, markeredgewidth=2, zorder=6, label="target toe")
    else:
        axis.axvline(measures.front(deposit), color=colour, linewidth=0.9)
        return f"front at {measures.front(deposit):.4f} m"
    return f"{observation.kind} {observation.text(observation.exact(deposit))}"


def profiles(axis: Axes, found: Result, shown: Mapping[str, Deposit], scene: Scene) -> None:
    """The height profiles of all deposits, and what is known of a target."""
    target, domain = found.target, scene.domain
    spacing = min(2.0 * domain.cell, 0.5 * domain.size[0])
    profile = Profile(ObservationSettings(kind="profile", spacing=spacing), scene)
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
