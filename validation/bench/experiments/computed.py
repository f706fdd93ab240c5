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
from validation.bench.experiments.angle import ROUNDS, Search, search_all
from validation.bench.experiments.scores import AngleScore, Score
from validation.experiments.experiment import Angle, Case, Course, Shipped, Variant
from validation.experiments.quantities import Floats, quantity

Simulate = Callable[[Sequence[Scene]], Sequence[Positions]]
"""Scenes in, their deposits [m], each of shape [N, D], out."""
Key = tuple[str, str, float]
"""Experiment, case and cell [m]."""
Follow = Callable[[Scene], Trajectory]
"""A scene in, its whole motion out."""


@dataclass(frozen=True, kw_only=True)
class VariantFound:
    """What a scene that differs in one respect shows, beside the one that it differs from."""

    shipped: Shipped
    variant: Variant
    measured: tuple[float, float]
    """Value and spread [m]."""
    found: float
    """Extent of the variant [m]."""
    usual: float
    """Extent of the case itself, on the same cells at the same angle [m]."""
    cell: float
    """[m]."""


@dataclass(frozen=True, kw_only=True)
class CourseFound:
    """An extent over time at the angle that was inferred from its end, beside the measured one."""

    experiment: str
    case: Case
    course: Course
    deg: float
    """Angle of friction [deg]."""
    found: tuple[float, ...]
    """Extents [m] at the times of the course."""


@dataclass(frozen=True, kw_only=True)
class Findings:
    """Everything that a page says."""

    shipped: tuple[Shipped, ...]
    scores: tuple[Score, ...]
    """By the first angle of each experiment."""
    others: tuple[Score, ...]
    """By its other angles."""
    angles: tuple[AngleScore, ...]
    variants: tuple[VariantFound, ...]
    courses: tuple[CourseFound, ...] = ()


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
    forward = run_forward(shipped, simulate)
    places = {
        (each.name, case.name, cell): (each, case)
        for each in shipped
        for case in each.experiment.cases
        if case.target is not None
        for cell in each.cells(case)
    }
    searches = {key: search_from(*places[key], key[2], forward) for key in places}

    def extents(asked: Sequence[tuple[Key, float]]) -> list[float]:
        scenes = [places[key][0].scene(places[key][1].scene, key[2], angle) for key, angle in asked]
        return [
            extent(*places[key], scene, deposit)
            for (key, _), scene, deposit in zip(asked, scenes, simulate(scenes), strict=True)
        ]

    search_all(searches, extents, rounds)
    scores = [score(each, case, angle, forward) for each, case, angle in forward_cases(shipped)]
    flat = [one for some in scores for one in some]
    first = {each.name: each.experiment.angles[0] for each in shipped if each.experiment.angles}
    return Findings(
        shipped=tuple(shipped),
        scores=tuple(one for one in flat if one.angle == first[one.experiment]),
        others=tuple(one for one in flat if one.angle != first[one.experiment]),
        angles=tuple(
            angle_score(each, case, searches)
            for each in shipped
            for case in each.experiment.cases
            if case.target is not None
        ),
        variants=tuple(run_variants(shipped, simulate, forward)),
        courses=tuple(run_courses(shipped, searches, follow)),
    )


def angle_score(shipped: Shipped, case: Case, searches: Mapping[Key, Search]) -> AngleScore:
    """What the searches of a case came to."""
    assert case.target is not None, "only asked of cases that have one"
    coarse, fine = (searches[shipped.name, case.name, cell].inferred() for cell in shipped.cells(case))
    return AngleScore(
        experiment=shipped.name,
        case=case,
        measured=case.measured[case.target],
        angles=shipped.experiment.angles,
        inferred=(coarse, fine),
    )


Forward = dict[tuple[str, str, float, float], tuple[Scene, Positions]]
"""(experiment, case, cell [m], angle [deg]): the scene and its deposit."""


def forward_cases(shipped: Sequence[Shipped]) -> list[tuple[Shipped, Case, Angle]]:
    """Every case with every angle of its material."""
    return [
        (each, case, angle) for each in shipped for case in each.experiment.cases for angle in each.experiment.angles
    ]


def run_forward(shipped: Sequence[Shipped], simulate: Simulate) -> Forward:
    """The deposits of every case at every angle, on both cells."""
    keys = [(each, case, cell, angle.deg) for each, case, angle in forward_cases(shipped) for cell in each.cells(case)]
    scenes = [each.scene(case.scene, cell, deg) for each, case, cell, deg in keys]
    return {
        (each.name, case.name, cell, deg): (scene, deposit)
        for (each, case, cell, deg), scene, deposit in zip(keys, scenes, simulate(scenes), strict=True)
    }


def extent(shipped: Shipped, case: Case, scene: Scene, deposit: Positions) -> float:
    """The front or radius [m] that an angle is inferred from, of a deposit."""
    assert case.target is not None, "only asked of cases that have one"
    return quantity(case.measured[case.target], scene, deposit)


def search_from(shipped: Shipped, case: Case, cell: float, forward: Forward) -> Search:
    """A search that knows the runs forward."""
    assert case.target is not None, "only asked of cases that have one"
    measured = case.measured[case.target]
    known = {
        deg: extent(shipped, case, *forward[shipped.name, case.name, cell, deg])
        for deg in (angle.deg for angle in shipped.experiment.angles)
    }
    return Search(target=measured.value, spread=measured.spread, known=known)


def score(shipped: Shipped, case: Case, angle: Angle, forward: Forward) -> list[Score]:
    """The scores of a case's measured numbers at an angle."""
    cells = shipped.cells(case)
    runs = [forward[shipped.name, case.name, cell, angle.deg] for cell in cells]
    scores = []
    for measured in case.measured:
        coarse, fine = (quantity(measured, scene, deposit) for scene, deposit in runs)
        scores.append(
            Score(experiment=shipped.name, case=case, measured=measured, angle=angle, cells=cells, found=(coarse, fine))
        )
    return scores


def run_variants(shipped: Sequence[Shipped], simulate: Simulate, forward: Forward) -> list[VariantFound]:
    """The variants of all experiments that have an angle, at the first one."""
    asked = [(each, variant) for each in shipped if each.experiment.angles for variant in each.experiment.variants]
    cases = [next(case for case in each.experiment.cases if case.name == variant.case) for each, variant in asked]
    cells = [each.cells(case)[0] for (each, _), case in zip(asked, cases, strict=True)]
    scenes = [
        each.scene(variant.scene, cell, each.experiment.angles[0].deg)
        for (each, variant), cell in zip(asked, cells, strict=True)
    ]
    found = []
    for (each, variant), case, cell, scene, deposit in zip(asked, cases, cells, scenes, simulate(scenes), strict=True):
        assert case.target is not None, "a variant is of a case with an extent"
        measured = case.measured[case.target]
        usual = forward[each.name, case.name, cell, each.experiment.angles[0].deg]
        found.append(
            VariantFound(
                shipped=each,
                variant=variant,
                measured=(measured.value, measured.spread),
                found=extent(each, case, scene, deposit),
                usual=extent(each, case, *usual),
                cell=cell,
            )
        )
    return found


def run_courses(shipped: Sequence[Shipped], searches: Mapping[Key, Search], follow: Follow) -> list[CourseFound]:
    """Extents over time, on the fine cells, at the angles that the searches came to."""
    found = []
    for each in shipped:
        for case in each.experiment.cases:
            if case.course is None or case.target is None:
                continue
            cell = each.cells(case)[1]
            deg = searches[each.name, case.name, cell].inferred().deg
            if math.isnan(deg):
                continue
            flow = follow(each.scene(case.scene, cell, deg))
            extents = [extent(each, case, flow.scene, positions) for positions in flow.positions]
            extents_at = extents_over_time(flow.time, extents, case.course)
            found.append(CourseFound(experiment=each.name, case=case, course=case.course, deg=deg, found=extents_at))
    return found


def extents_over_time(time: Floats, extents: Sequence[float], course: Course) -> tuple[float, ...]:
    """The extents [m] of a motion at the times of a course, counted from when it is as far as the course's first row.

    time: [s] of the motion's frames, extents: [m] at them.
    """
    # What falls back by the scatter of a quantile has still been there.
    furthest = np.maximum.accumulate(np.array(extents))
    start = float(np.interp(course.values[0], furthest, time))
    return tuple(float(value) for value in np.interp(start + np.array(course.times), time, furthest))
