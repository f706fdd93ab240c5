"""The reverse of `mpm.physics.volume_correction` and of the stress that opened cracks would add.

With r the density of the grid over that of the particle as there, e_s = max(0, 2 (1 - r) / (1 + r)) and h = 1 - 2 |o|,

    r' = -4 e_s' / (1 + r)^2,    M' = r' r / M,    h' = -r' r / h,    |o|' = -2 h',    o' = |o|' o / |o|

with M = sum_i w_ip m_i; where a wall or a solid hides mass its distance has a bar, too. The gap K e before the step has

    (K e)' = (K e)_new' / (1 + dt / T_g),    e_s' = (K e)_new' K (dt / T_g) / (1 + dt / T_g)

where it follows the grid, else that of the gap after the step.

Cracks add lambda e I + 2 mu e N(P), P = T I - sigma (`mpm.physics.stress.with_cracks`). N is one of three functions of
P, and its bar goes through the one that the step took: (cof P)' = N' / P2 with P2' = -N' : cof P / P2^2 for one crack,
P' = -N' / (2 P1) with P1' = N' : P / (2 P1^2) for two, none for three.
"""

import taichi as ti

from mpm.adjoint.contact import add_contact_bar
from mpm.arrays.access import lane_sum, maximum
from mpm.arrays.layout import Contact, Offset, Property, Setting
from mpm.arrays.properties import GAP_CUTOFF
from mpm.physics.contact import present as present_in
from mpm.physics.principal import TINY
from mpm.physics.transfer import property_of
from mpm.physics.volume_correction import DEEPEST, grid_gap


@ti.func
def gap_reverse(bar, opened, limit, bulk, x: ti.template(), worker, scene, block, scratch, dt, arrays: ti.template()):
    """Bars of the gap K e before the step and of K from that of `mpm.physics.volume_correction.updated_gap`.

    Leaves the bars of the grid's mass and its slopes in their place in `scratch`; adds those of positions, of the
    contact, of the density and of the rate 1 / T_g.
    """
    rate, present = dt * arrays.settings[scene, Setting.GAP_RATE], present_in(block, arrays)
    follows = (opened > 0.0) & (limit <= 0.0)
    gap = grid_gap(x, scene, block, scratch, arrays)
    part = ti.select(follows, bar / (1.0 + rate), 0.0 * bar)
    followed = (opened + rate * bulk * gap) / (1.0 + rate)
    rate_bar = lane_sum(present * part * (bulk * gap - followed), arrays)
    arrays.sums[worker, ti.static(int(Setting.GAP_RATE))] += ti.cast(dt, ti.f64) * rate_bar
    grid_gap_reverse(ti.select(gap > 0.0, part * rate * bulk, 0.0 * bar), x, scene, block, scratch, present, arrays)
    return ti.select(follows, part, bar), part * rate * gap


@ti.func
def grid_gap_reverse(bar, x: ti.template(), scene, block, scratch, present, arrays: ti.template()):
    """Bars of all that `mpm.physics.volume_correction.grid_gap` depends on, from that of a gap above 0."""
    features, layout = arrays.features, arrays.layout
    size = ti.static(features.dimension)
    dx = arrays.settings[scene, Setting.CELL]
    density = property_of(scene, block, Property.DENSITY, arrays)
    mass = maximum(arrays.scratch[scratch + features.density], TINY)
    zero = 0.0 * mass
    full = density * dx**features.dimension + zero
    near, across, raw = zero, zero, zero
    n = [zero for _ in ti.static(range(size))]
    slope = [arrays.scratch[scratch + features.density + 1 + k] for k in ti.static(range(size))]
    if ti.static(features.contact):
        at = block * features.block + features.contacts
        near = maximum(1.0 - arrays.state[at + Contact.DISTANCE] / (GAP_CUTOFF * dx), 0.0)
        full = full * (1.0 - 0.5 * near * near)
        for k in ti.static(range(size)):
            n[k] = arrays.state[at + Contact.NORMAL + k]
            raw = raw + slope[k] * n[k]
        across = ti.select(near > 0.0, maximum(raw, 0.0), zero)
    inside = [slope[k] - across * n[k] for k in ti.static(range(size))]
    low, high = [zero for _ in ti.static(range(size))], [zero for _ in ti.static(range(size))]
    square = zero
    for k in ti.static(range(size)):
        x_cells = x[k] / (GAP_CUTOFF * dx)
        length = arrays.offsets[scene, Offset.CELLS_X + k] / GAP_CUTOFF
        low[k], high[k] = maximum(1.0 - x_cells, 0.0), maximum(1.0 - length + x_cells, 0.0)
        full = full * (1.0 - 0.5 * (low[k] * low[k] + high[k] * high[k]))
        behind = ((inside[k] > 0.0) & (low[k] > 0.0)) | ((inside[k] < 0.0) & (high[k] > 0.0))
        inside[k] = ti.select(behind, zero, inside[k])
        square = square + inside[k] * inside[k]
    root = ti.sqrt(square)
    inwards = 0.25 * dx * root / mass
    share = maximum(1.0 - 2.0 * inwards, DEEPEST)
    packed = mass / (full * share)
    packed_bar = (0.0 - 4.0) * bar / ((1.0 + packed) * (1.0 + packed))
    full_bar = 0.0 - packed_bar * packed
    inwards_bar = ti.select(share > DEEPEST, 2.0 * packed_bar * packed / share, zero)
    mass_bar = (packed_bar * packed - inwards_bar * inwards) / mass
    arrays.scratch[scratch + features.density] = mass_bar
    per_root = inwards_bar * 0.25 * dx / (mass * maximum(root, TINY))
    inside_bar = [per_root * inside[k] for k in ti.static(range(size))]
    across_bar = zero
    for k in ti.static(range(size)):
        across_bar = across_bar - inside_bar[k] * n[k]
        # Of the logarithm of `full`, axis by axis.
        full_share_bar = full_bar / (1.0 - 0.5 * (low[k] * low[k] + high[k] * high[k]))
        moved = full_share_bar * (low[k] - high[k]) / (GAP_CUTOFF * dx)
        own = block * layout.width + k
        arrays.adjoints[own] = arrays.adjoints[own] + moved
    across_bar = ti.select((near > 0.0) & (raw > 0.0), across_bar, zero)
    for k in ti.static(range(size)):
        arrays.scratch[scratch + features.density + 1 + k] = inside_bar[k] + across_bar * n[k]
        if ti.static(features.contact):
            add_contact_bar(block, Contact.NORMAL + k, across_bar * slope[k] - across * inside_bar[k], arrays)
    if ti.static(features.contact):
        full_share_bar = 0.0 - full_bar * near / (1.0 - 0.5 * near * near)
        distance_bar = ti.select(near > 0.0, 0.0 - full_share_bar / (GAP_CUTOFF * dx), zero)
        add_contact_bar(block, Contact.DISTANCE, distance_bar, arrays)
    at = block * layout.width + layout.properties + ti.static(int(Property.DENSITY))
    arrays.adjoints[at] = arrays.adjoints[at] + present * full_bar / density


@ti.func
def cracks_reverse(bar: ti.template(), stress: ti.template(), opened, limit, lame, shear, features: ti.template()):
    """Bars of the stress's components, then of (K e, T, lambda, mu), from those of `with_cracks`'s components."""
    zero = 0.0 * bar[0]
    if ti.static(features.cohesive):
        xx, yy, zz = limit - stress[0], limit - stress[1], limit - stress[2]
        xy, yz, zx = 0.0 - stress[3], zero, zero
        bxy, byz, bzx = bar[3], zero, zero
        if ti.static(features.dimension == 3):
            yz, zx = 0.0 - stress[4], 0.0 - stress[5]
            byz, bzx = bar[4], bar[5]
        first = xx + yy + zz
        cxx, cyy, czz = yy * zz - yz * yz, zz * xx - zx * zx, xx * yy - xy * xy
        cxy, cyz, czx = yz * zx - xy * zz, zx * xy - yz * xx, xy * yz - zx * yy
        second = cxx + cyy + czz
        tolerance = 1.0e-4 * opened
        two, three_vectors = second <= tolerance * first, first <= tolerance
        per_bulk = 1.0 / (3.0 * lame + 2.0 * shear)
        along = 6.0 * shear * per_bulk * opened
        per_first, per_second = 1.0 / maximum(first, TINY), 1.0 / maximum(second, TINY)
        trace = bar[0] + bar[1] + bar[2]
        # N' : P and N' : cof P, where a bar of shear is that of both its components.
        by_p = bar[0] * xx + bar[1] * yy + bar[2] * zz + bxy * xy + byz * yz + bzx * zx
        by_cofactors = bar[0] * cxx + bar[1] * cyy + bar[2] * czz + bxy * cxy + byz * cyz + bzx * czx
        direct = ti.select(
            three_vectors, trace / 3.0, ti.select(two, 0.5 * (trace - by_p * per_first), by_cofactors * per_second)
        )
        # Two cracks.
        scale = 0.5 * along * per_first
        spread = scale * by_p * per_first
        # One.
        scale_one = along * per_second
        spread_one = scale_one * by_cofactors * per_second
        txx, tyy, tzz = (
            scale_one * bar[0] - spread_one,
            scale_one * bar[1] - spread_one,
            scale_one * bar[2] - spread_one,
        )
        txy, tyz, tzx = scale_one * bxy, scale_one * byz, scale_one * bzx
        pxx, pyy = tyy * zz + tzz * yy - tyz * yz, txx * zz + tzz * xx - tzx * zx
        pzz = txx * yy + tyy * xx - txy * xy
        pxy = tyz * zx + tzx * yz - txy * zz - 2.0 * tzz * xy
        pyz = txy * zx + tzx * xy - tyz * xx - 2.0 * txx * yz
        pzx = txy * yz + tyz * xy - tzx * yy - 2.0 * tyy * zx
        pxx = ti.select(three_vectors, zero, ti.select(two, spread - scale * bar[0], pxx))
        pyy = ti.select(three_vectors, zero, ti.select(two, spread - scale * bar[1], pyy))
        pzz = ti.select(three_vectors, zero, ti.select(two, spread - scale * bar[2], pzz))
        pxy = ti.select(three_vectors, zero, ti.select(two, 0.0 - scale * bxy, pxy))
        pyz = ti.select(three_vectors, zero, ti.select(two, 0.0 - scale * byz, pyz))
        pzx = ti.select(three_vectors, zero, ti.select(two, 0.0 - scale * bzx, pzx))
        opened_bar = (3.0 * lame * trace + 6.0 * shear * direct) * per_bulk
        # d(lambda / B) = (2 mu dlambda - 2 lambda dmu) / B^2 with B = 3 lambda + 2 mu, and 2 mu / B = 1 - 3 lambda / B.
        turning = 6.0 * opened * per_bulk * per_bulk * (trace - 3.0 * direct)
        limit_bar, lame_bar, shear_bar = pxx + pyy + pzz, shear * turning, 0.0 - lame * turning
        rxx, ryy, rzz, rxy = bar[0] - pxx, bar[1] - pyy, bar[2] - pzz, bar[3] - pxy
        if ti.static(features.dimension == 2):
            return rxx, ryy, rzz, rxy, opened_bar, limit_bar, lame_bar, shear_bar
        else:
            return rxx, ryy, rzz, rxy, bar[4] - pyz, bar[5] - pzx, opened_bar, limit_bar, lame_bar, shear_bar
    else:
        opened_bar = bar[0] + bar[1] + bar[2]
        if ti.static(features.dimension == 2):
            return bar[0], bar[1], bar[2], bar[3], opened_bar, zero, zero, zero
        else:
            return bar[0], bar[1], bar[2], bar[3], bar[4], bar[5], opened_bar, zero, zero, zero
