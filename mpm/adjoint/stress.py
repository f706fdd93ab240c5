"""The reverse of a block's stress step (`mpm.physics.particles.update_stress`).

All but the turn into principal axes is traced (`mpm.adjoint.pullback`). The return is an isotropic function of the
trial stress: s_i, n_i its principal values and axes, t_i(s) the returned ones. Its derivative in the axes of the trial
stress is (Carlson & Hoger 1986; de Souza Neto, Peric & Owen 2008, app. A)

    d sigma_ii = sum_j dt_i/ds_j dS_jj,      d sigma_ij = theta_ij dS_ij,     theta_ij = (t_i - t_j) / (s_i - s_j)

and that of the bars is its transpose: the diagonal by tracing t(s), the rest by the same theta. Where two principal
values meet, theta is its limit dt_i/ds_i - dt_i/ds_j: 1 where nothing yields and where both fell alike beside a crack,
0 on an edge, at the apex and where both stand at the cutoff, since the return then keeps them equal. So every
derivative is finite, and at an edge, the apex or the cutoff it is that of the piece which the return takes.

A bar of xy is that of the number which stands for xy and yx. The step carries its return to the tensor without axes
(`mpm.physics.stress`); here principal stresses that are equal or close must leave the axes undetermined but
orthonormal: Jacobi's rotations give such axes to rounding whatever the stress (Golub & Van Loan 2013, section 8.5).
"""

import taichi as ti

from mpm.adjoint.contact import grid_motion, jump_reverse, slip_reverse, touched
from mpm.adjoint.layout import add_bars, add_property_bar, contact_bar
from mpm.adjoint.pullback import Pullback, traceable
from mpm.adjoint.transfer import gather_moments
from mpm.arrays.access import TINY, lane_sum, magnitude, maximum, minimum, no_overflow, vectors
from mpm.arrays.layout import Offset, Property, Setting, component
from mpm.physics.contact import contact_of, jump_at_contact, with_jump
from mpm.physics.particles import law_values, strengths_of
from mpm.physics.stress import equivalent_strain, midpoint_increment, strain_between, trial_stress, with_cracks
from mpm.physics.transfer import property_of
from mpm.physics.volume_correction import LEAST, grid_gap, updated_gap

SWEEPS = {"f32": 4, "f64": 6}
"""Sweeps of three rotations: what is left off the diagonal falls at least with its square."""


def trial_of(strained, moduli, opening, limits, box, dt, features):
    """Trial stress [Pa] of a block, traced: after the strain of C and of contact, with the cracks that gaps leave.

    strained: stress, C, jump of velocity at contact and contact; opening: gap, rate at which it follows the grid's,
    mass of the grid around, place and density; box: cell and cells along each axis.
    """
    opened = None
    if features.volume_correction:
        gap, rate, mass, x, density = opening
        around = grid_gap(mass, x, strained[3], density, box, features)
        opened = updated_gap(gap[0], limits[0], moduli[0] + moduli[1] * (2.0 / 3.0), rate, around)
    cracked = with_cracks(strained[0], opened, limits, *moduli, features)
    return trial_stress(cracked, increment_of(strained, dt, features), *moduli, features.dimension)


def increment_of(strained, dt, features):
    """Strain and rotation [-] of a step of a block, traced: of C and of contact."""
    _, affine, jump, contact = strained
    increment = midpoint_increment([dt * each for each in affine], features.dimension)
    return with_jump(increment, jump, contact, features.dimension) if features.contact else increment


def strain_of(strained, moduli, new, dt, features):
    """Plastic strain [-] of a block where cracks count as strain (`mpm.physics.stress.stress_step`); traced."""
    bare = trial_stress(strained[0], increment_of(strained, dt, features), *moduli, features.dimension)
    return [strain_between(bare, new, moduli[1], features.stresses)]


def principal_return(s1, s2, s3, strengths, lame, shear, return_principal, features):
    """Returned principal stresses [Pa] and, where a step keeps them, plastic strain [-] and opening [Pa]; traced."""
    t1, t2, t3, opened = return_principal(s1, s2, s3, strengths, lame, shear, features)
    strain = equivalent_strain(t1 - s1, t2 - s2, t3 - s3, shear) if features.softens else None
    return t1, t2, t3, strain, opened if features.volume_correction else None


@ti.func
def stress_reverse(worker, table, scene, block, scratch, after, dt, arrays: ti.template()):
    """Bars of the stress before the step, of C after it and of the properties, from that of the stress after it.

    With volume correction also of the grid's mass and its slopes, in their place in `scratch`.
    """
    features, layout = arrays.features, arrays.layout
    size = ti.static(features.dimension)
    corrected = ti.static(int(features.volume_correction))
    first, own = no_overflow(block * features.state.size), block * layout.width
    lame, shear = property_of(scene, block, Property.LAME, arrays), property_of(scene, block, Property.SHEAR, arrays)
    strengths = strengths_of(scene, block, dt, arrays)
    limits = [strengths[3] for _ in ti.static(range(corrected))]
    stress = vectors(arrays.state, first + features.state.stress, features.stresses)
    affine = vectors(arrays.history, after + features.state.affine, size * size)
    contact = contact_of(block, arrays)
    touching, zero = False, 0.0 * stress[0]
    jump, slip_shear_bar, modulus, modulus_bar = zero, zero, lame + 2.0 * shear, zero
    if ti.static(features.contact):
        touching = touched(block, after, scene, arrays)
        for k in ti.static(range(size)):
            arrays.scratch[scratch + layout.scratch.foot + k] = zero
        if touching:
            gather_moments(table, scene, block, scratch, arrays)
            jump = jump_at_contact((grid_motion(scratch, arrays), affine, contact), stress, modulus, dt, size)
            slip_shear_bar = slip_reverse(worker, scene, block, scratch, after, shear, dt, arrays)
    gap = [arrays.state[first + features.state.gap] for _ in ti.static(range(corrected))]
    around = vectors(arrays.scratch, scratch + features.scratch.density, corrected * (1 + size))
    x = vectors(arrays.history, after, size)
    cells = [arrays.offsets[scene, Offset.CELLS_X + k] for k in ti.static(range(size))]
    rate, dx = dt * arrays.settings[scene, Setting.GAP_RATE], arrays.settings[scene, Setting.CELL]
    density = property_of(scene, block, Property.DENSITY, arrays)
    strained, moduli = ti.static(((stress, affine, jump, contact), (lame, shear)))
    numbers = ti.static((strained, moduli, (gap, rate, around, x, density), limits))
    elastic = ti.static([Pullback(trial_of, numbers, ((dx, cells), dt, features))])[0]
    strain_bar, opened_bar = zero, zero
    if ti.static(features.softens):
        strain_bar = arrays.adjoints[own + features.state.plastic_strain]
    if ti.static(features.volume_correction):
        remembered = arrays.history[after + features.state.gap] > LEAST * (lame + shear * (2.0 / 3.0))
        opened_bar = arrays.settings[scene, Setting.CORRECTED] * arrays.adjoints[own + features.state.gap]
        opened_bar = ti.select(remembered, opened_bar, zero)
    new = vectors(arrays.history, after + features.state.stress, features.stresses)
    cracked_bar, cracked_moduli_bar, new_bar = crack_reverse((strained, moduli, new), strain_bar, dt, features)
    if ti.static(features.cracks):
        strain_bar = zero
    bar = [arrays.adjoints[own + features.state.stress + k] + new_bar[k] for k in ti.static(range(features.stresses))]
    others = [strain_bar, opened_bar]
    trial_bar, strengths_bar, returned_bar = plastic_return_reverse(
        bar + others, elastic.values, strengths, lame, shear, features
    )
    strained_bar, moduli_bar, opening_bar, limits_bar = ti.static(elastic(trial_bar))
    stress_bar, affine_bar, jump_bar, contacts_bar = ti.static(strained_bar)
    old_bar, spun_bar, jumped_bar, touched_bar = ti.static(cracked_bar)
    for k in ti.static(range(features.stresses)):
        arrays.adjoints[own + features.state.stress + k] = stress_bar[k] + old_bar[k]
    add_bars(own + features.state.affine, affine_bar, arrays)
    add_bars(own + features.state.affine, spun_bar, arrays)
    if ti.static(features.contact):
        add_bars(contact_bar(block, 0, arrays), contacts_bar, arrays)
        add_bars(contact_bar(block, 0, arrays), touched_bar, arrays)
        if touching:
            moved = affine, contact, stress
            modulus_bar = jump_reverse(block, scratch, moved, modulus, dt, jump_bar + jumped_bar, arrays)
    if ti.static(features.volume_correction):
        gap_bar, rate_bar, around_bar, x_bar, density_bar = ti.static(opening_bar)
        arrays.adjoints[own + features.state.gap] = gap_bar[0]
        add_bars(own, x_bar, arrays)
        for k in ti.static(range(1 + size)):
            arrays.scratch[scratch + features.scratch.density + k] = around_bar[k]
        rate_total = lane_sum(arrays.state[first + features.state.present] * rate_bar, arrays)
        arrays.sums[worker, ti.static(int(Setting.GAP_RATE))] += ti.cast(dt, ti.f64) * rate_total
        add_property_bar(block, Property.DENSITY, density_bar, arrays)
    both = [returned_bar[k] + moduli_bar[k] + cracked_moduli_bar[k] for k in ti.static(range(2))]
    add_property_bar(block, Property.LAME, both[0] + modulus_bar, arrays)
    add_property_bar(block, Property.SHEAR, both[1] + slip_shear_bar + 2.0 * modulus_bar, arrays)
    if ti.static(features.volume_correction):
        strengths_bar[3] = strengths_bar[3] + limits_bar[0]
    strengths_reverse(scene, block, strengths_bar, dt, arrays)


@ti.func
def crack_reverse(arguments: ti.template(), strain_bar, dt, features: ti.template()):
    """Bars of the `arguments` of `strain_of`, shaped as these, from that of the plastic strain; 0 without cracks."""
    if ti.static(features.cracks):
        strain = ti.static([Pullback(strain_of, arguments, (dt, features))])[0]
        strained, moduli, new = ti.static(strain([strain_bar]))
        return strained, moduli, new
    else:
        none = 0.0 * strain_bar
        stress = [none for _ in ti.static(range(len(arguments[0][0])))]
        affine = [none for _ in ti.static(range(len(arguments[0][1])))]
        contact = [none for _ in ti.static(range(len(arguments[0][3])))]
        return (stress, affine, none, contact), (none, none), stress


@ti.func
def strengths_reverse(scene, block, bar: ti.template(), dt, arrays: ti.template()):
    """Bars of the columns of a block's law, and of its plastic strain, from those of its strengths."""
    features = arrays.features
    values, cell = law_values(scene, block, arrays), arrays.settings[scene, Setting.CELL]
    softened = block * features.state.size + features.state.plastic_strain
    strain = vectors(arrays.state, softened, int(features.softens))
    found = ti.static([Pullback(features.law.strengths, (values, strain), (cell, dt, features))])[0]
    bars = ti.static(found(bar))
    if ti.static(features.softens):
        add_bars(block * arrays.layout.width + features.state.plastic_strain, bars[1], arrays)
    for column in ti.static(features.law.columns(features)):
        add_property_bar(block, column, bars[0][ti.static(column - len(Property))], arrays)


@ti.func
def plastic_return_reverse(
    bar: ti.template(), trial: ti.template(), strengths: ti.template(), lame, shear, features: ti.template()
):
    """Bars of the trial stress, of the `strengths` of its law and of (lambda, mu), a list each.

    bar: of what `mpm.physics.stress.plastic_return` gives: stress, plastic strain and what opened.
    """
    strain_bar, opened_bar = bar[features.stresses], bar[features.stresses + 1]
    if ti.static(hasattr(features.law, "return_tensor")):
        whole = ti.static([Pullback(features.law.return_tensor, (trial, strengths, lame, shear), (features,))])[0]
        found = ti.static(whole(bar))
        return found[0], found[1], [found[2], found[3]]
    elif ti.static(features.dimension == 2):
        xx, yy, z, xy = trial
        half = 0.5 * (xx - yy)
        centre = xx - half
        radius = ti.sqrt(half * half + xy * xy)
        per = 1.0 / maximum(radius, TINY)
        # Twice the angle of the first axis in the plane; any where the plane's stresses are equal.
        cosine, sine = ti.select(radius > TINY, half * per, 0.0 * half + 1.0), xy * per
        a, b = centre + radius, centre - radius
        above, below = z > a, z < b
        s = [maximum(a, z), maximum(b, minimum(a, z)), minimum(b, z)]
        numbers = ti.static((s[0], s[1], s[2], strengths, lame, shear))
        step = ti.static([Pullback(principal_return, numbers, (traceable(features.law.return_principal), features))])[0]
        t = ti.static(step.values)
        top, bottom = ti.select(above, t[1], t[0]), ti.select(below, t[1], t[2])
        difference = bar[0] - bar[1]
        along, turning = cosine * difference + sine * bar[3], cosine * bar[3] - sine * difference
        top_bar, bottom_bar = 0.5 * (bar[0] + bar[1] + along), 0.5 * (bar[0] + bar[1] - along)
        b1 = ti.select(above, bar[2], top_bar)
        b2 = ti.select(above, top_bar, ti.select(below, bottom_bar, bar[2]))
        b3 = ti.select(below, bar[2], bottom_bar)
        g = ti.static(step([b1, b2, b3, strain_bar, opened_bar]))
        a_bar = ti.select(above, g[1], g[0])
        z_bar = ti.select(above, g[0], ti.select(below, g[2], g[1]))
        b_bar = ti.select(below, g[1], g[2])
        alike = above & features.law.fell_alike(s, t, strengths, lame, shear, features)
        free = features.law.elastic_at(s, strengths, features) | alike
        apart, turned_bar = a_bar - b_bar, theta(top - bottom, a - b, free) * turning
        half_bar, middle = cosine * apart - sine * turned_bar, 0.5 * (a_bar + b_bar)
        trial_bar = [middle + 0.5 * half_bar, middle - 0.5 * half_bar, z_bar, sine * apart + cosine * turned_bar]
        return trial_bar, g[3], [g[4], g[5]]
    else:
        p = (trial[0] + trial[1] + trial[2]) / 3.0
        deviator = [trial[0] - p, trial[1] - p, trial[2] - p, trial[3], trial[4], trial[5]]
        a, axes = principal_axes(deviator, features.precision)
        s = [p + a[0], p + a[1], p + a[2]]
        numbers = ti.static((s[0], s[1], s[2], strengths, lame, shear))
        step = ti.static([Pullback(principal_return, numbers, (traceable(features.law.return_principal), features))])[0]
        t = ti.static(step.values)
        own = in_axes([bar[0], bar[1], bar[2], 0.5 * bar[3], 0.5 * bar[4], 0.5 * bar[5]], axes)
        g = ti.static(step([own[0], own[1], own[2], strain_bar, opened_bar]))
        elastic = features.law.elastic_at(s, strengths, features)
        alike = elastic | features.law.fell_alike(s, t, strengths, lame, shear, features)
        k12 = theta(t[0] - t[1], a[0] - a[1], elastic) * own[3]
        k23 = theta(t[1] - t[2], a[1] - a[2], alike) * own[4]
        k31 = theta(t[0] - t[2], a[0] - a[2], elastic) * own[5]
        back = in_axes([g[0], g[1], g[2], k12, k23, k31], [axes[3 * (k % 3) + k // 3] for k in ti.static(range(9))])
        trial_bar = [back[0], back[1], back[2], 2.0 * back[3], 2.0 * back[4], 2.0 * back[5]]
        return trial_bar, g[3], [g[4], g[5]]


@ti.func
def theta(t, s, free):
    """theta [-] from differences of returned and trial stresses; 1 where the axes of both turn freely."""
    quotient = minimum(maximum(t / maximum(s, TINY), 0.0), 1.0)
    return ti.select(free, 0.0 * quotient + 1.0, quotient)


@ti.func
def in_axes(m: ti.template(), axes: ti.template()):
    """A M A^T of a symmetric M as xx, yy, zz, xy, yz, zx; the rows of A are `axes`, three after three."""
    am = [
        axes[3 * (k // 3)] * m[ti.static(component(0, k % 3, 3))]
        + axes[3 * (k // 3) + 1] * m[ti.static(component(1, k % 3, 3))]
        + axes[3 * (k // 3) + 2] * m[ti.static(component(2, k % 3, 3))]
        for k in ti.static(range(9))
    ]
    return [
        am[3 * i] * axes[3 * j] + am[3 * i + 1] * axes[3 * j + 1] + am[3 * i + 2] * axes[3 * j + 2]
        for i, j in ti.static(((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (2, 0)))
    ]


@ti.func
def principal_axes(m: ti.template(), precision: ti.template()):
    """Principal values s1 >= s2 >= s3 of xx, yy, zz, xy, yz, zx, and the components of the axes, three after three."""
    zero = 0.0 * m[0]
    value = [m[k] + zero for k in ti.static(range(3))]
    # Across the axis k.
    off = [m[4] + zero, m[5] + zero, m[3] + zero]
    axes = [zero + ti.static(float(k % 4 == 0)) for k in ti.static(range(9))]
    for _ in range(ti.static(SWEEPS[precision])):
        for p, q in ti.static(((0, 1), (1, 2), (0, 2))):
            r = ti.static(3 - p - q)
            cosine, sine, tangent = rotation(value[p], value[q], off[r])
            value[p], value[q] = value[p] - tangent * off[r], value[q] + tangent * off[r]
            off[r] = zero
            off[q], off[p] = cosine * off[q] - sine * off[p], sine * off[q] + cosine * off[p]
            for k in ti.static(range(3)):
                u, v = axes[3 * p + k], axes[3 * q + k]
                axes[3 * p + k], axes[3 * q + k] = cosine * u - sine * v, sine * u + cosine * v
    # In descending order.
    for p in ti.static((0, 1, 0)):
        swap = value[p + 1] > value[p]
        high, low = ti.select(swap, value[p + 1], value[p]), ti.select(swap, value[p], value[p + 1])
        value[p], value[p + 1] = high, low
        for k in ti.static(range(3 * p, 3 * p + 3)):
            u, v = axes[k], axes[k + 3]
            axes[k], axes[k + 3] = ti.select(swap, v, u), ti.select(swap, u, v)
    return value, axes


@ti.func
def rotation(app, aqq, apq):
    """(cosine, sine, tangent) of the rotation that makes the element pq of a symmetric matrix 0."""
    d, h = aqq - app, 2.0 * apq
    tangent = h / maximum(magnitude(d) + ti.sqrt(d * d + h * h), TINY)
    tangent = ti.select(d < 0.0, 0.0 - tangent, tangent)
    cosine = 1.0 / ti.sqrt(1.0 + tangent * tangent)
    return cosine, tangent * cosine, tangent
