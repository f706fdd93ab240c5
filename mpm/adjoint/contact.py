"""The reverse of `mpm.physics.contact`: of the traction of solids, its friction, and the places of faces.

Backwards from what a step leaves: the contact that is found at the new position (delta, d, n, the turned q), the
particle kept out of the solid, the bound on q, q itself, the strain of contact, and last the force on the nodes.
Where contact is found follows in `mpm.adjoint.faces`. The bound has a bar of rho, and of g / xi of the nearest solid.

**Impulses.** What contact takes of the flow's momentum in a step is added to the impulse I of its solid, whose bar I'
is that of all later frames together. It joins the bars of the force on the nodes and of velocities before a surface:

    I += -dt V0 delta t     so   t' -= dt V0 delta I',                (delta, V0)' likewise
    I += m (v - v_after)    so   v' += m I',  v_after' -= m I',       m' += I' . (v - v_after)
"""

import taichi as ti

from mpm.adjoint.boundary import after_contact_reverse
from mpm.adjoint.faces import add_face, depends, found_reverse, terrain_reverse
from mpm.adjoint.layout import add_bars, add_property_bar, contact_bar, impulse_bar
from mpm.adjoint.pullback import Pullback
from mpm.arrays.access import TINY, lane_numbers, maximum, put_lane_numbers, vectors
from mpm.arrays.layout import Contact, Offset, Property, Worker
from mpm.physics.boundary import after_contact
from mpm.physics.contact import (
    contact_at,
    contact_of,
    drag_share,
    find_drags,
    holds_of_node,
    jump_at_contact,
    present,
    removed_by,
    sheared_traction,
    surface_force,
    touches,
    turbulence_at,
)
from mpm.physics.grid import relaxation_factor
from mpm.physics.transfer import property_of
from mpm.solids.face_lookup import entry_of, face_number, list_of, normal_of, solid_of


@ti.func
def touched(block, after, scene, arrays: ti.template()):
    """Whether a particle of a block depends on a solid before a step or after it."""
    result = touches(block, arrays)
    for lane in ti.static(range(arrays.features.lanes)):
        result = result or depends(after * arrays.features.lanes + lane, scene, arrays)
    return result


@ti.func
def solids_reverse(bar, v, mass, node, worker, scene, arrays: ti.template()):
    """Bars of a node's velocity `v` before `mpm.physics.contact.apply_solids`, shape [D], and of its mass.

    bar: of the velocity after it; node: its index, [D]. Adds the bars of the holds and of their faces' normals.
    """
    features = arrays.features
    v_bar, mass_bar, entry = bar, 0.0 * mass, entry_of(node, scene, arrays)
    first, end = holds_of_node(entry, arrays)
    for hold in range(first, end):
        face, removed = removed_by(hold, v, scene, arrays)
        normal = normal_of(face, scene, arrays)
        if v.dot(normal) < 0.0:
            friction, share = arrays.holds[hold, 1], arrays.holds[hold, 2]
            removed_bar = 0.0 - bar
            if ti.static(arrays.layout.impulses):
                momentum_bar = impulse_bar(solid_of(face, scene, arrays), worker, arrays)
                mass_bar += momentum_bar.dot(removed)
                removed_bar = removed_bar + mass * momentum_bar
            left_bar = (0.0 - share) * removed_bar
            through_bar, normal_bar, friction_bar = after_contact_reverse(left_bar, v, normal, friction)
            v_bar = v_bar + through_bar - left_bar
            for k in ti.static(range(features.dimension)):
                add_face(face, features.face.normal + k, normal_bar[k], scene, arrays)
            arrays.hold_adjoints[hold, 1] += ti.cast(friction_bar, ti.f64)
            whole = removed_bar.dot(v - after_contact(v, normal, friction))
            arrays.hold_adjoints[hold, 2] += ti.cast(whole, ti.f64)
    if ti.static(features.terrain):
        _, listed = list_of(entry, arrays)
        if listed == 0:
            removed_bar, momentum_bar = 0.0 - bar, 0.0 * bar
            if ti.static(arrays.layout.impulses):
                momentum_bar = impulse_bar(arrays.offsets[scene, Offset.TERRAIN_SOLID], worker, arrays)
                removed_bar = removed_bar + mass * momentum_bar
            through_bar, removed = terrain_reverse(removed_bar, v, node, scene, arrays)
            v_bar = v_bar + through_bar
            mass_bar += momentum_bar.dot(removed)
    return v_bar, mass_bar


@ti.func
def push_reverse(
    worker, block, scratch, stress: ti.template(), pushed_bar: ti.template(), volume, dt, arrays: ti.template()
):
    """Bars of the contact, the stress and the volume of a block from those of its `surface_force`."""
    features, layout, lanes = arrays.features, arrays.layout, arrays.features.lanes
    size = ti.static(features.dimension)
    if touches(block, arrays):
        pushed = ti.static([Pullback(surface_force, (stress, contact_of(block, arrays)), (size,))])[0]
        bar = [pushed_bar[k] for k in ti.static(range(2 * size))]
        if ti.static(layout.impulses):
            # The bar of the impulse of the solid next to each particle.
            face = contact_at(block, Contact.FACE, arrays)
            for lane in range(lanes):
                scene = arrays.workers[worker, Worker.SCENE]
                solid = solid_of(face_number(arrays.lanes[face * lanes + lane]), scene, arrays)
                at = (scratch + layout.scratch.before) * lanes + lane
                put_lane_numbers(arrays.scratch_lanes, at, impulse_bar(solid, worker, arrays), arrays)
            for i in ti.static(range(size)):
                given = dt * present(block, arrays) * arrays.scratch[scratch + layout.scratch.before + i]
                bar[i] = bar[i] - volume * given
                add_property_bar(block, Property.VOLUME, 0.0 - given * pushed.values[i], arrays)
        stress_bar, contacts_bar = ti.static(pushed(bar))
        add_bars(block * layout.width + features.state.stress, stress_bar, arrays)
        add_bars(contact_bar(block, 0, arrays), contacts_bar, arrays)


@ti.func
def grid_motion(scratch, arrays: ti.template()):
    """The grid's velocity at each particle of a block, from the first sums of `scratch`; D of them."""
    return vectors(arrays.scratch, scratch + arrays.layout.scratch.sums, arrays.features.dimension)


@ti.func
def slip_reverse(worker, scene, block, scratch, after, shear, dt, arrays: ti.template()):
    """From the bars of what a step leaves of contact to those of its stress, of C and of the contact before it.

    Those of the grid's velocity come in `scratch` from `layout.scratch.foot`, with turbulence those of the grid's mass
    and distances in place of `drag` and `layer`. Returns that of the shear modulus.
    """
    features, layout = arrays.features, arrays.layout
    size = ti.static(features.dimension)
    own = block * layout.width
    stress = vectors(arrays.history, after + features.state.stress, features.stresses)
    affine = vectors(arrays.history, after + features.state.affine, size * size)
    if ti.static(features.turbulent):
        find_drags(scene, block, scratch, arrays.history_lanes, after * features.lanes, arrays)
        around = maximum(arrays.scratch[scratch + layout.scratch.sums + size], TINY)
        distance = arrays.scratch[scratch + layout.scratch.sums + features.node.distance]
        arrays.scratch[scratch + features.scratch.layer] = distance / around
    turbulence = turbulence_at(scratch, property_of(scene, block, Property.DENSITY, arrays), arrays)
    motion = grid_motion(scratch, arrays), affine, contact_of(block, arrays)
    numbers = ti.static((motion, stress, shear, turbulence))
    sheared = ti.static([Pullback(sheared_traction, numbers, (dt, size))])[0]
    before = scratch + layout.scratch.before
    for k in ti.static(range(size)):
        arrays.scratch[before + size + k] = sheared.values[k]
        velocity = arrays.state[block * features.state.size + features.state.velocity + k]
        kept = relaxation_factor(scene, dt, arrays) * velocity
        arrays.scratch[before + k] = kept + arrays.scratch[scratch + layout.scratch.sums + features.node.change + k]
    mass = ti.static(int(Contact.FREE))
    volume = property_of(scene, block, Property.VOLUME, arrays)
    density = property_of(scene, block, Property.DENSITY, arrays)
    if ti.static(layout.impulses):
        arrays.state[contact_at(block, mass, arrays)] = volume * density * present(block, arrays)
    found_reverse(worker, block, scratch, after, True, scene, arrays)
    if ti.static(layout.impulses):
        mass_bar = arrays.adjoints[contact_bar(block, mass, arrays)]
        add_property_bar(block, Property.VOLUME, density * mass_bar, arrays)
        add_property_bar(block, Property.DENSITY, volume * mass_bar, arrays)
        arrays.adjoints[contact_bar(block, mass, arrays)] = 0.0 * mass_bar
    shear_at = contact_bar(block, Contact.NORMAL + size, arrays)
    q_bar = vectors(arrays.adjoints, shear_at, size)
    for k in ti.static(range(size)):
        arrays.adjoints[shear_at + k] = 0.0 * q_bar[k]
    motion_bar, stress_bar, shear_bar, turbulence_bar = ti.static(sheared(q_bar))
    if ti.static(features.turbulent):
        add_property_bar(block, Property.DENSITY, turbulence_bar[0], arrays)
        add_drag_bars(scene, block, scratch, after, turbulence_bar[1], arrays)
        # Of the sums of mass and distance that particles see: D is their quotient.
        around = maximum(arrays.scratch[scratch + layout.scratch.sums + size], TINY)
        distance_bar = turbulence_bar[2] / around
        arrays.scratch[scratch + features.scratch.drag] = 0.0 - turbulence[2] * distance_bar
        arrays.scratch[scratch + features.scratch.layer] = distance_bar
    for k in ti.static(range(size)):
        arrays.scratch[scratch + layout.scratch.foot + k] = motion_bar[0][k]
    add_bars(own + features.state.affine, motion_bar[1], arrays)
    add_bars(own + features.state.stress, stress_bar, arrays)
    add_bars(contact_bar(block, 0, arrays), motion_bar[2], arrays)
    return shear_bar


@ti.func
def add_drag_bars(scene, block, scratch, after, bar, arrays: ti.template()):
    """Add the bars of g / xi of the particles of a block to those of their solids and, where xi varies, of places."""
    features, lanes, own = arrays.features, arrays.features.lanes, block * arrays.layout.width
    contact, drag = contact_at(block, 0, arrays), scratch + features.scratch.drag
    arrays.scratch[drag] = present(block, arrays) * bar
    for lane in range(lanes):
        if arrays.lanes[(contact + Contact.DELTA) * lanes + lane] > 0.0:
            face = face_number(arrays.lanes[(contact + Contact.FACE) * lanes + lane])
            value = ti.cast(arrays.scratch_lanes[drag * lanes + lane], ti.f64)
            solid = solid_of(face, scene, arrays)
            x = lane_numbers(arrays.history_lanes, after * lanes + lane, arrays)
            share, along, across = drag_share(solid, x, scene, arrays)
            arrays.drag_adjoints[scene, solid] += ti.cast(share, ti.f64) * value
            if ti.static(features.dimension == 3):
                scaled = arrays.drags[scene, solid] * ti.cast(value, float)
                arrays.adjoint_lanes[own * lanes + lane] += scaled * along
                arrays.adjoint_lanes[(own + 2) * lanes + lane] += scaled * across


@ti.func
def jump_reverse(block, scratch, strained: ti.template(), modulus, dt, bar, arrays: ti.template()):
    """From the bar of `jump_at_contact` to those of the grid's velocity, in `scratch`, of C, contact and stress.

    strained: C, contact and stress. Returns the bar of the modulus.
    """
    features, layout = arrays.features, arrays.layout
    size = ti.static(features.dimension)
    affine, contact, stress = strained
    motion = grid_motion(scratch, arrays), affine, contact
    numbers = ti.static((motion, stress, modulus))
    jump = ti.static([Pullback(jump_at_contact, numbers, (dt, size))])[0]
    motion_bar, stress_bar, modulus_bar = ti.static(jump([bar]))
    for k in ti.static(range(size)):
        at = scratch + layout.scratch.foot + k
        arrays.scratch[at] = arrays.scratch[at] + motion_bar[0][k]
    add_bars(block * layout.width + features.state.affine, motion_bar[1], arrays)
    add_bars(block * layout.width + features.state.stress, stress_bar, arrays)
    add_bars(contact_bar(block, 0, arrays), motion_bar[2], arrays)
    return modulus_bar
