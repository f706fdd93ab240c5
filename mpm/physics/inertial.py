"""Friction that grows with the inertial number, mu(I) (Jop, Forterre & Pouliquen 2006, eq. 2).

    sin phi = mu_s + (mu_2 - mu_s) / (1 + I_0 / I),     I = gamma' d / sqrt(P / rho_s)

On the plane that shears the normal stress is the centre P = -(s1 + s3) / 2 of Mohr's circle and the shear stress its
radius R = (s1 - s3) / 2, where nothing dilates; so sin phi is the measured ratio mu. gamma' is the plastic shear rate
of that plane. `mpm.physics.mohr_coulomb` returns with slow friction mu_s to (P, R) by a plastic shear g_s in the step
dt; with more friction (in MPM: Dunatunga & Kamrin 2015) the shear is g = gamma' dt < g_s, where

    (1 + b mu_s) G (g_s - g) = (sin phi - mu_s) P,     b = dP / (G dg)

b says how P changes as the return goes on: by (lambda + G) sin psi / G on a plane; where two stresses meet at an edge,
by -1/3 where they are the larger two and by 1/3 where the smaller two, and as they dilate. With w the share of the
growth, sin phi = mu_s + (mu_2 - mu_s) w, and g = g_0 w / (1 - w), g_0 = dt I_0 sqrt(P / rho_s) / d, backward Euler is

    m w^2 - (e + m + k) w + e = 0,     e = (1 + b mu_s) G g_s,  m = (mu_2 - mu_s) P,  k = (1 + b mu_s) G g_0

whose smaller root is in [0, 1] at any step: 0 where nothing yields, about e / k in slow shear and 1 in very fast shear.
Under tension, P <= 0, there is no I and friction is that of slow shear.

| symbol | variable |
|---|---|
| mu_s, mu_2 | sin_phi, sin_phi_limit |
| I_0 dt / (d sqrt(rho_s)) | inertial_step |
| P, G g_s, 1 + b mu_s | pressure, shear_return, stiffening |
| e, m, k, w | excess, most, slow, share |
"""

import taichi as ti

from mpm.arrays.access import maximum
from mpm.physics.principal import TINY


@ti.func
def sin_phi_at_rate(pressure, shear_return, stiffening, sin_phi, sin_phi_limit, inertial_step, shear):
    """sin phi [-] at the rate of shear of a step that returns by `shear_return` [Pa] to `pressure` [Pa] with mu_s."""
    pressure, growth = maximum(pressure, 0.0), maximum(sin_phi_limit - sin_phi, 0.0)
    excess, most = stiffening * shear_return, growth * pressure
    slow = stiffening * shear * inertial_step * ti.sqrt(pressure)
    # (e + m + k)^2 - 4 m e without a difference of large numbers.
    square = (excess - most) * (excess - most) + slow * (slow + 2.0 * (excess + most))
    share = 2.0 * excess / maximum(excess + most + slow + ti.sqrt(square), TINY)
    return ti.select(pressure > 0.0, sin_phi + growth * share, sin_phi)
