"""Pictures of an inversion: the deposits over each other, the way there."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Rectangle
from numpy.typing import NDArray

from datasets import files, measures
from datasets.scene import Scene
from inverse.observations import Profile, Values
from inverse.problem import Observable, Problem
from inverse.result import Round

Deposit = NDArray[np.floating]
COLOURS = {"target": "#222222", "surrogate": "#d95f02", "MPM": "#1b6ca8"}
"""One colour per deposit, the same in every picture."""
SPACING = 0.02
"""Distance between the stations of the profiles drawn [m]: two cells hold enough of the surrogate's points."""


def draw_deposits(
    path: Path, scene: Scene, deposits: Mapping[str, Deposit], observed: tuple[Values, Values] | float | None
) -> None:
    """Points and height profiles of `deposits` (name -> positions [m], shape [N, D]), one above the other.

    scene: seen from the side, with its baffles.
    observed: what is known of a target without a deposit, stations and heights of its profile or its front [m].
    """
    profile = Profile(scene, SPACING)
    rows = len(deposits) + 1
    figure, axes = plt.subplots(rows, 1, figsize=(9, 2.0 * rows), sharex=True, layout="constrained")
    for axis, (name, deposit) in zip(axes, deposits.items(), strict=False):
        axis.scatter(deposit[:, 0], deposit[:, 1], s=900.0 / len(deposit), color=COLOURS[name], linewidths=0)
        axis.axvline(measures.front(deposit), color=COLOURS[name], linewidth=0.8)
        for baffle in scene.baffles:
            axis.add_patch(
                Rectangle((baffle.lower[0], baffle.lower[1]), *baffle.size[:2], fill=False, edgecolor="#888888")
            )
        axis.set_title(f"{name}: front at {measures.front(deposit):.4f} m", loc="left", fontsize=9)
    for name, deposit in deposits.items():
        axes[-1].plot(profile.stations, profile.heights(deposit), color=COLOURS[name], label=name)
    if isinstance(observed, tuple):
        axes[-1].plot(observed[0], observed[1], ".", color=COLOURS["target"], label="target")
    elif observed is not None:
        axes[-1].axvline(observed, color=COLOURS["target"], linestyle="--", linewidth=0.8, label="target")
    axes[-1].legend(fontsize=8, frameon=False)
    reach = max(measures.runout(deposit) for deposit in deposits.values())
    for axis in axes:
        axis.set_xlim(0.0, min(1.1 * reach, scene.domain.size[0]))
        axis.set_ylim(bottom=0.0)
        axis.set_ylabel("height [m]")
    axes[-1].set_xlabel("x [m]")
    with files.replacing(path) as part:
        figure.savefig(part, dpi=130)
    plt.close(figure)


def draw_iterations(
    path: Path,
    problem: Problem,
    rounds: Sequence[Round],
    truth: Mapping[str, float] | None,
    checks: Sequence[tuple[Mapping[str, float], float]] = (),
) -> None:
    """Loss and unknowns over the evaluations; `checks` are the unknowns and the loss of MPM runs, one per round."""
    rows = len(problem.unknowns) + 1
    figure, axes = plt.subplots(rows, 1, figsize=(9, max(5.0, 1.2 * rows)), sharex=True, layout="constrained")
    first, ends = 1, []
    for stage in rounds:
        numbers = np.arange(first, first + len(stage.evaluations))
        first += len(stage.evaluations)
        ends.append(first - 1)
        label = "surrogate" if stage.number == 0 else None
        colour = COLOURS["surrogate"]
        _line(axes[0], numbers, [evaluation.loss for evaluation in stage.evaluations], colour, label)
        for index, axis in enumerate(axes[1:]):
            _line(axis, numbers, [evaluation.unknowns[index] for evaluation in stage.evaluations], colour, label)
    places = ends + [first - 1 + extra for extra in range(1, len(checks) + 1)]
    for number, (place, (unknowns, loss)) in enumerate(zip(places, checks, strict=False)):
        label = "MPM" if number == 0 else None
        axes[0].plot(place, loss, "s", color=COLOURS["MPM"], label=label)
        for unknown, axis in zip(problem.unknowns, axes[1:], strict=True):
            axis.plot(place, unknowns[unknown.name], "s", color=COLOURS["MPM"], label=label)
    axes[0].set_yscale("log")
    share = problem.observation.kind is Observable.PASSED
    axes[0].set_ylabel("loss [-]" if share else "loss [m$^2$]")
    for unknown, axis in zip(problem.unknowns, axes[1:], strict=True):
        axis.set_ylabel(unknown.name)
        if truth:
            axis.axhline(truth[unknown.name], color=COLOURS["target"], linestyle="--", linewidth=0.8, label="truth")
    axes[-1].set_xlabel("evaluation of the surrogate and its gradient")
    for axis in axes:
        axis.legend(fontsize=8, frameon=False)
    with files.replacing(path) as part:
        figure.savefig(part, dpi=130)
    plt.close(figure)


def _line(axis: Axes, x: NDArray[np.int64], y: Sequence[float], colour: str, label: str | None) -> None:
    axis.plot(x, y, ".-", color=colour, label=label)
