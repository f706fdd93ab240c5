"""Linear calibration: which unknown belongs to an observation of the scattering MPM, and within which limits.

Around the answer an observation z of the MPM is a line in the unknown u plus scatter, z = a + b (u - u_mean) + e.
Which u belongs to the observed z* is the calibration problem: u = u_mean + (z* - z_mean) / b, with the limits of
Fieller (Draper & Smith, Applied Regression Analysis, 3rd ed. 1998, section 3.2, "inverse regression")

    (z* - z_mean - b d)^2 <= t^2 s^2 (1 + r^2 / s^2 + 1/n + d^2 / S),    d = u - u_mean

| symbol | variable | meaning |
|---|---|---|
| n, S | `count`, `spread` | number of runs; sum of (u_i - u_mean)^2 |
| b, s | `slope`, `scatter` | slope and residual standard deviation of the line |
| r | `noise` | standard deviation of the measurement; the 1 before it is the target's own chance as a flow |
| t | `student` | 97.5 % point of Student's t with n - 2 degrees of freedom |
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student_t

CONFIDENCE = 0.95


@dataclass(frozen=True, kw_only=True)
class Calibration:
    """What the runs around the answer say of one unknown."""

    estimate: float
    """The unknown that belongs to the target."""
    half_width: float
    """95 % of the time the truth is this close to `estimate`; infinite where the slope drowns in the scatter."""
    slope: float
    """Of the observation [m per unit of the unknown]."""
    scatter: float
    """Standard deviation of the observation between runs that differ in their jitter seed only [m]."""


def calibrate(unknown: NDArray[np.float64], seen: NDArray[np.float64], target: float, noise: float) -> Calibration:
    """Invert the line through `seen` [m] over `unknown`, both of shape [n], n >= 3, at `target` [m]."""
    count = len(seen)
    centre, mean = unknown.mean(), seen.mean()
    spread = float(((unknown - centre) ** 2).sum())
    slope = float(((unknown - centre) * (seen - mean)).sum()) / spread
    residual = seen - mean - slope * (unknown - centre)
    scatter = math.sqrt(float((residual**2).sum()) / (count - 2))
    student = float(student_t.ppf(0.5 + CONFIDENCE / 2.0, count - 2))
    # The limits are the roots of square d^2 - 2 linear d + constant = 0.
    square = slope**2 - (student * scatter) ** 2 / spread
    linear = slope * (target - mean)
    constant = (target - mean) ** 2 - student**2 * (scatter**2 * (1.0 + 1.0 / count) + noise**2)
    step = (target - mean) / slope if slope else math.inf
    half_width = math.inf
    if square > 0.0:
        root = math.sqrt(max(linear**2 - square * constant, 0.0))
        half_width = max(abs((linear + sign * root) / square - step) for sign in (-1.0, 1.0))
    return Calibration(estimate=float(centre + step), half_width=half_width, slope=slope, scatter=scatter)
