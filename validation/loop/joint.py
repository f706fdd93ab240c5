"""Several unknowns at once from the scattering MPM: the estimate that belongs to a target, and within which limits.

Near u0 an observation of the MPM, M numbers, is y(u) = y0 + J (u - u0) + e, with e another flow's chance in each run.
Unknowns are taken in fractions v of their range. Least squares with weights W give v = g (y* - y0), and

    g = H^+ J^T W,    H = J^T W J - sum_k (J_k - J)^T W (J_k - J) / (K (K - 1))

| symbol | variable | meaning |
|---|---|---|
| y0 | `centre` | mean of n runs at u0 that differ in their jitter seed alone |
| J_k, J | `slopes`, their mean | by runs on either side of u0 with jitter seed k of K; or given, without scatter |
| W | `weights` | one over the scatter of each number, half of it shared by all, and the measurement's noise |
| H | `gram` | what the scatter of J adds to it is taken off: it would hide how little a weak combination tells |
| S | `spread` | covariance of v: of g e over the seeds (n - 1 degrees of freedom), times 1 + leverage, and the noise |
| P^2 | `PRIOR` | variance of v before anything was observed; what is not told stays at u0, as wide as that |

The leverage is that of a regression, 1/n + c sum_u (v_u / h)^2 / (2 K): the first for y0, the second for J over the
distance v, with h the distance of the runs on either side. Those share their jitter seeds, so that less than all of
the scatter is in their difference: c is how much, by how far the J_k are apart. Along each principal direction of S
the limits are Fieller's (see `validation.loop.calibration`): its variance grows by 1 / (1 - t^2 q^2), with q the relative
uncertainty of J along it. The prior then damps what is not told: v <- P^2 (P^2 + S)^-1 v with the covariance
P^2 (P^2 + S)^-1 S.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear
from scipy.stats import t as student_t

from validation.loop.calibration import CONFIDENCE

PRIOR = 0.5
"""Standard deviation of an unknown within its bounds, as a fraction of the range: 95 % of the time within them."""
NOTHING = 1e-9
"""An eigenvalue of the Gram matrix this small beside the largest is none."""
NOT_TOLD = (100.0 * PRIOR) ** 2
"""Variance of a combination before the prior of which the observation says nothing."""

Matrix = NDArray[np.float64]
Row = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Joint:
    """What the runs around u0 say of all unknowns; everything in fractions of the ranges."""

    estimate: Row
    """v that belongs to the target, shape [U]."""
    covariance: Matrix
    """Of the estimate, shape [U, U]."""
    spread: Matrix
    """The same before the prior, shape [U, U]: singular values and combinations are its."""
    student: float
    """97.5 % point of Student's t."""
    gain: Matrix
    """g, shape [U, M]."""
    scatter: Row
    """Standard deviation of each unknown by the chance of one flow alone, shape [U]."""
    noise: Row
    """The same by errors of the measurement alone, shape [U]."""
    centre: Row
    """y0, shape [M]."""
    slope: Matrix
    """J, per range, shape [M, U]."""
    damped: Matrix
    """P^2 (P^2 + S)^-1, shape [U, U]."""

    @property
    def half_widths(self) -> Row:
        """95 % of the time the truth is this close to the estimate, shape [U]; at most the range."""
        return np.asarray(np.minimum(self.student * np.sqrt(np.maximum(np.diag(self.covariance), 0.0)), 1.0))

    def inside(self, lower: Row, upper: Row) -> Row:
        """The likeliest v with lower <= v <= upper, shape [U]."""
        # Of the precision: no more than a billion times the prior's, or nothing scatters.
        values, vectors = np.linalg.eigh(self.covariance)
        root = (vectors / np.sqrt(np.maximum(values, 1e-9 * PRIOR**2))).T
        low = np.minimum(lower, -1e-12)
        high = np.maximum(upper, 1e-12)
        return np.asarray(np.clip(lsq_linear(root, root @ self.estimate, bounds=(low, high)).x, lower, upper))

    def bend(self, moved: Row, change: Row) -> Row:
        """By how much v is off, shape [U], because the observation is no plane.

        moved, change: from u0 to another place [U], and what that does to one flow [M], its jitter seed held.
        """
        return np.asarray(self.damped @ self.gain @ (change - self.slope @ moved))

    def least_misfit(self, target: Row, lower: Row, upper: Row) -> float:
        """Mean square misfit that y0 + J v has at best with lower <= v <= upper, over that of y0."""
        misfit = target - self.centre
        low, high = np.minimum(lower, -1e-12), np.maximum(upper, 1e-12)
        left = misfit - self.slope @ lsq_linear(self.slope, misfit, bounds=(low, high)).x
        return float(left @ left) / max(float(misfit @ misfit), 1e-300)


def estimate(
    here: Matrix,
    slopes: Matrix,
    target: Row,
    *,
    noise: float,
    distance: float,
    given: bool = False,
    covariance: Matrix | None = None,
) -> Joint:
    """What runs at u0, `here` of shape [n, M], and their slopes per range, shape [K, M, U], say of a `target` [M].

    noise: standard deviation of each number of the target by errors of the measurement; where these are dependent,
    `covariance` of shape [M, M] counts instead. distance: h, of the runs on either side, as a fraction of the range.
    given: the slopes are not from runs.
    """
    seeds, replicates, unknowns = len(here), len(slopes), slopes.shape[2]
    centre, slope = here.mean(axis=0), slopes.mean(axis=0)
    chance, coupled = here - centre, 1.0
    variance = chance.var(axis=0, ddof=1)
    own = noise**2 if covariance is None else np.diag(covariance)
    total = 0.5 * (variance + variance.mean()) + own
    weights = 1.0 / np.maximum(total, 1e-24)
    gram = (slope.T * weights) @ slope
    if replicates > 1:
        apart = slopes - slope
        excess = np.einsum("kmu,m,kmv->uv", apart, weights, apart) / (replicates - 1)
        gram -= excess / replicates
        # Runs with other seeds on either side would be apart by this much.
        most = unknowns * float(weights @ variance) / (2.0 * distance**2)
        coupled = min(1.0, float(np.trace(excess)) / most) if most > 0.0 else 1.0
    values, vectors = np.linalg.eigh(gram)
    told = values > NOTHING * max(float(values[-1]), 1e-300)
    # No more combinations are told than there are numbers.
    told &= np.arange(unknowns) >= unknowns - len(target)
    kept = vectors[:, told]
    gain = (kept / values[told]) @ kept.T @ (slope.T * weights)
    raw = gain @ (target - centre)
    drawn = chance @ gain.T
    single = drawn.T @ drawn / (seeds - 1)
    missing = NOT_TOLD * vectors[:, ~told] @ vectors[:, ~told].T
    student = float(student_t.ppf(0.5 + CONFIDENCE / 2.0, seeds - 1))
    # Variance of J's columns per range, as a multiple of the scatter's.
    of_slope = 0.0 if given else coupled / (2.0 * replicates * distance**2)
    measured = noise**2 * gain @ gain.T if covariance is None else gain @ covariance @ gain.T
    found, leverage = np.zeros(unknowns), 1.0 / seeds
    for _ in range(2):
        spread = (1.0 + leverage) * single + measured + missing
        spread = fieller(spread, single, student**2 * of_slope)
        damped = PRIOR**2 * np.linalg.inv(PRIOR**2 * np.eye(unknowns) + spread)
        found = damped @ raw
        leverage = 1.0 / seeds + of_slope * float(found @ found)
    covariance = damped @ spread
    return Joint(
        estimate=found,
        covariance=0.5 * (covariance + covariance.T),
        spread=spread,
        student=student,
        gain=gain,
        scatter=np.sqrt(np.diag(single)),
        noise=np.sqrt(np.maximum(np.diag(measured), 0.0)),
        centre=centre,
        slope=slope,
        damped=np.asarray(damped, np.float64),
    )


def fieller(spread: Matrix, single: Matrix, factor: float) -> Matrix:
    """`spread` with the uncertainty of J along each of its principal directions, `factor` times the scatter's."""
    values, vectors = np.linalg.eigh(spread)
    widened = []
    for value, direction in zip(values, vectors.T, strict=True):
        relative = factor * float(direction @ single @ direction)
        widened.append(value / (1.0 - relative) if relative < 1.0 else math.inf)
    return np.asarray((vectors * np.minimum(widened, NOT_TOLD)) @ vectors.T)
