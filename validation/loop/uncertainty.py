"""Uncertainty of the parameters: an ensemble of MPM runs with several jitter seeds, at an answer and on either side."""

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student_t

from inverse.jacobian import by_differences
from inverse.parameters import Vector
from inverse.result import Combination, Identifiability
from validation.loop.check import ENSEMBLE, Check, History, Task
from validation.loop.correct import corrected
from validation.loop.discrepancy import Discrepancy
from validation.loop.estimate import CONFIDENCE, Estimate, estimate

SPREAD = 0.05
"""Distance of the runs on either side, as a fraction of a parameter's range (2 degrees)."""
MAX_BY_MPM = 12
"""Parameters up to which the slopes are the MPM's own; beyond, those of the corrected surrogate."""
MIN_DEVIATION = 1e-6
"""Smallest standard deviation of a combination, as a fraction of the range: singular values stay finite."""


@dataclass(frozen=True, kw_only=True)
class Uncertainty:
    """The parameters by an ensemble around `centre`, with their 95 % half-widths."""

    centre: Vector
    """Shape [U]."""
    runs: tuple[Check, ...]
    """The ensemble."""
    at_centre: tuple[Check, ...]
    """Of these the runs at the centre, each with a jitter seed of its own."""
    values: Vector
    """The parameters that belong to the target, shape [U]; of a design its centre."""
    half_widths: Vector
    """Shape [U]; of a design the change of a parameter that a run distinguishes from the scatter."""
    slopes: Vector
    """Of the observation, root mean square over what is compared, with a parameter and what the others cannot undo of
    it, shape [U] [unit of the observation per unit of the parameter]."""
    scatter: Vector
    """Standard deviation of the observation along the same, between runs that differ in their jitter seed, [U]."""
    misfit_scatter: float
    """Root mean square of `Observation.distance` between two runs at the centre."""
    front_scatter: float
    """The same of the relative difference of their fronts [-]."""
    estimate: Estimate | None = None
    """In fractions of the ranges from the centre; absent for a design."""
    identifiability: Identifiability | None = None
    """Absent for a design."""
    curvature: Vector | None = None
    """Error of each parameter because the MPM's slopes change between the centre and the answer, shape [U]."""
    discrepancy: Discrepancy | None = None
    """Of the answer; absent where no numbers are left over for it."""

    @property
    def factor(self) -> float:
        """Of the half-widths, for the discrepancy of the model; 1 where there is none."""
        return 1.0 if self.discrepancy is None else self.discrepancy.factor

    def widths(self, answer: Vector, ranges: Vector) -> Vector:
        """Half-widths around `answer`, shape [U]: with curvature and discrepancy; at most `ranges`, known before."""
        curvature = 0.0 if self.curvature is None else self.curvature
        total = self.factor * np.hypot(self.half_widths, curvature) + np.abs(self.values - answer)
        return np.asarray(np.minimum(total, ranges))


def by_ensemble(task: Task, history: History, centre: Vector) -> Uncertainty:
    """Run the ensemble around `centre` and estimate the parameters by it."""
    if task.problem.target.minimise:
        return of_design(task, centre)
    count, ranges, target = len(centre), task.bounds.range, task.target.values
    by_mpm = count <= MAX_BY_MPM
    runs, here, slopes = ensemble(task, centre, replicates(task) if by_mpm else 0)
    observed = np.stack([run.observation for run in here])
    if not by_mpm:
        model = corrected(task, history)
        observed, target = np.stack([model.select(row) for row in observed]), model.select(target)
        slopes = (by_differences(model, centre, SPREAD * ranges) * ranges)[None]
    covariance = task.target.covariance
    found = estimate(
        observed,
        slopes,
        target,
        noise=task.target.noise,
        distance=SPREAD,
        exact_slopes=not by_mpm,
        covariance=covariance if covariance is not None and len(covariance) == len(target) else None,
    )
    compared = observed.shape[1] / task.observation.components
    signs = np.where(found.jacobian.sum(axis=0) < 0.0, -1.0, 1.0) if observed.shape[1] == 1 else np.ones(count)
    steepness = 1.0 / np.maximum(np.linalg.norm(found.gain, axis=1) * ranges * math.sqrt(compared), 1e-300)
    return Uncertainty(
        centre=centre,
        runs=tuple(runs),
        at_centre=tuple(here),
        values=centre + found.values * ranges,
        half_widths=found.half_widths * ranges,
        slopes=signs * steepness,
        scatter=steepness * found.scatter * ranges,
        misfit_scatter=misfit_scatter(task, here),
        front_scatter=front_scatter(here),
        estimate=found,
        identifiability=identifiability(task, found),
    )


def of_design(task: Task, centre: Vector) -> Uncertainty:
    """Of a design no parameter is estimated: what change of one does the MPM distinguish from its scatter?

    The half-width is the distance at which slope and curvature of the observation, by the runs on either side, have
    changed it by t times the scatter of the difference of a run from the mean at the centre.
    """
    runs, here, _ = ensemble(task, centre, replicates(task))
    base = np.array([run.observation[0] for run in here])
    scatter = float(base.std(ddof=1))
    student = float(student_t.ppf(0.5 + CONFIDENCE / 2.0, len(base) - 1))
    change = student * scatter * math.sqrt(1.0 + 1.0 / len(base))
    slopes, widths = [], []
    for index, width in enumerate(task.bounds.range):
        moved = [run for run in runs if run.parameters[index] != centre[index]]
        steps = np.array([run.parameters[index] - centre[index] for run in moved])
        rise = np.array([run.observation[0] for run in moved]) - base.mean()
        slope, bend = np.linalg.lstsq(np.stack([steps, steps**2], axis=1), rise, rcond=None)[0]
        roots = np.roots([max(float(bend), 1e-12), abs(float(slope)), -change])
        slopes.append(float(slope))
        widths.append(float(min(max(roots.real), width)))
    return Uncertainty(
        centre=centre,
        runs=tuple(runs),
        at_centre=tuple(here),
        values=centre,
        half_widths=np.array(widths),
        slopes=np.array(slopes),
        scatter=np.full(len(centre), scatter),
        misfit_scatter=misfit_scatter(task, here),
        front_scatter=front_scatter(here),
    )


def ensemble(task: Task, centre: Vector, pairs: int) -> tuple[list[Check], list[Check], NDArray[np.float64]]:
    """All runs of an ensemble, those at `centre`, and slopes per range from both sides, shape [pairs, M, U].

    Runs on either side share their jitter seed: scatter that both have in common cancels in their difference.
    """
    seeds = np.random.SeedSequence(task.problem.scene.seed).generate_state(task.problem.loop.seeds).tolist()
    points = [(centre, seed) for seed in seeds]
    for index, width in enumerate(task.bounds.range):
        for sign in (-1.0, 1.0):
            moved = centre.copy()
            moved[index] += sign * SPREAD * width
            points += [(task.rounded(moved), seed) for seed in seeds[:pairs]]
    scenes = [task.problem.scene_at(point, seed) for point, seed in points]
    flows = task.store(ENSEMBLE)(scenes, record=task.deposit_or_all)
    runs = [task.compare(point, flow) for (point, _), flow in zip(points, flows, strict=True)]
    here, rest = runs[: len(seeds)], iter(runs[len(seeds) :])
    columns = []
    for index, width in enumerate(task.bounds.range):
        behind, ahead = ([next(rest) for _ in range(pairs)] for _ in range(2))
        columns.append(
            [
                (high.observation - low.observation) / (high.parameters[index] - low.parameters[index]) * width
                for low, high in zip(behind, ahead, strict=True)
            ]
        )
    slopes = np.array(columns).reshape(len(centre), pairs, len(here[0].observation))
    return runs, here, np.moveaxis(slopes, 0, -1)


def replicates(task: Task) -> int:
    """Runs on either side in each parameter: about as many in all as at the centre, and two at least."""
    return max(2, task.problem.loop.seeds // (2 * len(task.problem.parameters)))


def misfit_scatter(task: Task, runs: Sequence[Check]) -> float:
    """Distance of two of `runs`, root mean square."""
    pairs = [
        task.observation.distance(one.observation, other.observation)
        for number, one in enumerate(runs)
        for other in runs[:number]
    ]
    return math.sqrt(float(np.mean(np.square(pairs))))


def front_scatter(runs: Sequence[Check]) -> float:
    """Relative difference of the fronts of two of `runs`, root mean square [-]."""
    fronts = np.array([run.front for run in runs])
    return float(math.sqrt(2.0) * fronts.std(ddof=1) / fronts.mean())


def identifiability(task: Task, found: Estimate) -> Identifiability:
    """The combinations of the parameters, best constrained first, and the effect of errors on each parameter."""
    names, ranges = task.problem.names, task.bounds.range
    values, vectors = np.linalg.eigh(found.spread)
    deviations = np.sqrt(np.maximum(values, MIN_DEVIATION**2))
    combinations = [
        Combination(
            weights=dict(zip(names, (vector * np.sign(vector[np.argmax(np.abs(vector))])).tolist(), strict=True)),
            singular_value=float(1.0 / deviation),
            half_width=float(found.student * deviation),
        )
        for deviation, vector in zip(deviations, vectors.T, strict=True)
    ]
    cell, named = task.problem.scene.domain.cell, task.problem.named
    in_metres = task.observation.unit == "m"
    return Identifiability(
        combinations=combinations,
        half_a_cell=named(0.5 * cell * np.linalg.norm(found.gain, axis=1) * ranges) if in_metres else None,
        scatter=named(found.scatter * ranges),
        noise=named(found.noise * ranges),
    )


def with_curvature(task: Task, history: History, uncertainty: Uncertainty, check: Check) -> Uncertainty:
    """`uncertainty` with the error that `check`, run where it pointed to, shows the linear estimate to have."""
    found, ranges = uncertainty.estimate, task.bounds.range
    base = [each for each in history.checks if np.array_equal(each.parameters, uncertainty.centre)]
    if found is None or not base or len(found.centre) != len(check.observation):
        return uncertainty
    moved, change = (check.parameters - uncertainty.centre) / ranges, check.observation - base[0].observation
    return dataclasses.replace(uncertainty, curvature=found.curvature(moved, change) * ranges)
