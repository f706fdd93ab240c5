"""The estimate of parameters from scattering runs of the MPM, and its confidence limits.

Near u0 an observation of the MPM, M numbers, is y(u) = y0 + J (u - u0) + e, where e differs from run to run with the
jitter seed. In fractions v of the parameters' ranges, least squares with weights W give v = g (y* - y0), and

    g = H^+ J^T W,    H = J^T W J - sum_k (J_k - J)^T W (J_k - J) / (K (K - 1))

| symbol | variable | meaning |
|---|---|---|
| y0 | `centre` | mean of n runs at u0 that differ in their jitter seed alone |
| J_k, J | `slopes`, `jacobian` | by runs on either side of u0 with jitter seed k of K; or given, without scatter |
| W | `weights` | one over the scatter of each number, half of it shared by all, and the measurement's noise |
| H | `gram` | corrected for what the scatter of J adds to it, which would hide a weak combination |
| S | `spread` | covariance of v: of g e over the seeds (n - 1 degrees of freedom), times 1 + leverage, and the noise |
| P^2 | `PRIOR` | variance of v before the observation; along what is not identifiable v stays 0 with this variance |

The leverage is that of a regression, 1/n + c sum_u (v_u / h)^2 / (2 K): the first for y0, the second for J over the
distance v, with h the distance of the runs on either side. Those share their jitter seeds, so that their difference
has less than all of the scatter: c is how much, by the differences of the J_k. Along each principal direction of S
the limits are those of Fieller (Some problems in interval estimation, J. Roy. Statist. Soc. B 16 (1954) 175-185) for
the ratio of two uncertain numbers: the variance grows by 1 / (1 - t^2 q^2), with q the relative uncertainty of J along
it and t the 97.5 % point of Student's t. The prior then damps v <- P^2 (P^2 + S)^-1 v, with the covariance
P^2 (P^2 + S)^-1 S.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear
from scipy.stats import t as student_t

CONFIDENCE = 0.95
"""Of all half-widths."""
PRIOR = 0.5
"""Standard deviation of a parameter within its bounds, as a fraction of the range: 95 % of the time within them."""
RANK = 1e-9
"""An eigenvalue of the Gram matrix this small beside the largest is zero."""
UNINFORMED = (100.0 * PRIOR) ** 2
"""Variance, before the prior, of a combination that the observation does not depend on."""

Matrix = NDArray[np.float64]
Row = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Estimate:
    """What runs around u0 say of the parameters, all in fractions of the ranges."""

    values: Row
    """v that belongs to the target, shape [U]."""
    covariance: Matrix
    """Of the values, shape [U, U]."""
    spread: Matrix
    """The same before the prior, shape [U, U]: singular values and combinations are its."""
    student: float
    """97.5 % point of Student's t."""
    gain: Matrix
    """g, shape [U, M]."""
    scatter: Row
    """Standard deviation of each parameter by the scatter of one flow alone, shape [U]."""
    noise: Row
    """The same by errors of the measurement alone, shape [U]."""
    centre: Row
    """y0, shape [M]."""
    jacobian: Matrix
    """J, shape [M, U]."""
    damping: Matrix
    """P^2 (P^2 + S)^-1, shape [U, U]."""

    @property
    def half_widths(self) -> Row:
        """95 % confidence limits on either side of the values, shape [U]; at most the range."""
        return np.asarray(np.minimum(self.student * np.sqrt(np.maximum(np.diag(self.covariance), 0.0)), 1.0))

    def within(self, lower: Row, upper: Row) -> Row:
        """The likeliest v with lower <= v <= upper, shape [U]."""
        # A precision of at most a billion times the prior's, where nothing scatters.
        values, vectors = np.linalg.eigh(self.covariance)
        root = (vectors / np.sqrt(np.maximum(values, 1e-9 * PRIOR**2))).T
        low, high = np.minimum(lower, -1e-12), np.maximum(upper, 1e-12)
        return np.asarray(np.clip(lsq_linear(root, root @ self.values, bounds=(low, high)).x, lower, upper))

    def curvature(self, moved: Row, change: Row) -> Row:
        """Error of v, shape [U], because the observation is not linear.

        moved, change: from u0 to other parameters [U], and the change of one flow's observation [M], its seed held.
        """
        return np.asarray(self.damping @ self.gain @ (change - self.jacobian @ moved))


def estimate(
    runs: Matrix,
    slopes: Matrix,
    target: Row,
    *,
    noise: float,
    distance: float,
    exact_slopes: bool = False,
    covariance: Matrix | None = None,
) -> Estimate:
    """The parameters that belong to `target` [M], by `runs` at u0 [n, M] and slopes per range around it [K, M, U].

    noise: standard deviation of each number of the target by errors of the measurement; where these are dependent,
    `covariance` of shape [M, M] counts instead. distance: h, of the runs on either side, as a fraction of the range.
    exact_slopes: they are not from runs.
    """
    seeds, replicates, count = len(runs), len(slopes), slopes.shape[2]
    centre, jacobian = runs.mean(axis=0), slopes.mean(axis=0)
    scattered, coupled = runs - centre, 1.0
    variance = scattered.var(axis=0, ddof=1)
    own = noise**2 if covariance is None else np.diag(covariance)
    weights = 1.0 / np.maximum(0.5 * (variance + variance.mean()) + own, 1e-24)
    gram = (jacobian.T * weights) @ jacobian
    if replicates > 1:
        differences = slopes - jacobian
        excess = np.einsum("kmu,m,kmv->uv", differences, weights, differences) / (replicates - 1)
        gram -= excess / replicates
        # Trace of the excess if the runs on either side had other seeds.
        independent = count * float(weights @ variance) / (2.0 * distance**2)
        coupled = min(1.0, float(np.trace(excess)) / independent) if independent > 0.0 else 1.0
    values, vectors = np.linalg.eigh(gram)
    identifiable = values > RANK * max(float(values[-1]), 1e-300)
    # No more combinations than numbers.
    identifiable &= np.arange(count) >= count - len(target)
    kept, lost = vectors[:, identifiable], vectors[:, ~identifiable]
    gain = (kept / values[identifiable]) @ kept.T @ (jacobian.T * weights)
    raw = gain @ (target - centre)
    drawn = scattered @ gain.T
    single = drawn.T @ drawn / (seeds - 1)
    measured = noise**2 * gain @ gain.T if covariance is None else gain @ covariance @ gain.T
    student = float(student_t.ppf(0.5 + CONFIDENCE / 2.0, seeds - 1))
    # Variance of J's columns per range, as a multiple of the scatter's.
    of_slope = 0.0 if exact_slopes else coupled / (2.0 * replicates * distance**2)
    found, leverage = np.zeros(count), 1.0 / seeds
    for _ in range(2):
        spread = (1.0 + leverage) * single + measured + UNINFORMED * lost @ lost.T
        spread = fieller(spread, single, student**2 * of_slope)
        damping = PRIOR**2 * np.linalg.inv(PRIOR**2 * np.eye(count) + spread)
        found = damping @ raw
        leverage = 1.0 / seeds + of_slope * float(found @ found)
    posterior = damping @ spread
    return Estimate(
        values=found,
        covariance=0.5 * (posterior + posterior.T),
        spread=spread,
        student=student,
        gain=gain,
        scatter=np.sqrt(np.diag(single)),
        noise=np.sqrt(np.maximum(np.diag(measured), 0.0)),
        centre=centre,
        jacobian=jacobian,
        damping=np.asarray(damping, np.float64),
    )


def fieller(spread: Matrix, single: Matrix, factor: float) -> Matrix:
    """`spread` with the uncertainty of J along each of its principal directions, `factor` times that of `single`."""
    values, vectors = np.linalg.eigh(spread)
    widened = []
    for value, direction in zip(values, vectors.T, strict=True):
        relative = factor * float(direction @ single @ direction)
        widened.append(value / (1.0 - relative) if relative < 1.0 else math.inf)
    return np.asarray((vectors * np.minimum(widened, UNINFORMED)) @ vectors.T)
