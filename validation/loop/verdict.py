"""From the posterior to its answers, each checked by runs of the MPM there, and the verdict on them."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.stats import chi2

from datasets.errors import InputError
from datasets.maps import least_thickness
from datasets.scene import Scene
from inverse.answer import IDENTIFIABLE, MAX_NUMBERS, Answer, MpmRun, Purpose, Verdict, judge
from inverse.noise import Fit, Scatter, fit
from inverse.observations import Values
from inverse.parameters import Vector
from inverse.posterior import Matrix
from inverse.posterior.answers import Part
from inverse.posterior.posterior import Posterior, Region
from inverse.posterior.settings import CONSTANTS
from inverse.search.inference import narrowed, parts_of
from validation.loop.task import Loop, Task

CLOSE = 0.35  # of a half-width: checks this close to an answer are checks of it
AT_BOUND = 0.02  # distance from a bound, as a fraction of the range, at which parameters lie at it
EXCLUDED = 1e-3
"""Probability of the nearest fit of all, at a bound, below which no parameters between the bounds give the target."""
SETTLED = 0.05  # change of the factor of a discrepancy, over it, that widens or narrows no interval
NEGLIGIBLE = 0.1  # share of the variance of residuals, below which a source of it explains none of a misfit
HALF, TWICE = 0.5, 2.0  # sizes of other cells over the scene's, by which the error of these is measured
THIN = 2.0  # cells across a mass in 3D, below which cells twice as large do not show the error


@dataclass(frozen=True, kw_only=True)
class Conclusion:
    """What a search came to."""

    search: Loop
    answers: tuple[Answer, ...]
    """Those that the MPM confirms first, then by weight."""
    verdict: Verdict
    cells: tuple[MpmRun, ...] = ()
    """Runs at an answer on other cells, which are no part of the emulator."""


def concluded(task: Task, state: Loop, *, moves: int = CONSTANTS.moves) -> Conclusion:
    """The answers, checked, with the discrepancy of the first one in their half-widths, and the verdict.

    moves: see `checked`.
    """
    unreachable = is_unreachable(state.knowledge.posterior)
    state, answers = checked(state, moves=moves)
    if cells := on_other_cells(task, answers[0]):
        # The error grows as the cell (Roache 1994): nature has none, a twin on other cells that of its own.
        cell, other = (runs[0].trajectory.scene.domain.cell for runs in (answers[0].checks, cells))
        share = (cell - (task.target.cell or 0.0)) / (cell - other)
        change = share * (answers[0].observation - np.mean([run.numbers for run in cells], axis=0))
        beyond = 1.0 if share <= 0.0 else max(0.0, 1.0 - 1.0 / share)
        state, answers = checked(reopened(state, discretisation=change, extrapolated=beyond), moves=moves)
    for _ in range(CONSTANTS.rounds):
        shown, before = discrepancy(state, answers[0]), state.knowledge.factor
        if abs(shown.factor - before) <= SETTLED * before:
            break
        # The residuals are least in another place where all parameters are open again that they had excluded.
        wider = reopened(state, factor=shown.factor, spared=shown.alone is not None)
        state, answers = checked(wider, again=False, moves=min(1, moves))
    # What the MPM refuses is no other answer beside one that it confirms.
    answers = tuple(answer for answer in answers if answer.confirmed) or answers
    verdict = judge(task.problem, answers, unreachable=unreachable)
    return Conclusion(search=state, answers=answers, verdict=verdict, cells=cells)


def discrepancy(state: Loop, answer: Answer) -> Fit:
    """The fit of `answer` where its part of the posterior is likeliest: by Birge's ratio its errors are larger.

    Residuals are least there; a skewed posterior has its median elsewhere.
    """
    # Answers are in another order than parts: those first that the MPM confirms.
    location = state.knowledge.box.shares(answer.parameters)
    part = min(parts_of(state), key=lambda candidate: float(np.linalg.norm(candidate.point - location)))
    best = part.points[[int(np.argmax(state.knowledge.posterior.likelihood(part.points)))]]
    return fitted(state, answer.checks, best[0])


def reopened(state: Loop, **changes: Any) -> Loop:
    """With larger errors: where the posterior leaves the region of its runs, all that smaller errors excluded is open.

    An emulator of the runs in the old region would extrapolate. That of all runs takes its place, then those of smaller
    regions as long as they know more; of more than `few_parameters` that of all runs in the wider region.
    """
    before = state.knowledge.posterior.region
    state = state.informed(**changes)
    region, unknowns = state.knowledge.posterior.region, len(before.low)
    if np.all(region.low >= before.low) and np.all(region.high <= before.high):
        return state
    region = Region.whole(unknowns) if unknowns <= CONSTANTS.few_parameters else region
    state = state.informed(region=region)
    while (share := state.knowledge.posterior.emulator_share) > CONSTANTS.converged:
        smaller = state.informed()
        if smaller.knowledge.posterior.emulator_share >= share:
            break
        state = smaller
    return narrowed(state)


def judged(state: Loop) -> Conclusion:
    """The answers by the runs that there are."""
    answers = answers_of(state, parts_of(state))
    return Conclusion(search=state, answers=answers, verdict=judge(state.knowledge.problem, answers))


def nearer(led: Loop, whole: Conclusion) -> Conclusion:
    """Of a search that a surrogate led, which the MPM did not confirm, and one of the whole box after it: the nearer.

    By all runs of both. What is excluded over the whole box remains excluded.
    """
    guided = judged(replace(led, runs=(*led.runs, *whole.search.runs[len(led.runs) :])).informed())
    fits = (conclusion.answers[0].fit for conclusion in (guided, whole))
    ratios = [math.inf if fit is None else fit.ratio for fit in fits]
    return guided if whole.verdict is Verdict.UNCONFIRMED and ratios[0] < ratios[1] else whole


def checked(state: Loop, *, again: bool = True, moves: int = CONSTANTS.moves) -> tuple[Loop, tuple[Answer, ...]]:
    """Runs at every answer, and again where an answer moves by what these show, at most `moves` times.

    The answer is the median of the posterior all the same, the checks those nearest to it. again: once more, too, where
    the MPM does not confirm the first of them.
    """
    for turn in range(CONSTANTS.rounds):
        parts, close = parts_of(state), CLOSE if turn < moves else math.inf
        locations = [part.point for part in parts if not is_checked(state, part, close)]
        if not locations:
            answers = answers_of(state, parts)
            if answers[0].confirmed or not again or is_certain(answers[0]):
                break
            # Where the mean of few runs is not near enough, that of more may be.
            locations = [state.knowledge.box.shares(answers[0].parameters)]
        if state.left < len(locations):
            break
        checks = CONSTANTS.few_checks if state.known or state.knowledge.guide is not None else CONSTANTS.checks
        count = min(checks, state.left // len(locations))
        state = state.ran(np.repeat(np.stack(locations), count, axis=0), purpose=Purpose.CHECK).informed()
    return state, answers_of(state, parts_of(state))


def is_certain(answer: Answer) -> bool:
    """Whether more runs at an answer would leave its misfit as it is: the scatter of their mean is no part of it."""
    fit = answer.fit
    if fit is None:
        return False
    total = fit.noise**2 + fit.cells**2 + fit.scatter**2
    return fit.scatter**2 / len(answer.checks) < NEGLIGIBLE * total


def distances(runs: Sequence[MpmRun], part: Part) -> Values:
    """Distance of runs from the point of a part: root mean square over the parameters, in half-widths, shape [n]."""
    off = (np.stack([run.point for run in runs]) - part.point) / np.maximum(part.half_widths, 1e-6)
    return np.asarray(np.sqrt((off**2).mean(axis=1)))


def checks_of(state: Loop, part: Part) -> list[MpmRun]:
    """The checks of a part: those at the place, among all in it that were checked, that is nearest to its point."""
    made = [run for run in state.runs if run.purpose is Purpose.CHECK]
    if not made:
        return []
    points = np.stack([run.point for run in made])
    within = np.all((points >= part.points.min(axis=0)) & (points <= part.points.max(axis=0)), axis=1)
    within &= state.knowledge.posterior.likelihood(points) >= part.threshold
    if not within.any():
        return []
    nearest = points[int(np.argmin(np.where(within, distances(made, part), np.inf)))]
    return [run for run in made if np.array_equal(run.point, nearest)]


def is_checked(state: Loop, part: Part, close: float) -> bool:
    """Whether its checks are so close to its point, in half-widths, or it is most of the box."""
    checks = checks_of(state, part)
    if not checks:
        return False
    return bool(distances(checks[:1], part)[0] <= close or part.half_widths.max() > IDENTIFIABLE)


def answers_of(state: Loop, parts: Sequence[Part]) -> tuple[Answer, ...]:
    """The answer in each part, with the checks or else the runs nearest to it; those first that the MPM confirms."""
    box, answers = state.knowledge.box, []
    for part in parts:
        checks = checks_of(state, part) or [state.every[int(np.argmin(distances(state.every, part)))]]
        known = state.knowledge
        fit = replace(fitted(state, checks, part.point), applied=known.factor, spared=known.spared)
        place, ends = box.at(part.point), box.at(part.interval)
        answers.append(Answer(parameters=place, interval=ends, weight=part.weight, checks=tuple(checks), fit=fit))
    return tuple(sorted(answers, key=lambda answer: not answer.confirmed))


def fitted(state: Loop, checks: Sequence[MpmRun], point: Vector) -> Fit:
    """The checks of an answer, carried over to `point` [U] of the unit box, beside the target.

    The scatter is that of runs repeated near it, else anywhere.

    The checks may lie a part of a half-width beside it: the difference is the emulator's.
    """
    knowledge, near, numbers = state.knowledge, state.knowledge.posterior.near, state.numbers
    scatter = Scatter.of_runs(state.points[near], numbers[near], knowledge.scatter)
    if scatter.freedom == 0:
        scatter = Scatter.of_runs(state.points, numbers, knowledge.scatter)
    place, step = knowledge.box.shares(checks[0].parameters), 1e-3 * np.eye(len(point))
    there, here = knowledge.posterior.expected(np.stack([point, place]))
    shown = np.stack([check.numbers for check in checks]) + (there - here)
    slopes: Matrix | None = None
    if shown.shape[1] <= MAX_NUMBERS:
        # Derivatives by parameters in fractions of their ranges, by the emulator, shape [U, M].
        slopes = (knowledge.posterior.expected(place + step) - knowledge.posterior.expected(place - step)) / 2e-3
    return fit(
        knowledge.target,
        shown,
        scatter,
        cells=knowledge.discretisation,
        extrapolated=knowledge.extrapolated,
        parameters=len(point),
        slopes=slopes,
    )


def on_other_cells(task: Task, answer: Answer) -> tuple[MpmRun, ...]:
    """Runs at an answer on cells of another size (`other_cells`); none for a target that is a flow on the same.

    What they change is, to first order, the error of the cells used (Roache, Perspective: a method for uniform
    reporting of grid refinement studies, J. Fluids Eng. 116 (1994) 405-413). None where the numbers are those of single
    particles, and where the box does not divide into such cells.
    """
    # Where the checks are: the difference is of the cells alone.
    location = answer.checks[0].parameters
    scene = task.problem.scene_at(location)
    if task.target.cell == scene.domain.cell:
        return ()
    for factor in other_cells(scene):
        # One run on half the cells costs as much as sixteen in 3D, and scatters less than these.
        checks = answer.checks[:1] if factor < 1.0 and scene.dimension == 3 else answer.checks
        try:
            other = task.on_cells(scene, factor)
            scenes = [replace(other, seed=check.trajectory.scene.seed) for check in checks]
            return task.compared([location] * len(scenes), scenes, Purpose.CELLS)
        except InputError:
            # The box does not divide into such cells, or the memory does not suffice for them.
            continue
    return ()


def other_cells(scene: Scene) -> tuple[float, ...]:
    """Cells that show the error of those of `scene`, over these, the best ones first.

    Half the cells, in 3D cells twice as large: half the cells cost sixteen times as much there. Where a mass is thinner
    than `THIN` cells, cells twice as large do not show the error: of a slide a quarter of a cell thick, what they
    change has another sign than what half the cells change.
    """
    thin = min(map(least_thickness, scene.masses)) < THIN * scene.domain.cell
    return (HALF,) if scene.dimension == 2 else (HALF, TWICE) if thin else (TWICE,)


def is_unreachable(posterior: Posterior) -> bool:
    """Whether the likeliest parameters of all lie at a bound and leave more than scatter and noise explain.

    Whatever a stated prior; before the errors are multiplied by Birge's ratio, which moves medians off the bound.
    """
    samples = posterior.samples if posterior.likelihood.prior is None else posterior.plausible
    best = samples.points[[int(np.argmax(samples.log_likelihood))]]
    if not np.any((best < AT_BOUND) | (best > 1.0 - AT_BOUND)):
        return False
    (residual,), fixed, (variance,) = posterior.likelihood.residual(best)
    square = float(residual @ np.linalg.solve(fixed + np.diag(variance), residual))
    return float(chi2.sf(square, len(residual))) < EXCLUDED
