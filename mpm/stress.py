"""One step of Cauchy stress: an objective elastic increment, then the plastic return.

    sigma_trial = R sigma R^T + lambda tr(D) I + 2 mu D,    R = (I - W / 2)^-1 (I + W / 2)

with D and W the symmetric and skew parts of the velocity gradient times the step. R is a rotation for every W (Hughes &
Winget 1980), so a rigid spin keeps the invariants of the stress to rounding; for small steps this is Jaumann's rate.
R - I = 2 (Q + Q^2) / (1 + q . q) with q half the axial vector of W and Q v = q x v; in 2D tan(angle / 2) = q.
Components xx, yy, zz, xy and, in 3D, yz, zx; 2D is plane strain.

The returned stress has the axes of the trial stress, and no axes are computed. With s_i the principal stresses, g_i the
change of each, and the divided differences g12 = (g1 - g2) / (s1 - s2), g123 = (g12 - g23) / (s1 - s3), Newton's
interpolation polynomial carries the change over to the tensor:

    sigma = sigma_trial + g1 I + g12 (sigma_trial - s1 I) + g123 (sigma_trial - s1 I) (sigma_trial - s2 I)

Because a return never widens a gap, with elastic coupling neither, g12 and g23 lie in [-1, 0]: clamped to that they are
right where stresses meet, too. In plane strain this is a scaled deviator around a moved centre.

Volume correction remembers what opened (`crack_stress`). A crack that closes moves the stress across it alone and may widen a gap;
the clamp is then [-1, 1], which where two stresses meet costs no more than what closed in this step.
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
        xx, yy, zz, xy, yz, zx = turned(stress, 0.25 * (gzy - gyz), 0.25 * (gxz - gzx), 0.25 * (gyx - gxy))
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
def turned(stress: ti.template(), qx, qy, qz):
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
def crack_stress(stress: ti.template(), opened, limit, lame, shear, features: ti.template()):
    """What the strain of opened cracks, elastic, would add to the principal stresses s1, s2 and s3 [Pa].

    `opened` is their volume e, as the mean stress K e that it would have made [Pa]; `stress` that before the step. Of
    the m principal stresses that stand at T, each axis has opened by e / m: in all directions in a loose fragment, as
    cohesionless material does wherever it opens (Tampubolon et al. 2017), in one in a crack beside compression. The
    return takes the stress lambda e + 2 mu e_i away again, unless strain closes the crack: alone it changes nothing.
    """
    if ti.static(features.cohesive):
        # P = T I - sigma, all of whose principal values are >= 0: m = 3 where its trace is 0, m >= 2 where its second
        # invariant is; to a ten-thousandth of the opening, for rounding in single precision.
        xx, yy, zz = limit - stress[0], limit - stress[1], limit - stress[2]
        trace = xx + yy + zz
        second = xx * yy + yy * zz + zz * xx - stress[3] * stress[3]
        if ti.static(features.dimension == 3):
            second = second - stress[4] * stress[4] - stress[5] * stress[5]
        least = 1.0e-4 * opened
        two, three = second <= least * trace, trace <= least
        bulk3 = 3.0 * lame + 2.0 * shear
        all_around = 3.0 * lame / bulk3 * opened
        along = 6.0 * shear / bulk3 * opened
        return (
            all_around + ti.select(three, 1.0 / 3.0, ti.select(two, 0.5, 1.0)) * along,
            all_around + ti.select(three, 1.0 / 3.0, ti.select(two, 0.5, 0.0)) * along,
            all_around + ti.select(three, 1.0 / 3.0, 0.0) * along,
        )
    else:
        return opened, opened, opened


@ti.func
def plastic_return(
    stress: ti.template(), crack: ti.template(), sin_phi, sin_psi, strength, limit, lame, shear, features: ti.template()
):
    """The stress [Pa] that Mohr-Coulomb with tension cutoff admits in place of a trial stress.

    `crack` is what `crack_stress` gives, read where `features.corrected`. Returns the stress's components; the
    increment of equivalent deviatoric plastic strain [-], sqrt(2/3 e : e) with e = dev(sigma_trial - sigma) / (2 mu);
    and the mean stress that opening cost [Pa].
    """
    if ti.static(features.dimension == 2):
        xx, yy, z, xy = stress
        half = 0.5 * (xx - yy)
        centre = xx - half
        radius = ti.sqrt(half * half + xy * xy)
        a, b = centre + radius, centre - radius
        s1, s2, s3 = larger(a, z), larger(b, smaller(a, z)), smaller(b, z)
        t1, t2, t3, opened = returned(s1, s2, s3, crack, sin_phi, sin_psi, strength, limit, lame, shear, features)
        yielded = (t1 != s1) | (t2 != s2) | (t3 != s3)
        above, below = z > a, z < b
        top = ti.select(above, t2, t1)
        bottom = ti.select(below, t2, t3)
        out = ti.select(above, t1, ti.select(below, t3, t2))
        scale = 0.5 * (top - bottom) / larger(radius, TINY)
        if ti.static(features.corrected and features.cohesive):
            scale = smaller(scale, 2.0)
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
        t1, t2, t3, opened = returned(s1, s2, s3, crack, sin_phi, sin_psi, strength, limit, lame, shear, features)
        g1, g2, g3 = t1 - s1, t2 - s2, t3 - s3
        widest = ti.static(1.0 if features.corrected and features.cohesive else 0.0)
        g12 = between((g1 - g2) / larger(s1 - s2, TINY), -1.0, widest)
        g23 = between((g2 - g3) / larger(s2 - s3, TINY), -1.0, widest)
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
            opened,
        )


@ti.func
def returned(
    s1, s2, s3, crack: ti.template(), sin_phi, sin_psi, strength, limit, lame, shear, features: ti.template()
):
    """The return of principal stresses [Pa] together with what a remembered crack adds to them."""
    if ti.static(features.corrected):
        s1, s2, s3 = s1 + crack[0], s2 + crack[1], s3 + crack[2]
    return return_principal(s1, s2, s3, sin_phi, sin_psi, strength, limit, lame, shear, features)


@ti.func
def equivalent_strain(g1, g2, g3, shear):
    """Equivalent deviatoric plastic strain [-] behind changes `g` of the principal stresses [Pa]."""
    mean = (g1 + g2 + g3) / 3.0
    square = (g1 - mean) * (g1 - mean) + (g2 - mean) * (g2 - mean) + (g3 - mean) * (g3 - mean)
    return ti.sqrt(square / 6.0) / shear
