"""The reverse of `mpm.physics.stress`: through the plastic return of the tensor, then through the elastic trial.

The return is an isotropic function of the trial stress: s_i, n_i its principal values and axes, t_i(s) the returned
ones. Its derivative in the axes of the trial stress is (Carlson & Hoger 1986; de Souza Neto, Peric & Owen 2008, app. A)

    d sigma_ii = sum_j dt_i/ds_j dS_jj,      d sigma_ij = theta_ij dS_ij,     theta_ij = (t_i - t_j) / (s_i - s_j)

and that of the bars is its transpose: the diagonal by `mpm.adjoint.mohr_coulomb`, the rest by the same theta. Where two
principal values meet, theta is its limit dt_i/ds_i - dt_i/ds_j: 1 where nothing yields and where both fell alike beside
a crack, 0 on an edge, at the apex and where both stand at the cutoff, since the return then keeps them equal. So every
derivative is finite, and at an edge, the apex or the cutoff it is that of the piece which the return takes.

The trial stress S = P + lambda tr(D) I + 2 mu D, P = R sigma R^T, has

    sigma' = R^T S' R,    omega' = 2 axial(P S'),    q' = k (omega' + omega' x q),    k = 2 / (1 + q . q)

since dR R^T is the spin omega = k (dq + q x dq) of Cayley's rotation with the vector q (Argyris 1982, eq. 48), and
axial(N) = (N_yz - N_zy, N_zx - N_xz, N_xy - N_yx). G' follows from D and q = axial(G^T) / 4, and A' from
G = A - A A / 2: A' = G' - (G' A^T + A^T G') / 2. A bar of xy is that of the number which stands for xy and yx.
"""

import taichi as ti

from mpm.adjoint.mohr_coulomb import opening_reverse, return_reverse
from mpm.adjoint.principal import principal_axes
from mpm.arrays.access import maximum, minimum
from mpm.physics.mohr_coulomb import return_principal
from mpm.physics.principal import TINY
from mpm.physics.stress import rotated


@ti.func
def divided(t, s, elastic, alike):
    """theta [-] from differences of returned and trial stresses; `elastic` and `alike` are one where it is 1."""
    theta = minimum(maximum(t / maximum(s, TINY), 0.0), 1.0)
    return ti.select(elastic + alike > 0.0, 0.0 * theta + 1.0, theta)


@ti.func
def strain_reverse(bar, g1, g2, g3, shear, features: ti.template()):
    """Bars of the changes g of the principal stresses and of mu from that of `mpm.physics.stress.equivalent_strain`.

    0 where nothing yields: there the strain has a corner, from which it grows in either direction.
    """
    zero = 0.0 * g1
    if ti.static(features.softens):
        mean = (g1 + g2 + g3) / 3.0
        d1, d2, d3 = g1 - mean, g2 - mean, g3 - mean
        length = ti.sqrt((d1 * d1 + d2 * d2 + d3 * d3) / 6.0)
        per = ti.select(length > TINY, bar / (6.0 * maximum(length, TINY) * shear), zero)
        return per * d1, per * d2, per * d3, 0.0 - bar * length / (shear * shear)
    else:
        return zero, zero, zero, zero


@ti.func
def changes_reverse(strain_bar, opened_bar, opened, g1, g2, g3, sin_psi, lame, shear, features: ti.template()):
    """Bars of the changes g = t - s and of (sin psi, lambda, mu) from those of plastic strain and of what opened."""
    e = strain_reverse(strain_bar, g1, g2, g3, shear, features)
    if ti.static(features.volume_correction):
        d1, d2, d3 = 0.0 - g1, 0.0 - g2, 0.0 - g3
        q = opening_reverse(opened_bar, opened, d1, d2, d3, sin_psi, lame, shear, features.dilates)
        return e[0] - q[0], e[1] - q[1], e[2] - q[2], q[3], q[4], e[3] + q[5]
    else:
        zero = 0.0 * g1
        return e[0], e[1], e[2], zero, zero, e[3]


@ti.func
def plastic_return_reverse(
    bar: ti.template(),
    stress: ti.template(),
    sin_phi,
    sin_psi,
    strength,
    limit,
    lame,
    shear,
    strain_bar,
    opened_bar,
    features: ti.template(),
):
    """Bars of the trial stress's components, then of (sin phi, sin psi, 2 c cos phi, T, lambda, mu).

    bar: of the returned components; stress: the trial's [Pa]; strain_bar: of the plastic strain after the step, read
    where the material softens; opened_bar: of what opened, read where `features.volume_correction`.
    """
    if ti.static(features.dimension == 2):
        xx, yy, z, xy = stress
        half = 0.5 * (xx - yy)
        centre = xx - half
        radius = ti.sqrt(half * half + xy * xy)
        per = 1.0 / maximum(radius, TINY)
        # Twice the angle of the first axis in the plane; any where the plane's stresses are equal.
        cosine, sine = ti.select(radius > TINY, half * per, 0.0 * half + 1.0), xy * per
        a, b = centre + radius, centre - radius
        above, below = z > a, z < b
        s1, s2, s3 = maximum(a, z), maximum(b, minimum(a, z)), minimum(b, z)
        t1, t2, t3, opened = return_principal(s1, s2, s3, sin_phi, sin_psi, strength, limit, lame, shear, features)
        top = ti.select(above, t2, t1)
        bottom = ti.select(below, t2, t3)
        difference = bar[0] - bar[1]
        along, turning = cosine * difference + sine * bar[3], cosine * bar[3] - sine * difference
        top_bar, bottom_bar = 0.5 * (bar[0] + bar[1] + along), 0.5 * (bar[0] + bar[1] - along)
        b1 = ti.select(above, bar[2], top_bar)
        b2 = ti.select(above, top_bar, ti.select(below, bottom_bar, bar[2]))
        b3 = ti.select(below, bar[2], bottom_bar)
        g1, g2, g3 = t1 - s1, t2 - s2, t3 - s3
        e = changes_reverse(strain_bar, opened_bar, opened, g1, g2, g3, sin_psi, lame, shear, features)
        b1, b2, b3 = b1 + e[0], b2 + e[1], b3 + e[2]
        r = return_reverse(b1, b2, b3, s1, s2, s3, sin_phi, sin_psi, strength, limit, lame, shear, features)
        g = r[0] - e[0], r[1] - e[1], r[2] - e[2], r[3], r[4] + e[3], r[5], r[6], r[7] + e[4], r[8] + e[5], r[9], r[10]
        a_bar = ti.select(above, g[1], g[0])
        z_bar = ti.select(above, g[0], ti.select(below, g[2], g[1]))
        b_bar = ti.select(below, g[1], g[2])
        theta = divided(top - bottom, a - b, g[9], ti.select(above, g[10], 0.0 * g[10]))
        apart = a_bar - b_bar
        half_bar = cosine * apart - sine * theta * turning
        xy_bar = sine * apart + cosine * theta * turning
        middle = 0.5 * (a_bar + b_bar)
        return middle + 0.5 * half_bar, middle - 0.5 * half_bar, z_bar, xy_bar, g[3], g[4], g[5], g[6], g[7], g[8]
    else:
        xx, yy, zz, xy, yz, zx = stress
        p = (xx + yy + zz) / 3.0
        a1, a2, a3, ux, uy, uz, vx, vy, vz, wx, wy, wz = principal_axes(
            xx - p, yy - p, zz - p, xy, yz, zx, features.precision
        )
        s1, s2, s3 = p + a1, p + a2, p + a3
        t1, t2, t3, opened = return_principal(s1, s2, s3, sin_phi, sin_psi, strength, limit, lame, shear, features)
        hxy, hyz, hzx = 0.5 * bar[3], 0.5 * bar[4], 0.5 * bar[5]
        # The bar times each axis, then in the axes.
        bux, buy, buz = (
            bar[0] * ux + hxy * uy + hzx * uz,
            hxy * ux + bar[1] * uy + hyz * uz,
            (hzx * ux + hyz * uy + bar[2] * uz),
        )
        bvx, bvy, bvz = (
            bar[0] * vx + hxy * vy + hzx * vz,
            hxy * vx + bar[1] * vy + hyz * vz,
            (hzx * vx + hyz * vy + bar[2] * vz),
        )
        bwx, bwy, bwz = (
            bar[0] * wx + hxy * wy + hzx * wz,
            hxy * wx + bar[1] * wy + hyz * wz,
            (hzx * wx + hyz * wy + bar[2] * wz),
        )
        b1, b2, b3 = ux * bux + uy * buy + uz * buz, vx * bvx + vy * bvy + vz * bvz, wx * bwx + wy * bwy + wz * bwz
        b12, b23 = ux * bvx + uy * bvy + uz * bvz, vx * bwx + vy * bwy + vz * bwz
        b13 = ux * bwx + uy * bwy + uz * bwz
        g1, g2, g3 = t1 - s1, t2 - s2, t3 - s3
        e = changes_reverse(strain_bar, opened_bar, opened, g1, g2, g3, sin_psi, lame, shear, features)
        b1, b2, b3 = b1 + e[0], b2 + e[1], b3 + e[2]
        r = return_reverse(b1, b2, b3, s1, s2, s3, sin_phi, sin_psi, strength, limit, lame, shear, features)
        g = r[0] - e[0], r[1] - e[1], r[2] - e[2], r[3], r[4] + e[3], r[5], r[6], r[7] + e[4], r[8] + e[5], r[9], r[10]
        zero = 0.0 * b1
        k12 = divided(t1 - t2, a1 - a2, g[9], zero) * b12
        k23 = divided(t2 - t3, a2 - a3, g[9], g[10]) * b23
        k13 = divided(t1 - t3, a1 - a3, g[9], zero) * b13
        # Back: the rows of the turned bar times the axes.
        ax, ay, az = g[0] * ux + k12 * vx + k13 * wx, g[0] * uy + k12 * vy + k13 * wy, g[0] * uz + k12 * vz + k13 * wz
        cx, cy, cz = k12 * ux + g[1] * vx + k23 * wx, k12 * uy + g[1] * vy + k23 * wy, k12 * uz + g[1] * vz + k23 * wz
        ex, ey, ez = k13 * ux + k23 * vx + g[2] * wx, k13 * uy + k23 * vy + g[2] * wy, k13 * uz + k23 * vz + g[2] * wz
        return (
            ux * ax + vx * cx + wx * ex,
            uy * ay + vy * cy + wy * ey,
            uz * az + vz * cz + wz * ez,
            2.0 * (ux * ay + vx * cy + wx * ey),
            2.0 * (uy * az + vy * cz + wy * ez),
            2.0 * (uz * ax + vz * cx + wz * ex),
            g[3],
            g[4],
            g[5],
            g[6],
            g[7],
            g[8],
        )


@ti.func
def trial_stress_reverse(
    bar: ti.template(), stress: ti.template(), gradient: ti.template(), lame, shear, d: ti.template()
):
    """Bars of the stress before, of the increment G row by row, and of (lambda, mu), from that of the trial stress."""
    if ti.static(d == 2):
        xx, yy, _, xy = stress
        gxx, gxy, gyx, gyy = gradient
        q = 0.25 * (gyx - gxy)
        per = 1.0 / (1.0 + q * q)
        sine, cosine = 2.0 * q * per, (1.0 - q * q) * per
        sine2, cosine2 = 2.0 * sine * cosine, (cosine - sine) * (cosine + sine)
        half = 0.5 * (xx - yy)
        half_bar = bar[0] - bar[1]
        # d/d(angle) of the turned (half, xy) is (-2 xy, 2 half) of the turned ones.
        angle_bar = 2.0 * (bar[3] * (cosine2 * half - sine2 * xy) - half_bar * (sine2 * half + cosine2 * xy))
        q_bar = 2.0 * per * angle_bar
        turned = cosine2 * half_bar + sine2 * bar[3]
        mean = 0.5 * (bar[0] + bar[1])
        trace = bar[0] + bar[1] + bar[2]
        sheared = shear * bar[3]
        return (
            mean + 0.5 * turned,
            mean - 0.5 * turned,
            bar[2],
            cosine2 * bar[3] - sine2 * half_bar,
            lame * trace + 2.0 * shear * bar[0],
            sheared - 0.25 * q_bar,
            sheared + 0.25 * q_bar,
            lame * trace + 2.0 * shear * bar[1],
            (gxx + gyy) * trace,
            2.0 * (gxx * bar[0] + gyy * bar[1]) + (gxy + gyx) * bar[3],
        )
    else:
        gxx, gxy, gxz, gyx, gyy, gyz, gzx, gzy, gzz = gradient
        qx, qy, qz = 0.25 * (gzy - gyz), 0.25 * (gxz - gzx), 0.25 * (gyx - gxy)
        pxx, pyy, pzz, pxy, pyz, pzx = rotated(stress, qx, qy, qz)
        txy, tyz, tzx = 0.5 * bar[3], 0.5 * bar[4], 0.5 * bar[5]
        # N = P S', whose axial vector is what the turned stress makes of a spin.
        nxy, nyx = pxx * txy + pxy * bar[1] + pzx * tyz, pxy * bar[0] + pyy * txy + pyz * tzx
        nyz, nzy = pxy * tzx + pyy * tyz + pyz * bar[2], pzx * txy + pyz * bar[1] + pzz * tyz
        nzx, nxz = pzx * bar[0] + pyz * txy + pzz * tzx, pxx * tzx + pxy * tyz + pzx * bar[2]
        ox, oy, oz = 2.0 * (nyz - nzy), 2.0 * (nzx - nxz), 2.0 * (nxy - nyx)
        k = 2.0 / (1.0 + (qx * qx + qy * qy + qz * qz))
        q_bar_x, q_bar_y, q_bar_z = (
            0.25 * k * (ox + oy * qz - oz * qy),
            0.25 * k * (oy + oz * qx - ox * qz),
            0.25 * k * (oz + ox * qy - oy * qx),
        )
        # R^T S' R is S' turned back; `rotated` takes the halves of the bars of shear, being components.
        rxx, ryy, rzz, rxy, ryz, rzx = rotated((bar[0], bar[1], bar[2], txy, tyz, tzx), 0.0 - qx, 0.0 - qy, 0.0 - qz)
        trace = bar[0] + bar[1] + bar[2]
        volumetric = lame * trace
        return (
            rxx,
            ryy,
            rzz,
            2.0 * rxy,
            2.0 * ryz,
            2.0 * rzx,
            volumetric + 2.0 * shear * bar[0],
            shear * bar[3] - q_bar_z,
            shear * bar[5] + q_bar_y,
            shear * bar[3] + q_bar_z,
            volumetric + 2.0 * shear * bar[1],
            shear * bar[4] - q_bar_x,
            shear * bar[5] - q_bar_y,
            shear * bar[4] + q_bar_x,
            volumetric + 2.0 * shear * bar[2],
            (gxx + gyy + gzz) * trace,
            2.0 * (gxx * bar[0] + gyy * bar[1] + gzz * bar[2])
            + (gxy + gyx) * bar[3]
            + (gyz + gzy) * bar[4]
            + (gzx + gxz) * bar[5],
        )


@ti.func
def midpoint_increment_reverse(bar: ti.template(), a: ti.template(), dimension: ti.template()):
    """Bar of A, row by row, from that of G = A - A A / 2."""
    return [
        bar[i] - 0.5 * transposed_products(bar, a, ti.static(i // dimension), ti.static(i % dimension), dimension)
        for i in ti.static(range(dimension * dimension))
    ]


@ti.func
def transposed_products(bar: ti.template(), a: ti.template(), i: ti.template(), j: ti.template(), d: ti.template()):
    """(G' A^T + A^T G')_ij of matrices given row by row."""
    value = bar[i * d] * a[j * d] + a[i] * bar[j]
    for k in ti.static(range(1, d)):
        value = value + bar[i * d + k] * a[j * d + k] + a[k * d + i] * bar[k * d + j]
    return value
