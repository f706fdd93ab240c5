"""One step of Cauchy stress: Jaumann rate of an isotropic elastic solid, then the plastic return.

    sigma_trial = sigma + (W sigma - sigma W) + lambda tr(D) I + 2 mu D

with D and W the symmetric and skew parts of the velocity gradient times the step (Belytschko et al. 2014, eq. 5.4.22).
Plane strain: components xx, yy, xy and zz. Eigenvalues alone are needed: the return scales the in-plane deviator, its
axes stay.
"""

import taichi as ti

from mpm.mohr_coulomb import return_principal


@ti.func
def trial_stress(stress, gradient, lame, shear):
    """Elastic trial: `stress` (xx, yy, xy, zz) [Pa] after the increment `gradient` = dt * velocity gradient [-]."""
    spin = gradient[0, 1] - gradient[1, 0]
    volumetric = lame * (gradient[0, 0] + gradient[1, 1])
    return ti.Vector(
        [
            stress[0] + spin * stress[2] + volumetric + 2.0 * shear * gradient[0, 0],
            stress[1] - spin * stress[2] + volumetric + 2.0 * shear * gradient[1, 1],
            stress[2] + 0.5 * spin * (stress[1] - stress[0]) + shear * (gradient[0, 1] + gradient[1, 0]),
            stress[3] + volumetric,
        ]
    )


@ti.func
def plastic_return(stress, sin_phi, sin_psi, strength, limit, lame, shear, dilates: ti.template()):
    """The stress (xx, yy, xy, zz) [Pa] that Mohr-Coulomb with tension limit admits in place of a trial stress."""
    centre = 0.5 * (stress[0] + stress[1])
    half = 0.5 * (stress[0] - stress[1])
    radius = ti.sqrt(half * half + stress[2] * stress[2])
    a, b, z = centre + radius, centre - radius, stress[3]
    s1, s3 = ti.max(a, z), ti.min(b, z)
    s2 = a + b + z - s1 - s3
    s1, s2, s3, yielded = return_principal(s1, s2, s3, sin_phi, sin_psi, strength, lame, shear, dilates)
    if s1 > limit:
        yielded = True
        if s1 + s2 + s3 >= 3.0 * limit:
            s1, s2, s3 = limit, limit, limit
        else:
            s1, s2, s3 = limit, ti.min(s2, limit), ti.min(s3, limit)
    if yielded:
        top, bottom, out = s1, s3, s2
        if z > a:
            top, bottom, out = s2, s3, s1
        elif z < b:
            top, bottom, out = s1, s2, s3
        scale = 0.0
        if radius > 0.0:
            scale = 0.5 * (top - bottom) / radius
        centre = 0.5 * (top + bottom)
        stress = ti.Vector([centre + scale * half, centre - scale * half, scale * stress[2], out])
    return stress
