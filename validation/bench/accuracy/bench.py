"""`python -m validation.bench accuracy`: error over seconds of the MPM, whether --tolerance holds.

`--ship` instead measures `mpm/resolution.toml`, which --tolerance reads, on other scenes; it takes longer.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial

import numpy as np
import tomli_w
from scipy.special import stdtrit

from datasets.errors import InputError
from datasets.files import write_text
from datasets.flow import measures
from datasets.flow.measures import Deposit
from datasets.flow.trajectory import Trajectory
from datasets.scene import Scene
from datasets.scene.particles import initial_particles
from mpm import simulate_many
from mpm.resolution import COVERAGE, MEASURED, MeasuredResolution, Resolution, read_measured, resolved, with_resolution
from mpm.runtime import Arch
from validation.bench.accuracy.flows import OWN_STEP, read_flows
from validation.bench.page import Keep, Out, emphasised, percent, tables, write_page
from validation.run_store import SHARE, Run, RunStore, kept

TOLERANCES = (0.2, 0.15, 0.1, 0.07, 0.05, 0.04, 0.03, 0.02)  # the page shows the resolution that each selects
TRIED = (0.2, 0.1, 0.05)  # tolerances tried on scenes that were not measured
REFERENCE = {2: 56.0, 3: 48.0}  # cells of their references across the smallest side, by dimension
SEED = 7  # of the trials: different from the measured ones
SHIPPED = {2: (5.0, 7.0, 10.0, 14.0, 20.0, 28.0, 40.0), 3: (5.0, 7.0, 10.0, 14.0, 18.0, 24.0)}
"""Cells across the smallest side with which `mpm/resolution.toml` is measured, by dimension, like the following."""
CHECKED = {2: (7.0, 14.0), 3: (5.0,)}  # cells at which another step, 0.4, and 3 particles per axis are tried too
SHIPPED_REFERENCE, SHIPPED_SEEDS = {2: 80.0, 3: 48.0}, {2: 3, 3: 2}


def error(flow: Trajectory, reference: Trajectory) -> float:
    """The larger of the errors of front and profile of a deposit, over the extent [-]; reference: on a much finer grid.
    The profile's error is `measures.transport_distance`; the extent is from the masses' initial rear to the front."""
    deposit, exact = flow.positions[-1], reference.positions[-1]
    front = measures.front(exact, reference.volumes)
    apart = measures.transport_distance(deposit, flow.volumes, exact, reference.volumes)
    extent = front - min(mass.lower[0] for mass in flow.scene.masses)
    return max(abs(measures.front(deposit, flow.volumes) - front), apart) / extent


def deposit_of(flow: Trajectory) -> Deposit:
    """The deposit of a reference: the MPM on fine cells."""
    scene, start = flow.scene, initial_particles(flow.scene).positions
    return Deposit.of_positions(start, flow.positions[-1], flow.volumes, scene.domain.size, measures.ground_of(scene))


@dataclass(frozen=True, kw_only=True)
class Error:
    """Errors of the runs of a scene at a resolution, one per jitter."""

    errors: tuple[float, ...]  # over the extent [-]
    thickness: tuple[float, ...]  # `measures.Errors.thickness` [-]
    seconds: float  # of a run: its share of the time of all parallel runs
    particle_steps: float


Errors = Mapping[Resolution, Mapping[str, Error]]  # by resolution and name of the scene
Limits = Mapping[int, Mapping[Resolution, float]]  # the bound of each measured resolution, by dimension


def own(cells: float, *, step_fraction: float = OWN_STEP, particles_per_axis: int = 2) -> Resolution:
    """A resolution, by default with the step and particles per axis of the references."""
    return Resolution(cells=cells, particles_per_axis=particles_per_axis, step_fraction=step_fraction, precision="f32")


def errors_of(
    scenes: Mapping[str, Scene], tried: Sequence[Resolution], reference: float, seeds: Sequence[int], store: RunStore
) -> Errors:
    """The errors of every scene at every resolution against its own reference."""

    def runs(scene: Scene, resolution: Resolution, seeds: Sequence[int]) -> list[Run]:
        fine = with_resolution(scene, resolution)
        return [Run(scene=replace(fine, seed=seed), precision=resolution.precision) for seed in seeds]

    exact = {name: runs(scene, own(reference), (0,)) for name, scene in scenes.items()}
    coarse = {(resolution, name): runs(scenes[name], resolution, seeds) for resolution in tried for name in scenes}
    store.run([run for group in (*coarse.values(), *exact.values()) for run in group])
    solutions = {name: store.run(group)[0] for name, group in exact.items()}
    deposits = {name: deposit_of(flow) for name, flow in solutions.items()}
    by_resolution: dict[Resolution, dict[str, Error]] = {resolution: {} for resolution in tried}
    for (resolution, name), group in coarse.items():
        flows = store.run(group)
        by_resolution[resolution][name] = Error(
            errors=tuple(error(flow, solutions[name]) for flow in flows),
            thickness=tuple(deposits[name].errors(flow.positions[-1], flow.volumes).thickness for flow in flows),
            seconds=float(np.mean([flow.summary[SHARE] for flow in flows])),
            particle_steps=flows[0].summary["steps"] * flows[0].summary["particles"],
        )
    return by_resolution


def rms(errors: Mapping[str, Error], what: str = "errors") -> float:
    """Root mean square over scenes and jitters."""
    return float(np.sqrt(np.mean([np.mean(np.square(getattr(entry, what))) for entry in errors.values()])))


def mean_seconds(errors: Mapping[str, Error]) -> float:
    return float(np.mean([entry.seconds for entry in errors.values()]))


def prediction_limit(errors: Sequence[float]) -> float:
    """A bound that the error of one more scene keeps with probability COVERAGE, from errors of the measured scenes. The
    upper prediction limit for one further normal variable (Hahn & Meeker 1991), m + t s sqrt(1 + 1/n) with m and s the
    mean and standard deviation of n errors and t Student's quantile for n - 1 degrees of freedom; and no less than the
    largest of them, which a share n / (n + 1) of further scenes stays within whatever the distribution."""
    if (count := len(errors)) < 2:
        return max(errors)
    deviation = float(np.std(errors, ddof=1)) * math.sqrt(1.0 + 1.0 / count)
    return max(float(np.mean(errors)) + float(stdtrit(count - 1, COVERAGE)) * deviation, *errors)


def bound(by_resolution: Errors, resolution: Resolution) -> float:
    """`prediction_limit` of the largest error of each scene here and on all finer grids that differ in nothing else.
    Where errors of both signs cancel, one is small by chance; on finer grids it is not."""
    names, cells = by_resolution[resolution], resolution.cells
    finer = [grid for grid in by_resolution if grid.cells >= cells and replace(grid, cells=cells) == resolution]
    return prediction_limit([max(max(by_resolution[grid][name].errors) for grid in finer) for name in names])


def measured(dimension: int, by_resolution: Errors) -> list[MeasuredResolution]:
    """The measured resolutions, which `--tolerance` reads."""
    return [
        MeasuredResolution(
            dimension=dimension,
            resolution=resolution,
            expected=round(rms(errors), 5),
            promised=round(bound(by_resolution, resolution), 5),
            thickness=round(rms(errors, "thickness"), 5),
            particle_steps=round(float(np.mean([entry.particle_steps for entry in errors.values()]))),
        )
        for resolution, errors in by_resolution.items()
    ]


def toml(resolutions: Sequence[MeasuredResolution]) -> str:
    """The text of `resolution.toml`."""
    return (
        "# What resolutions promise and cost, for --tolerance. By `python -m validation.bench accuracy --ship`.\n"
        "# expected, promised: errors over the extent, rms over scenes and jitters, and the bound for nine of ten\n"
        "# scenes; thickness: over the largest, rms alike; particle_steps: mean over the scenes.\n\n"
    ) + tomli_w.dumps({"measured": [asdict(entry) for entry in resolutions]})


def selected(dimension: int, tolerance: float, resolutions: Sequence[MeasuredResolution]) -> MeasuredResolution | None:
    """The resolution that a tolerance selects in a dimension; None if no measured one is within it."""
    scene = next(iter(read_flows(dimension, unseen=True).values()))
    try:
        return resolved(scene, tolerance, resolutions).measured
    except InputError:
        return None


def bench(*, out: Out, keep: Keep = None, ship: bool = False, arch: Arch = "cpu") -> str:
    """Try --tolerance on scenes on which it was not measured.

    Args:
        ship: Measure mpm/resolution.toml instead, which takes longer.
        arch: Architecture of the runs, as in `mpm.run`; times are processor times only with the default.
    """
    with kept(keep) as folder:
        store = RunStore(folder, partial(simulate_many, arch=arch))
        if ship:
            every = list[MeasuredResolution]()
            for d, sizes in SHIPPED.items():
                tried = [*map(own, sizes)]
                for cells in CHECKED[d]:
                    tried += [own(cells, step_fraction=0.4), own(cells, particles_per_axis=3)]
                scenes, seeds = read_flows(d, unseen=False), range(SHIPPED_SEEDS[d])
                every += measured(d, errors_of(scenes, tried, SHIPPED_REFERENCE[d], seeds, store))
            write_text(MEASURED, toml(every))
            return f"{len(every)} resolutions are in {MEASURED}."
        resolutions, trials = read_measured(), dict[int, Errors]()
        for dimension, reference in REFERENCE.items():
            chosen = [selection for tolerance in TRIED if (selection := selected(dimension, tolerance, resolutions))]
            tried = list(dict.fromkeys(selection.resolution for selection in chosen))
            trials[dimension] = errors_of(read_flows(dimension, unseen=True), tried, reference, (SEED,), store)
    limits = {d: {entry.resolution: entry.promised for entry in resolutions if entry.dimension == d} for d in trials}
    selections = [
        {
            "": f"{d}D",
            "`--tolerance`": percent(tolerance),
            "cells": f"{r.cells:.3g}",
            "particles per axis": r.particles_per_axis,
            "step": f"{r.step_fraction:g}",
            "bound": percent(selection.promised),
            "rms error": percent(selection.expected),
        }
        for d in trials
        for tolerance in TOLERANCES
        if (selection := selected(d, tolerance, resolutions)) is not None and (r := selection.resolution)
    ]
    return write_page(
        out,
        "accuracy",
        conclusion(trials, limits),
        coverage=COVERAGE * 10.0,
        selected=selections,
        references=" and ".join(f"{cells:g} cells in {dimension}D" for dimension, cells in REFERENCE.items()),
        trials=tables(trial_rows(d, by_resolution, limits[d]) for d, by_resolution in trials.items()),
    )


def trial_rows(dimension: int, by_resolution: Errors, limits: Mapping[Resolution, float]) -> list[dict[str, str]]:
    heads = {r: f"{r.cells:g} cells (bound {percent(limits[r])})" for r in by_resolution}
    rows = {
        name: {
            r: emphasised(percent(of[name].errors[0]), of[name].errors[0] <= limits[r])
            for r, of in by_resolution.items()
        }
        for name in next(iter(by_resolution.values()))
    }
    rows["thickness, rms"] = {r: percent(rms(errors, "thickness")) for r, errors in by_resolution.items()}
    rows["seconds of a run, mean"] = {r: f"{mean_seconds(errors):.2g}" for r, errors in by_resolution.items()}
    return [{f"{dimension}D": name} | {heads[r]: cell for r, cell in cells.items()} for name, cells in rows.items()]


def conclusion(trials: Mapping[int, Errors], limits: Limits) -> list[str]:
    held = [
        entry.errors[0] <= limits[dimension][resolution]
        for dimension, by_resolution in trials.items()
        for resolution, errors in by_resolution.items()
        for entry in errors.values()
    ]
    said = [f"{sum(held)} of {len(held)} errors on scenes that `--tolerance` was not measured on are within its bound."]
    for dimension, by_resolution in trials.items():
        parts = [f"{percent(rms(e))} on {r.cells:g} cells ({mean_seconds(e):.2g} s)" for r, e in by_resolution.items()]
        said.append(f"In {dimension}D the rms error is {', '.join(parts)} across the mass.")
    return said
