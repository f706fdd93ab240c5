"""How certain the answer is: an ensemble of MPM runs with several jitter seeds, calibrated against the target.

A profile is many numbers; what counts of it is its component along the direction in which it changes with the unknown.
"""

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from datasets.scene import Scene
from inverse.finite_difference import jacobian
from inverse.forward import Simulate
from inverse.observations import Values
from inverse.optimise import Bounds
from inverse.problem import Problem
from inverse.unknowns import Vector, with_unknowns
from validation.calibration import Calibration, calibrate
from validation.search import Checked, Search

SPREAD = 0.05
"""How far around the answer the ensemble reaches, as a fraction of an unknown's range (2 degrees)."""


@dataclass(frozen=True, kw_only=True)
class Certainty:
    """What the ensemble says."""

    calibrations: dict[str, Calibration]
    """Per unknown, the others held."""
    misfit: float
    """Relative misfit between two runs at the answer that differ in their jitter seed only, root mean square [-]."""
    runs: Sequence[Checked]
    """The ensemble."""


def certainty(state: Search, answer: Vector, simulate: Simulate) -> Certainty:
    """Run the MPM around `answer` and calibrate each unknown against the target."""
    problem, target = state.problem, state.target.values
    members = ensemble(problem, answer, state.bounds)
    trajectories = simulate([scene for _, scene in members])
    runs = [state.judge(point, trajectory) for (point, _), trajectory in zip(members, trajectories, strict=True)]
    everything = [*runs, *state.checked]
    directions = sensitive_directions(state, answer)
    calibrations = {}
    for index, unknown in enumerate(problem.unknowns):
        telling = [run for run in everything if tells(run.unknowns, answer, index, state.bounds.range)]
        calibrations[unknown.name] = calibrate(
            np.array([run.unknowns[index] for run in telling]),
            np.array([run.observation @ directions[index] for run in telling]),
            float(target @ directions[index]),
            problem.target.noise,
        )
    here = np.stack([run.observation for run in runs if np.array_equal(run.unknowns, answer)])
    pairs = [misfit(a, b) for number, a in enumerate(here) for b in here[:number]]
    return Certainty(calibrations=calibrations, misfit=math.sqrt(np.mean(np.square(pairs))), runs=runs)


def misfit(values: Values, target: Values) -> float:
    """Relative L1 misfit: the sum of |values - target| over the sum of the target [-]."""
    return float(np.abs(values - target).sum() / np.abs(target).sum())


def sensitive_directions(state: Search, answer: Vector) -> NDArray[np.float64]:
    """Unit vector in the space of observations along which each unknown moves it, shape [U, M].

    By the corrected surrogate, not by the ensemble: a direction fitted to the runs' own scatter would hide it.
    """
    if state.target.values.size == 1:
        return np.ones((len(answer), 1))
    slopes = jacobian(state.corrected(), answer, SPREAD * state.bounds.range).T
    length = np.linalg.norm(slopes, axis=1, keepdims=True)
    return slopes / np.where(length > 0.0, length, 1.0)


def ensemble(problem: Problem, answer: Vector, bounds: Bounds) -> list[tuple[Vector, Scene]]:
    """Unknowns and scene of each run: `seeds` jitters at the answer, and half as many on either side of it.

    One unknown moves at a time. The seeds are drawn from the scene's, so that a target's own seed is none of them.
    """
    count = problem.loop.seeds
    points = [answer] * count
    for index, width in enumerate(bounds.range):
        for side in (-1.0, 1.0):
            moved = answer.copy()
            moved[index] += side * SPREAD * width
            points += [bounds.clip(moved)] * max(1, count // 2)
    seeds = np.random.SeedSequence(problem.scene.seed).generate_state(len(points))
    names = [unknown.name for unknown in problem.unknowns]
    return [
        (point, dataclasses.replace(with_unknowns(problem.scene, names, point), seed=int(seed)))
        for point, seed in zip(points, seeds, strict=True)
    ]


def tells(point: Vector, answer: Vector, index: int, widths: Vector) -> bool:
    """Whether a run at `point` tells of unknown `index` alone: near the answer, every other unknown as in it."""
    apart = np.abs(point - answer) / widths
    return bool(apart[index] <= 1.5 * SPREAD and np.all(np.delete(apart, index) <= 1e-9))
