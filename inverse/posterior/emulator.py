"""An emulator of the MPM: a Gaussian process over the box with a linear trend and the scatter of the runs.

    y_j(v) = h(v) b_j + z_j(v) + e_j,    cov z_j = s_j^2 k(v, v'),    var e_j = g_j s_j^2

| symbol | variable | meaning |
|---|---|---|
| v | `points` | parameters in fractions of their ranges, shape [n, U] |
| y | `numbers` | results of n MPM runs, r components, shape [n, r] |
| h | `trend` | 1, v, and the prediction of a surrogate at v if there is one, shape [n, p] |
| k | `correlation` | Matern's of order 5/2, with a correlation length for each parameter |
| e | - | scatter from flow to flow with the jitter seed |
| g | `nuggets` | its variance over that of the process |

The coefficients b have a flat prior and are integrated out (Rasmussen & Williams, Gaussian processes for machine
learning, 2006, section 2.7): with P an orthonormal basis of the complement of the runs' trend, P^T y has the
restricted likelihood (Patterson & Thompson, Recovery of inter-block information when block sizes are unequal,
Biometrika 58 (1971) 545-554)

    log L_j = -1/2 [ (n - p) log s_j^2 + sum_i log(l_i + g) ],    s_j^2 = 1/(n - p) sum_i (q_i . P^T y_j)^2 / (l_i + g)

with l and q the eigenvalues and eigenvectors of P^T k P. One decomposition serves every component and every g, which is
summed over. With a surrogate in the trend this is the multi-fidelity model of Kennedy & O'Hagan (Predicting the
output from a complex computer code when fast approximations are available, Biometrika 87 (2000) 1-13).
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp, polygamma

from inverse.posterior import Matrix, Row
from inverse.posterior.settings import CONSTANTS

Trend = Callable[[Matrix], Matrix]  # points [S, U] -> the trend's functions there [S, p]
NUGGETS = np.array((1e-6, 1e-4, 1e-3, 1e-2, 3e-2, 0.1, 0.3, 1.0, 3.0, 10.0, 100.0, 1e4))  # g: a grid of quadrature
NEGLIGIBLE = 1e-3  # weight of a nugget below which it is left out
SHORTEST, LONGEST = 0.03, 20.0  # bounds of the search for the likeliest correlation length, in ranges
LENGTH_STEPS = (0.8, 0.4, 0.2, 0.1)  # of the search for their logarithms: runs allow less accuracy than the smallest
SAME = 1e-6  # difference below which two log-likelihoods are equal


def fewest_runs(unknowns: int) -> int:
    """Smallest number of runs at different parameters for an emulator of so many unknowns."""
    return math.ceil(CONSTANTS.runs_per_coefficient * (1 + unknowns)) + 2


def linear(points: Matrix) -> Matrix:
    """The trend without a surrogate: 1 and v, shape [S, 1 + U]."""
    return np.concatenate([np.ones((len(points), 1)), points], axis=1)


def squared_distance(one: Matrix, other: Matrix, lengths: Matrix) -> Matrix:
    """Squared distance between points [n, U] and [m, U] in units of `lengths` [U], shape [n, m]."""
    a, b = one / lengths, other / lengths
    return np.asarray(np.maximum((a**2).sum(1)[:, None] + (b**2).sum(1)[None] - 2.0 * a @ b.T, 0.0))


def correlation(one: Matrix, other: Matrix, lengths: Matrix) -> Matrix:
    """Matern's correlation of order 5/2 between points [n, U] and [m, U], shape [n, m]; lengths: [U]."""
    distance = np.sqrt(5.0 * squared_distance(one, other, lengths))
    return np.asarray((1.0 + distance + distance**2 / 3.0) * np.exp(-distance))


@dataclass(frozen=True, kw_only=True)
class Emulator:
    """The Gaussian process, conditioned on runs."""

    points: Matrix  # shape [n, U]
    numbers: Matrix  # shape [n, r]
    expected_scatter: Matrix  # expected standard deviation of each component from flow to flow, shape [r]
    lengths: Matrix  # shape [U]
    trend: Trend = linear
    repeats: int = 0  # degrees of freedom of that scatter from repeated runs; 0 without them

    @property
    def freedom(self) -> int:
        """n - p: degrees of freedom of every variance."""
        return len(self._decomposed[2])

    @cached_property
    def _decomposed(self) -> tuple[Matrix, Matrix, Matrix, Matrix]:
        """H^+ [p, n], P q [n, n - p], l [n - p] and the contrasts of the numbers, q . P^T y [n - p, r]."""
        basis = self.trend(self.points)
        count = basis.shape[1]
        full, upper = np.linalg.qr(basis, mode="complete")
        inverse = np.linalg.solve(upper[:count], full[:, :count].T)
        across = full[:, count:]
        values, vectors = np.linalg.eigh(across.T @ self._correlations @ across)
        contrasts = across @ vectors
        return inverse, contrasts, np.maximum(values, 0.0), contrasts.T @ self.numbers

    @cached_property
    def _correlations(self) -> Matrix:
        return correlation(self.points, self.points, self.lengths)

    @cached_property
    def _quadrature(self) -> tuple[Matrix, Matrix, float]:
        """Weights of the nuggets [G, r], variances s^2 [G, r], and the log-likelihood of the lengths."""
        _, _, values, roots = self._decomposed
        total = values + NUGGETS[:, None]
        variance = np.maximum((1.0 / total) @ roots**2 / len(values), 1e-30)
        likelihood = -0.5 * (len(values) * np.log(variance) + np.log(total).sum(axis=1)[:, None])
        scatter = 0.5 * np.log(NUGGETS[:, None] * variance) - np.log(self.expected_scatter)
        # The scatter of few repeated runs is often far too small, so the variance of log(chi-square) is added.
        variety = float(polygamma(1, 0.5 * self.repeats)) / 4.0 if self.repeats else 0.0
        likelihood = likelihood - 0.5 * scatter**2 / (CONSTANTS.scatter_spread**2 + variety)
        whole = logsumexp(likelihood, axis=0)
        return np.exp(likelihood - whole), variance, float(whole.sum())

    @property
    def log_likelihood(self) -> float:
        """Log-likelihood of the correlation lengths, with their prior."""
        median = CONSTANTS.length_scale * np.sqrt(len(self.lengths))
        shift = np.log(self.lengths / median) / CONSTANTS.length_spread
        return self._quadrature[2] - 0.5 * float(np.sum(shift**2))

    @cached_property
    def scatter(self) -> Matrix:
        """Covariance of the components of one flow, over the jitter seeds, shape [r, r]."""
        weights, variance, _ = self._quadrature
        deviation = np.sqrt((weights * variance * NUGGETS[:, None]).sum(axis=0))
        residual = self.numbers - self.mean(self.points)
        root = np.sqrt((residual**2).mean(axis=0))
        alike = np.divide(residual, root, out=np.zeros_like(residual), where=root > 0.0)
        # Few runs determine the correlations of many components poorly: these are r^2 / 2 numbers.
        share = self.freedom / (self.freedom + 0.5 * len(deviation) ** 2)
        together = share * (alike.T @ alike) / len(residual)
        np.fill_diagonal(together, 1.0)
        return np.asarray(together * np.outer(deviation, deviation))

    @cached_property
    def _weights(self) -> Matrix:
        """Weighted coefficients of the contrasts in the mean, shape [n - p, r]."""
        weights, _, _ = self._quadrature
        _, _, values, roots = self._decomposed
        precision = 1.0 / (values + NUGGETS[:, None])
        return np.asarray(np.einsum("gi,gr->ir", precision, weights) * roots)

    @cached_property
    def _of_trend(self) -> tuple[Matrix, Matrix, Matrix, Matrix]:
        """H^+ y [p, r], H^+ K P q [p, n - p], H^+ K H^+^T and H^+ H^+^T [p, p]."""
        inverse, contrasts, _, _ = self._decomposed
        weighted = inverse @ self._correlations
        return inverse @ self.numbers, weighted @ contrasts, weighted @ inverse.T, inverse @ inverse.T

    def _projected(self, points: Matrix) -> tuple[Matrix, Matrix, Matrix]:
        """h [S, p], the correlations k with the runs [S, n], and the contrasts of k - K H^+^T h [S, n - p]."""
        functions, near = self.trend(points), correlation(points, self.points, self.lengths)
        return functions, near, near @ self._decomposed[1] - functions @ self._of_trend[1]

    def mean(self, points: Matrix) -> Matrix:
        """Expected components at points [S, U], shape [S, r]."""
        functions, _, contrasts = self._projected(points)
        return np.asarray(functions @ self._of_trend[0] + contrasts @ self._weights)

    def predict(self, points: Matrix) -> tuple[Matrix, Matrix]:
        """Expected components of the mean over jitter seeds at points [S, U], and their variances, both [S, r]."""
        functions, near, contrasts = self._projected(points)
        fitted_trend, _, spread_of_trend, leverages = self._of_trend
        inverse, _, values, roots = self._decomposed
        weights, variance, _ = self._quadrature
        prior = 1.0 - 2.0 * ((near @ inverse.T) * functions).sum(1) + ((functions @ spread_of_trend) * functions).sum(1)
        leverage = ((functions @ leverages) * functions).sum(1)
        counted = np.flatnonzero(weights.max(axis=1) > NEGLIGIBLE)
        precision = 1.0 / (values + NUGGETS[counted, None])
        unexplained = prior[:, None] + leverage[:, None] * NUGGETS[counted] - contrasts**2 @ precision.T
        spread = np.maximum(unexplained, 0.0) @ (weights * variance)[counted]
        # The variance includes the differences between the means of different nuggets.
        for index, row in zip(counted, precision, strict=True):
            spread += weights[index] * (contrasts @ (row[:, None] * roots - self._weights)) ** 2
        return np.asarray(functions @ fitted_trend + contrasts @ self._weights), np.asarray(spread)

    def covariance(self, points: Matrix, component: int) -> tuple[Matrix, float]:
        """Covariance of a component between points [S, U], shape [S, S], and the variance of its scatter."""
        functions, near, contrasts = self._projected(points)
        weights, variance, _ = self._quadrature
        inverse, _, values, _ = self._decomposed
        nugget = float(np.exp(weights[:, component] @ np.log(NUGGETS)))
        scale = float(weights[:, component] @ variance[:, component])
        cross = functions @ (inverse @ near.T)
        prior = correlation(points, points, self.lengths) - cross - cross.T
        prior += functions @ (self._of_trend[2] + nugget * self._of_trend[3]) @ functions.T
        return scale * (prior - (contrasts / (values + nugget)) @ contrasts.T), scale * nugget

    @cached_property
    def left_out(self) -> tuple[Matrix, Matrix]:
        """Error of each run's components as predicted by all others, and its variance, both [n, r]."""
        weights, variance, _ = self._quadrature
        _, contrasts, values, roots = self._decomposed
        errors, variances = np.zeros_like(self.numbers), np.zeros_like(self.numbers)
        for nugget, share, scale in zip(NUGGETS, weights, variance, strict=True):
            precision = 1.0 / (values + nugget)
            diagonal = np.maximum(contrasts**2 @ precision, 1e-300)[:, None]
            errors += share * (contrasts @ (precision[:, None] * roots)) / diagonal
            variances += share * scale / diagonal
        return errors, variances

    @property
    def uncertainty(self) -> Matrix:
        """Squared error of each run as predicted by all others, and its variance, over the components, shape [n]."""
        errors, variances = self.left_out
        return np.asarray((errors**2 + variances).sum(axis=1))

    @cached_property
    def _left_out_ratio(self) -> tuple[Matrix, Matrix]:
        """Squared leave-one-out errors of the runs over their variances [n, r], and the widths of a local mean [U]."""
        count, unknowns = self.points.shape
        errors, variances = self.left_out
        widths = np.maximum(self.points.std(axis=0), 1e-9) * count ** (-1.0 / (unknowns + 4.0))
        return errors**2 / np.maximum(variances, 1e-300), widths

    def variance_ratio(self, points: Matrix) -> Matrix:
        """Factor by which the variances around points [S, U] are larger than stated, shape [S, r]. It is the mean
        squared leave-one-out error of the runs around, over its variance, with Gaussian weights by Scott's rule
        (Multivariate density estimation, 1992); `ratio_prior` runs of ratio 1 are added."""
        ratios, widths = self._left_out_ratio
        near = np.exp(-0.5 * squared_distance(points, self.points, widths))
        total = near.sum(axis=1) + CONSTANTS.ratio_prior
        mean = (near @ ratios + CONSTANTS.ratio_prior) / total[:, None]
        return np.asarray(np.maximum(mean, CONSTANTS.smallest_ratio))


def fitted(points: Matrix, numbers: Matrix, expected: Matrix, *, trend: Trend = linear, repeats: int = 0) -> Emulator:
    """The emulator with the likeliest correlation lengths; many parameters share one. Arguments as for `Emulator`."""
    count = points.shape[1]
    free = count if count <= CONSTANTS.separate_lengths else 1
    of = partial(Emulator, points=points, numbers=numbers, expected_scatter=expected, trend=trend, repeats=repeats)

    def at(logarithms: NDArray[np.floating]) -> Emulator:
        return of(lengths=np.broadcast_to(np.exp(logarithms), (count,)))

    middle = round(math.log(CONSTANTS.length_scale * np.sqrt(count)) / LENGTH_STEPS[-1])
    logarithms = likeliest(lambda steps: at(LENGTH_STEPS[-1] * steps).log_likelihood, np.full(free, middle))
    return at(LENGTH_STEPS[-1] * logarithms)


def likeliest(log_likelihood: Callable[[NDArray[np.int64]], float], start: NDArray[np.int64]) -> NDArray[np.int64]:
    """The logarithms of the likeliest correlation lengths, as multiples of the smallest step, shape [U]. They come from
    a pattern search over a lattice (Hooke & Jeeves, "Direct search" solution of numerical and statistical problems, J.
    ACM 8 (1961) 212-229). The likelihood is flat at its top, so that a descent would end by the last digits of its
    slopes, which differ between processors, and so would all later samples and runs."""
    best, value = start.copy(), log_likelihood(start)
    smallest, largest = (round(math.log(length) / LENGTH_STEPS[-1]) for length in (SHORTEST, LONGEST))
    for step in LENGTH_STEPS:
        width, improved = round(step / LENGTH_STEPS[-1]), True
        while improved:
            improved = False
            for number, side in product(range(len(best)), (-width, width)):
                tried = best.copy()
                tried[number] = min(max(tried[number] + side, smallest), largest)
                other = log_likelihood(tried)
                if other > value + SAME:
                    best, value, improved = tried, other, True
    return best


def most_informative(
    emulator: Emulator, candidates: Matrix, count: int, scales: Row, relevance: Row | float = 1.0
) -> list[int]:
    """The candidates [S, U] to run: those that reduce the emulator's variance over all candidates most. They are chosen
    one after the other by the largest decrease, given those before (MacKay, Information-based objective functions for
    active data selection, Neural Comput. 4 (1992) 590-604). scales: of the squares of each component [r]; relevance:
    weights of the candidates [S] in the mean of the variance."""
    parts = [emulator.covariance(candidates, component) for component in range(len(scales))]
    weights = np.broadcast_to(relevance, len(candidates))
    chosen: list[int] = []
    for _ in range(min(count, len(candidates))):
        gain = sum(
            (weights[:, None] * whole**2).mean(axis=0) / (np.diag(whole) + nugget) / scale
            for (whole, nugget), scale in zip(parts, scales, strict=True)
        )
        index = int(np.argmax(gain))
        chosen.append(index)
        parts = [
            (whole - np.outer(whole[:, index], whole[index]) / (whole[index, index] + nugget), nugget)
            for whole, nugget in parts
        ]
    return chosen
