"""From the search to the answer: sharpened by the ensemble, and the verdict on it."""

import dataclasses
import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from inverse.forward.interface import Simulate
from inverse.parameters.parameters import Vector, kind
from inverse.problem import Problem
from inverse.result import Verdict
from validation.loop.agreement import Seen, allowed, distance, meets
from validation.loop.certainty import SPREAD, Certainty, certainty
from validation.loop.discrepancy import discrepancy
from validation.loop.result import Answer
from validation.loop.search import Checked, Search

MOST_ENSEMBLES = 3
"""Where the MPM's slopes have changed on the way from an ensemble to its estimate, another one is made there."""
STRAIGHT = 0.5
"""Share of a half-width by which they may have moved the estimate; of a single unknown, whose bend is fitted, share of
the ensemble's reach at which the estimate may lie."""
NO_WORSE = 1.5
"""Loss over the least so far up to which that is worth it."""
NO_NEARER = 0.5
"""Of the squared misfit; where the MPM's own slopes promise no less within the bounds, there is nothing nearer."""
OF_THE_RANGE = 0.5
"""Half-width over the range between the bounds, above which an observation does not tell an unknown."""
OF_ITSELF = 0.25
"""The same where the half-width is also above the value."""


def settle(state: Search, members: Simulate) -> tuple[Answer, Certainty]:
    """The answer that all runs together point to, and what it is worth."""
    worth = certainty(state, state.nearest.unknowns, members)
    if state.problem.target.least:
        return Answer(unknowns=worth.centre, runs=[state.nearest, *worth.here]), worth
    for number in range(1, MOST_ENSEMBLES + 1):
        unknowns = pointed_to(state, worth)
        if state.budget < 1:
            answer = Answer(unknowns=state.nearest.unknowns, runs=[state.nearest])
            return answer, dataclasses.replace(worth, discrepancy=discrepancy(state, answer.runs, worth.here))
        run = state.check(unknowns)
        worth = dataclasses.replace(worth, bend=bend(state, worth, run))
        if straight(state, worth, unknowns) or number == MOST_ENSEMBLES or state.budget < 1:
            break
        if run.loss > NO_WORSE * state.nearest.loss:
            break
        # The slopes change over such a distance: look at them again where it led.
        state.surveyed += worth.runs
        worth = certainty(state, unknowns, members)
    answer = sharpened(state, worth, run)
    return answer, dataclasses.replace(worth, discrepancy=discrepancy(state, answer.runs, worth.here))


def straight(state: Search, worth: Certainty, unknowns: Vector) -> bool:
    """Whether what the runs around the ensemble's centre say holds at `unknowns` too, where they point to."""
    if worth.joint is None:
        reach = STRAIGHT * SPREAD * state.bounds.range
        return bool(np.all(np.abs(unknowns - worth.centre) <= reach))
    return worth.bend is None or bool(np.all(np.abs(worth.bend) <= STRAIGHT * widths(worth)))


def bend(state: Search, worth: Certainty, run: Checked) -> Vector | None:
    """By how much each unknown is off at `run`, by the change from the centre to it with the same jitter seed."""
    joint, scale = worth.joint, state.bounds.range
    base = [each for each in state.checked if np.array_equal(each.unknowns, worth.centre)]
    if joint is None or not base or len(joint.centre) != len(run.observation):
        return None
    return joint.bend((run.unknowns - worth.centre) / scale, run.observation - base[0].observation) * scale


def widths(worth: Certainty) -> Vector:
    """Half-widths by the ensemble alone, shape [U]."""
    return np.array([calibration.half_width for calibration in worth.calibrations.values()])


def pointed_to(state: Search, worth: Certainty) -> Vector:
    """The unknowns that belong to the target by all runs around the ensemble's centre."""
    if worth.joint is None:
        estimate = np.array([calibration.estimate for calibration in worth.calibrations.values()])
        return state.bounds.clip(estimate) if np.all(np.isfinite(estimate)) else worth.centre
    scale = state.bounds.range
    box = state.bounds.around(worth.centre, state.problem.loop.trust * scale)
    inside = worth.joint.inside((box.lower - worth.centre) / scale, (box.upper - worth.centre) / scale)
    return state.rounded(worth.centre + inside * scale)


def sharpened(state: Search, worth: Certainty, run: Checked) -> Answer:
    """The answer at `run`, where all runs together pointed to.

    A run scatters with its jitter seed, the line through all of them much less. Where a run at the answer misses by
    its own scatter, other seeds join it while the budget lasts, and their mean counts.
    """
    nearest = Answer(unknowns=state.nearest.unknowns, runs=[state.nearest])
    answer = Answer(unknowns=run.unknowns, runs=[run])
    for seed in np.random.SeedSequence([state.problem.scene.seed, 1]).generate_state(state.budget):
        if confirms(state, answer, worth):
            break
        answer = Answer(unknowns=run.unknowns, runs=[*answer.runs, state.check(run.unknowns, int(seed))])
    if not state.single and not confirms(state, answer, worth) and confirms(state, nearest, worth):
        return nearest  # The slopes misled.
    return answer


def confirms(state: Search, answer: Answer, worth: Certainty) -> bool:
    """Whether the MPM at the answer, on average over its runs, meets the target."""
    seen = Seen(observation=answer.observation, front_error=answer.front_error, components=state.observation.components)
    return meets(state.problem, state.target, seen, chance=worth.misfit, front_chance=worth.front_misfit)


def verdict(state: Search, answer: Answer, worth: Certainty, widths: Mapping[str, float]) -> Verdict:
    """What the MPM says of the answer, whose half-widths are `widths`."""
    if state.problem.target.least:
        begun = state.checked[1].observation[0]
        scatter = next(iter(worth.calibrations.values())).scatter
        better = begun - answer.observation[0] > 2.0 * scatter
        return Verdict.CONFIRMED if better else Verdict.UNCONFIRMED
    if confirms(state, answer, worth):
        return Verdict.NOT_IDENTIFIABLE if undetermined(state.problem, answer.unknowns, widths) else Verdict.CONFIRMED
    return Verdict.UNREACHABLE if out_of_reach(state, answer, worth) else Verdict.UNCONFIRMED


def undetermined(problem: Problem, unknowns: Vector, widths: Mapping[str, float]) -> list[str]:
    """The unknowns, at `unknowns` [U], of which the observation says no more than was known before.

    Those with a half-width of more than half of the range between the bounds; or of more than the value itself, where a
    value has a zero of its own, and more than a quarter of that range.
    """
    found = []
    for unknown, value in zip(problem.unknowns, unknowns, strict=True):
        width, span = widths[unknown.name], unknown.upper - unknown.lower
        drowned = kind(unknown.name).positive and width > abs(value) and width > OF_ITSELF * span
        if drowned or width > OF_THE_RANGE * span:
            found.append(unknown.name)
    return found


def out_of_reach(state: Search, answer: Answer, worth: Certainty) -> bool:
    """Whether the target is far from what any unknowns within the bounds give, by the MPM's own slopes at the answer.

    Either the bounds keep the answer from it: the slopes lead to it, but out of them. Or it is of another kind than
    what the MPM shows: more is left than the unknowns change from bound to bound. What is left otherwise is a
    discrepancy of the model, and the answer stands.
    """
    observed, components = state.problem.observation.kind, state.observation.components
    miss = distance(observed, answer.observation, state.target.values, components)
    if miss <= allowed(state.problem, state.target, worth.misfit, components):
        return False
    slope = worth.slope
    if slope is None or len(slope) != len(state.target.values):
        return False  # The slopes are the surrogate's.
    misfit = state.target.values - answer.observation
    low, high = ((bound - answer.unknowns) / state.bounds.range for bound in (state.bounds.lower, state.bounds.upper))
    if left_over(slope, misfit, low, high) <= NO_NEARER:
        return False
    free = np.full(len(low), math.inf)
    changed = float(np.sum(slope**2))
    return left_over(slope, misfit, -free, free) <= NO_NEARER or float(misfit @ misfit) > changed


def left_over(slope: NDArray[np.float64], misfit: Vector, lower: Vector, upper: Vector) -> float:
    """Share of |misfit|^2 that is left at best after moving by lower <= v <= upper [U] along `slope` [M, U]."""
    low, high = np.minimum(lower, -1e-12), np.maximum(upper, 1e-12)
    left = misfit - slope @ lsq_linear(slope, misfit, bounds=(low, high)).x
    return float(left @ left) / max(float(misfit @ misfit), 1e-300)


def half_widths(state: Search, answer: Answer, worth: Certainty) -> dict[str, float]:
    """Half-width of each unknown around the answer; no wider than the bounds, which were known before.

    Wider by the discrepancy of the model where the fit is worse than noise and chance allow (`validation.loop.discrepancy`).
    """
    off = np.zeros(len(answer.unknowns)) if worth.bend is None else worth.bend
    return {
        name: float(
            min(worth.widened * math.hypot(calibration.half_width, bent) + abs(calibration.estimate - value), width)
        )
        for (name, calibration), bent, value, width in zip(
            worth.calibrations.items(), off, answer.unknowns, state.bounds.range, strict=True
        )
    }
