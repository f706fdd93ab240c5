"""All runs of the experiments: forward at every angle that was measured independently, backward from the extents."""

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from datasets.measures import Positions
from datasets.scene import Scene
from datasets.trajectory import Trajectory
from mpm import simulate as simulate_scene
from validation.bench.experiments.angle import ROUNDS, AngleSearch, search_all
from validation.bench.experiments.scores import AngleScore, Score, SeriesScore, VariantScore
from validation.experiments.experiment import MeasuredScene, Shipped, TimeSeries
from validation.experiments.quantities import Floats, quantity

Simulate = Callable[[Sequence[Scene]], Sequence[Positions]]
"""Scenes to their deposits [m], each of shape [N, D]."""
Follow = Callable[[Scene], Trajectory]
"""A scene to its whole motion."""
Key = tuple[str, str, float]
"""Experiment, case and cell [m]."""
Deposits = Mapping[tuple[str, str, float, float], tuple[Scene, Positions]]
"""By experiment, case, cell [m] and angle [deg]: the scene and its deposit."""


@dataclass(frozen=True, kw_only=True)
class Findings:
    """All that the page is made from."""

    shipped: tuple[Shipped, ...]
    scores: tuple[Score, ...]
    """By the first angle of each experiment."""
    others: tuple[Score, ...]
    """By its other angles."""
    angles: tuple[AngleScore, ...]
    variants: tuple[VariantScore, ...]
    series: tuple[SeriesScore, ...] = ()


def with_cells(shipped: Shipped, factor: float) -> Shipped:
    """The same experiment on cells larger by `factor` [-]."""

    def larger(cells: tuple[float, float]) -> tuple[float, float]:
        return factor * cells[0], factor * cells[1]

    cases = tuple(
        dataclasses.replace(case, cells=None if case.cells is None else larger(case.cells))
        for case in shipped.experiment.cases
    )
    experiment = dataclasses.replace(shipped.experiment, cells=larger(shipped.experiment.cells), cases=cases)
    return dataclasses.replace(shipped, experiment=experiment)


def compute(
    shipped: Sequence[Shipped], simulate: Simulate, *, follow: Follow = simulate_scene, rounds: int = ROUNDS
) -> Findings:
    """Run everything; follow: for extents over time; rounds: of the search for the angles."""
    pairs = [(each, case) for each in shipped for case in each.experiment.cases]
    deposits = run_forward(pairs, simulate)
    targets = {(each.name, case.name, cell): (each, case) for each, case in pairs for cell in each.cells(case)}
    searches = {
        key: AngleSearch(
            target=case.extent.value,
            spread=case.extent.spread,
            known={angle.deg: quantity(case.extent, *deposits[*key, angle.deg]) for angle in each.experiment.angles},
        )
        for key, (each, case) in targets.items()
        if case.extent is not None
    }

    def extents(requested: Sequence[tuple[Key, float]]) -> list[float]:
        runs = [(*targets[key], key[2], angle) for key, angle in requested]
        scenes = [each.scene(case.scene, cell, angle) for each, case, cell, angle in runs]
        return [
            quantity(case.extent, scene, deposit)
            for (_, case, *_), scene, deposit in zip(runs, scenes, simulate(scenes), strict=True)
            if case.extent is not None
        ]

    search_all(searches, extents, rounds)
    by_angle: tuple[list[Score], list[Score]] = ([], [])
    for each, case in pairs:
        for number, angle in enumerate(each.experiment.angles):
            runs = [deposits[each.name, case.name, cell, angle.deg] for cell in each.cells(case)]
            for measured in case.measured:
                coarse, fine = (quantity(measured, *run) for run in runs)
                by_angle[number > 0].append(
                    Score(experiment=each.name, case=case, measured=measured, angle=angle, coarse=coarse, fine=fine)
                )
    angles = [angle_score(each, case, searches) for each, case in pairs if case.extent is not None]
    return Findings(
        shipped=tuple(shipped),
        scores=tuple(by_angle[0]),
        others=tuple(by_angle[1]),
        angles=tuple(angles),
        variants=tuple(run_variants(shipped, simulate, deposits)),
        series=tuple(run_series(pairs, angles, follow)),
    )


def run_forward(pairs: Sequence[tuple[Shipped, MeasuredScene]], simulate: Simulate) -> Deposits:
    """The deposits of every case at every angle of its material, on both cells."""
    runs = [
        (each, case, cell, angle.deg)
        for each, case in pairs
        for angle in each.experiment.angles
        for cell in each.cells(case)
    ]
    scenes = [each.scene(case.scene, cell, deg) for each, case, cell, deg in runs]
    return {
        (each.name, case.name, cell, deg): (scene, deposit)
        for (each, case, cell, deg), scene, deposit in zip(runs, scenes, simulate(scenes), strict=True)
    }


def angle_score(shipped: Shipped, case: MeasuredScene, searches: Mapping[Key, AngleSearch]) -> AngleScore:
    """The results of the searches of a case."""
    coarse, fine = (searches[shipped.name, case.name, cell].inferred() for cell in shipped.cells(case))
    return AngleScore(experiment=shipped.name, case=case, angles=shipped.experiment.angles, coarse=coarse, fine=fine)


def run_variants(shipped: Sequence[Shipped], simulate: Simulate, deposits: Deposits) -> list[VariantScore]:
    """The variants of all experiments that have an angle, at the first one, on the coarse cells."""
    scores = []
    for each in shipped:
        for variant in each.experiment.variants if each.experiment.angles else ():
            case = next(case for case in each.experiment.cases if case.name == variant.case)
            assert case.extent is not None, "a variant is of a case with an extent"
            cell, deg = each.cells(case)[0], each.experiment.angles[0].deg
            scene = each.scene(variant.scene, cell, deg)
            (deposit,) = simulate([scene])
            scores.append(
                VariantScore(
                    experiment=each.name,
                    variant=variant,
                    measured=case.extent,
                    found=quantity(case.extent, scene, deposit),
                    usual=quantity(case.extent, *deposits[each.name, case.name, cell, deg]),
                    cell=cell,
                )
            )
    return scores


def run_series(
    pairs: Sequence[tuple[Shipped, MeasuredScene]], angles: Sequence[AngleScore], follow: Follow
) -> list[SeriesScore]:
    """Extents over time, on the fine cells, at the angles that were inferred."""
    inferred = {(each.experiment, each.case.name): each for each in angles}
    scores = []
    for each, case in pairs:
        if case.series is None or case.extent is None:
            continue
        score = inferred[each.name, case.name]
        if math.isnan(score.fine.deg):
            continue
        flow = follow(each.scene(case.scene, each.cells(case)[1], score.fine.deg))
        extents = [quantity(case.extent, flow.scene, positions) for positions in flow.positions]
        found = extents_over_time(flow.time, extents, case.series)
        scores.append(SeriesScore(label=score.label, series=case.series, deg=score.fine.deg, found=found))
    return scores


def extents_over_time(time: Floats, extents: Sequence[float], series: TimeSeries) -> tuple[float, ...]:
    """The extents [m] of a motion at the times of a series, counted from when it is as far as the series' first row.

    time: [s] of the motion's frames, extents: [m] at them.
    """
    # The quantile of a front scatters; the furthest extent so far does not fall.
    furthest = np.maximum.accumulate(np.array(extents))
    start = float(np.interp(series.values[0], furthest, time))
    return tuple(float(value) for value in np.interp(start + np.array(series.times), time, furthest))
