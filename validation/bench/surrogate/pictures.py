"""Pictures: errors by kind, deposits, error and gradients over seconds."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import NullLocator

from datasets import measures
from datasets.trajectory import Trajectory
from validation.bench.surrogate.accuracy import Accuracy
from validation.bench.surrogate.page import FRONT, TRANSPORT
from validation.bench.surrogate.price import Prices
from validation.bench.surrogate.velocities import CRITERIA, Gradients
from validation.report.plots import BLUE, GREEN, GREY, INK, LIGHT_BLUE, ORANGE, figure, pane

COLOURS = (ORANGE, GREEN, GREY)
"""By model."""
STATIONS = 80
"""Of a height profile along the box."""
ACROSS = 4
"""Panes in a row."""
ERRORS = (0.3, 0.5, 1, 2, 3, 5, 10, 20, 30, 50, 100)
"""Ticks of errors [%]."""


@dataclass(frozen=True, kw_only=True)
class Pictured:
    """A scene's deposit by the reference and by the models."""

    name: str
    truth: Trajectory
    rollouts: Mapping[str, Trajectory]


def draw_errors(path: Path, dimension: int, found: Accuracy) -> None:
    """Errors of fronts (with their signs) and profiles by kind, a point for each scene, with the criteria."""
    kinds = list(dict.fromkeys(each.kind for each in found.scenes))
    with figure(path, columns=2, size=(6.2, 3.6)) as axes:
        for column, title in enumerate(("front, free of walls", "profile")):
            axis = pane(axes, 0, column)
            for number, model in enumerate(found.scores):
                shift = 0.22 * (number - 0.5 * (len(found.scores) - 1))
                for index, kind in enumerate(kinds):
                    scores = [each for each in found.of_kind(model, kind) if column == 1 or not each.at_wall]
                    values = [each.deposit.transport if column else each.deposit.front for each in scores]
                    spread = np.linspace(-0.08, 0.08, len(values)) if len(values) > 1 else np.zeros(len(values))
                    axis.plot(
                        index + shift + spread,
                        100.0 * np.array(values),
                        ".",
                        color=COLOURS[number % len(COLOURS)],
                        markersize=3.5,
                        label=model if index == 0 else None,
                    )
            limits = (TRANSPORT,) if column else [sign * limit for limit in FRONT[dimension] for sign in (-1.0, 1.0)]
            for limit in limits:
                if np.isfinite(limit):
                    axis.axhline(100.0 * limit, color=INK, linestyle=":", linewidth=0.9)
            axis.set_xticks(range(len(kinds)), kinds, rotation=30)
            axis.set_title(f"{title}, {dimension}D")
            axis.set_ylabel("error over the extent [%]")
        pane(axes).legend()


def draw_deposits(path: Path, scenes: Sequence[Pictured]) -> None:
    """Height profiles of deposits, the reference's filled; in 3D means across the box."""
    across = min(ACROSS, len(scenes))
    with figure(path, rows=-(-len(scenes) // across), columns=across, size=(3.6, 2.2)) as axes:
        for axis in axes.flat[len(scenes) :]:
            axis.set_visible(False)
        for axis, each in zip(axes.flat, scenes, strict=False):
            draw_deposit(axis, each)
        pane(axes).legend()


def draw_deposit(axis: Axes, each: Pictured) -> None:
    """One scene's."""
    size = each.truth.scene.domain.size
    stations = np.linspace(0.0, size[0], STATIONS + 1)

    def heights(flow: Trajectory) -> np.ndarray:
        width = size[2] if len(size) > 2 else 1.0
        return 100.0 * measures.height_profile(flow.positions[-1], flow.volumes, stations) / width

    axis.fill_between(stations, heights(each.truth), color=LIGHT_BLUE, linewidth=0, label="MPM, fine")
    for number, (model, flow) in enumerate(each.rollouts.items()):
        axis.plot(stations, heights(flow), color=COLOURS[number % len(COLOURS)], linewidth=1.0, label=model)
    axis.set_title(each.name)
    axis.set_xlabel("x [m]")
    axis.set_ylabel("height [cm]")


def draw_prices(path: Path, found: Mapping[int, Prices]) -> None:
    """Error over seconds, a pane per dimension."""
    with figure(path, columns=len(found), size=(5.6, 4.2)) as axes:
        for column, (dimension, each) in enumerate(found.items()):
            axis = pane(axes, 0, column)
            points = list(each.mpm.items())
            x, y = [point.seconds for _, point in points], [100.0 * point.error for _, point in points]
            axis.loglog(x, y, "o-", color=BLUE, label="MPM")
            for (cells, _), at in zip(points, zip(x, y, strict=True), strict=True):
                axis.annotate(f"{cells} cells", at, xytext=(3, 4), textcoords="offset points", fontsize=7)
            for number, (name, point) in enumerate(each.models.items()):
                colour = COLOURS[number % len(COLOURS)]
                axis.loglog(point.seconds, 100.0 * point.error, "*", ms=11, color=colour, label=name)
            axis.set_title(f"{dimension}D, {each.scenes} scenes")
            axis.set_xlabel("seconds on one thread")
            axis.set_ylabel("error of the deposit over its extent")
            shown = [tick for tick in ERRORS if 0.5 * axis.get_ylim()[0] <= tick <= 2.0 * axis.get_ylim()[1]]
            axis.yaxis.set_minor_locator(NullLocator())
            axis.set_yticks(shown, [f"{tick:g} %" for tick in shown])
            axis.legend()


def draw_gradients(path: Path, found: Sequence[Gradients]) -> None:
    """1 - cosine (above) and length over seconds, a column of panes per number of unknowns."""
    with figure(path, rows=2, columns=len(found), size=(5.0, 3.0)) as axes:
        for column, each in enumerate(found):
            ticks = pane(axes, 0, column), pane(axes, 1, column)
            values = [
                (one.seconds, max(1.0 - one.cosine, 1e-6), one.length, one.method) for one in (*each.mpm, *each.models)
            ]
            for index, axis in enumerate(ticks, start=1):
                coarse = sorted(values[: len(each.mpm)])
                axis.plot(
                    [v[0] for v in coarse], [v[index] for v in coarse], "o-", color=BLUE, label="differences, MPM"
                )
                for number, one in enumerate(values[len(each.mpm) :]):
                    axis.plot(one[0], one[index], "*", ms=11, color=COLOURS[number % len(COLOURS)], label=one[3])
                axis.set_xscale("log")
                axis.set_xlabel("seconds on one thread")
            above, below = ticks
            above.set_yscale("log")
            if each.unknowns in CRITERIA:
                above.axhline(1.0 - CRITERIA[each.unknowns], color=INK, linestyle=":", linewidth=0.9)
            below.axhline(1.0, color=INK, linewidth=0.7)
            above.set_title(f"{each.unknowns} unknowns")
            above.set_ylabel("1 - cosine")
            below.set_ylabel("length over the reference's")
        pane(axes).legend()
