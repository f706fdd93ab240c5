"""Model discrepancy: how much worse the MPM at the answer fits than the chance of two flows and the stated noise allow.

    S^2 = 1/(M - U) sum_i r_i^2 / s_i^2,    s_i^2 = n_i^2 + (1 + 1/k) c_i^2

| symbol | variable | meaning |
|---|---|---|
| r | `residual` | what is observed less what the k runs of the MPM at the answer show on average, M numbers |
| n, c | `noise`, `chance` | standard deviations of the measurement and of one flow, over the jitter seeds |
| U | `unknowns` | how many were fitted |
| S | `ratio` | 1 where the fit is as good as it should be |

Where S is above 1 by more than chance explains, the half-widths are multiplied by it: Birge's ratio (R. T. Birge, The
calculation of errors by the method of least squares, Phys. Rev. 40 (1932) 207-227), as the Particle Data Group scales
errors. It takes whatever the model lacks for noise that was stated too small, by one factor for all numbers.

The numbers do not err independently. Chance gives S^2 (M - U) a mean of M - U all the same, but a wider distribution:
chi-square with h = M^2 / |R|_F^2 degrees of freedom, R the correlation of r (Satterthwaite, Biometrics Bull. 2 (1946)
110-114).

Of a measured profile the residuals are those of its heights at its rows, both profiles brought to one area.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from inverse.observations.sampled import SampledProfile
from validation.loop.search import Checked, Search

RARE = 0.05
"""A ratio that chance exceeds less often than this counts."""

Values = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Discrepancy:
    """How the fit compares with what noise and chance allow."""

    ratio: float
    """S."""
    probability: float
    """That chance gives this much or more."""
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


def discrepancy(state: Search, found: Sequence[Checked], ensemble: Sequence[Checked]) -> Discrepancy | None:
    """That of the runs of the MPM at the answer, `found`; None where no numbers are left to tell, or for a design.

    ensemble: runs at one place near it that differ in their jitter seed alone.
    """
    if state.problem.target.least:
        return None
    observation, target = state.observation, state.target
    unknowns = len(state.problem.unknowns)
    if isinstance(observation, SampledProfile) and target.profile is not None and target.deviation is not None:
        rows, measured = target.profile
        shown, spread = (heights(observation, runs) for runs in (found, ensemble))
        scale = np.trapezoid(shown.mean(axis=0), rows) / np.trapezoid(measured, rows)
        covered = (target.deviation > 0.0) | (shown.mean(axis=0) > 0.0)
        residual = (shown.mean(axis=0) - scale * measured)[covered]
        # Where no deposit was seen and the model has one: what a row is blind to, not what was measured there.
        known = np.maximum(target.deviation[covered], float(target.deviation[target.deviation > 0.0].min()))
        return compare(residual, known, spread[:, covered], unknowns, runs=len(found))
    noise = np.full(len(target.values), target.noise)
    if target.covariance is not None:
        noise = np.sqrt(np.diag(target.covariance))
    shown = np.mean([run.observation for run in found], axis=0)
    spread = np.stack([run.observation for run in ensemble])
    return compare(shown - target.values, noise, spread, unknowns, runs=len(found))


def heights(observation: SampledProfile, runs: Sequence[Checked]) -> Values:
    """The profiles of `runs` at the measured rows [m], shape [n, R]."""
    return np.stack([observation.heights(run.trajectory.positions[-1]) for run in runs])


def compare(residual: Values, noise: Values, spread: Values, unknowns: int, *, runs: int) -> Discrepancy | None:
    """Compare residuals [M] with the noise of the measurement [M] and the numbers [n, M] of n flows at one place.

    runs: k, over how many the model's numbers are means. None where M is not above `unknowns`, or nothing scatters.
    """
    left = len(residual) - unknowns
    apart = spread - spread.mean(axis=0)
    chance = (1.0 + 1.0 / runs) * apart.var(axis=0, ddof=1)
    total = noise**2 + chance
    if left < 1 or not np.all(total > 0.0):
        return None
    ratio = math.sqrt(float(np.sum(residual**2 / total)) / left)
    # |R|_F^2 of R = diag(noise^2 / total) + F^T F without the matrix of a whole deposit.
    flows = apart * math.sqrt((1.0 + 1.0 / runs) / (len(spread) - 1)) / np.sqrt(total)
    own = noise**2 / total
    square = float(np.sum(own**2) + 2.0 * own @ (flows**2).sum(axis=0) + np.sum((flows @ flows.T) ** 2))
    freedom = max(1.0, len(residual) ** 2 / square - unknowns)
    return Discrepancy(
        ratio=ratio,
        probability=float(chi2.sf(ratio**2 * freedom, freedom)),
        numbers=len(residual),
        residual=math.sqrt(float(np.mean(residual**2))),
        noise=math.sqrt(float(np.mean(noise**2))),
    )
