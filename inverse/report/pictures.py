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
from inverse.observations.deposit import OfDeposit, Passed, Profile, Toe, Values, build
from inverse.observations.target import Target
from inverse.parameters.parameters import Vector, with_unknowns
from inverse.problem import Observable, Problem
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
    the `answer` [U] and were in truth; the toe and the line of `passed` are marked where they are what was observed.
    """
    observation = single(problem)
    scenes = standings(problem, target, answer)
    reach = extent(problem.scene, [*deposits.values()])
    figure, axes = sheet(len(deposits) + 1, flatness(problem.scene, reach))
    toe = target.values if isinstance(observation, Toe) else None
    for axis, (name, deposit) in zip(axes, deposits.items(), strict=False):
        # The baffles that this deposit met are filled.
        met = "truth" if name == "target" and "truth" in scenes else "found"
        if problem.scene.dimension == 2:
            side_view.paint(axis, deposit, COLOURS[name], scenes, met)
        else:
            plan_view.paint(axis, deposit, scenes, met, top=reach[1])
        mark(axis, observation, deposit, COLOURS[name], toe)
        axis.set_title(f"{name}: {caption(problem, deposit)}", loc="left", fontsize=9)
        frame(axis, problem.scene, reach)
    _profiles(axes[-1], problem, target, deposits, scenes["found"])
    axes[-1].set_xlim(0.0, reach[0])
    if problem.scene.dimension == 3:
        plan_view.scale(figure, axes[:-1], top=reach[1])
        plan_view.explain(figure, scenes, toe is not None)
    save(figure, path)


def draw_stages(
    path: Path, problem: Problem, target: Target, stages: Sequence[tuple[str, Vector, Deposit]], colour: str
) -> None:
    """Deposits on the way to the answer, over the target where it is known.

    stages: title, unknowns [U] and positions [m], shape [N, D], of each.
    """
    deposits = [deposit for _, _, deposit in stages]
    reach = extent(problem.scene, deposits if target.deposit is None else [*deposits, target.deposit])
    figure, axes = sheet(len(stages), flatness(problem.scene, reach), columns=3, last=False)
    profile = Profile(problem.scene, 2.0 * problem.scene.domain.cell)
    for axis, (title, unknowns, deposit) in zip(axes, stages, strict=True):
        scene = with_unknowns(problem.scene, problem.names, unknowns)
        if problem.scene.dimension == 2:
            side_view.paint(axis, deposit, colour, {"found": scene}, "found")
            if target.deposit is not None:
                heights = profile.heights(target.deposit)
                axis.plot(profile.stations, heights, color=COLOURS["target"], linewidth=1.0)
        else:
            plan_view.paint(axis, deposit, {"found": scene}, "found", top=reach[1])
        observation = single(problem)
        mark(axis, observation, deposit, colour, target.values if isinstance(observation, Toe) else None)
        axis.set_title(title, loc="left", fontsize=8)
        frame(axis, problem.scene, reach)
        axis.tick_params(labelsize=7)
    if problem.scene.dimension == 3:
        plan_view.scale(figure, axes, top=reach[1])
    save(figure, path)


def standings(problem: Problem, target: Target, answer: Vector) -> dict[str, Scene]:
    """The scene with its baffles as they were at the start, as found and, where it is known, as in truth."""
    scenes = {
        "start": with_unknowns(problem.scene, problem.names, problem.initial),
        "found": with_unknowns(problem.scene, problem.names, answer),
    }
    if target.truth:
        scenes["truth"] = with_unknowns(problem.scene, problem.names, [target.truth[name] for name in problem.names])
    # One that never moved is drawn once.
    moved = any(scene.baffles != scenes["found"].baffles for scene in scenes.values())
    return scenes if moved else {"found": scenes["found"]}


def single(problem: Problem) -> OfDeposit | None:
    """The one thing that is observed of a deposit; None where it is several."""
    if problem.observation.kind is Observable.SEVERAL:
        return None
    return build(problem.observation, problem.scene)


def caption(problem: Problem, deposit: Deposit) -> str:
    """What was observed of a deposit, in a few words."""
    observation = single(problem)
    if isinstance(observation, Toe | Passed):
        return seen(problem, observation.exact(deposit))
    if problem.observation.kind is Observable.RUNOUT:
        return f"runout {measures.runout(deposit):.4f} m"
    return f"front at {measures.front(deposit):.4f} m"


def seen(problem: Problem, values: Values) -> str:
    """An observation in words, with its unit."""
    kind = problem.observation.kind
    if kind is Observable.SEVERAL:
        return f"{len(values)} numbers"
    if kind is Observable.PASSED:
        return f"{100.0 * values[0]:.2f} % beyond {problem.observation.line:g} m"
    if kind is Observable.TOE:
        return f"toe at ({', '.join(f'{value:.3f}' for value in values)}) m"
    if kind is Observable.DEPOSIT:
        return f"{len(values) // problem.scene.dimension} points"
    if kind is Observable.PROFILE:
        return f"mean x {values.mean():.4f} m, 99.5 % within {values[-1]:.4f} m"
    return f"{kind} {values[0]:.4f} m"


def mark(axis: Axes, observation: object, deposit: Deposit, colour: str, toe: Values | None) -> None:
    """Mark what was observed: the toe, the line to pass, or the front. toe: the target's [m], shape [D]."""
    if isinstance(observation, Toe):
        across = 1 if deposit.shape[1] == 2 else 2
        own = measures.toe(deposit)
        axis.plot(own[0], own[across], "o", color=colour, markeredgecolor="white", markersize=8, zorder=5)
        if toe is not None:
            axis.plot(toe[0], toe[across], "+", color=COLOURS["target"], markersize=13, markeredgewidth=2, zorder=6)
    elif isinstance(observation, Passed):
        axis.axvline(observation.line, color="#b2182b", linestyle="--", linewidth=1.2, zorder=5)
    else:
        axis.axvline(measures.front(deposit), color=colour, linewidth=0.9)


def extent(scene: Scene, deposits: Sequence[Deposit]) -> tuple[float, float]:
    """How far along x the pictures go, and how high the deposits are [m]."""
    reach = max(measures.runout(deposit) for deposit in deposits)
    reach = max([reach, *(baffle.lower[0] + baffle.size[0] for baffle in scene.baffles)])
    height = max(float(deposit[:, 1].max()) for deposit in deposits)
    return min(1.05 * reach, scene.domain.size[0]), 1.08 * height


def frame(axis: Axes, scene: Scene, reach: tuple[float, float]) -> None:
    """Limits and names of the axes, lengths the same along both."""
    axis.set_xlim(0.0, reach[0])
    axis.set_ylim(0.0, reach[1] if scene.dimension == 2 else scene.domain.size[2])
    axis.set_aspect("equal")
    axis.set_xlabel("x [m]", fontsize=8)
    axis.set_ylabel("y [m]" if scene.dimension == 2 else "z [m]", fontsize=8)
    axis.tick_params(labelsize=8)


def flatness(scene: Scene, reach: tuple[float, float]) -> float:
    """Height of a panel over its width."""
    return (reach[1] if scene.dimension == 2 else scene.domain.size[2]) / reach[0]


def sheet(panels: int, flat: float, *, columns: int = 2, last: bool = True) -> tuple[Figure, list[Axes]]:
    """An empty picture of so many panels, as `flat` as that; `last`: the last one fills what its row has left."""
    columns = min(columns, panels)
    rows = math.ceil(panels / columns)
    places = [[row * columns + column for column in range(columns)] for row in range(rows)]
    beyond = str(panels - 1) if last else "."
    mosaic: list[HashableList[str]] = [[str(place) if place < panels else beyond for place in row] for row in places]
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
    elif target.deposit is None and not math.isnan(target.edge):
        axis.axvline(target.edge, color=COLOURS["target"], linestyle=":", label="target")
    for baffle in scene.baffles:
        axis.axvspan(baffle.lower[0], baffle.lower[0] + baffle.size[0], color="#bbbbbb", alpha=0.35, linewidth=0)
    if problem.observation.kind is Observable.PASSED:
        axis.axvline(float(problem.observation.line or 0.0), color="#b2182b", linestyle="--", linewidth=1.2)
    axis.set_ylim(bottom=0.0)
    axis.set_xlabel("x [m]", fontsize=8)
    axis.set_ylabel("height [m]", fontsize=8)
    axis.tick_params(labelsize=8)
    what = "height profiles" if problem.scene.dimension == 2 else "from the side: mean height over z"
    axis.set_title(what, loc="left", fontsize=9)
    axis.legend(fontsize=8, frameon=False)
