"""Mohr-Coulomb plasticity with tension cutoff, returned in principal stresses; for vectors of lanes, so branchless.

Tension is positive, s1 >= s2 >= s3 are the principal stresses. Yield function and flow potential (Davis 1968; de Souza
Neto, Peric & Owen 2008, section 8.2):

    F = s1 (1 + sin phi) - s3 (1 - sin phi) - 2 c cos phi
    G = s1 (1 + sin psi) - s3 (1 - sin psi)

With isotropic elasticity D (Lame constants lambda, mu) the return runs along D dG/ds. On one plane

    dgamma = F / (4 [mu + (lambda + mu) sin phi sin psi])

and where it would cross an edge of the hexagon two planes are active, two multipliers from a symmetric 2 x 2 system.
At the apex, wherever the mean stress reaches the tension limit T = min(tension cutoff, c cot phi), the point carries
T in all directions; each principal stress is then clipped to T. For psi = 0 the mean stress never changes in a
return, so nothing is ejected from the apex.

| symbol | variable |
|---|---|
| s1, s2, s3 | s1, s2, s3 |
| sin phi, sin psi | sin_phi, sin_psi |
| 2 c cos phi | strength |
| lambda, mu | lame, shear |
| T | limit |
"""

import taichi as ti

from mpm.lanes import larger, smaller


@ti.func
def on_plane(s1, s2, s3, excess, sin_phi, sin_psi, lame, shear, dilates: ti.template()):
    """Return along the flow of the plane F(s1, s3), which is violated by `excess` >= 0."""
    if ti.static(dilates):
        rate = excess / (4.0 * (shear + (lame + shear) * sin_phi * sin_psi))
        bulge = 2.0 * lame * sin_psi
        s1 = s1 - rate * (bulge + 2.0 * shear * (1.0 + sin_psi))
        s2 = s2 - rate * bulge
        s3 = s3 - rate * (bulge - 2.0 * shear * (1.0 - sin_psi))
    else:
        s1 = s1 - 0.5 * excess
        s3 = s3 + 0.5 * excess
    return s1, s2, s3


@ti.func
def on_edge(s1, s2, s3, excess, sin_phi, sin_psi, strength, lame, shear, upper: ti.template(), dilates: ti.template()):
    """Return to the edge where stresses 1 and 2 (`upper`) or 2 and 3 meet: the stress apart, then the equal two."""
    sign = ti.static(1.0 if upper else -1.0)
    pair, single = s2 + s3, s1
    if ti.static(upper):
        pair, single = s1 + s2, s3
    if ti.static(dilates):
        second = s1 * (1.0 + sin_phi) - s2 * (1.0 - sin_phi) - strength
        if ti.static(upper):
            second = s2 * (1.0 + sin_phi) - s3 * (1.0 - sin_phi) - strength
        # a, b: change of a plane's F per own and per other multiplier.
        a = 4.0 * (shear + (lame + shear) * sin_phi * sin_psi)
        b = 4.0 * lame * sin_phi * sin_psi + 2.0 * shear * (1.0 - sign * sin_phi) * (1.0 - sign * sin_psi)
        total = (excess + second) / (a + b)
        bulge = 2.0 * lame * sin_psi * total
        pair = pair - (2.0 * bulge + sign * 2.0 * shear * (1.0 + sign * sin_psi) * total)
        single = single - (bulge - sign * 2.0 * shear * (1.0 - sign * sin_psi) * total)
    else:
        # psi = 0 keeps the mean stress, so it and F = 0 give the answer.
        mean = pair + single
        single = ((1.0 + sign * sin_phi) * mean - sign * 2.0 * strength) / (3.0 - sign * sin_phi)
        pair = mean - single
    return single, 0.5 * pair


@ti.func
def return_principal(s1, s2, s3, sin_phi, sin_psi, strength, limit, lame, shear, dilates: ti.template()):
    """The stresses that Mohr-Coulomb with tension limit admits in place of s1 >= s2 >= s3, and then by how much their
    mean lay beyond the apex [Pa], 0 where it did not.

    It shifts stresses and brings them closer, never further apart: no difference s_i - s_j grows or changes its sign.
    """
    excess = larger(s1 * (1.0 + sin_phi) - s3 * (1.0 - sin_phi) - strength, 0.0)
    t1, t2, t3 = on_plane(s1, s2, s3, excess, sin_phi, sin_psi, lame, shear, dilates)
    low, twin_high = on_edge(s1, s2, s3, excess, sin_phi, sin_psi, strength, lame, shear, True, dilates)
    high, twin_low = on_edge(s1, s2, s3, excess, sin_phi, sin_psi, strength, lame, shear, False, dilates)
    upper, lower = t2 > t1, t3 > t2
    t1, t2, t3 = (
        ti.select(upper, twin_high, ti.select(lower, high, t1)),
        ti.select(upper, twin_high, ti.select(lower, twin_low, t2)),
        ti.select(upper, low, ti.select(lower, twin_low, t3)),
    )
    beyond = (t1 + t2 + t3) / 3.0 - limit
    apex = beyond >= 0.0
    return (
        ti.select(apex, limit, smaller(t1, limit)),
        ti.select(apex, limit, smaller(t2, limit)),
        ti.select(apex, limit, smaller(t3, limit)),
        larger(beyond, 0.0),
    )
