"""One step of Cauchy stress: Jaumann rate of an isotropic elastic solid, then the plastic return.

    sigma_trial = sigma + (W sigma - sigma W) + lambda tr(D) I + 2 mu D

with D and W the symmetric and skew parts of the velocity gradient times the step (Belytschko et al. 2014, eq. 5.4.22).
Components xx, yy, zz, xy and, in 3D, yz, zx; 2D is plane strain.

The returned stress has the axes of the trial stress, and no axes are computed. With s_i the principal stresses, g_i the
change of each, and the divided differences g12 = (g1 - g2) / (s1 - s2), g123 = (g12 - g23) / (s1 - s3), Newton's
interpolation polynomial carries the change over to the tensor:

    sigma = sigma_trial + g1 I + g12 (sigma_trial - s1 I) + g123 (sigma_trial - s1 I) (sigma_trial - s2 I)

Because a return never widens a gap, g12 and g23 lie in [-1, 0]: clamped to that they are right where stresses meet,
too. In plane strain this is a scaled deviator around a moved centre.
"""

import taichi as ti

from mpm.lanes import between, larger, smaller
from mpm.mohr_coulomb import return_principal
from mpm.principal import TINY, principal_deviator


@ti.func
def trial_stress(stress: ti.template(), gradient: ti.template(), lame, shear, dimension: ti.template()):
    """Elastic trial: `stress` [Pa] after the increment `gradient` = dt * velocity gradient [-], row by row."""
    if ti.static(dimension == 2):
        xx, yy, zz, xy = stress
        gxx, gxy, gyx, gyy = gradient
        spin = gxy - gyx
        volumetric = lame * (gxx + gyy)
        return (
            xx + spin * xy + volumetric + 2.0 * shear * gxx,
            yy - spin * xy + volumetric + 2.0 * shear * gyy,
            zz + volumetric,
            xy + 0.5 * spin * (yy - xx) + shear * (gxy + gyx),
        )
    else:
        xx, yy, zz, xy, yz, zx = stress
        gxx, gxy, gxz, gyx, gyy, gyz, gzx, gzy, gzz = gradient
        wxy, wxz, wyz = 0.5 * (gxy - gyx), 0.5 * (gxz - gzx), 0.5 * (gyz - gzy)
        volumetric = lame * (gxx + gyy + gzz)
        return (
            xx + 2.0 * (wxy * xy + wxz * zx) + volumetric + 2.0 * shear * gxx,
            yy + 2.0 * (wyz * yz - wxy * xy) + volumetric + 2.0 * shear * gyy,
            zz - 2.0 * (wxz * zx + wyz * yz) + volumetric + 2.0 * shear * gzz,
            xy + wxy * (yy - xx) + wxz * yz + wyz * zx + shear * (gxy + gyx),
            yz - wxy * zx + wyz * (zz - yy) - wxz * xy + shear * (gyz + gzy),
            zx + wxy * yz + wxz * (zz - xx) - wyz * xy + shear * (gzx + gxz),
        )


@ti.func
def plastic_return(stress: ti.template(), sin_phi, sin_psi, strength, limit, lame, shear, needs: ti.template()):
    """The stress [Pa] that Mohr-Coulomb with tension limit admits in place of a trial stress.

    Returns its components; the increment of equivalent deviatoric plastic strain [-], sqrt(2/3 e : e) with
    e = dev(sigma_trial - sigma) / (2 mu); and how far the mean of the trial stress lay beyond the apex [Pa].
    """
    if ti.static(needs.dimension == 2):
        xx, yy, z, xy = stress
        half = 0.5 * (xx - yy)
        centre = xx - half
        radius = ti.sqrt(half * half + xy * xy)
        a, b = centre + radius, centre - radius
        s1, s2, s3 = larger(a, z), larger(b, smaller(a, z)), smaller(b, z)
        t1, t2, t3, beyond = return_principal(s1, s2, s3, sin_phi, sin_psi, strength, limit, lame, shear, needs.dilates)
        yielded = (t1 != s1) | (t2 != s2) | (t3 != s3)
        above, below = z > a, z < b
        top = ti.select(above, t2, t1)
        bottom = ti.select(below, t2, t3)
        out = ti.select(above, t1, ti.select(below, t3, t2))
        scale = 0.5 * (top - bottom) / larger(radius, TINY)
        middle = 0.5 * (top + bottom)
        return (
            ti.select(yielded, middle + scale * half, xx),
            ti.select(yielded, middle - scale * half, yy),
            ti.select(yielded, out, z),
            ti.select(yielded, scale * xy, xy),
            equivalent_strain(t1 - s1, t2 - s2, t3 - s3, shear),
            beyond,
        )
    else:
        xx, yy, zz, xy, yz, zx = stress
        p = (xx + yy + zz) / 3.0
        dxx, dyy, dzz = xx - p, yy - p, zz - p
        a1, a2, a3 = principal_deviator(dxx, dyy, dzz, xy, yz, zx, needs.precision)
        s1, s2, s3 = p + a1, p + a2, p + a3
        t1, t2, t3, beyond = return_principal(s1, s2, s3, sin_phi, sin_psi, strength, limit, lame, shear, needs.dilates)
        g1, g2, g3 = t1 - s1, t2 - s2, t3 - s3
        g12 = between((g1 - g2) / larger(s1 - s2, TINY), -1.0, 0.0)
        g23 = between((g2 - g3) / larger(s2 - s3, TINY), -1.0, 0.0)
        g123 = (g12 - g23) / larger(s1 - s3, TINY)
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
            beyond,
        )


@ti.func
def equivalent_strain(g1, g2, g3, shear):
    """Equivalent deviatoric plastic strain [-] behind changes `g` of the principal stresses [Pa]."""
    mean = (g1 + g2 + g3) / 3.0
    square = (g1 - mean) * (g1 - mean) + (g2 - mean) * (g2 - mean) + (g3 - mean) * (g3 - mean)
    return ti.sqrt(square / 6.0) / shear
