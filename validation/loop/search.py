"""The search: runs of the MPM where they narrow the posterior most, until more of them would hardly narrow it.

First runs fill the box, or are where a surrogate leads (`validation.loop.surrogate`). Then, in waves: the emulator of
all runs around the posterior so far, its posterior, and runs where the emulator's variance hides most of it
(`inverse.posterior`). A wave costs seconds, so that none is too many.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from inverse.answer import MpmRun, Purpose
from inverse.observations import Values
from inverse.optimise import Inversion
from inverse.parameters import Vector
from inverse.posterior import Matrix
from inverse.posterior.answers import Part, parts
from inverse.posterior.emulator import fewest_runs, linear
from inverse.posterior.posterior import SMALLEST, Posterior, Region, next_points, posterior
from inverse.posterior.settings import CONSTANTS
from validation.loop.task import Task

OUTERMOST = 0.2
"""Share of the fall of the likelihood from its top to the edge of a region, within which a sample lies at the edge."""


@dataclass(frozen=True, kw_only=True)
class Search:
    """All runs so far, and what they say."""

    task: Task
    guide: Inversion | None = None
    """What the surrogate found: it confines the posterior to its region.

    Of more than `few_parameters` only the first runs are confined to it: of so many runs their own emulator excludes
    enough, and is right where the surrogate's band is too narrow.
    """
    runs: tuple[MpmRun, ...] = ()
    known: tuple[MpmRun, ...] = ()
    """Runs that were made before, for other targets; no part of the budget."""
    waves: tuple[dict[str, Any], ...] = ()
    """What was known after some of the runs, as `result.json` has it."""
    found: Posterior | None = None
    factor: float = 1.0
    """Of the discrepancy."""
    cells: tuple[MpmRun, ...] = ()
    """Runs at an answer on other cells, which are no part of the emulator."""
    discretisation: Values | None = None
    """What the cells of the scene change of the numbers there, as these show, shape [M]."""
    extrapolated: float = 1.0
    """Share of it beyond what these show."""

    @property
    def left(self) -> int:
        """Runs of the budget that are left."""
        return max(0, self.task.budget - len(self.runs))

    @property
    def posterior(self) -> Posterior:
        """After the latest wave."""
        assert self.found is not None
        return self.found

    @property
    def every(self) -> tuple[MpmRun, ...]:
        """Those that were known, and those of this search."""
        return (*self.known, *self.runs)

    @property
    def points(self) -> Matrix:
        """Of every run, in fractions of the ranges, shape [n, U]."""
        return self.task.bounds.shares(np.stack([each.parameters for each in self.every]))

    @property
    def numbers(self) -> Matrix:
        """What every run shows, shape [n, M]."""
        return np.stack([each.observation for each in self.every])

    def ran(self, points: Matrix, purpose: Purpose) -> "Search":
        """With runs at points [S, U] of the unit box, as far as the budget goes."""
        more = self.task.run(points[: self.left], len(self.runs), purpose)
        return replace(self, runs=(*self.runs, *more))

    def inferred(self, region: Region | None = None, **changes: Any) -> "Search":
        """With the posterior by all runs so far; region: that of the runs that count, in place of `region`."""
        state = replace(self, **changes)
        points, numbers = state.points, state.numbers
        guide, many = state.guide, points.shape[1] > CONSTANTS.few_parameters
        found = posterior(
            points,
            numbers,
            state.task.target,
            scatter=state.task.scatter,
            region=region or state.region(points),
            rng=state.task.generator(len(state.runs)),
            factor=state.factor,
            discretisation=state.discretisation,
            extrapolated=state.extrapolated,
            trends=(linear,) if guide is None else (guide.trend, linear),
            within=None if guide is None or (many and state.waves) else guide.within,
            prior=state.task.problem.prior,
        )
        box, problem = state.task.bounds, state.task.problem
        wave = {
            "mpm_runs": len(state.runs),
            "mean": problem.named(box.at(found.samples.mean)),
            "deviation": problem.named(box.range * np.sqrt(np.diag(found.samples.covariance))),
            "emulator_share": found.emulator_share,
            "with_surrogate": found.emulator.trend is not linear,
        }
        return replace(state, found=found, waves=(*state.waves, wave))

    def region(self, points: Matrix) -> Region | None:
        """What is not excluded: around the latest samples, once enough of the runs at points [n, U] are there."""
        if self.found is None:
            few = self.guide is None or self.guide.region is None
            return None if few else Region(low=points.min(axis=0), high=points.max(axis=0))
        if self.known and points.shape[1] <= CONSTANTS.few_parameters:
            return self.local(points)
        return self.found.next_region if self.found.next_region.suffices(points) else self.found.region

    def local(self, points: Matrix) -> Region:
        """Around the latest samples, where runs at points [n, U] scatter alike: those known before lie anywhere."""
        region = Region.around(self.posterior.plausible)
        while np.sum(region.inside(points)) < min(CONSTANTS.local_runs, len(points)):
            region = region.wider()
        return region

    def narrowed(self) -> "Search":
        """With the emulator of the runs around the samples alone, where these are in one part and it knows more there.

        Flows scatter and curve differently over the box: an emulator of all of it has the mean of their variances.
        """
        samples = self.posterior.samples
        wide = CONSTANTS.around_deviations * np.sqrt(np.diag(samples.covariance)) + SMALLEST
        low, high = np.maximum(samples.mean - wide, 0.0), np.minimum(samples.mean + wide, 1.0)
        around = Region(low=low, high=high)
        few = len(wide) <= CONSTANTS.few_parameters and not self.known
        enough = around.suffices(self.points) and np.sum(around.inside(self.points)) >= CONSTANTS.local_runs
        if not few or not enough or len(self.parts()) > 1:
            return self
        found = self.inferred(around)
        return found if found.posterior.emulator_share < self.posterior.emulator_share else self

    def parts(self) -> list[Part]:
        """The separate parts of the 95 % region."""
        found = self.posterior
        return parts(found.samples, found.likelihood, self.task.generator(len(self.runs)))

    def slopes(self, parameters: Vector) -> Matrix:
        """Derivatives of the numbers by parameters in fractions of their ranges, by the emulator, shape [U, M]."""
        step, point = 1e-3 * np.eye(len(parameters)), self.task.bounds.shares(parameters)
        return np.asarray((self.posterior.expected(point + step) - self.posterior.expected(point - step)) / 2e-3)

    @property
    def at_edge(self) -> bool:
        """Whether samples lie at the edge of the surrogate's region: the MPM leads beyond it.

        As long as the emulator knows little they lie there too, which leads nowhere.
        """
        if self.guide is None or self.posterior.likelihood.within is None or not self.converged:
            return False
        samples = self.posterior.samples
        outermost = self.guide.beyond(samples.points) > -OUTERMOST * self.guide.fall
        return float(samples.weights[outermost].sum()) > CONSTANTS.at_edge

    @property
    def converged(self) -> bool:
        """Whether further runs around the answers of a surrogate would shorten half-widths little."""
        return self.posterior.emulator_share <= CONSTANTS.converged_around

    def wider(self) -> "Search":
        """With the surrogate's region twice as wide."""
        assert self.guide is not None, "only its region has an edge"
        return self.inferred(guide=replace(self.guide, factor=2.0 * self.guide.factor))


def first(task: Task, runs: tuple[MpmRun, ...] = (), known: tuple[MpmRun, ...] = ()) -> Search:
    """The runs that fill the box, and some in its middle; as many as an emulator must have of a small budget.

    runs: those that there are already; known: from other targets, none are made where these are enough.
    """
    unknowns = len(task.problem.parameters)
    if len(known) >= fewest_runs(unknowns):
        return Search(task=task, known=known)
    count = CONSTANTS.first_runs + CONSTANTS.first_per_unknown * unknowns
    repeats = CONSTANTS.repeats
    left = task.budget - CONSTANTS.checks - len(runs)
    if count + repeats > left:
        count, repeats = max(unknowns + 3, left), 0
    cube = Region.whole(unknowns).filled(count, task.generator(0))
    middle = np.full((repeats, unknowns), 0.5)
    return Search(task=task, runs=runs, known=known).ran(np.concatenate([cube, middle]), Purpose.WAVE)


def searched(state: Search) -> Search:
    """Run the MPM in waves until the emulator's share is small; runs for checks of an answer are left over."""
    state = state.inferred()
    unknowns, spared = len(state.task.problem.parameters), CONSTANTS.repeats + CONSTANTS.checks
    size = CONSTANTS.wave + unknowns if unknowns <= CONSTANTS.few_parameters else fewest_runs(unknowns)
    enough = CONSTANTS.converged_around if state.known else CONSTANTS.converged
    while state.posterior.emulator_share > enough and state.left > spared:
        near = state.narrowed()
        if near.posterior.emulator_share <= enough:
            return near
        points = next_points(state.posterior, min(size, state.left - spared), state.task.generator(len(state.runs)))
        repeated = np.repeat(state.posterior.samples.mean[None], CONSTANTS.repeats, axis=0)
        state = state.ran(np.concatenate([repeated, points]), Purpose.WAVE).inferred()
    return state.narrowed()
