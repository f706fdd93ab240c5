"""Friction that grows with the inertial number, mu(I) (Jop, Forterre & Pouliquen 2006, eq. 2).

    sin phi = mu_s + (mu_2 - mu_s) / (1 + I_0 / I),     I = gamma' d / sqrt(P / rho_s)

Without dilation the shear plane has as normal stress the centre P = -(s1 + s3) / 2 of Mohr's circle and as shear stress
its radius R = (s1 - s3) / 2; so sin phi is the measured ratio mu. gamma' is the plastic shear rate of that plane; where
two stresses coincide at an edge, their mean replaces both. In a step dt (in MPM: Dunatunga & Kamrin 2015) the return of
`mpm.laws.mohr_coulomb` takes the trial (P, R) by the shear g = gamma' dt to

    R - G g = (P + b G g) sin phi + c cos phi_s

b is the change of P during the return: (lambda + G) sin psi / G on a plane; at an edge -1/3 if the larger two stresses
coincide, 1/3 if the smaller two do, plus that of dilation. With w the share of the growth, sin phi = mu_s + (mu_2 -
mu_s) w, and g = g_0 w / (1 - w), g_0 = dt I_0 sqrt(P / rho_s) / d, at the pressure of the slow return this is

    m w^2 - (e + m + k) w + e = 0,    e = R - P mu_s - c cos phi_s,   m = (mu_2 - mu_s) (P + b e / (1 + b mu_s)),
                                      k = (1 + b mu_s) G g_0

whose smaller root is in [0, 1] at any step: 0 where nothing yields, about e / k in slow shear and 1 in very fast shear.
Under tension I is undefined, and friction is that of slow shear.

| symbol | variable |
|---|---|
| mu_s, mu_2 | sin_phi, sin_phi_limit |
| 2 c cos phi_s | strength |
| I_0 dt / (d sqrt(rho_s)) | inertial_step |
| P, R; then P + b e / (1 + b mu_s) | trial_pressure, radius; pressure |
| 1 + b mu_s, b / (1 + b mu_s) | stiffening, rise |
| e, m, k, w | excess, most, slow, share |
"""

import taichi as ti

from mpm.arrays.access import TINY, maximum


@ti.func
def sin_phi_at_rate(s1, s2, s3, upper, lower, strengths: ti.template(), lame, shear, dilates: ti.template()):
    """sin phi [-] at the rate of shear at which a step returns the trial principal stresses s1 >= s2 >= s3 [Pa].

    upper, lower: whether the slow return is to the edge where stresses 1 and 2, or 2 and 3, meet; strengths: as
    `mpm.laws.mohr_coulomb.return_principal` takes them.
    """
    sin_phi, sin_psi, strength, _, sin_phi_limit, inertial_step = strengths
    high, low = ti.select(upper, 0.5 * (s1 + s2), s1), ti.select(lower, 0.5 * (s2 + s3), s3)
    trial_pressure, radius = 0.0 - 0.5 * (high + low), 0.5 * (high - low)
    excess = maximum(radius - trial_pressure * sin_phi - 0.5 * strength, 0.0)
    stiffening = ti.select(upper, 1.0 - sin_phi / 3.0, ti.select(lower, 1.0 + sin_phi / 3.0, 1.0))
    rise = ti.select(upper, -1.0 / (3.0 - sin_phi), ti.select(lower, 1.0 / (3.0 + sin_phi), 0.0))
    if ti.static(dilates):
        bulk4 = 4.0 * lame + shear * (8.0 / 3.0)
        at_upper = bulk4 * sin_psi / (shear * (3.0 - sin_psi)) - 1.0 / 3.0
        at_lower = bulk4 * sin_psi / (shear * (3.0 + sin_psi)) + 1.0 / 3.0
        b = ti.select(upper, at_upper, ti.select(lower, at_lower, (lame + shear) * sin_psi / shear))
        stiffening = 1.0 + b * sin_phi
        rise = b / stiffening
    pressure, growth = maximum(trial_pressure + rise * excess, 0.0), maximum(sin_phi_limit - sin_phi, 0.0)
    most, slow = growth * pressure, stiffening * shear * inertial_step * ti.sqrt(pressure)
    # (e + m + k)^2 - 4 m e without a difference of large numbers.
    square = (excess - most) * (excess - most) + slow * (slow + 2.0 * (excess + most))
    share = 2.0 * excess / maximum(excess + most + slow + ti.sqrt(square), TINY)
    return ti.select(pressure > 0.0, sin_phi + growth * share, sin_phi)
