"""From the posterior to its answers, each checked by runs of the MPM there, and the verdict on them."""

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from datasets.errors import InputError
from inverse.observations import Values
from inverse.parameters import Vector
from inverse.posterior.answers import Part, half_widths, parts
from inverse.posterior.settings import CONSTANTS
from inverse.problem import Problem
from inverse.result import IDENTIFIABLE, Purpose, Verdict
from validation.loop.check import Check, Task
from validation.loop.discrepancy import Discrepancy, discrepancy
from validation.loop.search import Search

CLOSE = 0.25
"""Of a half-width: checks this close to an answer are checks of it."""
EXCLUDED = 1e-3
"""Probability of the nearest fit of all, below which no parameters between the bounds give the target."""
AT_BOUND = 0.02
"""Distance from a bound, as a fraction of the range."""
BETTER = 2.0
"""Standard deviations of the scatter by which a design has to improve on the start."""


@dataclass(frozen=True, kw_only=True)
class Answer:
    """Parameters that the observation allows, with the runs of the MPM there."""

    parameters: Vector
    """Shape [U]."""
    half_widths: Vector
    """At 95 %, shape [U]."""
    weight: float
    """Share of the posterior."""
    checks: tuple[Check, ...]

    @property
    def observation(self) -> Values:
        """Mean of the checks, shape [M]."""
        return np.asarray(np.mean([each.observation for each in self.checks], axis=0))

    @property
    def front_error(self) -> float:
        """Mean relative error of the front, with its sign; nan where the target has none."""
        return float(np.mean([each.front_error for each in self.checks]))

    def scatter(self, task: Task) -> float:
        """Distance of two of the checks, root mean square (`Observation.distance`)."""
        pairs = [
            task.observation.distance(one.observation, other.observation)
            for number, one in enumerate(self.checks)
            for other in self.checks[:number]
        ]
        return math.sqrt(float(np.mean(np.square(pairs)))) if pairs else 0.0

    @property
    def front_scatter(self) -> float:
        """Relative difference of the fronts of two of the checks, root mean square [-]."""
        fronts = np.array([each.front for each in self.checks])
        return float(math.sqrt(2.0) * fronts.std(ddof=1) / fronts.mean()) if len(fronts) > 1 else 0.0

    def confirms(self, task: Task) -> bool:
        """Whether the mean of the checks is within the tolerance, given their scatter."""
        return task.observation.is_within(
            task.problem.loop,
            task.problem.scene.domain.cell,
            task.target,
            self.observation,
            front_error=self.front_error,
            scatter=self.scatter(task),
            front_scatter=self.front_scatter,
        )


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """What a search came to."""

    state: Search
    answers: tuple[Answer, ...]
    """Heaviest first."""
    verdict: Verdict
    discrepancy: Discrepancy | None = None
    """Of the first answer; absent where no numbers are left over for it."""


def concluded(state: Search) -> Outcome:
    """The answers, checked, with the discrepancy of the first one in their half-widths, and the verdict."""
    if state.task.problem.target.minimise:
        return of_design(state)
    excluded = is_excluded(state)
    state, found = checked(state)
    change = cells_change(state.task, found[0])
    if change is not None:
        state, found = checked(state.inferred(discretisation=change))
    fit = discrepancy(state.task, found[0].checks, residuals_of_runs(state))
    if fit is not None and fit.factor > 1.0 and not excluded:
        state = state.inferred(factor=fit.factor)
        found = tuple(each for each in matched(state, found) if each.weight > 0.0) or found
    return Outcome(state=state, answers=found, verdict=judge(state.task, found, excluded=excluded), discrepancy=fit)


def checked(state: Search) -> tuple[Search, tuple[Answer, ...]]:
    """Runs at every answer, and once more where the answers have moved by what these showed."""
    for _ in range(CONSTANTS.rounds):
        found = separate(state)
        locations = [each.point for each in found if not is_checked(state, each)]
        if not locations:
            answers = answers_of(state, found)
            if any(each.confirms(state.task) for each in answers):
                break
            # Where the mean of few runs is not near enough, that of more may be.
            locations = [state.task.unit(answers[0].parameters)]
        if state.left < len(locations):
            break
        count = min(CONSTANTS.checks, state.left // len(locations))
        state = state.ran(np.repeat(np.stack(locations), count, axis=0), Purpose.CHECK).inferred()
    return state, answers_of(state, separate(state))


def separate(state: Search) -> list[Part]:
    """The separate parts of the 95 % region."""
    found = state.posterior
    return parts(found.samples, found.likelihood, state.task.generator(len(state.runs)))


def distances(state: Search, runs: Sequence[Check], part: Part) -> Values:
    """Distance of runs from the point of a part: root mean square over the parameters, in half-widths, shape [n]."""
    locations = state.task.unit(np.stack([each.parameters for each in runs]))
    off = (locations - part.point) / np.maximum(part.half_widths, 1e-6)
    return np.asarray(np.sqrt((off**2).mean(axis=1)))


def checks_of(state: Search, part: Part) -> list[Check]:
    """The checks of a part: those at the place, among all in it that were checked, that is nearest to its point."""
    own = [each for each in state.runs if each.purpose is Purpose.CHECK]
    if not own:
        return []
    locations = state.task.unit(np.stack([each.parameters for each in own]))
    within = np.all((locations >= part.points.min(axis=0)) & (locations <= part.points.max(axis=0)), axis=1)
    within &= state.posterior.likelihood(locations) >= part.threshold
    far = np.where(within, distances(state, own, part), np.inf)
    if not within.any():
        return []
    nearest = own[int(np.argmin(far))].parameters
    return [each for each in own if np.array_equal(each.parameters, nearest)]


def is_checked(state: Search, part: Part) -> bool:
    """Whether its checks are close to its point; a part that is most of the box has none that is better than others."""
    found = checks_of(state, part)
    if not found:
        return False
    return bool(distances(state, found[:1], part)[0] <= CLOSE or part.half_widths.max() > IDENTIFIABLE)


def answers_of(state: Search, found: Sequence[Part]) -> tuple[Answer, ...]:
    """The answer in each part: where it was checked, else where a run is nearest to its point."""
    task, answers = state.task, []
    for part in found:
        own = checks_of(state, part) or [state.runs[int(np.argmin(distances(state, state.runs, part)))]]
        location = own[0].parameters
        share = np.full(len(part.points), 1.0 / len(part.points))
        widths = half_widths(part.points, share, task.unit(location)) * task.bounds.range
        answers.append(Answer(parameters=location, half_widths=widths, weight=part.weight, checks=tuple(own)))
    return tuple(answers)


def matched(state: Search, before: Sequence[Answer]) -> tuple[Answer, ...]:
    """Answers of a new posterior: those of before with its weights and half-widths about the same parameters."""
    task, found = state.task, separate(state)
    result = []
    for part in found:
        scale = np.maximum(part.half_widths, 1e-6)
        nearest = min(before, key=lambda each: float(np.max(np.abs(task.unit(each.parameters) - part.point) / scale)))
        share = np.full(len(part.points), 1.0 / len(part.points))
        widths = half_widths(part.points, share, task.unit(nearest.parameters)) * task.bounds.range
        result.append(dataclasses.replace(nearest, half_widths=widths, weight=part.weight))
    return tuple(result)


def cells_change(task: Task, answer: Answer) -> Values | None:
    """What the MPM's cells do to the numbers at an answer [M], for a target that no flow on the same cells has made.

    The difference from runs on cells twice as large is, to first order, the error of the cells used (Roache,
    Perspective: a method for uniform reporting of grid refinement studies, J. Fluids Eng. 116 (1994) 405-413).
    None for a twin, and where the box does not divide into such cells.
    """
    scene = task.problem.scene_at(answer.parameters)
    if task.problem.target.twin or task.observation.every_particle:
        return None
    try:
        domain = dataclasses.replace(scene.domain, cell=2.0 * scene.domain.cell)
        scenes = [dataclasses.replace(scene, domain=domain, seed=each.trajectory.scene.seed) for each in answer.checks]
    except InputError:
        return None
    return np.asarray(np.mean(task.observed(scenes), axis=0) - answer.observation)


def residuals_of_runs(state: Search) -> list[Check]:
    """The runs around the posterior."""
    return [each for each, near in zip(state.runs, state.posterior.near, strict=True) if near]


def is_excluded(state: Search) -> bool:
    """Whether the likeliest parameters of all leave more than scatter and noise explain."""
    found = state.posterior
    best = found.samples.points[[int(np.argmax(found.samples.log_likelihood))]]
    mean, variance = found.emulator.predict(best)
    whole = found.likelihood.fixed + np.diag(variance[0])
    residual = found.likelihood.target - mean[0]
    square = float(residual @ np.linalg.solve(whole, residual))
    return float(chi2.sf(square, len(residual))) < EXCLUDED


def judge(task: Task, answers: Sequence[Answer], *, excluded: bool) -> Verdict:
    """The verdict on the answers, heaviest first."""
    confirmed = [each for each in answers if each.confirms(task)]
    if not confirmed:
        return Verdict.UNREACHABLE if excluded and is_out_of_bounds(task, answers[0]) else Verdict.UNCONFIRMED
    if len(answers) > 1 or unidentified(task.problem, answers[0].parameters, answers[0].half_widths):
        return Verdict.AMBIGUOUS
    return Verdict.CONFIRMED


def is_out_of_bounds(task: Task, answer: Answer) -> bool:
    """Whether an answer that does not fit lies at a bound."""
    location = task.unit(answer.parameters)
    return bool(np.any((location < AT_BOUND) | (location > 1.0 - AT_BOUND)))


def unidentified(problem: Problem, values: Vector, widths: Vector) -> list[str]:
    """The parameters whose interval is most of the prior's; values, half-widths: shape [U].

    The interval is cut off at the bounds. A parameter with a zero of its own is none either where its half-width is
    above the value itself and half as wide.
    """
    names = []
    for each, value, width in zip(problem.parameters, values, widths, strict=True):
        length = (min(value + width, each.upper) - max(value - width, each.lower)) / each.range
        relative = each.kind.positive and width > abs(value) and length > 0.5 * CONSTANTS.most_of_the_prior
        if relative or length > CONSTANTS.most_of_the_prior:
            names.append(each.name)
    return names


def of_design(state: Search) -> Outcome:
    """The design of the least number expected, and how far parameters may move before it shows beyond the scatter."""
    task, found = state.task, state.posterior
    design = found.samples.points[int(np.argmin(expected(state, found.samples.points)))]
    state = state.ran(np.repeat(design[None], CONSTANTS.checks, axis=0), Purpose.CHECK)
    state = state.ran(np.repeat(task.unit(task.problem.initial)[None], CONSTANTS.checks, axis=0), Purpose.START)
    runs = [each for each in state.runs if each.purpose is Purpose.CHECK]
    share = found.samples.weights
    answer = Answer(
        parameters=runs[0].parameters,
        half_widths=half_widths(found.samples.points, share, design) * task.bounds.range,
        weight=1.0,
        checks=tuple(runs),
    )
    begun = np.mean([each.observation[0] for each in state.runs if each.purpose is Purpose.START])
    scatter = float(np.std([each.observation[0] for each in runs], ddof=1))
    better = begun - float(answer.observation[0]) > BETTER * max(scatter, 1e-12)
    verdict = Verdict.CONFIRMED if better else Verdict.UNCONFIRMED
    return Outcome(state=state, answers=(answer,), verdict=verdict)


def expected(state: Search, points: NDArray[np.float64]) -> Values:
    """Of one number: what the emulator expects at points [S, U], shape [S]."""
    reduced = state.posterior.reduction
    return np.asarray(
        state.posterior.emulator.mean(points)[:, 0] * reduced.basis[0, 0] / reduced.weights[0] + reduced.mean[0]
    )
