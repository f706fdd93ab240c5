"""Pictures of an inversion: the deposits beside and over each other, and the deposits on the way there."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.typing import HashableList
from numpy.typing import NDArray

from datasets import files, measures
from datasets.scene import Scene
from inverse.observations import Target
from inverse.observations.profile import Profile
from inverse.parameters import Vector
from inverse.problem import Problem
from inverse.report import plan_view, side_view

Deposit = NDArray[np.floating]
COLOURS = {"target": "#222222", "surrogate": "#d95f02", "MPM": "#1b6ca8"}
"""One colour per deposit, the same in every picture."""
WIDTH = 10.0
"""Of a picture [inches]."""
RESOLUTION = 100
"""Pixels per inch."""


def draw_deposits(
    path: Path, problem: Problem, target: Target, answer: Vector, deposits: Mapping[str, Deposit]
) -> None:
    """`deposits` (name -> positions [m], shape [N, D]), each by itself, and their height profiles over each other.

    In 2D from the side, in 3D from above, coloured by the height. Baffles stand where they were at the start, are at
    the `answer` [U] and were in truth; what was observed is marked.
    """
    observation = target.observation
    scenes = standings(problem, target, answer)
    limits = extent(problem.scene, [*deposits.values()])
    figure, axes = sheet(len(deposits) + 1, flatness(problem.scene, limits))
    for axis, (name, deposit) in zip(axes, deposits.items(), strict=False):
        # The baffles that were in the way of this deposit are filled.
        filled = "truth" if name == "target" and "truth" in scenes else "found"
        if problem.scene.dimension == 2:
            side_view.paint(axis, deposit, COLOURS[name], scenes, filled)
        else:
            plan_view.paint(axis, deposit, scenes, filled, top=limits[1])
        observation.mark(axis, deposit, COLOURS[name], target.values)
        axis.set_title(f"{name}: {observation.caption(deposit)}", loc="left", fontsize=9)
        frame(axis, problem.scene, limits)
    _profiles(axes[-1], problem, target, deposits, scenes["found"])
    axes[-1].set_xlim(0.0, limits[0])
    if problem.scene.dimension == 3:
        plan_view.scale(figure, axes[:-1], top=limits[1])
        plan_view.explain(figure, scenes, observation.legend())
    save(figure, path)


def draw_stages(
    path: Path, problem: Problem, target: Target, stages: Sequence[tuple[str, Vector, Deposit]], colour: str
) -> None:
    """Deposits on the way to the answer, over the target where it is known.

    stages: title, parameters [U] and positions [m], shape [N, D], of each.
    """
    deposits = [deposit for _, _, deposit in stages]
    limits = extent(problem.scene, deposits if target.deposit is None else [*deposits, target.deposit])
    figure, axes = sheet(len(stages), flatness(problem.scene, limits), columns=3, last=False)
    profile = Profile(problem.scene, 2.0 * problem.scene.domain.cell)
    for axis, (title, values, deposit) in zip(axes, stages, strict=True):
        scene = problem.scene_at(values)
        if problem.scene.dimension == 2:
            side_view.paint(axis, deposit, colour, {"found": scene}, "found")
            if target.deposit is not None:
                heights = profile.heights(target.deposit)
                axis.plot(profile.stations, heights, color=COLOURS["target"], linewidth=1.0)
        else:
            plan_view.paint(axis, deposit, {"found": scene}, "found", top=limits[1])
        target.observation.mark(axis, deposit, colour, target.values)
        axis.set_title(title, loc="left", fontsize=8)
        frame(axis, problem.scene, limits)
        axis.tick_params(labelsize=7)
    if problem.scene.dimension == 3:
        plan_view.scale(figure, axes, top=limits[1])
    save(figure, path)


def standings(problem: Problem, target: Target, answer: Vector) -> dict[str, Scene]:
    """The scene with its baffles as they were at the start, as found and, where it is known, as in truth."""
    scenes = {
        "start": problem.scene_at(problem.initial),
        "found": problem.scene_at(answer),
    }
    if target.truth:
        scenes["truth"] = problem.scene_at(np.array([target.truth[name] for name in problem.names]))
    # One that never moved is drawn once.
    moved = any(scene.baffles != scenes["found"].baffles for scene in scenes.values())
    return scenes if moved else {"found": scenes["found"]}


def extent(scene: Scene, deposits: Sequence[Deposit]) -> tuple[float, float]:
    """Upper limits of the pictures along x and of the height [m]."""
    end = max(measures.runout(deposit) for deposit in deposits)
    end = max([end, *(baffle.lower[0] + baffle.size[0] for baffle in scene.baffles)])
    height = max(float(deposit[:, 1].max()) for deposit in deposits)
    return min(1.05 * end, scene.domain.size[0]), 1.08 * height


def frame(axis: Axes, scene: Scene, limits: tuple[float, float]) -> None:
    """`limits` and names of the axes, lengths the same along both."""
    axis.set_xlim(0.0, limits[0])
    axis.set_ylim(0.0, limits[1] if scene.dimension == 2 else scene.domain.size[2])
    axis.set_aspect("equal")
    axis.set_xlabel("x [m]", fontsize=8)
    axis.set_ylabel("y [m]" if scene.dimension == 2 else "z [m]", fontsize=8)
    axis.tick_params(labelsize=8)


def flatness(scene: Scene, limits: tuple[float, float]) -> float:
    """Height of a panel over its width."""
    return (limits[1] if scene.dimension == 2 else scene.domain.size[2]) / limits[0]


def sheet(panels: int, flat: float, *, columns: int = 2, last: bool = True) -> tuple[Figure, list[Axes]]:
    """An empty picture of so many panels, as `flat` as that; `last`: the last one fills what its row has left."""
    columns = min(columns, panels)
    rows = math.ceil(panels / columns)
    panes = [[row * columns + column for column in range(columns)] for row in range(rows)]
    rest = str(panels - 1) if last else "."
    mosaic: list[HashableList[str]] = [[str(pane) if pane < panels else rest for pane in row] for row in panes]
    # Of the height of a panel a part is its title and the names of its axis.
    height = float(np.clip(WIDTH / columns * 0.85 * flat, 1.0, 3.4)) + 0.75
    layout = ConstrainedLayoutEngine(h_pad=0.08, w_pad=0.08)
    figure, axes = plt.subplot_mosaic(mosaic, figsize=(WIDTH, rows * height), layout=layout)
    return figure, [axes[str(number)] for number in range(panels)]


def save(figure: Figure, path: Path) -> None:
    """Write a picture."""
    with files.replacing(path) as part:
        figure.savefig(part, dpi=RESOLUTION)
    plt.close(figure)


def _profiles(axis: Axes, problem: Problem, target: Target, deposits: Mapping[str, Deposit], scene: Scene) -> None:
    """The height profiles of all deposits, and what is known of a target that has none."""
    profile = Profile(problem.scene, 2.0 * problem.scene.domain.cell)
    for name, deposit in deposits.items():
        style = "-" if name == "target" else "--" if name == "surrogate" else "-."
        axis.plot(profile.stations, profile.heights(deposit), style, color=COLOURS[name], label=name, linewidth=1.4)
    if target.deposit is None and target.profile is not None:
        axis.plot(*target.profile, ".", color=COLOURS["target"], label="target")
    elif target.deposit is None and not math.isnan(target.front):
        axis.axvline(target.front, color=COLOURS["target"], linestyle=":", label="target")
    for baffle in scene.baffles:
        axis.axvspan(baffle.lower[0], baffle.lower[0] + baffle.size[0], color="#bbbbbb", alpha=0.35, linewidth=0)
    target.observation.mark_profile(axis)
    axis.set_ylim(bottom=0.0)
    axis.set_xlabel("x [m]", fontsize=8)
    axis.set_ylabel("height [m]", fontsize=8)
    axis.tick_params(labelsize=8)
    what = "height profiles" if problem.scene.dimension == 2 else "from the side: mean height over z"
    axis.set_title(what, loc="left", fontsize=9)
    axis.legend(fontsize=8, frameon=False)
