"""The reverse of `mpm.physics.mohr_coulomb`: bars of trial stresses and constants from those of returned stresses.

The return t(s) is linear on each of its pieces (elastic, the plane, two edges, three ways of opening), so on a piece

    s_i' = sum_j t_j' dt_j/ds_i,       (a prime marks a bar, dJ/d of what it stands on)

and likewise for each constant; the piece is the one that the return takes, and its bars are those of its own formula.
"""

import taichi as ti

from mpm.arrays.access import maximum, minimum
from mpm.physics.mohr_coulomb import multipliers, on_hexagon
from mpm.physics.principal import TINY


@ti.func
def plane_reverse(b1, b2, b3, excess, sin_phi, sin_psi, lame, shear, dilates: ti.template()):
    """Bars of (excess, sin phi, sin psi, lambda, mu) from those of `on_plane`'s stresses, which s_i have as well."""
    zero = 0.0 * b1
    if ti.static(dilates):
        stiffness = shear + (lame + shear) * sin_phi * sin_psi
        rate = excess / (4.0 * stiffness)
        bulge = 2.0 * lame * sin_psi
        all_three = b1 + b2 + b3
        rate_bar = 0.0 - (
            b1 * (bulge + 2.0 * shear * (1.0 + sin_psi)) + b2 * bulge + b3 * (bulge - 2.0 * shear * (1.0 - sin_psi))
        )
        stiffness_bar = 0.0 - rate_bar * rate / stiffness
        sin_psi_bar = stiffness_bar * (lame + shear) * sin_phi - rate * (
            2.0 * lame * all_three + 2.0 * shear * (b1 + b3)
        )
        lame_bar = stiffness_bar * sin_phi * sin_psi - rate * 2.0 * sin_psi * all_three
        shear_bar = stiffness_bar * (1.0 + sin_phi * sin_psi) - rate * 2.0 * (
            b1 * (1.0 + sin_psi) - b3 * (1.0 - sin_psi)
        )
        sin_phi_bar = stiffness_bar * (lame + shear) * sin_psi
        return rate_bar / (4.0 * stiffness), sin_phi_bar, sin_psi_bar, lame_bar, shear_bar
    else:
        return 0.5 * (b3 - b1), zero, zero, zero, zero


@ti.func
def edge_reverse(
    single_bar,
    pair_bar,
    s1,
    s2,
    s3,
    excess,
    sin_phi,
    sin_psi,
    strength,
    lame,
    shear,
    upper: ti.template(),
    dilates: ti.template(),
):
    """Bars of (s1, s2, s3, excess, sin phi, sin psi, 2 c cos phi, lambda, mu) from those of `on_edge`'s stresses.

    pair_bar: of the sum of the equal two, half of what both have together.
    """
    sign = ti.static(1.0 if upper else -1.0)
    zero = 0.0 * single_bar
    if ti.static(dilates):
        total, per_total = multipliers(s1, s2, s3, excess, sin_phi, sin_psi, strength, lame, shear, upper)
        # What a unit of `total` takes of the pair and of the single one.
        of_pair = 4.0 * lame * sin_psi + sign * 2.0 * shear * (1.0 + sign * sin_psi)
        of_single = 2.0 * lame * sin_psi - sign * 2.0 * shear * (1.0 - sign * sin_psi)
        total_bar = 0.0 - (pair_bar * of_pair + single_bar * of_single)
        pair_rate, single_rate = 0.0 - pair_bar * total, 0.0 - single_bar * total
        second_bar = total_bar / per_total
        sum_bar = 0.0 - second_bar * total
        lame_bar = sin_psi * (4.0 * pair_rate + 2.0 * single_rate + 8.0 * sin_phi * sum_bar)
        shear_bar = (
            sign * 2.0 * ((1.0 + sign * sin_psi) * pair_rate - (1.0 - sign * sin_psi) * single_rate)
            + (4.0 + 4.0 * sin_phi * sin_psi + 2.0 * (1.0 - sign * sin_phi) * (1.0 - sign * sin_psi)) * sum_bar
        )
        sin_psi_bar = (
            (4.0 * lame + 2.0 * shear) * pair_rate
            + (2.0 * lame + 2.0 * shear) * single_rate
            + (4.0 * (2.0 * lame + shear) * sin_phi - sign * 2.0 * shear * (1.0 - sign * sin_phi)) * sum_bar
        )
        sin_phi_bar = (4.0 * (2.0 * lame + shear) * sin_psi - sign * 2.0 * shear * (1.0 - sign * sin_psi)) * sum_bar
        if ti.static(upper):
            return (
                pair_bar,
                pair_bar + (1.0 + sin_phi) * second_bar,
                single_bar - (1.0 - sin_phi) * second_bar,
                second_bar,
                sin_phi_bar + (s2 + s3) * second_bar,
                sin_psi_bar,
                0.0 - second_bar,
                lame_bar,
                shear_bar,
            )
        else:
            return (
                single_bar + (1.0 + sin_phi) * second_bar,
                pair_bar - (1.0 - sin_phi) * second_bar,
                pair_bar,
                second_bar,
                sin_phi_bar + (s1 + s2) * second_bar,
                sin_psi_bar,
                0.0 - second_bar,
                lame_bar,
                shear_bar,
            )
    else:
        mean = s1 + s2 + s3
        per = 1.0 / (3.0 - sign * sin_phi)
        single = ((1.0 + sign * sin_phi) * mean - sign * 2.0 * strength) * per
        whole_bar = (single_bar - pair_bar) * per
        mean_bar = pair_bar + (1.0 + sign * sin_phi) * whole_bar
        return (
            mean_bar,
            mean_bar,
            mean_bar,
            zero,
            sign * (mean + single) * whole_bar,
            zero,
            0.0 - sign * 2.0 * whole_bar,
            zero,
            zero,
        )


@ti.func
def cutoff_reverse(b2, b3, s1, s2, s3, sin_phi, strength, limit, lame, shear):
    """Bars of (s1, s2, s3, sin phi, 2 c cos phi, T, lambda, mu) from those of `on_cutoff`'s two stresses; and then

    one where one stress alone opened (s2 and s3 fell alike), else zero.
    """
    zero = 0.0 * b2
    beyond = s1 - limit
    per_coupling, per_poisson = 1.0 / (lame + 2.0 * shear), 1.0 / (lame + shear)
    coupling, poisson = lame * per_coupling, 0.5 * lame * per_poisson
    one2, one3 = s2 - coupling * beyond, s3 - coupling * beyond
    two = one2 > limit
    third = s3 - poisson * (beyond + s2 - limit)
    lowest = (limit * (1.0 + sin_phi) - strength) / (1.0 - sin_phi)
    cut = ti.select(two, minimum(third, limit), one3) >= lowest
    middle = s2 - poisson * (beyond + s3 - lowest)
    # One stress opens, two do (and the third follows or does too), or one beside the plane.
    a2, a3 = ti.select(cut, ti.select(two, zero, b2), zero), ti.select(cut, ti.select(two, zero, b3), zero)
    d2, d3 = ti.select(cut, ti.select(two, b2, zero), zero), ti.select(cut, ti.select(two, b3, zero), zero)
    c2, c3 = ti.select(cut, zero, b2), ti.select(cut, zero, b3)
    follows = ti.select(third < limit, d3, zero)
    inside = ti.select((middle >= lowest) & (middle <= limit), c2, zero)
    lowest_bar = c3 + ti.select(middle < lowest, c2, zero) + poisson * inside
    beyond_bar = 0.0 - coupling * (a2 + a3) - poisson * (follows + inside)
    coupling_bar = 0.0 - beyond * (a2 + a3)
    poisson_bar = 0.0 - (beyond + s2 - limit) * follows - (beyond + s3 - lowest) * inside
    per_cone = 1.0 / (1.0 - sin_phi)
    limit_bar = (
        d2
        + (d3 - follows)
        + poisson * follows
        + ti.select(middle > limit, c2, zero)
        + lowest_bar * (1.0 + sin_phi) * per_cone
        - beyond_bar
    )
    return (
        beyond_bar,
        a2 - poisson * follows + inside,
        a3 + follows - poisson * inside,
        lowest_bar * (limit + lowest) * per_cone,
        0.0 - lowest_bar * per_cone,
        limit_bar,
        coupling_bar * 2.0 * shear * per_coupling * per_coupling
        + poisson_bar * 0.5 * shear * per_poisson * per_poisson,
        0.0
        - coupling_bar * 2.0 * lame * per_coupling * per_coupling
        - poisson_bar * 0.5 * lame * per_poisson * per_poisson,
        ti.select(cut, ti.select(two, zero, zero + 1.0), zero),
    )


@ti.func
def return_reverse(b1, b2, b3, s1, s2, s3, sin_phi, sin_psi, strength, limit, lame, shear, features: ti.template()):
    """Bars of (s1, s2, s3, sin phi, sin psi, 2 c cos phi, T, lambda, mu) from those of the returned stresses, and then

    one where nothing yields, else zero; one where s2 and s3 fell alike, else zero.
    """
    dilates = ti.static(features.dilates)
    zero = 0.0 * b1
    h1, h2, h3, excess, upper, lower = on_hexagon(s1, s2, s3, sin_phi, sin_psi, strength, lame, shear, dilates)
    open_ = h1 + h2 + h3 >= 0.0
    if ti.static(features.cohesive):
        open_ = h1 > limit
    # Of what the hexagon returned, nothing is left where the cutoff holds.
    k1, k2, k3 = ti.select(open_, zero, b1), ti.select(open_, zero, b2), ti.select(open_, zero, b3)
    p1 = ti.select(upper, zero, ti.select(lower, zero, k1))
    p2 = ti.select(upper, zero, ti.select(lower, zero, k2))
    p3 = ti.select(upper, zero, ti.select(lower, zero, k3))
    plane = plane_reverse(p1, p2, p3, excess, sin_phi, sin_psi, lame, shear, dilates)
    top = edge_reverse(
        ti.select(upper, k3, zero),
        ti.select(upper, 0.5 * (k1 + k2), zero),
        s1,
        s2,
        s3,
        excess,
        sin_phi,
        sin_psi,
        strength,
        lame,
        shear,
        True,
        dilates,
    )
    bottom = edge_reverse(
        ti.select(upper, zero, ti.select(lower, k1, zero)),
        ti.select(upper, zero, ti.select(lower, 0.5 * (k2 + k3), zero)),
        s1,
        s2,
        s3,
        excess,
        sin_phi,
        sin_psi,
        strength,
        lame,
        shear,
        False,
        dilates,
    )
    excess_bar = ti.select(excess > 0.0, plane[0] + top[3] + bottom[3], zero)
    s1_bar = p1 + top[0] + bottom[0] + (1.0 + sin_phi) * excess_bar
    s2_bar = p2 + top[1] + bottom[1]
    s3_bar = p3 + top[2] + bottom[2] - (1.0 - sin_phi) * excess_bar
    sin_phi_bar = plane[1] + top[4] + bottom[4] + (s1 + s3) * excess_bar
    sin_psi_bar = plane[2] + top[5] + bottom[5]
    strength_bar = top[6] + bottom[6] - excess_bar
    lame_bar, shear_bar = plane[3] + top[7] + bottom[7], plane[4] + top[8] + bottom[8]
    limit_bar, alike = zero, zero
    elastic = ti.select(excess > 0.0, zero, ti.select(open_, zero, zero + 1.0))
    if ti.static(features.cohesive):
        c1, c2, c3 = ti.select(open_, b1, zero), ti.select(open_, b2, zero), ti.select(open_, b3, zero)
        crack = cutoff_reverse(c2, c3, s1, s2, s3, sin_phi, strength, limit, lame, shear)
        s1_bar, s2_bar, s3_bar = s1_bar + crack[0], s2_bar + crack[1], s3_bar + crack[2]
        sin_phi_bar, strength_bar = sin_phi_bar + crack[3], strength_bar + crack[4]
        limit_bar = c1 + crack[5]
        lame_bar, shear_bar = lame_bar + crack[6], shear_bar + crack[7]
        alike = ti.select(open_, crack[8], zero)
    return (
        s1_bar,
        s2_bar,
        s3_bar,
        sin_phi_bar,
        sin_psi_bar,
        strength_bar,
        limit_bar,
        lame_bar,
        shear_bar,
        elastic,
        alike,
    )


@ti.func
def opening_reverse(bar, opened, d1, d2, d3, sin_psi, lame, shear, dilates: ti.template()):
    """Bars of the changes d = s - t of the principal stresses and of (sin psi, lambda, mu) from that of what opened.

    opened: as `mpm.physics.mohr_coulomb.return_principal` gives it; at 0 it depends on nothing.
    """
    zero = 0.0 * bar
    live = ti.select(opened > 0.0, bar, zero)
    third = live / 3.0
    if ti.static(dilates):
        bulk3 = 3.0 * lame + 2.0 * shear
        total = d1 + d2 + d3
        share = lame / bulk3 * total
        shorter = maximum(share - d1, 0.0) + maximum(share - d2, 0.0) + maximum(share - d3, 0.0)
        per_cone = 1.0 / (shear * (1.0 - sin_psi))
        each = 0.0 - live * bulk3 * sin_psi * per_cone / 3.0
        m1 = ti.select(share > d1, each, zero)
        m2 = ti.select(share > d2, each, zero)
        m3 = ti.select(share > d3, each, zero)
        share_bar = m1 + m2 + m3
        common = third + share_bar * lame / bulk3
        turning = 2.0 * total * share_bar / (bulk3 * bulk3)
        factor = live * shorter * per_cone
        return (
            common - m1,
            common - m2,
            common - m3,
            0.0 - factor * bulk3 / (3.0 * (1.0 - sin_psi)),
            shear * turning - factor * sin_psi,
            factor * sin_psi * lame / shear - lame * turning,
        )
    else:
        return third, third, third, zero, zero, zero


@ti.func
def softened_reverse(
    bar: ti.template(), strain, per_strain, peak: ti.template(), residual: ti.template(), features: ti.template()
):
    """Bars of `strain`, of `per_strain`, of the four numbers of `peak` and the three of `residual`, from those of what

    `mpm.physics.mohr_coulomb.softened` makes of them.
    """
    zero = 0.0 * bar[0]
    rest = 1.0 - per_strain * strain
    w = maximum(rest, 0.0)
    sin_phi_bar, sin_psi_bar, strength_bar, limit_bar = bar[0], bar[1], zero, zero
    if ti.static(features.cohesive):
        sin_phi = residual[0] + w * (peak[0] - residual[0])
        strength = residual[1] + w * (peak[2] - residual[1])
        cutoff = residual[2] + w * (peak[3] - residual[2])
        per_apex = 1.0 / maximum(2.0 * sin_phi, TINY)
        at_apex = ti.select(cutoff < strength * per_apex, zero, bar[3])
        limit_bar = bar[3] - at_apex
        strength_bar = bar[2] + at_apex * per_apex
        sin_phi_bar = sin_phi_bar - at_apex * 2.0 * strength * per_apex * per_apex
    w_bar = sin_phi_bar * (peak[0] - residual[0]) + sin_psi_bar * peak[1]
    w_bar = w_bar + strength_bar * (peak[2] - residual[1]) + limit_bar * (peak[3] - residual[2])
    w_bar = ti.select(rest > 0.0, w_bar, zero)
    left = 1.0 - w
    return (
        0.0 - per_strain * w_bar,
        0.0 - strain * w_bar,
        w * sin_phi_bar,
        w * sin_psi_bar,
        w * strength_bar,
        w * limit_bar,
        left * sin_phi_bar,
        left * strength_bar,
        left * limit_bar,
    )
