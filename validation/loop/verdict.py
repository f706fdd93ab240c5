"""From a search to the answer and the verdict on it: refined by ensembles, checked again, held against the target."""

import dataclasses
import math

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from inverse.parameters import Vector
from inverse.problem import Problem
from inverse.result import Verdict
from validation.loop.check import Answer, History, Task
from validation.loop.discrepancy import discrepancy
from validation.loop.uncertainty import Uncertainty, by_ensemble, with_curvature

MAX_ENSEMBLES = 3
"""Where the MPM's slopes have changed between an ensemble and its estimate, another one is made there."""
LINEAR = 0.5
"""Share of a half-width that such a change may be."""
NO_WORSE = 1.5
"""Misfit over the smallest so far up to which another ensemble is made."""
NO_NEARER = 0.5
"""Share of the squared misfit; where the MPM's slopes leave more within the bounds, nothing within them is nearer."""
OF_THE_RANGE = 0.5
"""Half-width over the range between the bounds, above which a parameter is not identifiable."""
OF_ITSELF = 0.25
"""The same where the half-width is also above the value."""
BETTER = 2.0
"""Standard deviations of the scatter by which a design has to improve on the start."""


def refine(task: Task, history: History) -> tuple[Answer, Uncertainty, History]:
    """The answer by all runs together: an ensemble around the nearest check, a check where it points to."""
    uncertainty = by_ensemble(task, history, history.nearest.parameters)
    history = history.surveyed(uncertainty.runs)
    if task.problem.target.minimise:
        checks = (history.nearest, *uncertainty.at_centre)
        return Answer(parameters=uncertainty.centre, checks=checks), uncertainty, history
    answer = Answer.at(history.nearest)
    for number in range(1, MAX_ENSEMBLES + 1):
        if history.budget(task.problem) < 1:
            break
        check = task.check(estimated(task, uncertainty))
        uncertainty = with_curvature(task, history, uncertainty, check)
        history = history.checked(check)
        answer = Answer.at(check)
        worse = check.misfit > NO_WORSE * history.nearest.misfit
        if is_linear(uncertainty) or worse or number == MAX_ENSEMBLES or history.budget(task.problem) < 1:
            answer, history = averaged(task, history, uncertainty, answer)
            break
        uncertainty = by_ensemble(task, history, check.parameters)
        history = history.surveyed(uncertainty.runs)
    fit = discrepancy(task, answer.checks, uncertainty.at_centre)
    return answer, dataclasses.replace(uncertainty, discrepancy=fit), history


def estimated(task: Task, uncertainty: Uncertainty) -> Vector:
    """The parameters of the estimate, within the trust region around the ensemble's centre and the bounds."""
    found, ranges, centre = uncertainty.estimate, task.bounds.range, uncertainty.centre
    assert found is not None
    box = task.bounds.around(centre, task.problem.loop.trust * ranges)
    return task.rounded(centre + found.within((box.lower - centre) / ranges, (box.upper - centre) / ranges) * ranges)


def is_linear(uncertainty: Uncertainty) -> bool:
    """Whether the slopes around the ensemble's centre hold where it points to as well."""
    curvature = uncertainty.curvature
    return curvature is None or bool(np.all(np.abs(curvature) <= LINEAR * uncertainty.half_widths))


def averaged(task: Task, history: History, uncertainty: Uncertainty, answer: Answer) -> tuple[Answer, History]:
    """`answer`, with checks of other jitter seeds there until their mean confirms or the budget is spent.

    A single run scatters with its jitter seed, the estimate by all runs much less. Where even the mean does not
    confirm and the nearest check does, that is the answer: the slopes were misleading.
    """
    seeds = np.random.SeedSequence([task.problem.scene.seed, 1]).generate_state(history.budget(task.problem))
    for seed in seeds.tolist():
        if confirms(task, answer, uncertainty):
            break
        check = task.check(answer.parameters, seed)
        history = history.checked(check)
        answer = dataclasses.replace(answer, checks=(*answer.checks, check))
    nearest = Answer.at(history.nearest)
    if not confirms(task, answer, uncertainty) and confirms(task, nearest, uncertainty):
        answer = nearest
    return answer, history


def confirms(task: Task, answer: Answer, uncertainty: Uncertainty) -> bool:
    """Whether the MPM at the answer is within the tolerance, given its scatter."""
    return task.is_within(answer, scatter=uncertainty.misfit_scatter, front_scatter=uncertainty.front_scatter)


def judge(task: Task, history: History, answer: Answer, uncertainty: Uncertainty) -> Verdict:
    """The verdict of the MPM on the answer."""
    if task.problem.target.minimise:
        begun = float(history.checks[1].observation[0])
        better = begun - float(answer.observation[0]) > BETTER * float(uncertainty.scatter[0])
        return Verdict.CONFIRMED if better else Verdict.UNCONFIRMED
    if confirms(task, answer, uncertainty):
        widths = uncertainty.widths(answer.parameters, task.bounds.range)
        unknown = unidentified(task.problem, answer.parameters, widths)
        return Verdict.NOT_IDENTIFIABLE if unknown else Verdict.CONFIRMED
    return Verdict.UNREACHABLE if is_unreachable(task, answer, uncertainty) else Verdict.UNCONFIRMED


def unidentified(problem: Problem, values: Vector, widths: Vector) -> list[str]:
    """The parameters that the observation does not constrain beyond their bounds; values, half-widths: shape [U].

    Those with a half-width of more than half of the range between the bounds; or of more than the value itself, where a
    value has a zero of its own, and more than a quarter of that range.
    """
    found = []
    for each, value, width in zip(problem.parameters, values, widths, strict=True):
        span = each.upper - each.lower
        relative = each.kind.positive and width > abs(value) and width > OF_ITSELF * span
        if relative or width > OF_THE_RANGE * span:
            found.append(each.name)
    return found


def is_unreachable(task: Task, answer: Answer, uncertainty: Uncertainty) -> bool:
    """Whether no parameters within the bounds give the target, by the MPM's own slopes at the answer.

    Either the bounds exclude it: the slopes lead to it, but out of them. Or more misfit is left than the parameters
    change from bound to bound. What is left otherwise is a discrepancy of the model, and the answer stands.
    """
    loop, cell = task.problem.loop, task.problem.scene.domain.cell
    distance = task.observation.distance(answer.observation, task.target.values)
    if distance <= task.observation.tolerance(loop, cell, task.target, uncertainty.misfit_scatter):
        return False
    found = uncertainty.estimate
    if found is None or len(found.jacobian) != len(task.target.values):
        return False  # The slopes are the surrogate's.
    misfit = task.target.values - answer.observation
    low, high = ((bound - answer.parameters) / task.bounds.range for bound in (task.bounds.lower, task.bounds.upper))
    if remaining(found.jacobian, misfit, low, high) <= NO_NEARER:
        return False
    free = np.full(len(low), math.inf)
    changed = float(np.sum(found.jacobian**2))
    return remaining(found.jacobian, misfit, -free, free) <= NO_NEARER or float(misfit @ misfit) > changed


def remaining(jacobian: NDArray[np.float64], misfit: Vector, lower: Vector, upper: Vector) -> float:
    """Share of |misfit|^2 that is left at best after a move lower <= v <= upper [U] along `jacobian` [M, U]."""
    low, high = np.minimum(lower, -1e-12), np.maximum(upper, 1e-12)
    left = misfit - jacobian @ lsq_linear(jacobian, misfit, bounds=(low, high)).x
    return float(left @ left) / max(float(misfit @ misfit), 1e-300)
