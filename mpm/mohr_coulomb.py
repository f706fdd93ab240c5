"""Mohr-Coulomb plasticity with tension cutoff in plane strain, returned in principal stresses.

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


@ti.func
def plane_step(s1, s2, s3, excess, sin_phi, sin_psi, lame, shear, dilates: ti.template()):
    """Return along the flow of the plane F(s1, s3), which is violated by `excess` > 0."""
    if ti.static(dilates):
        rate = excess / (4.0 * (shear + (lame + shear) * sin_phi * sin_psi))
        bulge = 2.0 * lame * sin_psi
        s1 -= rate * (bulge + 2.0 * shear * (1.0 + sin_psi))
        s2 -= rate * bulge
        s3 -= rate * (bulge - 2.0 * shear * (1.0 - sin_psi))
    else:
        s1 -= 0.5 * excess
        s3 += 0.5 * excess
    return s1, s2, s3


@ti.func
def return_principal(s1, s2, s3, sin_phi, sin_psi, strength, lame, shear, dilates: ti.template()):
    """Sorted principal stresses, returned to the hexagon: on its face, or on an edge.

    Returns the three stresses and whether they yielded.
    """
    excess = s1 * (1.0 + sin_phi) - s3 * (1.0 - sin_phi) - strength
    yielded = excess > 0.0
    if yielded:
        t1, t2, t3 = plane_step(s1, s2, s3, excess, sin_phi, sin_psi, lame, shear, dilates)
        if t1 >= t2 and t2 >= t3:
            s1, s2, s3 = t1, t2, t3
        else:
            # Stresses 1 and 2 (or 2 and 3) meet: each of them takes part in a plane of its own.
            upper = t2 > t1
            mean = s1 + s2 + s3
            pair, single = s2 + s3, s1
            if upper:
                pair, single = s1 + s2, s3
            if ti.static(dilates):
                second = s1 * (1.0 + sin_phi) - s2 * (1.0 - sin_phi) - strength
                sign = -1.0
                if upper:
                    second = s2 * (1.0 + sin_phi) - s3 * (1.0 - sin_phi) - strength
                    sign = 1.0
                # a, b: change of a plane's F per own and per other multiplier.
                a = 4.0 * (shear + (lame + shear) * sin_phi * sin_psi)
                b = 4.0 * lame * sin_phi * sin_psi + 2.0 * shear * (1.0 - sign * sin_phi) * (1.0 - sign * sin_psi)
                total = (excess + second) / (a + b)
                bulge = 2.0 * lame * sin_psi * total
                pair -= 2.0 * bulge + sign * 2.0 * shear * (1.0 + sign * sin_psi) * total
                single -= bulge - sign * 2.0 * shear * (1.0 - sign * sin_psi) * total
                s1, s2, s3 = single, 0.5 * pair, 0.5 * pair
                if upper:
                    s1, s2, s3 = 0.5 * pair, 0.5 * pair, single
            else:
                # psi = 0 keeps the mean stress, so it and F = 0 give the answer.
                if upper:
                    s3 = ((1.0 + sin_phi) * mean - 2.0 * strength) / (3.0 - sin_phi)
                    s1 = 0.5 * (mean - s3)
                    s2 = s1
                else:
                    s1 = ((1.0 - sin_phi) * mean + 2.0 * strength) / (3.0 + sin_phi)
                    s3 = 0.5 * (mean - s1)
                    s2 = s3
    return s1, s2, s3, yielded
