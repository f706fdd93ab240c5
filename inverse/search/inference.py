"""The posterior of the parameters from runs, and the result of one forward model, which may lead another's search.

Runs of a forward model are placed where they narrow the posterior most, until more of them would hardly narrow it. Each
wave fits an emulator to all runs around the posterior so far, samples its posterior, and runs where the emulator's
variance matters most (`inverse.posterior`). A wave costs only seconds in addition to its runs.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.stats import chi2

from inverse.forward import Forward
from inverse.observations import Values
from inverse.observations.target import ALL_DATA, Target, without
from inverse.posterior import Matrix
from inverse.posterior.answers import Part, parts, quantiles
from inverse.posterior.emulator import fewest_runs, linear
from inverse.posterior.posterior import SMALLEST, Posterior, Region, next_points, posterior
from inverse.posterior.settings import CONSTANTS
from inverse.problem import Box, Problem
from inverse.search.waves import ModelRun, WaveSearch, filling

EXCLUDED = 1e-3  # probability of parameters beyond the region of a surrogate, if its band is right
REWEIGHTED = 0.05  # relative change of an error's standard deviation that is too small to change an interval
UPDATES = 12  # largest number of updates of the errors of outliers
STEEP = 4.0  # slope of the log-probability beyond the region, over that of the log-likelihood
R = TypeVar("R", bound=ModelRun)


@dataclass(frozen=True, kw_only=True)
class Inference:
    """The posterior of the parameters from an emulator of the runs."""

    problem: Problem
    target: Target  # the target of the runs, shape [M]; for a surrogate, with its errors
    scatter: Values  # expected standard deviation of each number from run to run, shape [M]
    guide: "Inversion | None" = None
    """The result of a surrogate, whose region confines the posterior. With more than `few_parameters` it does so only
    for the first runs: later their own emulator excludes enough, even if the surrogate's band is too narrow."""
    factor: float = 1.0  # factor of the discrepancy
    spared: bool = False  # whether the factor leaves the error of the cells unchanged
    discretisation: Values | None = None  # error of the numbers due to the scene's cells, by runs on others, shape [M]
    extrapolated: float = 1.0  # share of that error that the runs do not show
    region: Region | None = None  # of the runs that count in the next update; default: what the latest posterior leaves
    latest: Posterior | None = None

    @property
    def posterior(self) -> Posterior:
        """The posterior of the latest update."""
        assert self.latest is not None, "no run was made yet"
        return self.latest

    @cached_property
    def box(self) -> Box:
        return self.problem.box

    def updated(self, search: WaveSearch[Any, Any]) -> "Inference":
        """The same with the posterior from all runs of `search`."""
        points, guide = search.points, self.guide
        many = points.shape[1] > CONSTANTS.few_parameters
        target, region = self.target, self.region or self.left(points, known=len(search.known) > 0)
        for _ in range(UPDATES):
            latest = replace(self, target=target).by(
                points,
                search.numbers,
                search.generator(),
                region=region,
                trends=(linear,) if guide is None else (guide.trend, linear),
                within=None if guide is None or (many and search.waves) else guide.within,
            )
            if target.dof is None:
                break
            # Robust noise: update each error from the posterior so far, until the errors converge.
            square = (latest.expected(latest.samples.points) - target.values) ** 2
            before, target = target.deviation, target.reweighted(latest.samples.weights @ square)
            if np.all(np.abs(target.deviation - before) <= REWEIGHTED * before):
                break
        return replace(self, latest=latest, region=None, target=target)

    def by(self, points: Matrix, numbers: Matrix, rng: np.random.Generator, **options: Any) -> Posterior:
        """The posterior from runs at points [n, U] with results `numbers` [n, M]; options: as for `posterior`."""
        cells = self.discretisation
        if cells is not None and self.spared:
            cells = cells / self.factor
        options |= {"scatter": self.scatter, "discretisation": cells, "extrapolated": self.extrapolated}
        return posterior(points, numbers, self.target, rng=rng, factor=self.factor, prior=self.problem.prior, **options)

    def left(self, points: Matrix, *, known: bool) -> Region | None:
        """The region that is not excluded: around the latest samples, once it contains enough of the runs [n, U].
        known: whether some runs were made for other targets; these lie anywhere, so more must scatter alike."""
        if self.latest is None:
            few = self.guide is None or self.guide.region is None
            return None if few else Region(low=points.min(axis=0), high=points.max(axis=0))
        if known and points.shape[1] <= CONSTANTS.few_parameters:
            region = Region.around(self.latest.plausible)
            while np.sum(region.inside(points)) < min(CONSTANTS.local_runs, len(points)):
                region = region.wider()
            return region
        return self.latest.next_region if self.latest.next_region.suffices(points) else self.latest.region


@dataclass(frozen=True, kw_only=True)
class Inversion(WaveSearch[ModelRun, Inference]):
    """The result of one forward model: a search by its predictions, and the stationary points of its misfit. The factor
    of its knowledge widens its region beyond its band, according to the results of the MPM."""

    forward: Forward
    minima: Matrix  # points at which the steps from each start ended, shape [k, U]
    settled: NDArray[np.bool_]  # which of them have converged, shape [k]
    rough: float  # expected roughness of the numbers, over their standard deviations from C
    region: Region | None = None  # part of the box in which the posterior is sampled; default: the whole box
    seconds: float = 0.0

    @property
    def posterior(self) -> Posterior:
        """The posterior from its emulator, in the units of the box."""
        return self.knowledge.posterior

    @property
    def target(self) -> Target:
        """The target's numbers that it predicts, with S and E in their covariance, shape [m]."""
        return self.knowledge.target

    @cached_property
    def regions(self) -> list[Part]:
        """The separate parts of its 95 % region, each with its median."""
        return parts(self.posterior.samples, self.posterior.likelihood, self.generator(1))

    @cached_property
    def answers(self) -> list[Part]:
        """The same parts, each with its minimum of L, to which MPM runs are led."""
        answers = []
        for part in self.regions:
            low, high = part.points.min(axis=0), part.points.max(axis=0)
            # No sample lies at a bound.
            slack = 0.05 * (high - low)
            minima = self.minima[np.all((self.minima >= low - slack) & (self.minima <= high + slack), axis=1)]
            point = minima[int(np.argmin(self.losses(minima)))] if len(minima) else part.point
            answers.append(replace(part, point=point))
        return answers

    @cached_property
    def precision(self) -> Matrix:
        """C^-1, shape [m, m]."""
        return np.asarray(np.linalg.inv(self.target.errors.matrix))

    def misfits(self, points: Matrix, numbers: Matrix | None = None) -> Values:
        """r^T C^-1 r, [k], of predictions `numbers` [k, m]; default: the stored predictions at `points` [k, U]."""
        if numbers is None:
            made = self.points
            numbers = self.numbers[[int(np.argmin(np.abs(made - point).sum(axis=1))) for point in points]]
        residual = numbers - self.target.values
        return np.asarray(((residual @ self.precision) * residual).sum(axis=1))

    def losses(self, points: Matrix, numbers: Matrix | None = None) -> Values:
        """L, shape [k]; arguments as for `misfits`."""
        prior = self.knowledge.problem.prior
        return self.misfits(points, numbers) + (np.zeros(len(points)) if prior is None else -2.0 * prior(points))

    def refined(self, **changes: Any) -> "Inversion":
        """The same with the posterior from all predictions in its region; changes: first applied to `knowledge`."""
        return self.informed(region=self.region or Region.whole(self.minima.shape[1]), **changes)

    @property
    def fall(self) -> float:
        """Decrease of the log-likelihood from its top to the edge of the region."""
        return 0.5 * float(chi2.isf(EXCLUDED, self.minima.shape[1]))

    def beyond(self, points: Matrix) -> Values:
        """Log-likelihood at the region's edge minus that at points [S, U], shape [S]."""
        belief, log_prior = self.posterior, self.posterior.likelihood.log_prior
        top = (belief.samples.log_likelihood - log_prior(belief.samples.points)).max()
        return np.asarray(top - self.fall - (belief.likelihood(points) - log_prior(points)))

    def within(self, points: Matrix) -> Values:
        """Log-probability that the region contains points [S, U], shape [S]: 0 inside, steep outside."""
        return -STEEP * np.maximum(self.beyond(points), 0.0)

    def trend(self, points: Matrix) -> Matrix:
        """1 and its first U components at points [S, U], shape [S, 1 + U]: the trend of an emulator of the MPM."""
        emulator, count = self.posterior.emulator, points.shape[1]
        # In units of their standard deviation over the predictions.
        spread = emulator.numbers[:, :count].std(axis=0)
        components = emulator.mean(points)[:, :count] / np.maximum(spread, 1e-300)
        return np.concatenate([np.ones((len(points), 1)), components], axis=1)

    def around(self, count: int, rng: np.random.Generator) -> Matrix:
        """Points [count, U] of its 95 % region far from answers and each other; with many parameters, evenly in it."""
        samples = self.posterior.samples
        if samples.points.shape[1] > CONSTANTS.few_parameters:
            return Region.around(samples).filled(count, rng)
        threshold = np.quantile(samples.log_likelihood, 1.0 - CONSTANTS.credible)
        inside = samples.points[samples.log_likelihood >= threshold]
        chosen = [answer.point for answer in self.answers]
        scale = np.maximum(inside.std(axis=0), 1e-9)
        for _ in range(count):
            apart = cKDTree(np.stack(chosen) / scale).query(inside / scale)[0]
            chosen.append(inside[int(np.argmax(apart))])
        return np.stack(chosen[-count:])

    def compared(self, points: Matrix, shown: Matrix) -> "Inversion":
        """The same with a region wide enough for the results `shown` [n, M] of MPM runs at points [n, U]. The criterion
        is the squared difference in units of C, whose mean is 1 for each number if the band is right."""
        belief, factor = self.posterior, self.knowledge.factor
        places, label = np.unique(points, axis=0, return_inverse=True)
        selected = np.stack([self.forward.select(row) for row in shown])
        means = belief.reduction(np.stack([selected[label == group].mean(axis=0) for group in range(len(places))]))
        residual = means - belief.emulator.mean(places)
        square = np.einsum("sr,rs->s", residual, np.linalg.solve(belief.likelihood.fixed / factor**2, residual.T))
        contradiction = float(np.sqrt(square.max() / chi2.isf(0.05, residual.shape[1])))
        return self if contradiction <= factor else self.refined(factor=contradiction)


def left_out(search: WaveSearch[Any, Any]) -> dict[str, dict[str, float]]:
    """Half-widths of the numbers without each of several observations, and with all (`ALL_DATA`), by their names. They
    come from an emulator of all runs over the whole box, anywhere in which such a posterior may lie."""
    knowledge: Inference = search.knowledge
    names, widths = [part.name for part in knowledge.target.observation.parts], {}
    if len(names) < 2:
        return {}
    for name in (ALL_DATA, *names):
        target, index = without(knowledge.target, name)
        cells = None if knowledge.discretisation is None else knowledge.discretisation[index]
        rest = replace(knowledge, target=target, scatter=knowledge.scatter[index], discretisation=cells)
        samples = rest.by(search.points, search.numbers[:, index], search.generator()).samples
        low, _, high = quantiles(samples.points, samples.weights)
        widths[name] = knowledge.problem.named(0.5 * knowledge.box.range * (high - low))
    return widths


def begun(search: WaveSearch[R, Inference]) -> WaveSearch[R, Inference]:
    """The search with runs that fill the box, enough for an emulator, unless the known runs suffice."""
    unknowns = len(search.knowledge.problem.parameters)
    if len(search.known) >= fewest_runs(unknowns):
        return search
    count, repeats = CONSTANTS.first_runs + CONSTANTS.first_per_unknown * unknowns, CONSTANTS.repeats
    left = search.left - CONSTANTS.checks
    if count + repeats > left:
        count, repeats = max(unknowns + 3, left), 0
    return search.ran(filling(unknowns, count, search.generator(0), repeats=repeats))


def wave_size(unknowns: int) -> int:
    """Number of runs in a wave; with many parameters, as many as an emulator of a smaller region needs."""
    return CONSTANTS.wave + unknowns if unknowns <= CONSTANTS.few_parameters else fewest_runs(unknowns)


def further(search: WaveSearch[R, Inference], count: int) -> Matrix:
    """Points at which `count` runs narrow the posterior most, shape [count, U]."""
    return next_points(search.knowledge.posterior, count, search.generator())


def searched(search: WaveSearch[R, Inference]) -> WaveSearch[R, Inference]:
    """The search after waves until the emulator's share is small; runs for checks of an answer are reserved."""
    unknowns, spared = len(search.knowledge.problem.parameters), CONSTANTS.repeats + CONSTANTS.checks
    enough = CONSTANTS.converged_around if search.known else CONSTANTS.converged
    near = search

    def next_wave(state: WaveSearch[R, Inference]) -> Matrix | None:
        nonlocal near
        near, left = narrowed(state), state.left - spared
        if near.knowledge.posterior.emulator_share <= enough or left <= 0:
            return None
        repeated = np.repeat(state.knowledge.posterior.samples.mean[None], CONSTANTS.repeats, axis=0)
        return np.concatenate([repeated, further(state, min(wave_size(unknowns), left))])

    search.in_waves(next_wave)
    return near


def narrowed(search: WaveSearch[R, Inference]) -> WaveSearch[R, Inference]:
    """The search with an emulator of the runs around the samples only, if these form one part and it knows more there.
    Scatter and curvature vary over the box: an emulator of the whole box averages their variances."""
    before = search.knowledge.posterior
    wide = CONSTANTS.around_deviations * np.sqrt(np.diag(before.samples.covariance)) + SMALLEST
    low, high = np.maximum(before.samples.mean - wide, 0.0), np.minimum(before.samples.mean + wide, 1.0)
    around = Region(low=low, high=high)
    few = len(wide) <= CONSTANTS.few_parameters and not search.known
    enough = around.suffices(search.points) and np.sum(around.inside(search.points)) >= CONSTANTS.local_runs
    if not few or not enough or len(parts_of(search)) > 1:
        return search
    informed = search.informed(region=around)
    return informed if informed.knowledge.posterior.emulator_share < before.emulator_share else search


def parts_of(search: WaveSearch[R, Inference]) -> list[Part]:
    belief = search.knowledge.posterior
    return parts(belief.samples, belief.likelihood, search.generator())
