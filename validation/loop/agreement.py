"""Whether an observation of the MPM meets the target: how far apart two are, and how far they may be."""

import math
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from inverse.observations.deposit import Values
from inverse.observations.target import Target
from inverse.problem import Observable, Problem
from validation.loop.calibration import CONFIDENCE


@dataclass(frozen=True, kw_only=True)
class Seen:
    """What of one or several runs of the MPM is judged."""

    observation: Values
    """Exact, shape [M]."""
    front_error: float
    """Relative, with its sign; nan where the target tells nothing of a front."""
    components: int
    """Of the observation, see `inverse.observations.deposit.Observation`."""


def distance(kind: Observable, values: Values, wanted: Values, components: int) -> float:
    """How far two observations, both of shape [M], are apart, in the measure in which `kind` is judged.

    Front and runout relative to `wanted`, profile the mean distance of equal shares over the mean x [-]; toe and
    deposit the (root mean square) distance of the points [m]; a share that passed the difference [-]; several
    observations the root mean square of all numbers, in standard deviations [-].
    """
    match kind:
        case Observable.FRONT | Observable.RUNOUT | Observable.PROFILE:
            return float(np.abs(values - wanted).sum() / np.abs(wanted).sum())
        case Observable.TOE | Observable.DEPOSIT | Observable.SEVERAL:
            return math.sqrt(components * float(np.mean((values - wanted) ** 2)))
        case Observable.PASSED:
            return float(abs(values[0] - wanted[0]))


def allowed(problem: Problem, target: Target, chance: float, components: int) -> float:
    """How far the MPM at the answer may be from the target to confirm, in the measure of `distance`.

    chance: the same measure between two runs that differ in their jitter seed alone, root mean square. Where it is
    known and twice of it is more than what was asked, that is what can be had; not for a front, whose runs are
    averaged, nor for a deposit. Stated noise of many numbers stays in the misfit of the best of answers.
    """
    loop, cell, noise = problem.loop, problem.scene.domain.cell, target.noise
    match problem.observation.kind:
        case Observable.FRONT:
            return loop.confirm_within
        case Observable.RUNOUT:
            return max(loop.runout_within, 2.0 * chance)
        case Observable.PASSED:
            return max(loop.passed_within, 2.0 * chance)
        case Observable.PROFILE:
            return math.hypot(max(loop.profile_within, 2.0 * chance), 2.0 * noise / float(np.abs(target.values).mean()))
        case Observable.TOE:
            return math.hypot(max(loop.toe_within * cell, 2.0 * chance), 2.0 * noise * math.sqrt(components))
        case Observable.DEPOSIT:
            return math.hypot(loop.deposit_within * cell, 2.0 * noise * math.sqrt(components))
        case Observable.SEVERAL:
            if loop.several_within is not None:
                return loop.several_within
            # The numbers of one observation err together: each counts as one, at least.
            count = len(problem.observations)
            return math.sqrt(float(chi2.ppf(CONFIDENCE, count)) / count) * math.hypot(1.0, chance)


def meets(problem: Problem, target: Target, seen: Seen, *, chance: float, front_chance: float) -> bool:
    """The verdict on what the MPM shows.

    chance: see `allowed`; front_chance: relative difference of the fronts of the same two runs. Twice of it will do
    for the front of a profile: the whole of the profile says where it should be, the target's front is one flow's. Of
    a measured one also what its noise does to the front.
    """
    kind = problem.observation.kind
    if kind is Observable.FRONT:
        return abs(seen.front_error) <= problem.loop.confirm_within
    if kind is Observable.PROFILE and abs(seen.front_error) > of_the_front(problem, target, front_chance):
        return False
    miss = distance(kind, seen.observation, target.values, seen.components)
    return miss <= allowed(problem, target, chance, seen.components)


def of_the_front(problem: Problem, target: Target, front_chance: float) -> float:
    """Relative error of the front of a profile that is allowed [-]; the arguments are those of `meets`."""
    most = max(problem.loop.confirm_within, 2.0 * front_chance)
    if target.covariance is None:
        return most
    edge = math.sqrt(float(target.covariance[-1, -1])) / target.edge
    return math.hypot(most, 2.0 * edge)
