"""How certain the answer is: an ensemble of MPM runs with several jitter seeds, calibrated against the target.

One unknown is calibrated by itself (`validation.loop.calibration`), several together (`validation.loop.joint`). Of many numbers,
a profile or a deposit, what counts is their component along the directions in which they change with the unknowns.
"""

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student_t

from datasets.scene import Scene
from inverse.finite_difference import jacobian
from inverse.forward.interface import Simulate
from inverse.observations.deposit import Values
from inverse.observations.target import Target
from inverse.optimise import Bounds
from inverse.parameters.parameters import Vector, with_unknowns
from inverse.problem import Observable, Problem
from inverse.result import Combination, Identifiability
from validation.loop.agreement import distance
from validation.loop.calibration import CONFIDENCE, Calibration, calibrate
from validation.loop.discrepancy import Discrepancy
from validation.loop.joint import Joint, estimate
from validation.loop.search import Checked, Search

SPREAD = 0.05
"""How far around the answer the ensemble reaches, as a fraction of an unknown's range (2 degrees)."""
MOST_BY_MPM = 12
"""Unknowns up to which the slopes are the MPM's own; beyond, those of the corrected surrogate."""
LEAST = 1e-6
"""Least standard deviation of a combination, as a fraction of the range: singular values stay numbers."""


@dataclass(frozen=True, kw_only=True)
class Certainty:
    """What the ensemble says."""

    calibrations: dict[str, Calibration]
    """Per unknown. Of several, slope and scatter are root mean squares over what is compared, along what this unknown
    alone moves; of a design, see `tolerances`."""
    misfit: float
    """Between two runs at the answer that differ in their jitter seed only, in the measure of
    `validation.loop.agreement.distance`, root mean square."""
    front_misfit: float
    """Relative difference of their fronts, root mean square [-]."""
    runs: Sequence[Checked]
    """The ensemble."""
    centre: Vector
    """The unknowns that it is around, shape [U]."""
    joint: Joint | None = None
    """Of several unknowns, in fractions of their ranges from the centre."""
    bend: Vector | None = None
    """Of several unknowns: by how much the run at the answer says that each is off, for the MPM's slopes change on the
    way there from the centre, shape [U]; part of the half-width."""
    identifiability: Identifiability | None = None
    """Absent for a design."""
    slope: NDArray[np.float64] | None = None
    """Of the observation, per range of each unknown, shape [M, U]; absent for a design."""
    discrepancy: Discrepancy | None = None
    """How the answer fits; absent where nothing is left to tell."""

    @property
    def widened(self) -> float:
        """By which factor the half-widths are wider for the discrepancy of the model; 1 where there is none."""
        return 1.0 if self.discrepancy is None else self.discrepancy.factor

    @property
    def here(self) -> list[Checked]:
        """The runs at the centre."""
        return [run for run in self.runs if np.array_equal(run.unknowns, self.centre)]


def certainty(state: Search, answer: Vector, simulate: Simulate) -> Certainty:
    """Run the MPM around `answer` and calibrate the unknowns against the target."""
    if state.single:
        return one(state, answer, simulate)
    return design(state, answer, simulate) if state.problem.target.least else several(state, answer, simulate)


def one(state: Search, answer: Vector, simulate: Simulate) -> Certainty:
    """Of a single unknown: a regression over the ensemble and all runs nearby."""
    problem, target = state.problem, state.target.values
    members = ensemble(problem, answer, state.bounds)
    trajectories = simulate([scene for _, scene in members])
    runs = [state.judge(point, trajectory) for (point, _), trajectory in zip(members, trajectories, strict=True)]
    here = [run for run in runs if np.array_equal(run.unknowns, answer)]
    direction = sensitive_direction(state, answer)
    telling = [
        run
        for run in [*runs, *state.checked]
        if abs(run.unknowns[0] - answer[0]) <= 1.5 * SPREAD * state.bounds.range[0]
    ]
    calibration = calibrate(
        np.array([run.unknowns[0] for run in telling]),
        np.array([run.observation @ direction for run in telling]),
        float(target @ direction),
        noise_along(state.target, direction),
    )
    (unknown,) = problem.unknowns
    return Certainty(
        calibrations={unknown.name: calibration},
        misfit=apart(state, here),
        front_misfit=fronts_apart(here),
        runs=runs,
        centre=answer,
        identifiability=of_one(state, calibration, noise_along(state.target, direction)),
        slope=slope_of(telling, state.bounds),
    )


def several(state: Search, answer: Vector, simulate: Simulate) -> Certainty:
    """Of several unknowns: all at once."""
    by_mpm = len(answer) <= MOST_BY_MPM
    runs, here, slopes = around(state, answer, simulate, replicates=replicates(state.problem) if by_mpm else 0)
    seen, target = np.stack([run.observation for run in here]), state.target.values
    if not by_mpm:
        model = state.corrected()
        wanted = model.surrogate.wanted
        seen, target = np.stack([wanted(row) for row in seen]), wanted(target)
        slopes = jacobian(model, answer, SPREAD * state.bounds.range)[None] * state.bounds.range
    known = state.target.covariance
    joint = estimate(
        seen,
        slopes,
        target,
        noise=state.target.noise,
        distance=SPREAD,
        given=not by_mpm,
        covariance=known if known is not None and len(known) == len(target) else None,
    )
    widths, compared = state.bounds.range, seen.shape[1] / state.observation.components
    calibrations = {}
    for index, name in enumerate(state.problem.names):
        # One unit of this unknown, the others free to undo what they can of it.
        slope = 1.0 / max(float(np.linalg.norm(joint.gain[index])) * widths[index] * math.sqrt(compared), 1e-300)
        calibrations[name] = Calibration(
            estimate=float(answer[index] + joint.estimate[index] * widths[index]),
            half_width=float(joint.half_widths[index] * widths[index]),
            slope=slope,
            scatter=slope * float(joint.scatter[index] * widths[index]),
        )
    return Certainty(
        calibrations=calibrations,
        misfit=apart(state, here),
        front_misfit=fronts_apart(here),
        runs=runs,
        centre=answer,
        joint=joint,
        identifiability=of_several(state, joint),
        slope=joint.slope,
    )


def slope_of(runs: Sequence[Checked], bounds: Bounds) -> NDArray[np.float64]:
    """Least-squares slope of the observation over a single unknown, per range, shape [M, 1]."""
    unknown = np.array([run.unknowns[0] for run in runs]) / bounds.range[0]
    seen = np.stack([run.observation for run in runs])
    off = unknown - unknown.mean()
    return np.asarray(off @ (seen - seen.mean(axis=0)) / (off @ off))[:, None]


def design(state: Search, answer: Vector, simulate: Simulate) -> Certainty:
    """Of a design nothing is to be estimated: how far may an unknown move before the MPM tells the difference?

    The half-width is the distance at which slope and curvature of the observation, by the runs on either side, have
    changed it by t times the scatter of the difference of a run from the mean at the answer.
    """
    runs, here, _ = around(state, answer, simulate, replicates=replicates(state.problem))
    at = np.array([run.observation[0] for run in here])
    scatter = float(at.std(ddof=1))
    student = float(student_t.ppf(0.5 + CONFIDENCE / 2.0, len(at) - 1))
    change = student * scatter * math.sqrt(1.0 + 1.0 / len(at))
    calibrations = {}
    for index, name in enumerate(state.problem.names):
        moved = [run for run in runs if run.unknowns[index] != answer[index]]
        steps = np.array([run.unknowns[index] - answer[index] for run in moved])
        rise = np.array([run.observation[0] for run in moved]) - at.mean()
        slope, bend = np.linalg.lstsq(np.stack([steps, steps**2], axis=1), rise, rcond=None)[0]
        roots = np.roots([max(float(bend), 1e-12), abs(float(slope)), -change])
        calibrations[name] = Calibration(
            estimate=float(answer[index]),
            half_width=float(min(max(roots.real), state.bounds.range[index])),
            slope=float(slope),
            scatter=scatter,
        )
    return Certainty(
        calibrations=calibrations,
        misfit=apart(state, here),
        front_misfit=fronts_apart(here),
        runs=runs,
        centre=answer,
    )


def around(
    state: Search, answer: Vector, simulate: Simulate, *, replicates: int
) -> tuple[list[Checked], list[Checked], NDArray[np.float64]]:
    """All runs of an ensemble around `answer`, those at it, and slopes per range from both sides, shape [K, M, U].

    Runs on either side share their jitter seed: what is chance in both of them alike goes out of their difference.
    """
    seeds = [
        int(seed) for seed in np.random.SeedSequence(state.problem.scene.seed).generate_state(state.problem.loop.seeds)
    ]
    points = [(answer, seed) for seed in seeds]
    for index, width in enumerate(state.bounds.range):
        for side in (-1.0, 1.0):
            moved = answer.copy()
            moved[index] += side * SPREAD * width
            points += [(state.rounded(moved), seed) for seed in seeds[:replicates]]
    trajectories = simulate([state.scene(point, seed) for point, seed in points])
    runs = [state.judge(point, trajectory) for (point, _), trajectory in zip(points, trajectories, strict=True)]
    here, rest = runs[: len(seeds)], runs[len(seeds) :]
    columns = []
    for index, width in enumerate(state.bounds.range):
        behind, ahead = (rest[(2 * index + side) * replicates :][:replicates] for side in (0, 1))
        columns.append(
            [
                (high.observation - low.observation) / (high.unknowns[index] - low.unknowns[index]) * width
                for low, high in zip(behind, ahead, strict=True)
            ]
        )
    slopes = np.array(columns).reshape(len(answer), replicates, len(here[0].observation))
    return runs, here, np.moveaxis(slopes, 0, -1)


def replicates(problem: Problem) -> int:
    """Runs on either side of the answer in each unknown: about as many in all as at it, and two at least."""
    return max(2, problem.loop.seeds // (2 * len(problem.unknowns)))


def apart(state: Search, runs: Sequence[Checked]) -> float:
    """How far two of `runs` are apart, root mean square."""
    kind, components = state.problem.observation.kind, state.observation.components
    pairs = [
        distance(kind, a.observation, b.observation, components) for number, a in enumerate(runs) for b in runs[:number]
    ]
    return math.sqrt(float(np.mean(np.square(pairs))))


def fronts_apart(runs: Sequence[Checked]) -> float:
    """Relative difference of the fronts of two of `runs`, root mean square [-]."""
    fronts = np.array([run.front for run in runs])
    return float(math.sqrt(2.0) * fronts.std(ddof=1) / fronts.mean())


def sensitive_direction(state: Search, answer: Vector) -> Values:
    """Unit vector in the space of observations along which the unknown moves it, shape [M].

    By the corrected surrogate, not by the ensemble: a direction fitted to the runs' own scatter would hide it.
    """
    if state.target.values.size == 1:
        return np.ones(1)
    slope = jacobian(state.corrected(), answer, SPREAD * state.bounds.range)[:, 0]
    length = float(np.linalg.norm(slope))
    return slope / (length if length > 0.0 else 1.0)


def ensemble(problem: Problem, answer: Vector, bounds: Bounds) -> list[tuple[Vector, Scene]]:
    """Of a single unknown, unknowns and scene of each run: `seeds` jitters at the answer, half as many on either side.

    The seeds are drawn from the scene's, so that a target's own seed is none of them.
    """
    count = problem.loop.seeds
    points = [answer] * count
    for side in (-1.0, 1.0):
        points += [bounds.clip(answer + side * SPREAD * bounds.range)] * max(1, count // 2)
    seeds = np.random.SeedSequence(problem.scene.seed).generate_state(len(points))
    return [
        (point, dataclasses.replace(with_unknowns(problem.scene, problem.names, point), seed=int(seed)))
        for point, seed in zip(points, seeds, strict=True)
    ]


def noise_along(target: Target, direction: Values) -> float:
    """Standard deviation of the target's component along a unit vector `direction` [M] by errors of the measurement."""
    if target.covariance is None:
        return target.noise
    return math.sqrt(max(0.0, float(direction @ target.covariance @ direction)))


def of_one(state: Search, calibration: Calibration, noise: float) -> Identifiability:
    """What a calibration says of a single unknown; noise: of the measurement, along the unknown's direction."""
    (name,), (width,) = state.problem.names, state.bounds.range
    slope = max(abs(calibration.slope), 1e-300)
    combination = Combination(
        weights={name: 1.0},
        singular_value=float(1.0 / max(math.hypot(calibration.scatter, noise) / (width * slope), LEAST)),
        half_width=float(calibration.half_width / width),
    )
    return Identifiability(
        combinations=[combination],
        half_a_cell={name: 0.5 * state.problem.scene.domain.cell / slope},
        scatter={name: calibration.scatter / slope},
        noise={name: noise / slope},
    )


def of_several(state: Search, joint: Joint) -> Identifiability:
    """The combinations of the unknowns, best known first, and what errors of the observation mean for each unknown."""
    names, widths = state.problem.names, state.bounds.range
    values, vectors = np.linalg.eigh(joint.spread)
    deviations = np.sqrt(np.maximum(values, LEAST**2))
    combinations = [
        Combination(
            weights=dict(zip(names, (vector * np.sign(vector[np.argmax(np.abs(vector))])).tolist(), strict=True)),
            singular_value=float(1.0 / deviation),
            half_width=float(joint.student * deviation),
        )
        for deviation, vector in zip(deviations, vectors.T, strict=True)
    ]
    gain = np.linalg.norm(joint.gain, axis=1) * widths

    def by_name(values: NDArray[np.float64]) -> dict[str, float]:
        return dict(zip(names, values.tolist(), strict=True))

    share = state.problem.observation.kind in (Observable.PASSED, Observable.SEVERAL)
    return Identifiability(
        combinations=combinations,
        half_a_cell=None if share else by_name(0.5 * state.problem.scene.domain.cell * gain),
        scatter=by_name(joint.scatter * widths),
        noise=by_name(joint.noise * widths),
    )
