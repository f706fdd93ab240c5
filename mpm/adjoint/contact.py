"""The reverse of `mpm.physics.contact`: of the traction of solids, its friction, and the places of faces.

Backwards from what a step leaves: the contact that is found at the new position (delta, d, n, the turned q), the
particle kept out of the solid, Coulomb's bound on q, q itself, the strain of contact, and last the force on the nodes.
Where contact is found follows in `mpm.adjoint.faces`.

**Impulses.** What contact takes of the flow's momentum in a step is added to the impulse I of its solid, whose bar I'
is that of all later frames together. It joins the bars of the force on the nodes and of velocities before a surface:

    I += -dt V0 delta t     so   t' -= dt V0 delta I',                (delta, V0)' likewise
    I += m (v - v_after)    so   v' += m I',  v_after' -= m I',       m' += I' . (v - v_after)
"""

import taichi as ti

from mpm.adjoint.boundary import after_contact_reverse
from mpm.adjoint.faces import depends, found_reverse
from mpm.arrays.access import maximum, minimum
from mpm.arrays.layout import Contact, Property, Setting, Worker, component
from mpm.physics.boundary import after_contact
from mpm.physics.contact import normal_stress, normals, present, shear_at, touches
from mpm.physics.grid import relaxation_factor
from mpm.physics.transfer import property_of
from mpm.solids.face_lookup import solid_of

TINY = 1.0e-20
"""Keeps quotients finite, as in the step."""


@ti.func
def contact_bar(block, column: ti.template(), arrays: ti.template()):
    """Index of the bar of the vector `column` of those that describe the contact of a block."""
    return block * arrays.layout.width + arrays.layout.contacts + column


@ti.func
def shear_bar(block, k: ti.template(), arrays: ti.template()):
    """Index of the bar of component k of the shear tractions of a block."""
    return contact_bar(block, Contact.NORMAL + arrays.features.dimension + k, arrays)


@ti.func
def touched(block, after, scene, arrays: ti.template()):
    """1 where a particle of a block depends on a solid before a step or after it, else 0."""
    result = 0
    if touches(block, arrays):
        result = 1
    for lane in ti.static(range(arrays.features.lanes)):
        if depends(after * arrays.features.lanes + lane, scene, arrays):
            result = 1
    return result


@ti.func
def solids_reverse(bar, v, mass, n, worker, arrays: ti.template()):
    """Bars of a node's velocity `v` before `mpm.physics.contact.apply_solids`, shape [D], and of its mass.

    bar: of the velocity after it; n: its entry in `fixed_nodes`. Adds the bars of the held node's normal and friction.
    """
    features = arrays.features
    line, mass_bar = arrays.fixed_nodes[n] - 1, 0.0 * mass
    if line >= 0:
        normal = ti.Vector([arrays.node_contacts[line, k] for k in ti.static(range(features.dimension))])
        if v.dot(normal) < 0.0:
            friction = arrays.node_contacts[line, features.dimension]
            momentum_bar = 0.0 * bar
            if ti.static(arrays.layout.impulses):
                solid = ti.cast(arrays.node_contacts[line, features.dimension + 1], ti.i32)
                momentum_bar = impulse_bar(solid, worker, arrays)
                mass_bar = momentum_bar.dot(v - after_contact(v, normal, friction))
            v_bar, normal_bar, friction_bar = after_contact_reverse(bar - mass * momentum_bar, v, normal, friction)
            bar = v_bar + mass * momentum_bar
            for k in ti.static(range(features.dimension)):
                arrays.node_contact_adjoints[line, k] += ti.cast(normal_bar[k], ti.f64)
            arrays.node_contact_adjoints[line, features.dimension] += ti.cast(friction_bar, ti.f64)
    return bar, mass_bar


@ti.func
def push_reverse(worker, scene, block, scratch, volume, unit, dt, arrays: ti.template()):
    """Bars of the contact and the stress of a block from those of its force on the nodes, gathered in `scratch`.

    unit: 4 / dx^2, times dt where forces are momentum at once; with `prepare_contact` in `scratch`. Returns the bar of
    the volume.
    """
    features, layout = arrays.features, arrays.layout
    size = ti.static(features.dimension)
    sums, force = scratch + layout.sums, ti.static(features.force if features.forces else 0)
    dx = arrays.settings[scene, Setting.CELL]
    volume_bar = 0.0 * arrays.scratch[sums]
    if touches(block, arrays):
        n = normals(block, arrays)
        delta = arrays.state[contact_of(block, Contact.DELTA, arrays)]
        distance = arrays.state[contact_of(block, Contact.DISTANCE, arrays)]
        adhesion = arrays.state[contact_of(block, Contact.ADHESION, arrays)]
        across = normal_stress(block, n, arrays)
        pull = minimum(across, adhesion)
        each = unit * dx * dx * 0.25
        delta_bar, distance_bar, pull_bar = 0.0 * delta, 0.0 * delta, 0.0 * delta
        n_bar = [0.0 * delta for _ in ti.static(range(size))]
        if ti.static(layout.impulses):
            gather_impulse_adjoints(block, scratch, worker, arrays)
        for i in ti.static(range(size)):
            push = arrays.scratch[scratch + features.push + i]
            push_bar = each * arrays.scratch[sums + force + i]
            if ti.static(layout.impulses):
                push_bar = push_bar - dt * present(block, arrays) * arrays.scratch[scratch + layout.before + i]
            for j in ti.static(range(size)):
                gathered = arrays.scratch[sums + (1 + j) * features.node + force + i]
                push_bar = push_bar - unit * gathered * distance * n[j]
                arm_bar = 0.0 - unit * volume * gathered * push
                distance_bar = distance_bar + arm_bar * n[j]
                n_bar[j] = n_bar[j] + arm_bar * distance
            volume_bar = volume_bar + push_bar * push
            push_bar = volume * push_bar
            q = arrays.state[shear_at(block, i, arrays)]
            arrays.adjoints[shear_bar(block, i, arrays)] = (
                arrays.adjoints[shear_bar(block, i, arrays)] + delta * push_bar
            )
            delta_bar = delta_bar + push_bar * (q - pull * n[i])
            pull_bar = pull_bar - delta * n[i] * push_bar
            n_bar[i] = n_bar[i] - delta * pull * push_bar
        pushed = ti.select(across < adhesion, pull_bar, 0.0 * pull_bar)
        add_normal_stress_bar(block, n, n_bar, pushed, arrays)
        add_contact_bar(block, Contact.DELTA, delta_bar, arrays)
        add_contact_bar(block, Contact.DISTANCE, distance_bar, arrays)
        add_contact_bar(block, Contact.ADHESION, pull_bar - pushed, arrays)
        for k in ti.static(range(size)):
            add_contact_bar(block, Contact.NORMAL + k, n_bar[k], arrays)
    return volume_bar


@ti.func
def impulse_bar(solid, worker, arrays: ti.template()):
    """The bar of the impulse of a solid, shape [D]."""
    features = arrays.features
    first = arrays.workers[worker, Worker.IMPULSE] + solid * features.dimension
    return ti.Vector([arrays.impulse_adjoints[first + k] for k in ti.static(range(features.dimension))])


@ti.func
def gather_impulse_adjoints(block, scratch, worker, arrays: ti.template()):
    """Leave in the scratch from `layout.before` the bar of the impulse of the solid next to each particle."""
    features, layout, lanes = arrays.features, arrays.layout, arrays.features.lanes
    face = contact_of(block, Contact.FACE, arrays)
    for lane in range(lanes):
        solid = solid_of(ti.cast(arrays.lanes[face * lanes + lane], ti.i32), arrays)
        bar = impulse_bar(solid, worker, arrays)
        for k in ti.static(range(features.dimension)):
            arrays.scratch_lanes[(scratch + layout.before + k) * lanes + lane] = bar[k]


@ti.func
def contact_of(block, column: ti.template(), arrays: ti.template()):
    """Index of the vector `column` of those that describe the contact of a block."""
    return block * arrays.features.block + arrays.features.contacts + column


@ti.func
def add_contact_bar(block, column: ti.template(), value, arrays: ti.template()):
    """Add to the bars of `column` of the contact of a block."""
    at = contact_bar(block, column, arrays)
    arrays.adjoints[at] = arrays.adjoints[at] + value


@ti.func
def add_normal_stress_bar(block, n: ti.template(), n_bar: ti.template(), bar, arrays: ti.template()):
    """Add the bars of the stress and of the normals `n` of a block from that of sigma_nn."""
    features = arrays.features
    size = ti.static(features.dimension)
    for i in ti.static(range(size)):
        for j in ti.static(range(size)):
            number = ti.static(component(i, j, size))
            stress = arrays.state[block * features.block + features.stress + number]
            at = block * arrays.layout.width + features.stress + number
            arrays.adjoints[at] = arrays.adjoints[at] + bar * n[i] * n[j]
            n_bar[i] = n_bar[i] + 2.0 * bar * stress * n[j]


@ti.func
def foot_motion(block, scratch, after, n: ti.template(), arrays: ti.template()):
    """v_f [m/s] of each particle of a block: the grid's, in the first sums of `scratch`, less d C n; D of them."""
    features, layout = arrays.features, arrays.layout
    size = ti.static(features.dimension)
    distance = arrays.state[contact_of(block, Contact.DISTANCE, arrays)]
    velocity = [arrays.scratch[scratch + layout.sums + i] for i in ti.static(range(size))]
    for i in ti.static(range(size)):
        for j in ti.static(range(size)):
            affine = arrays.history[after + ti.static(features.affine + i * size + j)]
            velocity[i] = velocity[i] - distance * affine * n[j]
    return velocity


@ti.func
def opening_of(velocity: ti.template(), n: ti.template()):
    """n . v_f [m/s]."""
    value = velocity[0] * n[0]
    for k in ti.static(range(1, len(velocity))):
        value = value + velocity[k] * n[k]
    return value


@ti.func
def slip_reverse(
    worker,
    scene,
    block,
    scratch,
    after,
    dt,
    shear,
    opening,
    n: ti.template(),
    n_bar: ti.template(),
    arrays: ti.template(),
):
    """From the bars of what a step leaves of contact to those of its stress and of v_f, which come in `scratch` from

    `layout.foot`; bars of the shear tractions before the step. Returns those of the opening and the shear modulus.
    """
    features, layout = arrays.features, arrays.layout
    size = ti.static(features.dimension)
    velocity = foot_motion(block, scratch, after, n, arrays)
    delta = arrays.state[contact_of(block, Contact.DELTA, arrays)]
    friction = arrays.state[contact_of(block, Contact.FRICTION, arrays)]
    new = after + features.stress
    across, square = 0.0 * delta, TINY + 0.0 * delta
    slip = [velocity[k] - opening * n[k] for k in ti.static(range(size))]
    q = [arrays.state[shear_at(block, k, arrays)] - dt * shear * delta * slip[k] for k in ti.static(range(size))]
    for i in ti.static(range(size)):
        square = square + q[i] * q[i]
        for j in ti.static(range(size)):
            across = across + n[i] * n[j] * arrays.history[new + ti.static(component(i, j, size))]
    length = ti.sqrt(square)
    bound = friction * maximum(0.0 - across, 0.0)
    scale = minimum(bound / length, 1.0)
    before = scratch + layout.before
    for k in ti.static(range(size)):
        arrays.scratch[before + size + k] = scale * q[k]
        v = arrays.scratch[scratch + layout.sums + k]
        if ti.static(features.relaxed):
            kept = relaxation_factor(scene, dt, arrays) * arrays.state[block * features.block + features.velocity + k]
            v = kept + arrays.scratch[scratch + layout.sums + features.change + k]
        arrays.scratch[before + k] = v
    if ti.static(layout.impulses):
        volume, density = (
            property_of(scene, block, Property.VOLUME, arrays),
            property_of(scene, block, Property.DENSITY, arrays),
        )
        mass = contact_of(block, Contact.IMPULSE, arrays)
        arrays.state[mass] = volume * density * present(block, arrays)
        found_reverse(worker, block, scratch, after, True, scene, arrays)
        mass_bar = arrays.adjoints[contact_bar(block, Contact.IMPULSE, arrays)]
        own = block * layout.width + layout.properties
        arrays.adjoints[own + Property.VOLUME] = arrays.adjoints[own + Property.VOLUME] + density * mass_bar
        arrays.adjoints[own + Property.DENSITY] = arrays.adjoints[own + Property.DENSITY] + volume * mass_bar
        arrays.adjoints[contact_bar(block, Contact.IMPULSE, arrays)] = 0.0 * mass_bar
    else:
        found_reverse(worker, block, scratch, after, True, scene, arrays)
    # Coulomb's bound, then the elastic shear traction.
    product = 0.0 * delta
    for k in ti.static(range(size)):
        product = product + q[k] * arrays.adjoints[shear_bar(block, k, arrays)]
    slides = bound < length
    bound_bar = ti.select(slides, product / length, 0.0 * product)
    along = ti.select(slides, bound * product / (length * square), 0.0 * product)
    add_contact_bar(block, Contact.FRICTION, bound_bar * maximum(0.0 - across, 0.0), arrays)
    across_bar = ti.select(across < 0.0, 0.0 - friction * bound_bar, 0.0 * bound_bar)
    delta_bar, shear_modulus_bar, opening_bar = 0.0 * delta, 0.0 * delta, 0.0 * delta
    for k in ti.static(range(size)):
        at = shear_bar(block, k, arrays)
        q_bar = scale * arrays.adjoints[at] - along * q[k]
        arrays.adjoints[at] = q_bar
        slip_bar = (0.0 - dt) * shear * delta * q_bar
        delta_bar = delta_bar - dt * shear * slip[k] * q_bar
        shear_modulus_bar = shear_modulus_bar - dt * delta * slip[k] * q_bar
        arrays.scratch[scratch + layout.foot + k] = slip_bar
        opening_bar = opening_bar - n[k] * slip_bar
        n_bar[k] = n_bar[k] - opening * slip_bar
    for i in ti.static(range(size)):
        for j in ti.static(range(size)):
            number = ti.static(component(i, j, size))
            at = block * layout.width + features.stress + number
            arrays.adjoints[at] = arrays.adjoints[at] + across_bar * n[i] * n[j]
            n_bar[i] = n_bar[i] + 2.0 * across_bar * arrays.history[new + number] * n[j]
    add_contact_bar(block, Contact.DELTA, delta_bar, arrays)
    return opening_bar, shear_modulus_bar


@ti.func
def jump_reverse(
    block,
    scratch,
    after,
    dt,
    jump,
    opening,
    opening_bar,
    increment_bar: ti.template(),
    n: ti.template(),
    n_bar: ti.template(),
    arrays: ti.template(),
):
    """From the bar of G to those of v_f, in `scratch`, of C and of contact: G holds `jump` n n^T."""
    features, layout = arrays.features, arrays.layout
    size = ti.static(features.dimension)
    velocity = foot_motion(block, scratch, after, n, arrays)
    delta = arrays.state[contact_of(block, Contact.DELTA, arrays)]
    distance = arrays.state[contact_of(block, Contact.DISTANCE, arrays)]
    adhesion = arrays.state[contact_of(block, Contact.ADHESION, arrays)]
    separated = (normal_stress(block, n, arrays) >= adhesion) & (opening > 0.0)
    jump_bar = 0.0 * delta
    for i in ti.static(range(size)):
        for j in ti.static(range(size)):
            bar = increment_bar[i * size + j]
            jump_bar = jump_bar + bar * n[i] * n[j]
            n_bar[i] = n_bar[i] + jump * (bar + increment_bar[j * size + i]) * n[j]
    jump_bar = ti.select(separated, 0.0 * jump_bar, jump_bar)
    opening_bar = opening_bar + dt * delta * jump_bar
    distance_bar = 0.0 * delta
    for i in ti.static(range(size)):
        at = scratch + layout.foot + i
        velocity_bar = arrays.scratch[at] + opening_bar * n[i]
        n_bar[i] = n_bar[i] + opening_bar * velocity[i]
        arrays.scratch[at] = velocity_bar
        for j in ti.static(range(size)):
            affine = arrays.history[after + ti.static(features.affine + i * size + j)]
            distance_bar = distance_bar - velocity_bar * affine * n[j]
            n_bar[j] = n_bar[j] - velocity_bar * affine * distance
            own = block * layout.width + ti.static(features.affine + i * size + j)
            arrays.adjoints[own] = arrays.adjoints[own] - velocity_bar * distance * n[j]
    add_contact_bar(block, Contact.DELTA, dt * opening * jump_bar, arrays)
    add_contact_bar(block, Contact.DISTANCE, distance_bar, arrays)
    for k in ti.static(range(size)):
        add_contact_bar(block, Contact.NORMAL + k, n_bar[k], arrays)
