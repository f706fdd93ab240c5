"""One step of Cauchy stress: an objective elastic increment, then the plastic return.

    sigma_trial = R sigma R^T + lambda tr(D) I + 2 mu D,    R = (I - W / 2)^-1 (I + W / 2)

with D and W the symmetric and skew parts of the velocity gradient times the step. R is a rotation for every W (Hughes &
Winget 1980), so a rigid spin keeps the invariants of the stress to rounding; for small steps this is Jaumann's rate.
R - I = 2 (Q + Q^2) / (1 + q . q) with q half the axial vector of W and Q v = q x v; in 2D tan(angle / 2) = q.
Components xx, yy, zz, xy and, in 3D, yz, zx; 2D is plane strain.

The increment is measured in the midpoint configuration (Hughes & Winget 1980): the displacement over a step, with the
gradient A = dt C in the configuration before it, has the gradient G = A (I + A / 2)^-1 at the midpoint, to second order

    G = A - A A / 2

D and W are the symmetric and the skew part of G. With A instead, a spinning body would grow, since its particles move
along tangents: by 5 % of its moment of inertia in three turns at a step of 0.5 ms and one turn per second.

Principal stresses s1 >= s2 >= s3, tension positive: in plane strain one is the stress out of plane, the others are
centre +- radius of Mohr's circle. In 3D (Smith 1961)

    s_k = p + 2 q cos((theta + 2 pi k) / 3),   q = sqrt(J2 / 3),   cos(theta) = r = J3 / (2 q^3)

There is no arc cosine on vector registers, and none is needed: cos(theta / 3) and sin(theta / 3) / sin(theta / 2) are
smooth in t = cos(theta / 2) = sqrt((1 + r) / 2) on all of [0, 1], so a short Chebyshev series gives them to rounding.
Where two principal stresses coincide, r loses half of its digits, and they differ by up to 1e-3 q in f32. This does not
affect the stress return, which depends on their mean.

The returned stress has the axes of the trial stress, and no axes are computed. With the principal stresses s_i, their
changes g_i and the divided differences g12 = (g1 - g2) / (s1 - s2), g123 = (g12 - g23) / (s1 - s3), Newton's
interpolation polynomial carries the change over to the tensor:

    sigma = sigma_trial + g1 I + g12 (sigma_trial - s1 I) + g123 (sigma_trial - s1 I) (sigma_trial - s2 I)

No return widens the gap between two principal stresses, even with elastic coupling: g12, g23 lie in [-1, 0] and,
clamped to it, hold where stresses coincide, too. In plane strain: a scaled deviator around a shifted centre.
"""

from collections.abc import Callable

import numpy as np
import taichi as ti
from numpy.typing import NDArray

from mpm.arrays.access import TINY, clamp, maximum, minimum
from mpm.arrays.layout import Precision

DEGREE: dict[Precision, int] = {"f32": 10, "f64": 22}
"""Degree of the series; each degree reduces the error by a factor of 5.8, as the nearest singularity is t = -1."""


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


@ti.func
def trial_stress(stress: ti.template(), gradient: ti.template(), lame, shear, dimension: ti.template()):
    """Elastic trial: `stress` [Pa] after the increment `gradient` = dt * velocity gradient [-], row by row."""
    if ti.static(dimension == 2):
        xx, yy, zz, xy = stress
        gxx, gxy, gyx, gyy = gradient
        q = 0.25 * (gyx - gxy)
        half = 0.5 * (xx - yy)
        # half and xy turn by twice the angle, whose sine and cosine these are: less 2 sine (sine (half, xy) + ...).
        per = 1.0 / (1.0 + q * q)
        sine, cosine = 2.0 * q * per, (1.0 - q * q) * per
        lost = 2.0 * sine * (sine * half + cosine * xy)
        won = 2.0 * sine * (cosine * half - sine * xy)
        volumetric = lame * (gxx + gyy)
        return (
            xx - lost + volumetric + 2.0 * shear * gxx,
            yy + lost + volumetric + 2.0 * shear * gyy,
            zz + volumetric,
            xy + won + shear * (gxy + gyx),
        )
    else:
        gxx, gxy, gxz, gyx, gyy, gyz, gzx, gzy, gzz = gradient
        xx, yy, zz, xy, yz, zx = rotated(stress, 0.25 * (gzy - gyz), 0.25 * (gxz - gzx), 0.25 * (gyx - gxy))
        volumetric = lame * (gxx + gyy + gzz)
        return (
            xx + volumetric + 2.0 * shear * gxx,
            yy + volumetric + 2.0 * shear * gyy,
            zz + volumetric + 2.0 * shear * gzz,
            xy + shear * (gxy + gyx),
            yz + shear * (gyz + gzy),
            zx + shear * (gzx + gxz),
        )


@ti.func
def rotated(stress: ti.template(), qx, qy, qz):
    """R sigma R^T in 3D [Pa] of Cayley's rotation R = I + C with the vector q = W's axial vector / 2 [-].

    Summed as sigma + C sigma + (C sigma)^T + C sigma C^T: in single precision R itself would lose C's small part.
    """
    xx, yy, zz, xy, yz, zx = stress
    twice = 2.0 / (1.0 + (qx * qx + qy * qy + qz * qz))
    sx, sy, sz = twice * qx, twice * qy, twice * qz
    sxx, syy, szz = sx * qx, sy * qy, sz * qz
    sxy, syz, szx = sx * qy, sy * qz, sz * qx
    # The rows of C, then those of C sigma.
    cxx, cxy, cxz = 0.0 - (syy + szz), sxy - sz, szx + sy
    cyx, cyy, cyz = sxy + sz, 0.0 - (szz + sxx), syz - sx
    czx, czy, czz = szx - sy, syz + sx, 0.0 - (sxx + syy)
    mxx, mxy, mxz = cxx * xx + cxy * xy + cxz * zx, cxx * xy + cxy * yy + cxz * yz, cxx * zx + cxy * yz + cxz * zz
    myx, myy, myz = cyx * xx + cyy * xy + cyz * zx, cyx * xy + cyy * yy + cyz * yz, cyx * zx + cyy * yz + cyz * zz
    mzx, mzy, mzz = czx * xx + czy * xy + czz * zx, czx * xy + czy * yy + czz * yz, czx * zx + czy * yz + czz * zz
    return (
        xx + (2.0 * mxx + (mxx * cxx + mxy * cxy + mxz * cxz)),
        yy + (2.0 * myy + (myx * cyx + myy * cyy + myz * cyz)),
        zz + (2.0 * mzz + (mzx * czx + mzy * czy + mzz * czz)),
        xy + (mxy + myx + (mxx * cyx + mxy * cyy + mxz * cyz)),
        yz + (myz + mzy + (myx * czx + myy * czy + myz * czz)),
        zx + (mzx + mxz + (mzx * cxx + mzy * cxy + mzz * cxz)),
    )


@ti.func
def stress_step(
    old: ti.template(), gradient: ti.template(), opened, strengths: ti.template(), lame, shear, features: ti.template()
):
    """The result of `plastic_return` after the increment `gradient` [-] of the stress `old` [Pa].

    `opened` is the last value of the last step's return [Pa], read where `features.volume_correction`: with volume
    correction (Tampubolon et al. 2017), an opened gap must close before it carries stress again. The fourth strength of
    a law that opens is the largest tension T [Pa].
    """
    limits = [strengths[3] for _ in ti.static(range(int(features.volume_correction)))]
    cracked = with_cracks(old, opened, limits, lame, shear, features)
    trial = trial_stress(cracked, gradient, lame, shear, features.dimension)
    new = plastic_return(trial, strengths, lame, shear, features)
    if ti.static(features.cracks):
        # The strain of open cracks counted as plastic when they opened.
        bare = trial_stress(old, gradient, lame, shear, features.dimension)
        strain = strain_between(bare, new, shear, features.stresses)
        return [new[k] for k in ti.static(range(features.stresses))] + [strain, new[features.stresses + 1]]
    else:
        return new


@ti.func
def strain_between(bare: ti.template(), new: ti.template(), shear, count: ti.template()):
    """Equivalent deviatoric plastic strain [-] that leads from the first `count` stresses of `bare` to `new` [Pa]."""
    d = [bare[k] - new[k] for k in ti.static(range(count))]
    mean = (d[0] + d[1] + d[2]) / 3.0
    xx, yy, zz = d[0] - mean, d[1] - mean, d[2] - mean
    square = xx * xx + yy * yy + zz * zz
    for k in ti.static(range(3, count)):
        square = square + 2.0 * d[k] * d[k]
    return ti.sqrt(square / 6.0) / shear


@ti.func
def with_cracks(stress: ti.template(), opened, limits: ti.template(), lame, shear, features: ti.template()):
    """Stress [Pa]; with volume correction plus the elastic stress of the strain e N of the opened cracks.

    It is lambda e I + 2 mu e N; `opened` is the volume strain e of the cracks, as the mean stress K e [Pa]; `limits`
    holds T alone. N = sum n n^T / m over the m principal axes n with stress T: all directions in a loose fragment, as
    wherever cohesionless material opens; one in a crack beside compression. The return removes that stress again,
    unless strain closes the crack: alone it has no effect. P = T I - sigma has principal values >= 0, and 0 along such
    axes. With its invariants P1, P2 and no axes, N = cof P / P2 for m = 1, (I - P / P1) / 2 for m = 2, I / 3 for m = 3.
    """
    if ti.static(features.volume_correction and features.cohesive):
        xx, yy, zz = limits[0] - stress[0], limits[0] - stress[1], limits[0] - stress[2]
        xy, yz, zx = 0.0 - stress[3], 0.0 * stress[3], 0.0 * stress[3]
        if ti.static(features.dimension == 3):
            yz, zx = 0.0 - stress[4], 0.0 - stress[5]
        first = xx + yy + zz
        cxx, cyy, czz = yy * zz - yz * yz, zz * xx - zx * zx, xx * yy - xy * xy
        second = cxx + cyy + czz
        # Values below a ten-thousandth of the opening count as 0, for rounding in single precision.
        zero = 1.0e-4 * opened
        two, three = second <= zero * first, first <= zero
        bulk3 = 3.0 * lame + 2.0 * shear
        around, along = 3.0 * lame / bulk3 * opened, 6.0 * shear / bulk3 * opened
        third = around + along / 3.0
        one = along / maximum(second, TINY)
        pair = 0.5 * along / maximum(first, TINY)
        rxx = stress[0] + ti.select(three, third, around + ti.select(two, pair * (yy + zz), one * cxx))
        ryy = stress[1] + ti.select(three, third, around + ti.select(two, pair * (zz + xx), one * cyy))
        rzz = stress[2] + ti.select(three, third, around + ti.select(two, pair * (xx + yy), one * czz))
        rxy = stress[3] + ti.select(three, 0.0, ti.select(two, 0.0 - pair * xy, one * (yz * zx - xy * zz)))
        if ti.static(features.dimension == 2):
            return rxx, ryy, rzz, rxy
        else:
            ryz = stress[4] + ti.select(three, 0.0, ti.select(two, 0.0 - pair * yz, one * (zx * xy - yz * xx)))
            rzx = stress[5] + ti.select(three, 0.0, ti.select(two, 0.0 - pair * zx, one * (xy * yz - zx * yy)))
            return rxx, ryy, rzz, rxy, ryz, rzx
    elif ti.static(features.volume_correction):
        return [stress[k] + opened if k < 3 else stress[k] for k in ti.static(range(features.stresses))]
    else:
        return [stress[k] for k in ti.static(range(features.stresses))]


@ti.func
def plastic_return(stress: ti.template(), strengths: ti.template(), lame, shear, features: ti.template()):
    """The stress [Pa] that the law of `features` admits in place of a trial stress.

    Returns its components; the increment of equivalent deviatoric plastic strain [-], sqrt(2/3 e : e) with
    e = dev(sigma_trial - sigma) / (2 mu); and the mean stress lost by opening [Pa].
    """
    if ti.static(hasattr(features.law, "return_tensor")):
        return features.law.return_tensor(stress, strengths, lame, shear, features)
    elif ti.static(features.dimension == 2):
        xx, yy, z, xy = stress
        half = 0.5 * (xx - yy)
        centre = xx - half
        radius = ti.sqrt(half * half + xy * xy)
        a, b = centre + radius, centre - radius
        s1, s2, s3 = maximum(a, z), maximum(b, minimum(a, z)), minimum(b, z)
        t1, t2, t3, opened = features.law.return_principal(s1, s2, s3, strengths, lame, shear, features)
        yielded = (t1 != s1) | (t2 != s2) | (t3 != s3)
        above, below = z > a, z < b
        top = ti.select(above, t2, t1)
        bottom = ti.select(below, t2, t3)
        out = ti.select(above, t1, ti.select(below, t3, t2))
        scale = 0.5 * (top - bottom) / maximum(radius, TINY)
        middle = 0.5 * (top + bottom)
        return (
            ti.select(yielded, middle + scale * half, xx),
            ti.select(yielded, middle - scale * half, yy),
            ti.select(yielded, out, z),
            ti.select(yielded, scale * xy, xy),
            equivalent_strain(t1 - s1, t2 - s2, t3 - s3, shear),
            opened,
        )
    else:
        xx, yy, zz, xy, yz, zx = stress
        p = (xx + yy + zz) / 3.0
        dxx, dyy, dzz = xx - p, yy - p, zz - p
        a1, a2, a3 = principal_deviator(dxx, dyy, dzz, xy, yz, zx, features.precision)
        s1, s2, s3 = p + a1, p + a2, p + a3
        t1, t2, t3, opened = features.law.return_principal(s1, s2, s3, strengths, lame, shear, features)
        g1, g2, g3 = t1 - s1, t2 - s2, t3 - s3
        # From the deviator: if it is small against the mean, rounding could make s1 = s3 but not d = 0.
        g12 = clamp((g1 - g2) / maximum(a1 - a2, TINY), -1.0, 0.0)
        g23 = clamp((g2 - g3) / maximum(a2 - a3, TINY), -1.0, 0.0)
        g123 = (g12 - g23) / maximum(a1 - a3, TINY)
        # In powers of the deviator d, with a1 + a2 + a3 = 0.
        constant = g1 - g12 * a1 + g123 * a1 * a2
        linear = g12 + g123 * a3
        return (
            xx + constant + linear * dxx + g123 * (dxx * dxx + xy * xy + zx * zx),
            yy + constant + linear * dyy + g123 * (xy * xy + dyy * dyy + yz * yz),
            zz + constant + linear * dzz + g123 * (zx * zx + yz * yz + dzz * dzz),
            xy + linear * xy + g123 * (dxx * xy + xy * dyy + zx * yz),
            yz + linear * yz + g123 * (xy * zx + dyy * yz + yz * dzz),
            zx + linear * zx + g123 * (dxx * zx + xy * yz + zx * dzz),
            equivalent_strain(g1, g2, g3, shear),
            opened,
        )


@ti.func
def equivalent_strain(g1, g2, g3, shear):
    """Equivalent deviatoric plastic strain [-] behind changes `g` of the principal stresses [Pa]."""
    mean = (g1 + g2 + g3) / 3.0
    square = (g1 - mean) * (g1 - mean) + (g2 - mean) * (g2 - mean) + (g3 - mean) * (g3 - mean)
    return ti.sqrt(square / 6.0) / shear


@ti.func
def midpoint_increment(a: ti.template(), dimension: ti.template()):
    """G [-] of the increment `a` = dt * velocity gradient [-], both row by row, shape [D * D]."""
    return [
        a[i] - 0.5 * row_times_column(a, ti.static(i // dimension), ti.static(i % dimension), dimension)
        for i in ti.static(range(dimension * dimension))
    ]


@ti.func
def row_times_column(a: ti.template(), row: ti.template(), column: ti.template(), dimension: ti.template()):
    """(A A)_ij of a matrix given row by row."""
    value = a[row * dimension] * a[column]
    for k in ti.static(range(1, dimension)):
        value = value + a[row * dimension + k] * a[k * dimension + column]
    return value
