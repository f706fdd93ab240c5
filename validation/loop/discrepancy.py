"""Model discrepancy: the misfit at the answer over what the scatter of two flows and the stated noise explain.

    S^2 = 1/(M - U) sum_i r_i^2 / s_i^2,    s_i^2 = n_i^2 + (1 + 1/k) c_i^2

| symbol | variable | meaning |
|---|---|---|
| r | `residual` | the observation less the mean of k runs of the MPM at the answer, M numbers |
| n, c | `noise`, `chance` | standard deviations of the measurement and of one flow, over the jitter seeds |
| U | `parameters` | how many were fitted |
| S | `ratio` | 1 where the fit is as good as it should be |

Where S is above 1 by more than scatter explains, the half-widths are multiplied by it: Birge's ratio (R. T. Birge, The
calculation of errors by the method of least squares, Phys. Rev. 40 (1932) 207-227), as the Particle Data Group scales
errors. Whatever the model lacks is treated as noise that was stated too small, by one factor for all numbers.

Errors of the numbers are dependent. Scatter gives S^2 (M - U) a mean of M - U all the same, but a wider distribution:
chi-square with h = M^2 / |R|_F^2 degrees of freedom, R the correlation of r (Satterthwaite, Biometrics Bull. 2 (1946)
110-114).

Of a measured profile the residuals are those of its heights at its rows, both profiles brought to one area.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from inverse.observations import Values
from inverse.posterior.settings import CONSTANTS
from validation.loop.check import Check, Task

RARE = 0.05
"""A ratio with a smaller p-value than this counts."""


@dataclass(frozen=True, kw_only=True)
class Discrepancy:
    """The fit compared with noise and scatter."""

    ratio: float
    """S."""
    probability: float
    """p-value: of this much or more by scatter alone."""
    numbers: int
    """How many were compared."""
    residual: float
    """Root mean square of the residuals, in the unit of what is compared."""
    noise: float
    """Root mean square of the stated standard deviations, in the same unit."""

    @property
    def factor(self) -> float:
        """By which half-widths are multiplied, 1 at least."""
        return self.ratio if self.ratio > 1.0 and self.probability < RARE else 1.0


def discrepancy(task: Task, found: Sequence[Check], around: Sequence[Check]) -> Discrepancy | None:
    """That of the checks at an answer, `found`; None where no numbers are left over.

    around: runs near it at other parameters; what they scatter by is across a trend in these, linear or, with enough of
    them, with the squares.
    """
    runs, others = ([each.trajectory for each in group] for group in (found, around))
    residual, noise, numbers = task.observation.residuals(task.target, runs, others)
    points = task.unit(np.stack([each.parameters for each in around]))
    basis = np.concatenate([np.ones((len(points), 1)), points], axis=1)
    if len(points) > 2 * (basis.shape[1] + points.shape[1]):
        basis = np.concatenate([basis, points**2], axis=1)
    free = len(points) - np.linalg.matrix_rank(basis)
    if free < 1:
        return None
    across = numbers - basis @ np.linalg.lstsq(basis, numbers, rcond=None)[0]
    spread = across * math.sqrt((len(points) - 1) / free)
    noise = np.hypot(noise, CONSTANTS.smallest_scatter * float(task.scatter.mean()))
    return compare(residual, noise, spread, len(task.problem.parameters), runs=len(found))


def compare(residual: Values, noise: Values, spread: Values, parameters: int, *, runs: int) -> Discrepancy | None:
    """Compare residuals [M] with noise of the measurement [M] and the scatter [n, M] of n flows.

    runs: k, over how many the model's numbers are means. None where M is not above `parameters`, or nothing scatters.
    """
    free = len(residual) - parameters
    deviation = spread - spread.mean(axis=0)
    chance = (1.0 + 1.0 / runs) * deviation.var(axis=0, ddof=1)
    total = noise**2 + chance
    if free < 1 or not np.all(total > 0.0):
        return None
    ratio = math.sqrt(float(np.sum(residual**2 / total)) / free)
    # |R|_F^2 of R = diag(noise^2 / total) + F^T F without the matrix of a whole deposit.
    flows = deviation * math.sqrt((1.0 + 1.0 / runs) / (len(spread) - 1)) / np.sqrt(total)
    own = noise**2 / total
    square = float(np.sum(own**2) + 2.0 * own @ (flows**2).sum(axis=0) + np.sum((flows @ flows.T) ** 2))
    freedom = max(1.0, len(residual) ** 2 / square - parameters)
    return Discrepancy(
        ratio=ratio,
        probability=float(chi2.sf(ratio**2 * freedom, freedom)),
        numbers=len(residual),
        residual=math.sqrt(float(np.mean(residual**2))),
        noise=math.sqrt(float(np.mean(noise**2))),
    )
