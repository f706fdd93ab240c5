"""Friction that grows with the inertial number, mu(I) (Jop, Forterre & Pouliquen 2006, eq. 2).

    sin phi = mu_s + (mu_2 - mu_s) / (1 + I_0 / I),     I = gamma' d / sqrt(P / rho_s)

On the plane that shears the normal stress is the centre P = -(s1 + s3) / 2 of Mohr's circle and the shear stress its
radius R = (s1 - s3) / 2, where nothing dilates; so sin phi is the measured ratio mu. gamma' is the plastic shear rate
of that plane. The backward Euler step of `mpm.physics.mohr_coulomb` with this sin phi (in MPM: Dunatunga & Kamrin 2015)
takes the trial radius R to R - G g with the shear g = gamma' dt, so that with w = (sin phi - mu_s) / (mu_2 - mu_s)

    R - G g (1 + b sin phi) = P sin phi + c cos phi_s,     g = g_0 w / (1 - w),     g_0 = dt I_0 sqrt(P / rho_s) / d

where b = (lambda + G) sin psi / G lowers P as the plane dilates (in I the trial P stands). Of the excess over the slow
strength e = R - P mu_s - c cos phi_s and the most that the rate can add, m = P (mu_2 - mu_s), w is the smaller root of

    (m - f) w^2 - (e + m + k) w + e = 0,     k = G g_0 (1 + b mu_s),     f = G g_0 b (mu_2 - mu_s),

in [0, 1] at any step: 0 where nothing yields, e / k where it shears slowly, 1 where it shears very fast. The return
then has this sin phi on every plane. On an edge of the pyramid, where axis 2 yields too, g is that of the plane alone,
which is the shear rate there to a fifth. Under tension, P <= 0, there is no I and friction is that of slow shear.

| symbol | variable |
|---|---|
| mu_s, mu_2 | sin_phi, sin_phi_limit |
| sin psi | sin_psi |
| 2 c cos phi_s | strength |
| I_0 dt / (d sqrt(rho_s)) | inertial_step |
| P, R | pressure, radius |
| e, m, k, f, w | excess, most, slow, bulge, share |
| lambda, G | lame, shear |
"""

import taichi as ti

from mpm.arrays.access import maximum
from mpm.physics.principal import TINY


@ti.func
def sin_phi_at_rate(
    s1, s3, sin_phi, sin_psi, strength, sin_phi_limit, inertial_step, lame, shear, dilates: ti.template()
):
    """sin phi [-] at the rate of shear at which a step returns the trial principal stresses s1 >= s3 [Pa]."""
    pressure, radius = maximum(0.0 - 0.5 * (s1 + s3), 0.0), 0.5 * (s1 - s3)
    growth = maximum(sin_phi_limit - sin_phi, 0.0)
    excess, most = maximum(radius - pressure * sin_phi - 0.5 * strength, 0.0), pressure * growth
    slow = shear * inertial_step * ti.sqrt(pressure)
    bulge = 0.0 * slow
    if ti.static(dilates):
        dilating = (lame + shear) / shear * sin_psi
        bulge = slow * dilating * growth
        slow = slow + slow * dilating * sin_phi
    # (e + m + k)^2 - 4 (m - f) e without a difference of large numbers.
    square = (excess - most) * (excess - most) + slow * (slow + 2.0 * (excess + most)) + 4.0 * bulge * excess
    share = 2.0 * excess / maximum(excess + most + slow + ti.sqrt(square), TINY)
    return ti.select(pressure > 0.0, sin_phi + growth * share, sin_phi)
