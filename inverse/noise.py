"""The misfit between observation and MPM at the right parameters that noise, scatter and cells explain.

    y = f + sum_o b_o d_o + scatter + noise,    S^2 = 1/M r^T (K + D)^-1 r,    K = diag(n^2 + (1 + 1/k) c^2)

| symbol | variable | meaning |
|---|---|---|
| r | `residual` | mean of k runs of the MPM minus the observation, M numbers |
| n | `noise` | standard deviation of the measurement errors (`Target.errors`) |
| c | `scatter` | standard deviation of one flow over the jitter seeds; the observation is one flow, the mean is of k |
| d | `cells` | error of the MPM's cells, unless the observation is a flow on the same cells |
| b, D | `biases` | its unknown factor, smooth within an observation o, integrated out: one error, no noise |
| S | `ratio` | 1 on average at the right parameters |

The MPM lies within the predictive interval if chance exceeds S at least once in a hundred times. The errors of the
numbers are dependent: S^2 still has the mean 1, but a wider distribution, an F distribution with

    h = M^2 / |R|_F^2,    nu = nu_c (1 + (N + D) / C)^2

degrees of freedom. R is the covariance of whitened r (Satterthwaite, Biometrics Bull. 2 (1946) 110-114), nu_c the
degrees of freedom of the scatter's estimate, and N, D, C the sums of n^2, d^2 and (1 + 1/k) c^2; N and D are known.

If there are more numbers than parameters and chance exceeds S less than once in twenty times, half-widths are
multiplied by S (M / (M - U))^(1/2), as if all noise had been stated too small: Birge's ratio (R. T. Birge, The
calculation of errors by the method of least squares, Phys. Rev. 40 (1932) 207-227). If the cells have an error too,
either all errors are too small, or only noise and scatter, whichever makes the residuals more likely,

    F^2 (K + D)  or  F^2 K + D,    r^T (...)^-1 r = M - U

"""

import math
from dataclasses import dataclass, field

import numpy as np
from scipy.linalg import eigh, solve_triangular
from scipy.optimize import brentq
from scipy.stats import f, norm

from datasets.flow.measures import rms
from datasets.scene.grid_field import Floats
from inverse.observations.target import Target

SMOOTH = 0.3
"""Correlation length of the error of the cells, over the numbers of an observation, if no run has shown its shape. For
eight fronts of a column over time (cells of 20, 10 and 5 mm) the change by finer cells beyond the known shape changes
sign once, like a Gaussian process of this length (docs/theory/uncertainty.md)."""
CONFIDENCE = 0.99  # share of right answers that lie within the predictive interval
RARE = 0.05  # a misfit that chance exceeds less often than this widens half-widths
PRIOR_FREEDOM = 2.0  # degrees of freedom of the expected scatter, added to those of repeated runs
FLOOR = 1.0e-6  # smallest variance of a number over the largest one: rounding, for a number that does not vary at all


@dataclass(frozen=True, kw_only=True)
class Scatter:
    """The scatter of flows that differ only in their jitter seed."""

    deviations: Floats  # deviations of runs from the mean of runs at the same parameters, shape [n, M]
    freedom: int  # nu_c: number of runs minus number of means
    expected: Floats  # expected standard deviation of each number before any run, shape [M]

    @classmethod
    def of_runs(cls, points: Floats, numbers: Floats, expected: Floats) -> "Scatter":
        """The scatter of repeated runs, among runs at points [n, U] with results `numbers` [n, M]."""
        _, label, count = np.unique(points, axis=0, return_inverse=True, return_counts=True)
        means = np.stack([numbers[label == place].mean(axis=0) for place in range(len(count))])
        repeated = (count > 1)[label]
        return cls(deviations=(numbers - means[label])[repeated], freedom=int((count - 1).sum()), expected=expected)

    @property
    def variance(self) -> Floats:
        """c^2, shape [M]; the expected variance, scaled to that of the runs over all numbers, has `PRIOR_FREEDOM`."""
        if self.freedom == 0:
            return np.asarray(self.expected**2)
        square = (self.deviations**2).sum(axis=0)
        level = float(np.mean(square / np.maximum(self.expected, 1e-300) ** 2)) / self.freedom
        prior = np.maximum(level, FLOOR) * self.expected**2
        return np.asarray((square + PRIOR_FREEDOM * prior) / (self.freedom + PRIOR_FREEDOM))

    @property
    def covariance(self) -> Floats:
        """The covariance [M, M] of numbers with this variance, correlated as in runs at one point.

            C = D^(1/2) [(1 - q) c + q I] D^(1/2)

        c is the sample correlation and q the share that minimises the expected error of a Gaussian sample towards the
        identity (oracle approximating shrinkage: Chen, Wiesel, Eldar & Hero, IEEE Trans. Signal Process. 58 (2010)
        5016-5029, eq. 23)."""
        count, size = self.deviations.shape
        square = (self.deviations**2).sum(axis=0) / self.freedom
        scaled = self.deviations / np.sqrt(np.maximum(square, FLOOR * max(float(square.max()), 1e-12)))
        correlation = scaled.T @ scaled / self.freedom
        squares, trace = float((correlation**2).sum()), float(np.trace(correlation))
        top = (1.0 - 2.0 / size) * squares + trace**2
        bottom = (count + 1.0 - 2.0 / size) * (squares - trace**2 / size)
        share = 1.0 if bottom <= 0.0 else min(1.0, top / bottom)
        correlation *= 1.0 - share
        np.fill_diagonal(correlation, 1.0)
        return np.asarray(correlation * np.sqrt(np.outer(self.variance, self.variance)))


@dataclass(frozen=True, kw_only=True)
class Fit:
    """The fit of the MPM at an answer to the observation."""

    residual: float  # root mean square of r, in the unit of the numbers
    noise: float  # root mean square of n
    scatter: float  # root mean square of c
    cells: float  # root mean square of d
    ratio: float  # S
    freedom: tuple[float, float]  # h and nu
    numbers: int  # M
    parameters: int  # U
    outliers: dict[int, float] = field(default_factory=dict)  # numbers that the others do not predict -> z (`outlying`)
    alone: float | None = None  # F of noise and scatter alone, if that makes the residuals more likely
    applied: float = 1.0  # the applied F, as reported
    spared: bool = False  # whether it was applied to noise and scatter alone

    @property
    def allowed(self) -> float:
        """Half of the predictive interval: the largest root mean square of residuals within it."""
        limit = math.sqrt(float(f.ppf(CONFIDENCE, *self.freedom)))
        return self.residual * limit / self.ratio if self.ratio > 0.0 else limit * math.hypot(self.noise, self.cells)

    @property
    def inside(self) -> bool:
        """Whether the MPM lies within the predictive interval."""
        return self.ratio**2 <= float(f.ppf(CONFIDENCE, *self.freedom))

    @property
    def probability(self) -> float:
        """Probability of such an S or a larger one by chance."""
        return float(f.sf(self.ratio**2, *self.freedom))

    @property
    def factor(self) -> float:
        """F, the factor for the errors, at least 1: Birge's ratio with M - U degrees of freedom."""
        if self.numbers <= self.parameters or self.ratio <= 1.0 or self.probability >= RARE:
            return 1.0
        return self.alone or self.ratio * math.sqrt(self.numbers / (self.numbers - self.parameters))


def biases(target: Target, cells: Floats, extrapolated: float) -> Floats:
    """Covariance D [M, M] of the errors by cells that change the numbers by `cells` [M]: smooth within an observation.

    D = (1 - e/2) d d^T + e/2 a a^T k,    a_i^2 = sum_j k_ij d_j^2 / sum_j k_ij,    k Gaussian of length `SMOOTH`

    extrapolated: share e of d that no run has shown. Half of it has the shape of d, half any smooth shape that is as
    large as d around each number: cells do not change a front before it has moved, so its unknown error is small too.
    """
    covariance = (1.0 - 0.5 * extrapolated) * np.outer(cells, cells)
    for part in target.observation.parts:
        numbers = np.arange(len(cells))[part.numbers]
        apart = (numbers[:, None] - numbers) / max(1.0, SMOOTH * len(numbers))
        alike = np.exp(-0.5 * apart**2)
        around = np.sqrt(alike @ cells[numbers] ** 2 / alike.sum(axis=1))
        # Each observation has its own factor.
        covariance[np.ix_(numbers, numbers)] += 0.5 * extrapolated * alike * np.outer(around, around)
    return covariance


def fit(
    target: Target,
    shown: Floats,
    scatter: Scatter,
    *,
    cells: Floats | None = None,
    extrapolated: float = 1.0,
    parameters: int = 0,
    slopes: Floats | None = None,
) -> Fit:
    """The fit of runs at one answer, with results `shown` [k, M].
    cells: d [M]; extrapolated: see `biases`; parameters: number fitted; slopes: by them [U, M], for `outlying`."""
    share, residual = 1.0 + 1.0 / len(shown), shown.mean(axis=0) - target.values
    errors, variance = target.errors, share * scatter.variance
    independent = errors.deviation**2
    total, free = np.maximum(independent + variance, 1e-300), max(1, scatter.freedom)
    bias = None if cells is None else biases(target, cells, extrapolated)
    size, flows = len(residual), scatter.deviations * math.sqrt(share / free)
    if cells is None or bias is None:
        whitened, flows = residual / np.sqrt(total), flows / np.sqrt(total)
        # |R|_F^2 of R = N + F^T F + diag(remainder), over total, without the matrix of a whole deposit.
        shown_by_flows = (flows**2).sum(axis=0)
        remainder = np.maximum(variance / total - shown_by_flows, 0.0)
        if errors.dependent is None:
            remainder += independent / total
        square = float(np.sum((flows @ flows.T) ** 2) + 2.0 * remainder @ shown_by_flows + remainder @ remainder)
        if errors.dependent is not None:
            noise = errors.over(np.sqrt(total)).matrix
            square += float(np.sum(noise**2) + 2.0 * np.sum((flows @ noise) * flows) + 2.0 * remainder @ np.diag(noise))
    else:
        lower = np.linalg.cholesky(np.diag(total + FLOOR * (total.max() + float(np.diag(bias).max()))) + bias)
        rest = np.maximum(variance - (flows**2).sum(axis=0), 0.0)
        half = solve_triangular(lower, errors.matrix + flows.T @ flows + np.diag(rest) + bias, lower=True)
        square = float(np.sum(solve_triangular(lower, half.T, lower=True) ** 2))
        whitened = solve_triangular(lower, residual, lower=True)
        independent = independent + cells**2
    alone, ratio = None, rms(whitened)
    if bias is not None and ratio > 1.0 and size > parameters:
        alone = noise_alone(residual / np.sqrt(total), bias / np.sqrt(np.outer(total, total)), size - parameters)
    predicted = None
    if slopes is not None:
        # Parameters in fractions of their ranges have the variance 1/12.
        predicted = np.diag(total) + slopes.T @ slopes / 12.0 + (0.0 if bias is None else bias)
    first = float(np.clip(size**2 / max(square, 1.0), 1.0, size))
    # Degrees of freedom of the scatter including its prior; many if there is only the prior.
    counted = scatter.freedom + PRIOR_FREEDOM if scatter.freedom else 1e6
    second = counted * (1.0 + float(independent.sum()) / max(float(variance.sum()), 1e-300)) ** 2
    return Fit(
        residual=rms(residual),
        noise=rms(errors.deviation),
        scatter=rms(np.sqrt(scatter.variance)),
        cells=0.0 if cells is None else rms(cells),
        ratio=ratio,
        freedom=(first, min(second, 1e9)),
        numbers=size,
        parameters=parameters,
        outliers={} if predicted is None else outlying(-residual, predicted),
        alone=alone,
    )


def noise_alone(residual: Floats, bias: Floats, freedom: int) -> float | None:
    """F > 1 of F^2 I + D if it makes residuals [M] more likely than F^2 (I + D), in units of noise and scatter."""
    values, axes = eigh(bias)
    values, squares = np.maximum(values, 0.0), (axes.T @ residual) ** 2

    def excess(square: float) -> float:
        return float((squares / (square + values)).sum()) - freedom

    if excess(1.0) <= 0.0:
        return None
    square = float(brentq(excess, 1.0, 1.0 + float(squares.sum()) / freedom))
    every = float((squares / (1.0 + values)).sum()) / freedom
    likelier = np.log(square + values).sum() < np.log(every * (1.0 + values)).sum()
    return math.sqrt(square) if likelier else None


def outlying(residual: Floats, covariance: Floats) -> dict[int, float]:
    """Numbers whose residuals [M] differ from the others' prediction by more than chance does once in a hundred flows.

    z_i = (P r)_i / P_ii^(1/2),   P = C^-1,   r observed less predicted

    leaves out one number after the other (Dubrule, Cross validation of kriging in a unique neighborhood, Math. Geol. 15
    (1983) 687-699). The worst one is removed and the others are judged again, because it has affected all of them.
    Without an agreeing majority none is named: of two numbers that contradict each other either may be wrong."""
    limit = float(norm.isf(0.5 * (1.0 - CONFIDENCE) / len(residual)))
    scale, left, outliers = np.sqrt(np.diag(covariance)), np.arange(len(residual)), {}
    correlation = covariance / np.outer(scale, scale) + 1e-12 * np.eye(len(scale))
    while True:
        inverse = np.linalg.inv(correlation[np.ix_(left, left)])
        off = inverse @ (residual / scale)[left] / np.sqrt(np.diag(inverse))
        worst = int(np.argmax(np.abs(off)))
        if abs(off[worst]) <= limit:
            break
        if len(left) - 1 <= 0.5 * len(residual):
            return {}
        outliers[int(left[worst])] = float(off[worst])
        left = np.delete(left, worst)
    return dict(sorted(outliers.items()))
