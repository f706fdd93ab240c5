"""The posterior of the parameters over the whole box, from an emulator of the MPM.

    p(v | y*) ~ p(v) pi(v) t_nu(y* - m(v); C(v)),    C(v) = F^2 (S + N + D) + diag(k V + (k - 1) S)

| symbol | variable | meaning |
|---|---|---|
| m, V | `Emulator.predict` | mean of the MPM over jitter seeds, and the variance of its estimate |
| k | `Emulator.variance_ratio` | factor by which it errs more than stated around v |
| S | `Emulator.scatter` | scatter of one flow, because the target is one flow |
| N | `Reduction.noise` | errors of the measurement |
| D | `discretisation` | error of the MPM's cells, unless the target is a flow on the same cells |
| F | `factor` | model discrepancy that the fit shows beyond all of these (`validation.loop.discrepancy`) |
| nu | `freedom` | degrees of freedom of Student's t: those of S, more if N is known and larger |
| pi | `Likelihood.in_regime` | probability that flows at v are in the target's regime, if there are several regimes |
| p(v) | `Likelihood.log_prior` | prior, uniform between the bounds unless one is stated |

Only runs exclude parameters, a prior never does. Parameters that an emulator has excluded stay excluded, and only runs
around the remaining ones make the next emulator, which is simpler there (history matching in waves: Vernon, Goldstein
& Bower, Galaxy formation: a Bayesian uncertainty analysis, Bayesian Anal. 5 (2010) 619-670).

A cohesive column stands or falls. The emulator covers only one such regime if that predicts its runs far better
(Gramacy & Lee, Bayesian treed Gaussian process models with an application to computer modeling, J. Am. Stat. Assoc. 103
(2008) 1119-1130). A regime ends at a gap in the results of the runs.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaln
from scipy.stats import f, qmc

from inverse.noise import biases
from inverse.observations.target import Target
from inverse.posterior import Matrix, Row
from inverse.posterior.emulator import Emulator, Trend, fewest_runs, fitted, linear, most_informative, squared_distance
from inverse.posterior.reduction import Reduction, reduction
from inverse.posterior.sampling import Samples, sample
from inverse.posterior.settings import CONSTANTS

OUTERMOST = 0.1  # outermost share of a region's extent, in which a sample lies at its edge
SMALLEST = 1e-4  # smallest extent of a region, as a fraction of the range


@dataclass(frozen=True, kw_only=True)
class Region:
    """A box within the unit box that has not been excluded."""

    low: Row  # shape [U]
    high: Row  # shape [U]

    @staticmethod
    def whole(unknowns: int) -> "Region":
        return Region(low=np.zeros(unknowns), high=np.ones(unknowns))

    @staticmethod
    def around(samples: Samples) -> "Region":
        """The region around samples: their extent plus `margin`; beyond `few_parameters`, some standard deviations."""
        low, high = samples.points.min(axis=0), samples.points.max(axis=0)
        more = CONSTANTS.margin * np.maximum(high - low, SMALLEST)
        low, high = low - more, high + more
        if len(low) > CONSTANTS.few_parameters:
            wide = CONSTANTS.region_deviations * np.sqrt(np.diag(samples.covariance)) + SMALLEST
            low, high = np.maximum(low, samples.mean - wide), np.minimum(high, samples.mean + wide)
        return Region(low=np.maximum(low, 0.0), high=np.minimum(high, 1.0))

    @property
    def sampled(self) -> "Region":
        """The region of samples: beyond `few_parameters`, larger than the region that the runs fill."""
        return self if len(self.low) <= CONSTANTS.few_parameters else self.wider(CONSTANTS.beyond_region)

    def wider(self, factor: float = 2.0) -> "Region":
        """The region `factor` times as wide."""
        more = 0.5 * (factor - 1.0) * (self.high - self.low)
        return Region(low=np.maximum(self.low - more, 0.0), high=np.minimum(self.high + more, 1.0))

    def holds(self, points: Matrix) -> bool:
        """Whether few of the samples [S, U] lie at an edge that is no bound of the prior."""
        share = (points - self.low) / (self.high - self.low)
        few = len(self.low) <= CONSTANTS.few_parameters
        most = CONSTANTS.at_edge if few else CONSTANTS.at_edge_of_many
        below = (np.mean(share < OUTERMOST, axis=0) > most) & (self.low > 0.0)
        above = (np.mean(share > 1.0 - OUTERMOST, axis=0) > most) & (self.high < 1.0)
        return not bool(np.any(below | above))

    def inside(self, points: Matrix) -> NDArray[np.bool_]:
        """Which of points [n, U] lie in it, shape [n]."""
        return np.asarray(np.all((points >= self.low - 1e-9) & (points <= self.high + 1e-9), axis=1))

    def filled(self, count: int, rng: np.random.Generator) -> Matrix:
        """Points that fill it evenly, shape [count, U]."""
        cube = qmc.LatinHypercube(len(self.low), rng=rng, optimization="random-cd").random(count)
        return np.asarray(self.low + (self.high - self.low) * cube)

    def suffices(self, points: Matrix) -> bool:
        """Whether enough different runs of those at points [n, U] lie in it for their own emulator."""
        return len(np.unique(points[self.inside(points)], axis=0)) >= fewest_runs(points.shape[1])


@dataclass(frozen=True, kw_only=True)
class Regime:
    """A regime, by the runs inside and outside it."""

    inside: Matrix  # points of the runs inside, shape [n, U]
    outside: Matrix  # points of all other runs, shape [m, U]

    def __call__(self, points: Matrix) -> Row:
        """Log-probability that points [S, U] are in the regime, shape [S]. It is the share of runs inside, each
        weighted by its distance to the power -(U + 2) (Shepard, A two-dimensional interpolation function for
        irregularly-spaced data, Proc. ACM Natl. Conf. 23 (1968) 517-524)."""
        power = 0.5 * points.shape[1] + 1.0
        squares = (squared_distance(points, runs, np.ones(1)) for runs in (self.inside, self.outside))
        inside, outside = ((np.maximum(square, 1e-12) ** -power).sum(axis=1) for square in squares)
        return np.asarray(np.log(np.maximum(inside / (inside + outside), 1e-300)))


@dataclass(frozen=True, kw_only=True)
class Likelihood:
    """The likelihood of the components of the target."""

    emulator: Emulator
    target: Row  # shape [r]
    fixed: Matrix  # F^2 (S + N + D), shape [r, r]
    freedom: float  # nu
    regime: Regime | None = None  # the regime of the target's flow; default: everywhere
    within: Callable[[Matrix], Row] | None = None  # log-probability that points [S, U] are not excluded, shape [S]
    prior: Callable[[Matrix], Row] | None = None  # logarithm of a stated prior over the uniform one, shape [S]

    def __call__(self, points: Matrix) -> Row:
        """Logarithm of the likelihood times the prior over the uniform one, at points [S, U], shape [S]."""
        square, determinant = self.squares(points)
        half, more = 0.5 * self.freedom, 0.5 * len(self.target)
        constant = gammaln(half + more) - gammaln(half) - more * np.log(np.pi * self.freedom)
        by_runs = constant - 0.5 * determinant + self.relative(square) + self.in_regime(points)
        return np.asarray(by_runs + self.log_prior(points))

    def log_prior(self, points: Matrix) -> Row:
        """Logarithm of the prior over the uniform one at points [S, U], shape [S]."""
        return np.zeros(len(points)) if self.prior is None else self.prior(points)

    def plausibility(self, points: Matrix) -> Row:
        """Log-likelihood without the prior, minus its largest value for the local scales, shape [S]."""
        return self.relative(self.squares(points)[0]) + self.in_regime(points)

    def relative(self, square: Row) -> Row:
        """Logarithm of Student's density over its largest value, for squared lengths of residuals [S], shape [S]."""
        return np.asarray(-0.5 * (self.freedom + len(self.target)) * np.log1p(square / self.freedom))

    def in_regime(self, points: Matrix) -> Row:
        """Log-probability that points [S, U] are in the target's regime and not excluded, shape [S]."""
        terms = [term(points) for term in (self.regime, self.within) if term is not None]
        return np.asarray(sum(terms, np.zeros(len(points))))

    def residual(self, points: Matrix) -> tuple[Matrix, Matrix, Matrix]:
        """y* - m(v) [S, r], the fixed part of C(v) [r, r], and the rest of C(v), a diagonal [S, r]."""
        mean, variance = self.emulator.predict(points)
        ratio = self.emulator.variance_ratio(points)
        return self.target - mean, self.fixed, ratio * variance + (ratio - 1.0) * np.diag(self.emulator.scatter)

    def squares(self, points: Matrix) -> tuple[Row, Row]:
        """Squared lengths of the residuals at points [S, U] in the local scales, and log-determinants, [S] each."""
        residual, fixed, variance = self.residual(points)
        lower = np.linalg.cholesky(fixed + variance[:, :, None] * np.eye(len(self.target)))
        scaled = np.linalg.solve(lower, residual[:, :, None])[:, :, 0]
        return (scaled**2).sum(axis=1), 2.0 * np.log(np.diagonal(lower, axis1=1, axis2=2)).sum(axis=1)


@dataclass(frozen=True, kw_only=True)
class Posterior:
    """Samples of the posterior and their origin."""

    reduction: Reduction
    likelihood: Likelihood
    samples: Samples
    region: Region  # the region that had not been excluded before
    near: NDArray[np.bool_]  # which of all runs the emulator uses, shape [n]
    deviation: Row  # standard deviation of the counted errors of each number, shape [M]
    unmeasured: Matrix  # F^2 (S + D) of the components, shape [r, r]
    explained: Row  # largest variance of each component that repeated runs explain, shape [r]; above it there is misfit

    @property
    def emulator(self) -> Emulator:
        return self.likelihood.emulator

    def expected(self, points: Matrix) -> Matrix:
        """Expected results of runs at points [S, U], shape [S, M]."""
        return self.reduction.numbers(self.emulator.mean(points))

    @cached_property
    def plausible(self) -> Samples:
        """Samples that the runs do not exclude, however little is known; with many parameters, the posterior's."""
        if len(self.region.low) > CONSTANTS.few_parameters:
            return self.samples
        rng = np.random.default_rng(len(self.near))
        return sample(self.likelihood.plausibility, rng, low=self.region.low, high=self.region.high)

    @cached_property
    def emulator_share(self) -> float:
        """Share of the emulator in the variance of the residuals, over plausible samples and components [-]."""
        every = max(1, len(self.plausible.points) // 500)
        _, variance = self.emulator.predict(self.plausible.points[::every])
        unfitted = np.maximum(np.diag(self.emulator.scatter) - self.explained, 0.0)
        return float(np.mean((variance + unfitted) / (variance + np.diag(self.likelihood.fixed))))

    @property
    def next_region(self) -> Region:
        """Around plausible samples if the emulator dominates the variance; else unchanged, because slopes need room."""
        return Region.around(self.plausible) if self.emulator_share > CONSTANTS.narrow_above else self.region


def posterior(
    points: Matrix,
    numbers: Matrix,
    target: Target,
    *,
    scatter: Row,
    rng: np.random.Generator,
    region: Region | None = None,
    factor: float = 1.0,
    discretisation: Row | None = None,
    extrapolated: float = 1.0,
    trends: Sequence[Trend] = (linear,),
    within: Callable[[Matrix], Row] | None = None,
    prior: Callable[[Matrix], Row] | None = None,
) -> Posterior:
    """The posterior given runs at points [n, U] with results `numbers` [n, M].
    scatter: expected standard deviation of each number from flow to flow [M]; region: region that is not excluded and
    contains the runs that count, by default the whole box; factor: F; discretisation: change d of the numbers by the
    cells [M]; extrapolated: share e of d that no run has shown (`inverse.noise.biases`); trends: candidates, of which
    the one with the smallest leave-one-out errors is used; within, prior: see `Likelihood`."""
    unknowns = points.shape[1]
    region = region or Region.whole(unknowns)
    near = region.inside(points)
    reduced, emulator, expected, repeats = emulated(points[near], numbers[near], target, scatter, trends)
    regime, alike = None, regime_of(reduced(numbers), points, near, reduced(target.values))
    if alike is not None:
        of_regime = emulated(points[near & alike], numbers[near & alike], target, scatter, trends)
        if of_regime[1].uncertainty.mean() < CONSTANTS.other_regime * emulator.uncertainty[alike[near]].mean():
            regime = Regime(inside=points[alike], outside=points[~alike])
            near, (reduced, emulator, expected, repeats) = near & alike, of_regime
    single = emulator.scatter + np.diag((CONSTANTS.smallest_scatter * reduced.expected_scatter) ** 2)
    errors = reduced.noise
    if discretisation is not None:
        scaled = reduced.basis * reduced.weights[:, None]
        errors = errors + scaled.T @ biases(target, discretisation, extrapolated) @ scaled
    ratio = float(np.trace(errors) / max(float(np.trace(single)), 1e-300))
    # Test of lack of fit (Draper & Smith, Applied regression analysis, 1998, section 2.1).
    explained = expected**2 * f.ppf(CONSTANTS.lack_of_fit, emulator.freedom, repeats + CONSTANTS.scatter_prior)
    likelihood = Likelihood(
        emulator=emulator,
        target=reduced(target.values),
        fixed=factor**2 * (single + errors),
        freedom=emulator.freedom * (1.0 + ratio) ** 2,
        regime=regime,
        within=within,
        prior=prior,
    )
    while True:
        box = region.sampled
        samples = sample(likelihood, rng, low=box.low, high=box.high)
        if box.holds(samples.points):
            break
        # The previous wave has excluded too much.
        region = region.wider()
    return Posterior(
        reduction=reduced,
        likelihood=likelihood,
        samples=samples,
        region=region,
        near=near,
        deviation=target.deviation,
        unmeasured=factor**2 * (single + errors - reduced.noise),
        explained=explained,
    )


def regime_of(components: Matrix, points: Matrix, near: NDArray[np.bool_], target: Row) -> NDArray[np.bool_] | None:
    """Which of the runs at points [n, U] with components [n, r] are in the target's [r] regime. They are the runs
    before the widest gap in the distances from the target. None if the gap is no wider than `regime_gap`, or if the
    runs among them that are `near` [n] are too few for an emulator, or all of `near`."""
    distances = np.sqrt(((components - target) ** 2).sum(axis=1))
    ordered = np.sort(distances[near])
    _, first = np.unique(points[near], axis=0, return_index=True)
    enough = np.sort(distances[near][first])[fewest_runs(points.shape[1]) - 1 :]
    if len(enough) < 2:
        return None
    ratios = ordered[1:] / np.maximum(ordered[:-1], 1e-300)
    ratios[ordered[:-1] < enough[0]] = 0.0
    widest = int(np.argmax(ratios))
    return distances <= ordered[widest] if ratios[widest] > CONSTANTS.regime_gap else None


def emulated(
    points: Matrix, numbers: Matrix, target: Target, scatter: Row, trends: Sequence[Trend]
) -> tuple[Reduction, Emulator, Row, int]:
    """The emulator of runs at points [n, U] with results `numbers` [n, M], with `repeated_scatter`."""
    reduced = reduction(numbers, points, target, scatter=scatter)
    expected, repeats = repeated_scatter(points, reduced.components, reduced.expected_scatter)
    enough = [trend for trend in trends if len(points) > trend(points[:1]).shape[1] + 1]
    made = [fitted(points, reduced.components, expected, trend=trend, repeats=repeats) for trend in enough]
    return reduced, min(made, key=lambda emulator: float(np.mean(emulator.left_out[0] ** 2))), expected, repeats


def repeated_scatter(points: Matrix, components: Matrix, expected: Row) -> tuple[Row, int]:
    """Standard deviation of each component [n, r] from repeated runs at points [n, U], and degrees of freedom. Each has
    `scatter_prior` additional degrees of freedom, of all components together, and is at least `smallest_scatter` times
    `expected` [r]. Without repeated runs it is `expected`."""
    _, label, count = np.unique(points, axis=0, return_inverse=True, return_counts=True)
    freedom = int((count - 1).sum())
    if freedom == 0:
        return expected, 0
    means = np.zeros((len(count), components.shape[1]))
    np.add.at(means, label, components)
    square = ((components - (means / count[:, None])[label]) ** 2).sum(axis=0)
    total = square + CONSTANTS.scatter_prior * square.mean() / freedom
    deviation = np.sqrt(total / (freedom + CONSTANTS.scatter_prior))
    return np.maximum(deviation, CONSTANTS.smallest_scatter * expected), freedom


def next_points(posterior: Posterior, count: int, rng: np.random.Generator) -> Matrix:
    """Points at which further runs reduce the emulator's variance most, among plausible ones, shape [count, U]. The
    variance is over all components, each in units of its scatter and noise. With more than `few_parameters`, points
    fill the region evenly, because the space between few samples of many dimensions would remain unknown."""
    if posterior.samples.points.shape[1] > CONSTANTS.few_parameters:
        return posterior.next_region.filled(count, rng)
    candidates = np.unique(posterior.plausible.drawn(300, rng), axis=0)
    return candidates[most_informative(posterior.emulator, candidates, count, np.diag(posterior.likelihood.fixed))]
