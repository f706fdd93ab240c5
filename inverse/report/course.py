"""Pictures of numbers: loss and parameters over the evaluations, and what was found beside the truth."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib import colormaps
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter

from inverse.forward.interface import Evaluation
from inverse.problem import Problem
from inverse.report.pictures import COLOURS, WIDTH, save

FEW = 6
"""Up to so many lines have colours of their own; more of them follow a ramp."""
MINIMUM_LOSS = 1e-14
"""A loss below it is drawn here: zero has no logarithm."""


def draw(
    path: Path,
    problem: Problem,
    evaluations: Sequence[Evaluation],
    truth: Mapping[str, float] | None,
    forward: str = "surrogate",
) -> None:
    """Loss and parameters over the `evaluations` of `forward`.

    Parameters of one unit share an axis; true values are dashed.
    """
    units = grouped(problem)
    rows = 1 + len(units)
    figure, axes = plt.subplots(rows, 1, figsize=(WIDTH, 0.6 + 2.7 * rows), sharex=True, layout="constrained")
    colours = dict(zip(problem.names, ramp(len(problem.names)), strict=True))
    own = {each.name: axes[1 + units.index(each.kind.unit)] for each in problem.parameters}
    numbers = np.arange(1, len(evaluations) + 1)
    losses = [max(evaluation.loss, MINIMUM_LOSS) for evaluation in evaluations]
    axes[0].plot(numbers, losses, ".-", color=COLOURS[forward], label=forward)
    for index, name in enumerate(problem.names):
        values = [evaluation.parameters[index] for evaluation in evaluations]
        own[name].plot(numbers, values, ".-", color=colours[name], label=name)
    for name in problem.names:
        if truth:
            own[name].axhline(truth[name], color=colours[name], linestyle="--", linewidth=1.0, alpha=0.8)
    _finish(axes, problem, units, bool(truth))
    save(figure, path)


def draw_found(
    path: Path,
    problem: Problem,
    found: Mapping[str, float],
    half_widths: Mapping[str, float] | None,
    truth: Mapping[str, float] | None,
) -> None:
    """Every parameter side by side: start, found with its half-width, truth."""
    units = grouped(problem)
    figure, grid = plt.subplots(
        len(units), 1, figsize=(WIDTH, 0.4 + 3.2 * len(units)), layout="constrained", squeeze=False
    )
    for unit, axis in zip(units, grid[:, 0], strict=True):
        names = [each.name for each in problem.parameters if each.kind.unit == unit]
        x = np.arange(len(names))
        starts = [each.initial for each in problem.parameters if each.name in names]
        for number, name in enumerate(names if truth else []):
            # A step as wide as its column: the profile of the truth over the layers.
            label = "truth" if number == 0 else None
            axis.plot([number - 0.4, number + 0.4], [truth[name]] * 2 if truth else [], color="black", label=label)
        axis.plot(x - 0.2, starts, "_", color="#888888", markersize=9, markeredgewidth=1.5, label="start")
        values = [found[name] for name in names]
        errors = [half_widths[name] for name in names] if half_widths else None
        axis.errorbar(
            x + 0.1,
            values,
            yerr=errors,
            fmt="o",
            color=COLOURS["MPM"],
            capsize=4,
            label="found, with its half-width (95 %)" if half_widths else "found",
        )
        axis.set_xticks(x, [name.replace(".", "\n") for name in names], fontsize=8)
        axis.set_xlim(-0.6, len(names) - 0.4)
        axis.set_ylabel(f"[{unit}]")
        axis.grid(axis="y", color="#e5e5e5")
        axis.legend(fontsize=8, frameon=False, loc="upper left", bbox_to_anchor=(1.0, 1.0))
    save(figure, path)


def grouped(problem: Problem) -> list[str]:
    """The units of the parameters, in the order of the problem."""
    return list(dict.fromkeys(kind.unit for kind in problem.kinds))


def ramp(count: int) -> list[tuple[float, ...]]:
    """A colour for each of `count` parameters."""
    if count == 1:
        return [colormaps["tab10"](1)]
    if count <= FEW:
        return [colormaps["Dark2"](number) for number in (0, 2, 3, 4, 5, 7)[:count]]  # The surrogate's orange is not.
    return [colormaps["turbo"](0.05 + 0.9 * number / (count - 1)) for number in range(count)]


def _finish(axes: Sequence[Axes], problem: Problem, units: Sequence[str], truth: bool) -> None:
    """Names of the axes, legends beside the axes."""
    axes[0].set_yscale("log")
    low, high = axes[0].get_ylim()
    axes[0].yaxis.set_major_locator(LogLocator(subs=(1.0,) if high > 30.0 * low else (1.0, 2.0, 5.0)))
    axes[0].yaxis.set_major_formatter("{x:.0e}" if high > 3.0 * low else "{x:.2e}")
    axes[0].yaxis.set_minor_formatter(NullFormatter())
    axes[0].set_ylabel(f"loss [{problem.observed.misfit_unit()}]".replace("^2", "$^2$"))
    for unit, axis in zip(units, axes[1:], strict=True):
        axis.set_ylabel(f"[{unit}]")
        if truth:
            axis.plot([], [], color="#777777", linestyle="--", linewidth=1.0, label="truth")
    axes[-1].set_xlabel("evaluation")
    axes[-1].xaxis.set_major_locator(MaxNLocator(integer=True))
    for axis in axes:
        axis.tick_params(labelsize=8)
        axis.legend(fontsize=8, frameon=False, loc="upper left", bbox_to_anchor=(1.0, 1.0))
