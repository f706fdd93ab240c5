"""The reverse of a block's stress step (`mpm.physics.particles.update_stress`).

All except the turn into principal axes is traced (`mpm.adjoint.pullback`). The return is an isotropic function of the
trial stress: s_i, n_i its principal values and axes, t_i(s) the returned ones. Its derivative in the axes of the trial
stress is (Carlson & Hoger 1986; de Souza Neto, Peric & Owen 2008, app. A)

    d sigma_ii = sum_j dt_i/ds_j dS_jj,      d sigma_ij = theta_ij dS_ij,     theta_ij = (t_i - t_j) / (s_i - s_j)

and the adjoints follow by its transpose: the diagonal by tracing t(s), the rest by the same theta. Where two principal
values coincide, theta is its limit dt_i/ds_i - dt_i/ds_j: 1 where nothing yields and where both fell alike beside a
crack, 0 on an edge, at the apex and where both are at the cutoff, since the return then keeps them equal. So every
derivative is finite, and at an edge, the apex or the cutoff it is that of the branch which the return takes.

An adjoint of xy belongs to the number that represents both xy and yx. The step applies its return without axes
(`mpm.physics.stress`). Here axes must be orthonormal even where equal or close principal stresses leave them
undetermined: Jacobi's rotations give such axes to rounding for any stress (Golub & Van Loan 2013, section 8.5).
"""

import taichi as ti

from mpm.adjoint.contact import grid_motion, jump_reverse, slip_reverse, touched
from mpm.adjoint.layout import add_adjoints, add_property_adjoint, add_setting_adjoint, adjoints_of
from mpm.adjoint.pullback import Pullback, traceable
from mpm.adjoint.transfer import gather_moments
from mpm.arrays.access import TINY, magnitude, maximum, minimum, vectors
from mpm.arrays.layout import Offset, Property, Setting, component
from mpm.physics.contact import contact_of, jump_at_contact, with_jump
from mpm.physics.particles import law_values
from mpm.physics.stress import equivalent_strain, midpoint_increment, strain_between, trial_stress, with_cracks
from mpm.physics.transfer import property_of
from mpm.physics.volume_correction import LEAST, grid_gap, updated_gap

SWEEPS = {"f32": 4, "f64": 6}  # sweeps of three rotations: off-diagonal elements decrease at least quadratically


def before_return(columns, strained, moduli, opening, box, dt, strengths_at, features):
    """Arguments of the plastic return of a block, traced: the trial stress [Pa] after the strain of C and of contact,
    with cracks from gaps, then the strengths of its law.

    columns: the values of the law's columns, and the plastic strain; strained: stress, C, velocity jump at contact and
    contact; opening: gap, rate at which it follows the grid's gap, mass of the grid around, position and density; box:
    cell, cells along each axis and T_0."""
    strengths = strengths_at(*columns, box[0], dt, features)
    opened, limits = None, []
    if features.volume_correction:
        gap, rate, mass, x, density = opening
        around = grid_gap(mass, x, strained[3], density, box[:2], features)
        limits = [strengths[3]]
        opened = updated_gap(gap[0], limits[0] - box[2], moduli[0] + moduli[1] * (2.0 / 3.0), rate, around)
    cracked = with_cracks(strained[0], opened, limits, *moduli, features)
    return trial_stress(cracked, increment_of(strained, dt, features), *moduli, features.dimension), strengths


def increment_of(strained, dt, features):
    """Strain and rotation [-] of a block in a step, from C and contact; traced."""
    _, affine, jump, contact = strained
    increment = midpoint_increment([dt * entry for entry in affine], features.dimension)
    return with_jump(increment, jump, contact, features.dimension) if features.contact else increment


def strain_of(strained, moduli, new, dt, features):
    """Plastic strain [-] of a block if cracks count as strain (`mpm.physics.stress.stress_step`); traced."""
    bare = trial_stress(strained[0], increment_of(strained, dt, features), *moduli, features.dimension)
    return [strain_between(bare, new, moduli[1], features.stresses)]


def principal_return(s1, s2, s3, strengths, lame, shear, return_principal, features):
    """Returned principal stresses [Pa] and, if a step keeps them, plastic strain [-] and opening [Pa]; traced."""
    t1, t2, t3, opened = return_principal(s1, s2, s3, strengths, lame, shear, features)
    strain = equivalent_strain(t1 - s1, t2 - s2, t3 - s3, shear) if features.softens else None
    return t1, t2, t3, strain, opened if features.volume_correction else None


@ti.func
def stress_reverse(block: ti.template(), arrays: ti.template()):
    """Adjoints of the stress before the step, of C after it and of the properties, from that of the stress after it.

    With volume correction, also those of the grid's mass and its slopes, in their place in `scratch`.
    """
    features, layout = arrays.features, arrays.layout
    scene, number, dt = block.scene, block.number, block.dt
    size = ti.static(features.dimension)
    corrected = ti.static(int(features.volume_correction))
    lame, shear = property_of(scene, number, Property.LAME, arrays), property_of(scene, number, Property.SHEAR, arrays)
    stress = vectors(arrays.state, block.state + features.state.stress, features.stresses)
    affine = vectors(arrays.history, block.after + features.state.affine, size * size)
    contact = contact_of(number, arrays)
    touching, zero = False, 0.0 * stress[0]
    jump, adj_slip_shear, modulus, adj_modulus = zero, zero, lame + 2.0 * shear, zero
    if ti.static(features.contact):
        touching = touched(block, arrays)
        for k in ti.static(range(size)):
            arrays.scratch[block.scratch + layout.scratch.foot + k] = zero
        if touching:
            gather_moments(block, arrays)
            jump = jump_at_contact((grid_motion(block, arrays), affine, contact), stress, modulus, dt, size)
            adj_slip_shear = slip_reverse(block, shear, arrays)
    gap = [arrays.state[block.state + features.state.gap] for _ in ti.static(range(corrected))]
    density_at = block.scratch + features.scratch.density
    around = vectors(arrays.scratch, density_at, corrected * (1 + size))
    x = vectors(arrays.history, block.after, size)
    cells = [arrays.offsets[scene, Offset.CELLS_X + k] for k in ti.static(range(size))]
    rate, dx = dt * arrays.settings[scene, Setting.GAP_RATE], arrays.settings[scene, Setting.CELL]
    density = property_of(scene, number, Property.DENSITY, arrays)
    strained, moduli = ti.static(((stress, affine, jump, contact), (lame, shear)))
    plastic = vectors(arrays.state, block.state + features.state.plastic_strain, int(features.softens))
    columns = law_values(scene, number, arrays)
    numbers = ti.static(((columns, plastic), strained, moduli, (gap, rate, around, x, density)))
    least = arrays.settings[scene, Setting.LEAST_TENSION]
    constants = ti.static(((dx, cells, least), dt, traceable(features.law.strengths), features))
    taken = ti.static([Pullback(before_return, numbers, constants)])[0]
    trial, strengths = ti.static(taken.values[: features.stresses], taken.values[features.stresses :])
    adj_strain, adj_opened = zero, zero
    if ti.static(features.softens):
        adj_strain = arrays.adjoints[block.adj + features.state.plastic_strain]
    if ti.static(features.volume_correction):
        remembered = arrays.history[block.after + features.state.gap] > LEAST * (lame + shear * (2.0 / 3.0))
        adj_opened = arrays.settings[scene, Setting.CORRECTED] * arrays.adjoints[block.adj + features.state.gap]
        adj_opened = ti.select(remembered, adj_opened, zero)
    new = vectors(arrays.history, block.after + features.state.stress, features.stresses)
    adj_cracked, adj_cracked_moduli, adj_new = crack_reverse((strained, moduli, new), adj_strain, dt, features)
    if ti.static(features.cracks):
        adj_strain = zero
    adj_after = adjoints_of(block, features.state.stress, features.stresses, arrays)
    adj_whole = [adj_after[k] + adj_new[k] for k in ti.static(range(features.stresses))]
    others = [adj_strain, adj_opened]
    adj = adj_whole + others
    adj_trial, adj_strengths, adj_returned = plastic_return_reverse(adj, trial, strengths, lame, shear, features)
    adj_columns, adj_strained, adj_moduli, adj_opening = ti.static(taken(adj_trial + adj_strengths))
    for k in ti.static(range(features.stresses)):
        arrays.adjoints[block.adj + features.state.stress + k] = zero
    add_strained(block, adj_strained, arrays)
    add_strained(block, adj_cracked, arrays)
    if ti.static(features.contact):
        if touching:
            moved = affine, contact, stress
            adj_modulus = jump_reverse(block, moved, modulus, adj_strained[2] + adj_cracked[2], arrays)
    if ti.static(features.volume_correction):
        adj_gap, adj_rate, adj_around, adj_x, adj_density = ti.static(adj_opening)
        arrays.adjoints[block.adj + features.state.gap] = adj_gap[0]
        add_adjoints(block, 0, adj_x, arrays)
        for k in ti.static(range(1 + size)):
            arrays.scratch[density_at + k] = adj_around[k]
        add_setting_adjoint(block, Setting.GAP_RATE, dt * adj_rate, arrays)
        add_property_adjoint(block, Property.DENSITY, adj_density, arrays)
    both = [adj_returned[k] + adj_moduli[k] + adj_cracked_moduli[k] for k in ti.static(range(2))]
    add_property_adjoint(block, Property.LAME, both[0] + adj_modulus, arrays)
    add_property_adjoint(block, Property.SHEAR, both[1] + adj_slip_shear + 2.0 * adj_modulus, arrays)
    add_adjoints(block, features.state.plastic_strain, adj_columns[1], arrays)
    for column in ti.static(features.law.columns(features)):
        add_property_adjoint(block, column, adj_columns[0][ti.static(column - len(Property))], arrays)


@ti.func
def add_strained(block: ti.template(), adj: ti.template(), arrays: ti.template()):
    """Add the adjoints of `strained` of `before_return`, except that of the jump."""
    state = arrays.features.state
    add_adjoints(block, state.stress, adj[0], arrays)
    add_adjoints(block, state.affine, adj[1], arrays)
    add_adjoints(block, state.contacts, adj[3], arrays)


@ti.func
def crack_reverse(arguments: ti.template(), adj_strain, dt, features: ti.template()):
    """Adjoints of the `arguments` of `strain_of`, shaped as these, from that of plastic strain; 0 without cracks."""
    if ti.static(features.cracks):
        strain = ti.static([Pullback(strain_of, arguments, (dt, features))])[0]
        strained, moduli, new = ti.static(strain([adj_strain]))
        return strained, moduli, new
    else:
        none = 0.0 * adj_strain
        stress = [none for _ in ti.static(range(len(arguments[0][0])))]
        affine = [none for _ in ti.static(range(len(arguments[0][1])))]
        contact = [none for _ in ti.static(range(len(arguments[0][3])))]
        return (stress, affine, none, contact), (none, none), stress


@ti.func
def plastic_return_reverse(
    adj: ti.template(), trial: ti.template(), strengths: ti.template(), lame, shear, features: ti.template()
):
    """Adjoints of the trial stress, of the `strengths` of its law and of (lambda, mu), a list each.

    adj: of what `mpm.physics.stress.plastic_return` gives: stress, plastic strain and opening.
    """
    adj_strain, adj_opened = adj[features.stresses], adj[features.stresses + 1]
    if ti.static(hasattr(features.law, "return_tensor")):
        whole = ti.static([Pullback(features.law.return_tensor, (trial, strengths, lame, shear), (features,))])[0]
        adjoints = ti.static(whole(adj))
        return adjoints[0], adjoints[1], [adjoints[2], adjoints[3]]
    else:
        p = (trial[0] + trial[1] + trial[2]) / 3.0
        # In 2D axes do not turn out of the plane.
        none = [0.0 * p for _ in ti.static(range(6 - features.stresses))]
        shears = [trial[k] for k in ti.static(range(3, features.stresses))]
        deviator = [trial[k] - p for k in ti.static(range(3))]
        a, axes = principal_axes(deviator + shears + none, features)
        s = [p + a[0], p + a[1], p + a[2]]
        numbers = ti.static((s[0], s[1], s[2], strengths, lame, shear))
        step = ti.static([Pullback(principal_return, numbers, (traceable(features.law.return_principal), features))])[0]
        t = ti.static(step.values)
        halves = [ti.static(1.0 if k < 3 else 0.5) * adj[k] for k in ti.static(range(features.stresses))]
        principal = in_axes(halves + none, axes)
        g = ti.static(step([principal[0], principal[1], principal[2], adj_strain, adj_opened]))
        elastic = features.law.elastic_at(s, strengths, features)
        alike = elastic | features.law.fell_alike(s, t, strengths, lame, shear, features)
        k12 = theta(t[0] - t[1], a[0] - a[1], elastic) * principal[3]
        k23 = theta(t[1] - t[2], a[1] - a[2], alike) * principal[4]
        k31 = theta(t[0] - t[2], a[0] - a[2], elastic) * principal[5]
        back = in_axes([g[0], g[1], g[2], k12, k23, k31], [axes[3 * (k % 3) + k // 3] for k in ti.static(range(9))])
        adj_trial = [ti.static(1.0 if k < 3 else 2.0) * back[k] for k in ti.static(range(features.stresses))]
        return adj_trial, g[3], [g[4], g[5]]


@ti.func
def theta(t, s, free):
    """theta [-] from differences of returned and trial stresses; 1 if the axes of both turn freely."""
    quotient = minimum(maximum(t / maximum(s, TINY), 0.0), 1.0)
    return ti.select(free, 0.0 * quotient + 1.0, quotient)


@ti.func
def in_axes(m: ti.template(), axes: ti.template()):
    """A M A^T of a symmetric M as xx, yy, zz, xy, yz, zx; the rows of A are `axes`, three by three."""
    am = [
        axes[3 * (k // 3)] * m[ti.static(component(0, k % 3))]
        + axes[3 * (k // 3) + 1] * m[ti.static(component(1, k % 3))]
        + axes[3 * (k // 3) + 2] * m[ti.static(component(2, k % 3))]
        for k in ti.static(range(9))
    ]
    return [
        am[3 * i] * axes[3 * j] + am[3 * i + 1] * axes[3 * j + 1] + am[3 * i + 2] * axes[3 * j + 2]
        for i, j in ti.static(((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (2, 0)))
    ]


@ti.func
def principal_axes(m: ti.template(), features: ti.template()):
    """Principal values s1 >= s2 >= s3 of six components and their axes, three by three; 2D needs one rotation."""
    zero = 0.0 * m[0]
    value = [m[k] + zero for k in ti.static(range(3))]
    # Element across axis k.
    off = [m[4] + zero, m[5] + zero, m[3] + zero]
    axes = [zero + ti.static(float(k % 4 == 0)) for k in ti.static(range(9))]
    for _ in range(ti.static(SWEEPS[features.precision] if features.dimension == 3 else 1)):
        for p, q in ti.static(((0, 1), (1, 2), (0, 2))[: 3 if features.dimension == 3 else 1]):
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
