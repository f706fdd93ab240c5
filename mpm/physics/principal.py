"""Principal stresses in closed form, for vectors of lanes; tension positive, s1 >= s2 >= s3.

In plane strain one is the stress out of plane, the others centre +- radius of Mohr's circle. In 3D (Smith 1961)

    s_k = p + 2 q cos((theta + 2 pi k) / 3),   q = sqrt(J2 / 3),   cos(theta) = r = J3 / (2 q^3)

There is no arc cosine on vector registers, and none is needed: cos(theta / 3) and sin(theta / 3) / sin(theta / 2) are
smooth in t = cos(theta / 2) = sqrt((1 + r) / 2) on all of [0, 1], so a short Chebyshev series gives them to rounding.
Where two stresses meet, r loses half of its digits: they are then apart by up to 1e-3 q in f32. The return of the
stress does not mind, because it depends on their mean.
"""

from collections.abc import Callable

import numpy as np
import taichi as ti
from numpy.typing import NDArray

from mpm.arrays.access import clamp, maximum, minimum
from mpm.arrays.layout import Precision

TINY = 1.0e-30
"""Keeps a quotient finite where its denominator is zero and its numerator is smaller still."""
DEGREE: dict[Precision, int] = {"f32": 10, "f64": 22}
"""Of the series: the nearest singularity, t = -1, makes every degree reduce the error by a factor of 5.8."""


def series(function: Callable[[NDArray[np.float64]], NDArray[np.float64]], precision: Precision) -> tuple[float, ...]:
    """Power series in 2 t - 1 that interpolates `function` of t in (0, 1) at Chebyshev's points."""
    fit = np.polynomial.Chebyshev.interpolate(function, DEGREE[precision], domain=[0.0, 1.0])
    power = fit.convert(kind=np.polynomial.Polynomial, domain=[0.0, 1.0])
    return tuple(float(c) for c in power.coef)


COSINE = {each: series(lambda t: np.cos(2.0 / 3.0 * np.arccos(t)), each) for each in DEGREE}
"""cos(theta / 3) of t = cos(theta / 2)."""
SINE = {each: series(lambda t: np.sin(2.0 / 3.0 * np.arccos(t)) / np.sin(np.arccos(t)), each) for each in DEGREE}
"""sin(theta / 3) / sin(theta / 2) of t."""


@ti.func
def polynomial(x, coefficients: ti.template()):
    """Horner's rule; the coefficients from the constant upwards."""
    value = coefficients[-1] + 0.0 * x
    for k in ti.static(range(len(coefficients) - 2, -1, -1)):
        value = value * x + coefficients[k]
    return value


@ti.func
def principal_deviator(dxx, dyy, dzz, dxy, dyz, dzx, precision: ti.template()):
    """Principal values a1 >= a2 >= a3 of a deviator [Pa] in 3D."""
    second = 0.5 * (dxx * dxx + dyy * dyy + dzz * dzz) + dxy * dxy + dyz * dyz + dzx * dzx
    third = dxx * (dyy * dzz - dyz * dyz) - dxy * (dxy * dzz - dyz * dzx) + dzx * (dxy * dyz - dyy * dzx)
    q = ti.sqrt(second / 3.0)
    r = clamp(third / maximum(2.0 * q * q * q, TINY), -1.0, 1.0)
    t = ti.sqrt(0.5 * (1.0 + r))
    cosine = polynomial(2.0 * t - 1.0, ti.static(COSINE[precision]))
    sine = polynomial(2.0 * t - 1.0, ti.static(SINE[precision])) * ti.sqrt(0.5 * (1.0 - r))
    a1 = 2.0 * q * cosine
    a3 = 0.0 - q * (cosine + 3.0**0.5 * sine)
    return a1, minimum(a1, maximum(a3, 0.0 - a1 - a3)), a3
