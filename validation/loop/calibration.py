"""Calibration: which unknown belongs to an observation of the scattering MPM, and within which limits.

Around the answer an observation z of the MPM is a curve in the unknown u plus scatter, z = a + b d + c d^2 + e with
d = u - u_mean; the last term where there are runs enough to tell it (over four degrees the front bends by millimetres).
Which u belongs to the observed z* is the calibration problem: the root d* of the curve, with the limits of Fieller
(Draper & Smith, Applied Regression Analysis, 3rd ed. 1998, section 3.2, "inverse regression") along its tangent there

    (b* w)^2 <= t^2 (s^2 (1 + h(w)) + r^2),    h(w) = x(w)^T (X^T X)^-1 x(w),  x(w) = (1, d* + w, d*^2 + 2 d* w)

| symbol | variable | meaning |
|---|---|---|
| X | `design` | a row (1, d_i, d_i^2) per run |
| b*, w | `slope`, half-width | slope of the curve at d*; distance from it |
| s, r | `scatter`, `noise` | residual standard deviation; standard deviation of the measurement |
| h | `leverage` | what the runs' own scatter adds; the 1 before it is the target's own chance as a flow |
| t | `student` | 97.5 % point of Student's t with as many degrees of freedom as the fit leaves |
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student_t

CONFIDENCE = 0.95
ENOUGH_FOR_A_CURVE = 7
"""Runs from which on a curvature is fitted."""


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
    """Invert the curve through `seen` [m] over `unknown`, both of shape [n], n >= 3, at `target` [m]."""
    if len(seen) >= ENOUGH_FOR_A_CURVE and len(np.unique(unknown)) >= 3:
        curved = _calibrate(unknown, seen, target, noise, degree=2)
        # Where so few runs cannot tell slope and bend apart, the slope is what counts.
        if curved is not None and math.isfinite(curved.half_width):
            return curved
    straight = _calibrate(unknown, seen, target, noise, degree=1)
    assert straight is not None
    return straight


def _calibrate(
    unknown: NDArray[np.float64], seen: NDArray[np.float64], target: float, noise: float, *, degree: int
) -> Calibration | None:
    """With a polynomial of `degree`; None where a curve has no root among the runs, or turns back between them."""
    centre = unknown.mean()
    design = np.vander(unknown - centre, degree + 1, increasing=True)
    fitted, *_ = np.linalg.lstsq(design, seen, rcond=None)
    freedom = len(seen) - degree - 1
    scatter = math.sqrt(float(((seen - design @ fitted) ** 2).sum()) / freedom)
    student = float(student_t.ppf(0.5 + CONFIDENCE / 2.0, freedom))
    intercept, slope = float(fitted[0]), float(fitted[1])
    step = (target - intercept) / slope if slope else math.inf
    tangent = np.array([0.0, 1.0])
    if degree == 2:
        bend, reach = float(fitted[2]), float(np.abs(unknown - centre).max())
        square = slope**2 - 4.0 * bend * (intercept - target)
        if square < 0.0 or abs(slope) <= 2.0 * abs(bend) * reach:
            return None
        # The root that goes over into the line's where there is no bend.
        step = 2.0 * (target - intercept) / (slope + math.copysign(math.sqrt(square), slope))
        if abs(step) > reach:
            return None
        slope += 2.0 * bend * step
        tangent = np.array([0.0, 1.0, 2.0 * step])
    half_width = math.inf
    if math.isfinite(step):
        inverse = np.linalg.inv(design.T @ design)
        place = step ** np.arange(degree + 1)
        leverage, cross, along = place @ inverse @ place, place @ inverse @ tangent, tangent @ inverse @ tangent
        # The limits are the roots of square w^2 - 2 linear w - constant = 0.
        square = slope**2 - (student * scatter) ** 2 * along
        linear = (student * scatter) ** 2 * cross
        constant = student**2 * (scatter**2 * (1.0 + leverage) + noise**2)
        if square > 0.0:
            half_width = float((abs(linear) + math.sqrt(linear**2 + square * constant)) / square)
    return Calibration(estimate=float(centre + step), half_width=half_width, slope=slope, scatter=scatter)
