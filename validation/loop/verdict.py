"""From the posterior to its answers, each checked by runs of the MPM there, and the verdict on them."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.stats import chi2

from datasets.errors import InputError
from inverse.answer import IDENTIFIABLE, MAX_NUMBERS, Answer, MpmRun, Purpose, Verdict, judge
from inverse.noise import Fit, Scatter, fit
from inverse.observations import Values
from inverse.parameters import Vector
from inverse.posterior.answers import Part
from inverse.posterior.posterior import Region
from inverse.posterior.settings import CONSTANTS
from validation.loop.search import Search
from validation.loop.task import Task

CLOSE = 0.35
"""Of a half-width: checks this close to an answer are checks of it."""
EXCLUDED = 1e-3
"""Probability of the nearest fit of all, below which no parameters between the bounds give the target."""
SETTLED = 0.05
"""Change of the factor of a discrepancy, over it, that widens or narrows no interval."""
NEGLIGIBLE = 0.1
"""Share of the variance of residuals, below which a source of it explains none of a misfit."""
OTHER_CELLS = {2: 0.5, 3: 2.0}
"""Of the scene's, by dimension: those by which the error of the cells is measured."""


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """What a search came to."""

    state: Search
    answers: tuple[Answer, ...]
    """Those that the MPM confirms first, then by weight."""
    verdict: Verdict


def concluded(state: Search, *, moves: int = CONSTANTS.moves) -> Outcome:
    """The answers, checked, with the discrepancy of the first one in their half-widths, and the verdict.

    moves: see `checked`.
    """
    excluded = is_excluded(state)
    state, found = checked(state, moves=moves)
    if cells := on_other_cells(state.task, found[0]):
        # The error grows as the cell (Roache 1994): nature has none, a twin on other cells that of its own.
        own, other = (each[0].trajectory.scene.domain.cell for each in (found[0].checks, cells))
        share = (own - (state.task.target.cell or 0.0)) / (own - other)
        change = share * (found[0].observation - np.mean([each.observation for each in cells], axis=0))
        beyond = 1.0 if share <= 0.0 else max(0.0, 1.0 - 1.0 / share)
        wider = reopened(state, cells=cells, discretisation=change, extrapolated=beyond)
        state, found = checked(wider, moves=moves)
    for _ in range(CONSTANTS.rounds):
        factor = discrepancy(state, found[0])
        if abs(factor - state.factor) <= SETTLED * state.factor:
            break
        # The residuals are least in another place where all parameters are open again that they had excluded.
        state, found = checked(reopened(state, factor=factor), again=False, moves=min(1, moves))
    # What the MPM refuses is no other answer beside one that it confirms.
    found = tuple(each for each in found if each.confirmed) or found
    return Outcome(state=state, answers=found, verdict=judge(state.task.problem, found, excluded=excluded))


def discrepancy(state: Search, answer: Answer) -> float:
    """Factor of all errors by the fit of `answer` where its part of the posterior is likeliest: Birge's ratio.

    Residuals are least there; a skewed posterior has its median elsewhere.
    """
    # Answers are in another order than parts: those first that the MPM confirms.
    own = state.task.bounds.shares(answer.parameters)
    part = min(state.parts(), key=lambda each: float(np.linalg.norm(each.point - own)))
    best = part.points[[int(np.argmax(state.posterior.likelihood(part.points)))]]
    return fitted(state, answer.checks, best[0]).factor


def reopened(state: Search, **changes: Any) -> Search:
    """With larger errors: where the posterior leaves the region of its runs, all that smaller errors excluded is open.

    An emulator of the runs in the old region would extrapolate. That of all runs takes its place, then those of smaller
    regions as long as they know more; of more than `few_parameters` that of all runs in the wider region.
    """
    before = state.posterior.region
    state = state.inferred(**changes)
    region, unknowns = state.posterior.region, len(state.task.problem.parameters)
    if np.all(region.low >= before.low) and np.all(region.high <= before.high):
        return state
    state = state.inferred(Region.whole(unknowns) if unknowns <= CONSTANTS.few_parameters else region)
    while state.posterior.emulator_share > CONSTANTS.converged:
        smaller = state.inferred()
        if smaller.posterior.emulator_share >= state.posterior.emulator_share:
            break
        state = smaller
    return state.narrowed()


def judged(state: Search) -> Outcome:
    """The answers by the runs that there are."""
    found = answers_of(state, state.parts())
    return Outcome(state=state, answers=found, verdict=judge(state.task.problem, found))


def nearer(led: Search, whole: Outcome) -> Outcome:
    """Of a search that a surrogate led, which the MPM did not confirm, and one of the whole box after it: the nearer.

    By all runs of both. What is excluded over the whole box remains excluded.
    """
    outcome = judged(replace(led, runs=(*led.runs, *whole.state.runs[len(led.runs) :])).inferred())
    ratios = [math.inf if each.answers[0].fit is None else each.answers[0].fit.ratio for each in (outcome, whole)]
    return outcome if whole.verdict is Verdict.UNCONFIRMED and ratios[0] < ratios[1] else whole


def checked(state: Search, *, again: bool = True, moves: int = CONSTANTS.moves) -> tuple[Search, tuple[Answer, ...]]:
    """Runs at every answer, and again where an answer moves by what these show, at most `moves` times.

    The answer is the median of the posterior all the same, the checks those nearest to it. again: once more, too, where
    the MPM does not confirm the first of them.
    """
    for turn in range(CONSTANTS.rounds):
        found, close = state.parts(), CLOSE if turn < moves else math.inf
        locations = [each.point for each in found if not is_checked(state, each, close)]
        if not locations:
            answers = answers_of(state, found)
            if answers[0].confirmed or not again or is_certain(answers[0]):
                break
            # Where the mean of few runs is not near enough, that of more may be.
            locations = [state.task.bounds.shares(answers[0].parameters)]
        if state.left < len(locations):
            break
        checks = CONSTANTS.few_checks if state.known or state.guide is not None else CONSTANTS.checks
        count = min(checks, state.left // len(locations))
        state = state.ran(np.repeat(np.stack(locations), count, axis=0), Purpose.CHECK).inferred()
    return state, answers_of(state, state.parts())


def is_certain(answer: Answer) -> bool:
    """Whether more runs at an answer would leave its misfit as it is: the scatter of their mean is no part of it."""
    fit = answer.fit
    if fit is None:
        return False
    total = fit.noise**2 + fit.cells**2 + fit.scatter**2
    return fit.scatter**2 / len(answer.checks) < NEGLIGIBLE * total


def distances(state: Search, runs: Sequence[MpmRun], part: Part) -> Values:
    """Distance of runs from the point of a part: root mean square over the parameters, in half-widths, shape [n]."""
    locations = state.task.bounds.shares(np.stack([each.parameters for each in runs]))
    off = (locations - part.point) / np.maximum(part.half_widths, 1e-6)
    return np.asarray(np.sqrt((off**2).mean(axis=1)))


def checks_of(state: Search, part: Part) -> list[MpmRun]:
    """The checks of a part: those at the place, among all in it that were checked, that is nearest to its point."""
    own = [each for each in state.runs if each.purpose is Purpose.CHECK]
    if not own:
        return []
    locations = state.task.bounds.shares(np.stack([each.parameters for each in own]))
    within = np.all((locations >= part.points.min(axis=0)) & (locations <= part.points.max(axis=0)), axis=1)
    within &= state.posterior.likelihood(locations) >= part.threshold
    far = np.where(within, distances(state, own, part), np.inf)
    if not within.any():
        return []
    nearest = own[int(np.argmin(far))].parameters
    return [each for each in own if np.array_equal(each.parameters, nearest)]


def is_checked(state: Search, part: Part, close: float) -> bool:
    """Whether its checks are so close to its point, in half-widths, or it is most of the box."""
    found = checks_of(state, part)
    if not found:
        return False
    return bool(distances(state, found[:1], part)[0] <= close or part.half_widths.max() > IDENTIFIABLE)


def answers_of(state: Search, found: Sequence[Part]) -> tuple[Answer, ...]:
    """The answer in each part, with the checks or else the runs nearest to it; those first that the MPM confirms."""
    task, answers = state.task, []
    for part in found:
        own = checks_of(state, part) or [state.every[int(np.argmin(distances(state, state.every, part)))]]
        answers.append(
            Answer(
                parameters=task.bounds.at(part.point),
                interval=task.bounds.at(part.interval),
                weight=part.weight,
                checks=tuple(own),
                fit=replace(fitted(state, own, part.point), applied=state.factor),
            )
        )
    return tuple(sorted(answers, key=lambda each: not each.confirmed))


def fitted(state: Search, checks: Sequence[MpmRun], point: Vector) -> Fit:
    """The checks of an answer, carried over to `point` [U] of the unit box, beside the target.

    The scatter is that of runs repeated near it, else anywhere.

    The checks may lie a part of a half-width beside it: the difference is the emulator's.
    """
    task, near = state.task, state.posterior.near
    numbers, unknowns = state.numbers, len(task.problem.parameters)
    scatter = Scatter.of_runs(state.points[near], numbers[near], task.scatter)
    if scatter.freedom == 0:
        scatter = Scatter.of_runs(state.points, numbers, task.scatter)
    shown = np.stack([each.observation for each in checks])
    there, here = state.posterior.expected(np.stack([point, task.bounds.shares(checks[0].parameters)]))
    return fit(
        task.target,
        shown + (there - here),
        scatter,
        cells=state.discretisation,
        extrapolated=state.extrapolated,
        parameters=unknowns,
        slopes=None if shown.shape[1] > MAX_NUMBERS else state.slopes(checks[0].parameters),
    )


def on_other_cells(task: Task, answer: Answer) -> tuple[MpmRun, ...]:
    """Runs at an answer on half the cells, in 3D on cells twice as large; for a target of no flow on the scene's cells.

    What they change is, to first order, the error of the cells used (Roache, Perspective: a method for uniform
    reporting of grid refinement studies, J. Fluids Eng. 116 (1994) 405-413). Larger cells show less of it, where it
    does not fall steadily; half the cells cost sixteen runs in 3D. None where the numbers are those of single
    particles, and where the box does not divide into such cells.
    """
    # Where the checks are: the difference is of the cells alone.
    location = answer.checks[0].parameters
    scene = task.problem.scene_at(location)
    if task.target.cell == scene.domain.cell:
        return ()
    try:
        scene = task.on_cells(scene, OTHER_CELLS[scene.dimension])
        scenes = [replace(scene, seed=each.trajectory.scene.seed) for each in answer.checks]
    except InputError:
        return ()
    return task.compared([location] * len(scenes), scenes, Purpose.CELLS)


def is_excluded(state: Search) -> bool:
    """Whether the likeliest parameters of all, whatever a stated prior, leave more than scatter and noise explain."""
    found = state.posterior
    samples = found.samples if found.likelihood.prior is None else found.plausible
    best = samples.points[[int(np.argmax(samples.log_likelihood))]]
    (residual,), fixed, (variance,) = found.likelihood.residual(best)
    square = float(residual @ np.linalg.solve(fixed + np.diag(variance), residual))
    return float(chi2.sf(square, len(residual))) < EXCLUDED
