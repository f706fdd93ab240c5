"""Error over seconds: the MPM on coarse and fine cells, and the models, on one thread, one after the other."""

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from pathlib import Path

import numpy as np
import torch
from tqdm import tqdm

import gns
from datasets.records import Record
from datasets.scene import Domain, Scene
from datasets.trajectory import Trajectory
from mpm import AT_REST, simulate
from mpm.resolution import ROUNDING, characteristic_length, fitted_cell
from validation.bench.surrogate.held_out import HeldOut, References
from validation.bench.surrogate.models import Model
from validation.bench.surrogate.records import Records, digest
from validation.bench.surrogate.scores import Deposit, deposit, rms

CELLS = {2: (7, 10, 14, 20, 28, 40), 3: (3, 5, 7, 10)}
"""Across the smallest side of the body, by dimension."""
PARTICLES_PER_AXIS = 2
STEP_FRACTION = 0.9


@dataclass(frozen=True, kw_only=True)
class Run(Record):
    """One scene by one method."""

    method: str
    """Name of a model, or `mpm_method`."""
    seconds: float
    """Without compilation and without loading a model [s]."""
    deposit: Deposit


@dataclass(frozen=True, kw_only=True)
class Runs(Record):
    """One scene by all methods, measured in turn."""

    runs: tuple[Run, ...]


@dataclass(frozen=True, kw_only=True)
class Point:
    """A method over all scenes."""

    seconds: float
    """Mean [s]."""
    error: float
    """Rms over the scenes of the larger of the front's and the profile's, over the extent [-]."""


@dataclass(frozen=True, kw_only=True)
class Prices:
    """What an error costs."""

    scenes: int
    mpm: Mapping[int, Point]
    """By cells across the smallest side, ascending."""
    models: Mapping[str, Point]


def mpm_method(cells: int) -> str:
    """The name of a resolution of the MPM."""
    return f"MPM, {cells} cells across"


def coarse(scene: Scene, cells: int) -> Scene:
    """A scene on so many cells across the smallest side of its body, or a few more.

    Its box is made higher by part of a cell where it has to be: else its height, a whole number of fine cells, would
    decide which coarser ones fit.
    """
    length, height, *width = scene.domain.size
    plan = dataclasses.replace(scene.domain, size=(length, length, *width))
    cell = fitted_cell(plan, characteristic_length(scene) / cells)
    domain = Domain(size=(length, math.ceil(height / cell - ROUNDING) * cell, *width), cell=cell)
    return dataclasses.replace(scene, domain=domain, particles_per_axis=PARTICLES_PER_AXIS, step_fraction=STEP_FRACTION)


def measure(
    scenes: Sequence[HeldOut], models: Sequence[Model], references: References, keep: Path, cells: Sequence[int]
) -> Prices:
    """Run every scene by every method; scenes whose runs `keep` has are not run again."""
    torch.set_num_threads(1)
    # All references first: they run on all threads.
    truths = references([each.scene for each in scenes])
    stored = Records(keep / "prices.json", Runs)
    keys = [digest(sorted(model.digest for model in models), each.scene, tuple(cells)) for each in scenes]
    if any(key not in stored.found for key in keys):
        for model in models:
            # Kernels are compiled, or read from their cache, at a first call.
            gns.simulate(scenes[0].scene, model=model.simulator)
    bar = tqdm(zip(scenes, truths, keys, strict=True), desc="price", total=len(keys), unit="scene", dynamic_ncols=True)
    rows = [stored.made(key, partial(all_runs, each, truth, models, cells)) for each, truth, key in bar]
    found = {run.method: [row.runs[index] for row in rows] for index, run in enumerate(rows[0].runs)}
    return Prices(
        scenes=len(scenes),
        mpm={each: point(found[mpm_method(each)]) for each in sorted(cells)},
        models={model.name: point(found[model.name]) for model in models},
    )


def all_runs(each: HeldOut, truth: Trajectory, models: Sequence[Model], cells: Sequence[int]) -> Runs:
    """One scene by all methods. The MPM ends where the deposit rests, which is the cheapest that it can do."""
    runs = []
    for number in cells:
        flow = simulate(coarse(each.scene, number), precision="f32", threads=1, record=AT_REST)
        runs.append(run(mpm_method(number), flow, truth))
    runs += [run(model.name, gns.simulate(each.scene, model=model.simulator), truth) for model in models]
    return Runs(runs=tuple(runs))


def run(method: str, flow: Trajectory, truth: Trajectory) -> Run:
    """What one run cost, and its errors."""
    found = deposit(flow.positions[-1], flow.volumes, truth)
    return Run(method=method, seconds=float(flow.summary["wall_s"]), deposit=found)


def point(runs: Sequence[Run]) -> Point:
    """A method over its scenes."""
    return Point(
        seconds=float(np.mean([each.seconds for each in runs])), error=rms([each.deposit.error for each in runs])
    )


def curve(prices: Prices) -> list[Point]:
    """The MPM's points by their seconds, each with the smallest error of those that cost no more."""
    found: list[Point] = []
    for each in sorted(prices.mpm.values(), key=lambda each: each.seconds):
        best = min(each.error, found[-1].error) if found else each.error
        found.append(Point(seconds=each.seconds, error=best))
    return found


def mpm_error(prices: Prices, seconds: float) -> float | None:
    """The MPM's error at a price, interpolated in the logarithms; None for less than its cheapest run.

    Beyond its dearest run it is that run's.
    """
    points = curve(prices)
    if seconds < points[0].seconds:
        return None
    x, y = (np.log([getattr(each, key) for each in points]) for key in ("seconds", "error"))
    return math.exp(float(np.interp(math.log(seconds), x, y)))


def mpm_seconds(prices: Prices, error: float) -> float | None:
    """The price at which the MPM's error is no larger than `error`, interpolated likewise; None where it never is.

    That of its cheapest run where this is good enough.
    """
    points = curve(prices)
    if error >= points[0].error:
        return points[0].seconds
    for coarser, finer in pairwise(points):
        if finer.error <= error:
            share = math.log(error / coarser.error) / math.log(finer.error / coarser.error)
            return math.exp((1.0 - share) * math.log(coarser.seconds) + share * math.log(finer.seconds))
    return None


def said(name: str, prices: Prices) -> str:
    """From which to which price a model lies below the MPM's curve, or that it does not, and by how much."""
    model = prices.models[name]
    there, same = mpm_error(prices, model.seconds), mpm_seconds(prices, model.error)
    own = f"`{name}` has {model.error:.1%} for {model.seconds:.2g} s"
    if there is None:
        cheapest = curve(prices)[0]
        return f"{own}, below the price of any run of the MPM ({cheapest.error:.1%} for {cheapest.seconds:.2g} s)"
    if model.error < there:
        until = "no run of the MPM" if same is None else f"the MPM only from {same:.2g} s on"
        return f"{own}, where the MPM has {there:.1%}; so small an error has {until}"
    if same is None:
        return f"{own}, no less than the MPM's {there:.1%} at that price"
    return (
        f"{own}, above the MPM's curve, which has {there:.1%} at that price and the same error for {same:.2g} s: it is"
        " for gradients and for many candidates at once, not for a single run"
    )
