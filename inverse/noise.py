"""How far an observation may be from the MPM at the right parameters: what noise, scatter and cells explain.

    y = f + sum_o b_o d_o + scatter + noise,    S^2 = 1/M r^T (K + D)^-1 r,    K = diag(n^2 + (1 + 1/k) c^2)

| symbol | variable | meaning |
|---|---|---|
| r | `residual` | the mean of k runs of the MPM less the observation, M numbers |
| n | `noise` | standard deviation by errors of the measurement (`Target.errors`) |
| c | `scatter` | that of one flow, over the jitter seeds: the observation is one, the mean of k runs scatters by 1/k |
| d | `cells` | what the cells of the MPM change, where the observation is no flow on the same |
| b, D | `biases` | its unknown factor, smooth within an observation o, integrated over: one error, no noise |
| S | `ratio` | 1 on average at the right parameters |

The MPM lies within the predictive interval where chance exceeds S at least once in a hundred times. Errors of the
numbers are dependent: S^2 has the mean 1 all the same, but a wider distribution, that of F with

    h = M^2 / |R|_F^2,    nu = nu_c (1 + (N + D) / C)^2

degrees of freedom, R the covariance of whitened r (Satterthwaite, Biometrics Bull. 2 (1946) 110-114), nu_c those with
which the scatter is known and N, D, C the sums of n^2, d^2 and (1 + 1/k) c^2: what is known needs no estimate.

Where there are more numbers than parameters and S is above what chance explains once in twenty times, half-widths are
multiplied by S (M / (M - U))^(1/2), as if all noise had been stated too small: Birge's ratio (R. T. Birge, The
calculation of errors by the method of least squares, Phys. Rev. 40 (1932) 207-227). Beside an error of the cells the
residuals say which is too small: it is all, or noise and scatter alone, whatever makes them likelier,

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
"""Correlation length of the error of the cells where no run has shown its shape, over the numbers of an observation.

Of eight fronts of a column over time (cells of 20, 10 and 5 mm) what finer cells change beyond the known shape has one
change of sign, as a Gaussian process of this length has (docs/theory/uncertainty.md).
"""
CONFIDENCE = 0.99  # share of right answers that lie within the predictive interval
RARE = 0.05  # a misfit that chance exceeds less often than this widens half-widths
PRIOR_FREEDOM = 2.0  # degrees of freedom with which the expected scatter counts beside that of repeated runs
FLOOR = 1.0e-6
"""Part of the largest variance of a number that every number has: rounding, where one does not vary at all."""


@dataclass(frozen=True, kw_only=True)
class Scatter:
    """The scatter of flows that differ in their jitter seed alone."""

    deviations: Floats
    """Of runs from the mean of those at the same parameters, shape [n, M]."""
    freedom: int
    """nu_c: runs less the means."""
    expected: Floats
    """Standard deviation of each number before any run has shown it, shape [M]."""

    @classmethod
    def of_runs(cls, points: Floats, numbers: Floats, expected: Floats) -> "Scatter":
        """By runs at points [n, U] that show `numbers` [n, M]: those that share their point with others."""
        _, label, count = np.unique(points, axis=0, return_inverse=True, return_counts=True)
        means = np.stack([numbers[label == place].mean(axis=0) for place in range(len(count))])
        repeated = (count > 1)[label]
        return cls(deviations=(numbers - means[label])[repeated], freedom=int((count - 1).sum()), expected=expected)

    @property
    def variance(self) -> Floats:
        """c^2, shape [M]; what was expected counts with `PRIOR_FREEDOM`, scaled to what runs show of all numbers."""
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
        5016-5029, eq. 23).
        """
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
    """The MPM at an answer beside the observation."""

    residual: float
    """Root mean square of r, in the unit of the numbers."""
    noise: float
    """The same of n."""
    scatter: float
    """Of c."""
    cells: float
    """Of d."""
    ratio: float
    """S."""
    freedom: tuple[float, float]
    """h and nu."""
    numbers: int
    """M."""
    parameters: int
    """U."""
    outliers: dict[int, float] = field(default_factory=dict)
    """Numbers that others do not predict, with z of each (`outlying`)."""
    alone: float | None = None
    """F where the residuals are likelier with noise and scatter alone multiplied by it."""
    applied: float = 1.0
    """F that was applied, as it is reported."""
    spared: bool = False
    """Whether to noise and scatter alone."""

    @property
    def allowed(self) -> float:
        """Half of the predictive interval: the largest root mean square of residuals such as these within it."""
        limit = math.sqrt(float(f.ppf(CONFIDENCE, *self.freedom)))
        return self.residual * limit / self.ratio if self.ratio > 0.0 else limit * math.hypot(self.noise, self.cells)

    @property
    def inside(self) -> bool:
        """Whether the MPM lies within the predictive interval."""
        return self.ratio**2 <= float(f.ppf(CONFIDENCE, *self.freedom))

    @property
    def probability(self) -> float:
        """Of so large an S or more by chance."""
        return float(f.sf(self.ratio**2, *self.freedom))

    @property
    def factor(self) -> float:
        """F, by which errors are to be multiplied, 1 at least: Birge's ratio, of M - U free numbers."""
        if self.numbers <= self.parameters or self.ratio <= 1.0 or self.probability >= RARE:
            return 1.0
        return self.alone or self.ratio * math.sqrt(self.numbers / (self.numbers - self.parameters))


def biases(target: Target, cells: Floats, extrapolated: float) -> Floats:
    """Covariance D [M, M] of the errors by cells that change the numbers by `cells` [M]: smooth within an observation.

    D = (1 - e/2) d d^T + e/2 a a^T k,    a_i^2 = sum_j k_ij d_j^2 / sum_j k_ij,    k Gaussian of length `SMOOTH`

    extrapolated: share e of d that no run has shown, of which half has the shape of d and half any smooth one, as large
    as d around each number: cells change no front before it has moved, and what they leave unknown of it is no more.
    """
    covariance = (1.0 - 0.5 * extrapolated) * np.outer(cells, cells)
    for part in target.observation.parts:
        numbers = np.arange(len(cells))[part.numbers]
        apart = (numbers[:, None] - numbers) / max(1.0, SMOOTH * len(numbers))
        alike = np.exp(-0.5 * apart**2)
        around = np.sqrt(alike @ cells[numbers] ** 2 / alike.sum(axis=1))
        # Each observation has a factor of its own.
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
    """Of runs at one answer that show numbers [k, M].

    cells: d [M]; extrapolated: see `biases`; parameters: how many were fitted; slopes: by them [U, M], for `outlying`.
    """
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
    # Those with which the scatter is known, and with what its prior adds; many where nothing but the prior is.
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
    """F > 1 of F^2 I + D where that makes residuals [M] likelier than F^2 (I + D), in units of noise and scatter."""
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
    """Numbers whose residuals [M] lie off what the others predict by more than chance does once in a hundred flows.

    z_i = (P r)_i / P_ii^(1/2),   P = C^-1,   r observed less predicted

    leaves out one number after the other (Dubrule, Cross validation of kriging in a unique neighborhood, Math. Geol. 15
    (1983) 687-699). The farthest is left out for good, then those that are left are judged again: it moves them all.
    None is named where no majority agrees: of two numbers that contradict each other either may be wrong.
    """
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
