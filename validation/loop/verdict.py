"""Derives answers from the posterior, checks each by MPM runs at the answer, and gives the verdict on them."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.stats import chi2

from datasets.errors import InputError
from datasets.scene import Mass, Scene
from inverse.answer import CLOSE, IDENTIFIABLE, MAX_NUMBERS, Answer, MpmRun, Purpose, Verdict, judge
from inverse.noise import Fit, Scatter, fit
from inverse.observations import Values
from inverse.parameters import Vector
from inverse.posterior import Matrix
from inverse.posterior.answers import Part
from inverse.posterior.posterior import Posterior, Region
from inverse.posterior.settings import CONSTANTS
from inverse.search.inference import narrowed, parts_of
from validation.loop.task import Loop, Task

AT_BOUND = 0.02  # distance from a bound, as a fraction of the range, at which parameters lie at it
EXCLUDED = 1e-3
"""If the best fit lies at a bound and is less probable than this, no parameters within the bounds give the target."""
SETTLED = 0.05  # relative change of the discrepancy factor that is too small to change the intervals
NEGLIGIBLE = 0.1  # share of the residuals' variance below which its source does not explain a misfit
HALF, TWICE = 0.5, 2.0  # size of the cells that measure the discretisation error, over the scene's
WITHOUT_CELLS = "no interval includes the error of the cells"
THIN = 2.0  # cells across a mass in 3D below which cells twice as large do not show this error


@dataclass(frozen=True, kw_only=True)
class Conclusion:
    """The outcome of a search."""

    search: Loop
    answers: tuple[Answer, ...]
    """Confirmed answers first, then by weight."""
    verdict: Verdict
    cells: tuple[MpmRun, ...] = ()
    """Runs at an answer on cells of another size, which the emulator does not use."""
    remark: str = ""
    """Why there are none, if there should be some."""


def concluded(task: Task, state: Loop, *, moves: int = CONSTANTS.moves) -> Conclusion:
    """The checked answers, whose half-widths include the discrepancy of the first answer, and the verdict. moves: see
    `checked`."""
    unreachable = is_unreachable(state.knowledge.posterior)
    state, answers = checked(state, moves=moves)
    cells, remark = on_other_cells(task, answers[0])
    if cells:
        # The error is proportional to the cell (Roache 1994); a measurement has none, a twin that of its own cells.
        cell, other = (runs[0].trajectory.scene.domain.cell for runs in (answers[0].checks, cells))
        share = (cell - (task.target.cell or 0.0)) / (cell - other)
        change = share * (answers[0].checked - np.mean([run.numbers for run in cells], axis=0))
        beyond = 1.0 if share <= 0.0 else max(0.0, 1.0 - 1.0 / share)
        state, answers = checked(reopened(state, discretisation=change, extrapolated=beyond), moves=moves)
    for _ in range(CONSTANTS.rounds):
        shown, before = discrepancy(state, answers[0]), state.knowledge.factor
        if abs(shown.factor - before) <= SETTLED * before:
            break
        # Once excluded parameters are possible again, the residuals may be smallest elsewhere.
        wider = reopened(state, factor=shown.factor, spared=shown.alone is not None)
        state, answers = checked(wider, again=False, moves=min(1, moves))
    # If the MPM confirms an answer, those that it refuses are dropped.
    answers = tuple(answer for answer in answers if answer.confirmed) or answers
    verdict = judge(task.problem, answers, unreachable=unreachable)
    return Conclusion(search=state, answers=answers, verdict=verdict, cells=cells, remark=remark)


def discrepancy(state: Loop, answer: Answer) -> Fit:
    """The fit at the likeliest point of `answer`'s part of the posterior: its Birge ratio enlarges the errors. The
    residuals are smallest there; the median of a skewed posterior lies elsewhere."""
    # Answers are ordered differently from parts: confirmed ones come first.
    location = state.knowledge.box.shares(answer.parameters)
    part = min(parts_of(state), key=lambda candidate: float(np.linalg.norm(candidate.point - location)))
    best = part.points[[int(np.argmax(state.knowledge.posterior.likelihood(part.points)))]]
    return fitted(state, answer.checks, best[0])


def reopened(state: Loop, **changes: Any) -> Loop:
    """The search with larger errors: if the posterior leaves the region of its runs, excluded parameters reopen. An
    emulator of the runs in the old region would extrapolate. An emulator of all runs replaces it (with more than
    `few_parameters`, of all runs in the wider region), then emulators of smaller regions as long as they know more."""
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
    """The answers from the existing runs, without further ones."""
    answers = answers_of(state, parts_of(state))
    return Conclusion(search=state, answers=answers, verdict=judge(state.knowledge.problem, answers))


def nearer(led: Loop, whole: Conclusion) -> Conclusion:
    """The conclusion nearer to the target: of an unconfirmed search led by a surrogate, or of the whole box after it.
    Both use the runs of both searches. Parameters excluded over the whole box remain excluded."""
    guided = judged(replace(led, runs=(*led.runs, *whole.search.runs[len(led.runs) :])).informed())
    fits = (conclusion.answers[0].fit for conclusion in (guided, whole))
    ratios = [math.inf if fit is None else fit.ratio for fit in fits]
    return guided if whole.verdict is Verdict.UNCONFIRMED and ratios[0] < ratios[1] else whole


def checked(state: Loop, *, again: bool = True, moves: int = CONSTANTS.moves) -> tuple[Loop, tuple[Answer, ...]]:
    """Run checks at every answer, and again if the checks move an answer, at most `moves` times. The answer remains the
    median of the posterior; its checks are the nearest ones. again: also check once more if the MPM does not confirm
    the first answer."""
    for turn in range(CONSTANTS.rounds):
        parts, close = parts_of(state), CLOSE if turn < moves else math.inf
        locations = [part.point for part in parts if not is_checked(state, part, close)]
        if not locations:
            answers = answers_of(state, parts)
            if answers[0].confirmed or not again or is_certain(answers[0]):
                break
            # The mean of few runs may miss the target where the mean of more does not.
            locations = [state.knowledge.box.shares(answers[0].parameters)]
        if state.left < len(locations):
            break
        checks = CONSTANTS.few_checks if state.known or state.knowledge.guide is not None else CONSTANTS.checks
        count = min(checks, state.left // len(locations))
        state = state.ran(np.repeat(np.stack(locations), count, axis=0), purpose=Purpose.CHECK).informed()
    return state, answers_of(state, parts_of(state))


def is_certain(answer: Answer) -> bool:
    """Whether more runs at an answer would not change its misfit: the scatter of their mean is negligible."""
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
    """The checks of a part: of all checked places within it, those at the place nearest to its point."""
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
    """Whether a part has checks within `close` half-widths of its point, or fills so much of the box that any do."""
    checks = checks_of(state, part)
    if not checks:
        return False
    return bool(distances(checks[:1], part)[0] <= close or part.half_widths.max() > IDENTIFIABLE)


def answers_of(state: Loop, parts: Sequence[Part]) -> tuple[Answer, ...]:
    """The answer in each part, with its checks or else the nearest run; confirmed answers first."""
    box, answers = state.knowledge.box, []
    for part in parts:
        checks = checks_of(state, part) or [state.every[int(np.argmin(distances(state.every, part)))]]
        known = state.knowledge
        fit = replace(fitted(state, checks, part.point), applied=known.factor, spared=known.spared)
        carried, runs = carry(state, checks, part.point), tuple(checks)
        place, ends = box.at(part.point), box.at(part.interval)
        answer = Answer(parameters=place, interval=ends, weight=part.weight, checks=runs, carried=carried, fit=fit)
        answers.append(answer)
    return tuple(sorted(answers, key=lambda answer: not answer.confirmed))


def carry(state: Loop, checks: Sequence[MpmRun], point: Vector) -> Values:
    """Difference of the observation between `point` [U] of the unit box and the place of the checks, [M]: the checks
    may lie a fraction of a half-width away."""
    place = state.knowledge.box.shares(checks[0].parameters)
    there, here = state.knowledge.posterior.expected(np.stack([point, place]))
    return np.asarray(there - here)


def fitted(state: Loop, checks: Sequence[MpmRun], point: Vector) -> Fit:
    """Compare the checks of an answer, carried over to `point` [U] of the unit box, with the target. The scatter is
    that of runs repeated near the point, else anywhere."""
    knowledge, near, numbers = state.knowledge, state.knowledge.posterior.near, state.numbers
    scatter = Scatter.of_runs(state.points[near], numbers[near], knowledge.scatter)
    if scatter.freedom == 0:
        scatter = Scatter.of_runs(state.points, numbers, knowledge.scatter)
    place, step = knowledge.box.shares(checks[0].parameters), 1e-3 * np.eye(len(point))
    shown = np.stack([check.numbers for check in checks]) + carry(state, checks, point)
    slopes: Matrix | None = None
    if shown.shape[1] <= MAX_NUMBERS:
        # Derivatives by parameters in fractions of their ranges, by the emulator, shape [U, M].
        slopes = (knowledge.posterior.expected(place + step) - knowledge.posterior.expected(place - step)) / 2e-3
    cells, beyond, count = knowledge.discretisation, knowledge.extrapolated, len(point)
    return fit(knowledge.target, shown, scatter, cells=cells, extrapolated=beyond, parameters=count, slopes=slopes)


def on_other_cells(task: Task, answer: Answer) -> tuple[tuple[MpmRun, ...], str]:
    """Runs at an answer on cells of another size (`other_cells`); none for a twin on the scene's own cells. The change
    that they show is, to first order, the error of the cells used (Roache, Perspective: a method for uniform reporting
    of grid refinement studies, J. Fluids Eng. 116 (1994) 405-413). There are none if the observation is of single
    particles, or if runs on smaller cells need too much memory: the second result then says so."""
    # At the place of the checks, so that the runs differ only in cell size.
    location = answer.checks[0].parameters
    scene = task.problem.scene_at(location)
    if task.target.cell == scene.domain.cell:
        return (), ""
    reasons = []
    for factor, runs in other_cells(scene, len(answer.checks)).items():
        try:
            other = task.on_cells(scene, factor)
            scenes = [replace(other, seed=check.trajectory.scene.seed) for check in answer.checks[:runs]]
            return task.compared([location] * len(scenes), scenes, Purpose.CELLS), ""
        except InputError as error:
            reasons.append(str(error))  # the box does not divide into such cells, or a run on them lacks memory
    return (), f"{WITHOUT_CELLS}: {'; '.join(reasons)}"


def other_cells(scene: Scene, runs: int) -> dict[float, int]:
    """Sizes of the cells that show the error of the cells of `scene`, over the size of these, the best one first, each
    with the number of runs beside `runs` on the scene's cells. Half the size in 2D, twice the size in 3D, where half
    the size costs sixteen times as much; a box an odd number of cells long or wide divides only into smaller ones.
    If a mass is thinner than `THIN` cells, larger cells do not show the error: for a slide a quarter of a cell thick,
    the change on larger cells has the other sign than the change on smaller cells."""
    thin = min(map(mean_thickness, scene.masses)) < THIN * scene.domain.cell
    if scene.dimension == 2:
        return {HALF: runs}
    # One run on half the cell size costs as much as sixteen, and scatters less.
    return {HALF: 1, TWICE: runs} if thin else {TWICE: runs, HALF: 1}


def mean_thickness(mass: Mass) -> float:
    """Thickness of a layer [m], its mean where there is any; of another body its height."""
    if mass.kind != "layer":
        return mass.size[1]
    given = np.array(mass.thickness)
    return float(given[given > 0.0].mean())


def is_unreachable(posterior: Posterior) -> bool:
    """Whether the likeliest parameters lie at a bound and misfit by more than scatter and noise explain. A stated prior
    is ignored. Call it before Birge's ratio enlarges the errors, which moves medians off the bound."""
    samples = posterior.samples if posterior.likelihood.prior is None else posterior.plausible
    best = samples.points[[int(np.argmax(samples.log_likelihood))]]
    if not np.any((best < AT_BOUND) | (best > 1.0 - AT_BOUND)):
        return False
    (residual,), fixed, (variance,) = posterior.likelihood.residual(best)
    square = float(residual @ np.linalg.solve(fixed + np.diag(variance), residual))
    return float(chi2.sf(square, len(residual))) < EXCLUDED
