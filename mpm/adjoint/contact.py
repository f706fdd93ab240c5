"""The reverse of `mpm.physics.contact`: of the traction of solids, its friction, and the positions of faces.

It goes backwards from the end of a step: the contact found at the new position (delta, d, n, the turned q), the
particle kept out of the solid, the bound on q, q itself, the strain of contact, and last the force on the nodes.
`mpm.adjoint.faces` reverses the search for contact. The bound gives adjoints of rho and of the nearest solid's g / xi.

**Impulses.** The momentum that contact takes from the flow in a step is added to the impulse I of its solid, whose
adjoint I' is that of all later frames together. I' adds to the adjoints of the force on the nodes and of velocities
before a surface:

    I += -dt V0 delta t     so   t' -= dt V0 delta I',                (delta, V0)' likewise
    I += m (v - v_after)    so   v' += m I',  v_after' -= m I',       m' += I' . (v - v_after)
"""

import taichi as ti

from mpm.adjoint.faces import add_face, bed_hold_reverse, depends, found_reverse, hold_reverse
from mpm.adjoint.layout import add_adjoints, add_property_adjoint, adjoints_of, impulse_adjoint
from mpm.adjoint.pullback import Pullback
from mpm.arrays.access import lane_numbers, present, put_lane_numbers, vectors
from mpm.arrays.layout import Contact, Offset, Property, Setting
from mpm.physics.contact import (
    contact_at,
    contact_of,
    drag_share,
    find_drags,
    jump_at_contact,
    removed_by,
    removed_by_bed,
    sheared_traction,
    surface_force,
    touches,
    turbulence_at,
)
from mpm.physics.transfer import property_of
from mpm.solids.face_lookup import entry_of, face_number, holds_of_node, normal_of, solid_of
from mpm.solids.terrain import bed_under


@ti.func
def touched(block: ti.template(), arrays: ti.template()):
    """Whether a particle of a block depends on a solid before a step or after it."""
    result = touches(block.number, arrays)
    for lane in ti.static(range(arrays.features.lanes)):
        result = result or depends(block.after * arrays.features.lanes + lane, block.scene, arrays)
    return result


@ti.func
def solids_reverse(adj, v, mass, node, worker, scene, arrays: ti.template()):
    """Adjoints of a node's velocity `v` before `mpm.physics.contact.apply_solids`, shape [D], and of its mass.

    adj: of the velocity after it; node: its index, [D]. Adds the adjoints of the holds and of their faces' normals.
    """
    features = arrays.features
    adj_mass, entry = 0.0 * mass, entry_of(node, scene, arrays)
    first, end = holds_of_node(entry, arrays)
    adj_left = adj
    if ti.static(features.terrain):
        # The velocity after the listed faces.
        left = v
        for hold in range(first, end):
            left = left - removed_by(hold, v, arrays)[1]
        adj_removed = 0.0 - adj
        if ti.static(arrays.layout.impulses):
            adj_momentum = impulse_adjoint(arrays.offsets[scene, Offset.TERRAIN_SOLID], worker, arrays)
            adj_removed = adj_removed + mass * adj_momentum
            adj_mass += adj_momentum.dot(removed_by_bed(left, node, bed_under(node, scene, arrays), scene, arrays))
        adj_left = adj_left + bed_hold_reverse(adj_removed, left, node, scene, arrays)
    adj_v = adj_left
    for hold in range(first, end):
        face, removed = removed_by(hold, v, arrays)
        normal = normal_of(face, arrays)
        if v.dot(normal) < 0.0:
            adj_removed = 0.0 - adj_left
            if ti.static(arrays.layout.impulses):
                adj_momentum = impulse_adjoint(solid_of(face, scene, arrays), worker, arrays)
                adj_mass += adj_momentum.dot(removed)
                adj_removed = adj_removed + mass * adj_momentum
            friction, share = arrays.holds[hold, 1], arrays.holds[hold, 2]
            adj_own, adj_normal, adj_friction, adj_share = hold_reverse(adj_removed, v, normal, friction, share)
            adj_v = adj_v + adj_own
            for k in ti.static(range(features.dimension)):
                add_face(face, features.face.normal + k, adj_normal[k], arrays)
            arrays.hold_adjoints[hold, 1] += ti.cast(adj_friction, ti.f64)
            arrays.hold_adjoints[hold, 2] += ti.cast(adj_share, ti.f64)
    return adj_v, adj_mass


@ti.func
def push_reverse(block: ti.template(), stress: ti.template(), adj_pushed: ti.template(), volume, arrays: ti.template()):
    """Adjoints of the contact, the stress and the volume of a block from those of its `surface_force`."""
    features, layout, lanes = arrays.features, arrays.layout, arrays.features.lanes
    size = ti.static(features.dimension)
    if touches(block.number, arrays):
        pushed = ti.static([Pullback(surface_force, (stress, contact_of(block.number, arrays)), (size,))])[0]
        adj = [adj_pushed[k] for k in ti.static(range(2 * size))]
        if ti.static(layout.impulses):
            # The adjoint of the impulse of the solid next to each particle.
            face, before = contact_at(block.number, Contact.FACE, arrays), block.scratch + layout.scratch.before
            for lane in range(lanes):
                solid = solid_of(face_number(arrays.lanes[face * lanes + lane]), block.scene, arrays)
                adj_impulse = impulse_adjoint(solid, block.worker, arrays)
                put_lane_numbers(arrays.scratch_lanes, before * lanes + lane, adj_impulse, arrays)
            for i in ti.static(range(size)):
                given = block.dt * present(block.number, arrays) * arrays.scratch[before + i]
                adj[i] = adj[i] - volume * given
                add_property_adjoint(block, Property.VOLUME, 0.0 - given * pushed.values[i], arrays)
        adj_stress, adj_contact = ti.static(pushed(adj))
        add_adjoints(block, features.state.stress, adj_stress, arrays)
        add_adjoints(block, features.state.contacts, adj_contact, arrays)


@ti.func
def grid_motion(block: ti.template(), arrays: ti.template()):
    """The grid's velocity at each particle of a block, from the first sums of `scratch`; D of them."""
    return vectors(arrays.scratch, block.scratch + arrays.layout.scratch.sums, arrays.features.dimension)


@ti.func
def slip_reverse(block: ti.template(), shear, arrays: ti.template()):
    """From the adjoints of contact after a step to those of its stress, of C and of contact before the step.

    Those of the grid's velocity go to `scratch` from `layout.scratch.foot` on; with turbulence, those of the grid's
    mass and distances replace `layer`. Returns that of the shear modulus.
    """
    features, layout, scene = arrays.features, arrays.layout, block.scene
    size, contacts = ti.static(features.dimension, features.state.contacts)
    stress = vectors(arrays.history, block.after + features.state.stress, features.stresses)
    affine = vectors(arrays.history, block.after + features.state.affine, size * size)
    if ti.static(features.turbulent):
        find_drags(scene, block.number, block.scratch, arrays.history_lanes, block.after * features.lanes, arrays)
        for k, number in ti.static(enumerate((size, features.node.distance))):
            seen = arrays.scratch[block.scratch + layout.scratch.sums + number]
            arrays.scratch[block.scratch + features.scratch.layer + k] = seen
    volume = property_of(scene, block.number, Property.VOLUME, arrays)
    density = property_of(scene, block.number, Property.DENSITY, arrays)
    turbulence = turbulence_at(block.scratch, density, arrays)
    motion = grid_motion(block, arrays), affine, contact_of(block.number, arrays)
    numbers = ti.static((motion, stress, shear, turbulence))
    dx = arrays.settings[scene, Setting.CELL]
    sheared = ti.static([Pullback(sheared_traction, numbers, (block.dt, dx, size))])[0]
    before = block.scratch + layout.scratch.before
    for k in ti.static(range(size)):
        arrays.scratch[before + size + k] = sheared.values[k]
        kept = block.kappa * arrays.state[block.state + features.state.velocity + k]
        change = arrays.scratch[block.scratch + layout.scratch.sums + features.node.change + k]
        arrays.scratch[before + k] = kept + change
    mass_at = block.adj + contacts + Contact.FREE
    if ti.static(layout.impulses):
        arrays.state[contact_at(block.number, Contact.FREE, arrays)] = volume * density * present(block.number, arrays)
    found_reverse(block, True, arrays)
    if ti.static(layout.impulses):
        adj_mass = arrays.adjoints[mass_at]
        add_property_adjoint(block, Property.VOLUME, density * adj_mass, arrays)
        add_property_adjoint(block, Property.DENSITY, volume * adj_mass, arrays)
        arrays.adjoints[mass_at] = 0.0 * adj_mass
    adj_q = adjoints_of(block, contacts + Contact.NORMAL + size, size, arrays)
    for k in ti.static(range(size)):
        arrays.adjoints[block.adj + contacts + Contact.NORMAL + size + k] = 0.0 * adj_q[k]
    adj_motion, adj_stress, adj_shear, adj_turbulence = ti.static(sheared(adj_q))
    if ti.static(features.turbulent):
        add_property_adjoint(block, Property.DENSITY, adj_turbulence[0], arrays)
        add_drag_adjoints(block, adj_turbulence[1], arrays)
        for k in ti.static(range(2)):
            arrays.scratch[block.scratch + features.scratch.layer + k] = adj_turbulence[2 + k]
    add_motion(block, adj_motion, arrays)
    add_adjoints(block, features.state.stress, adj_stress, arrays)
    return adj_shear


@ti.func
def add_motion(block: ti.template(), adj: ti.template(), arrays: ti.template()):
    """Add the adjoints of the grid's velocity at a block, in `scratch`, of C and of contact."""
    features, foot = arrays.features, block.scratch + arrays.layout.scratch.foot
    for k in ti.static(range(features.dimension)):
        arrays.scratch[foot + k] = arrays.scratch[foot + k] + adj[0][k]
    add_adjoints(block, features.state.affine, adj[1], arrays)
    add_adjoints(block, features.state.contacts, adj[2], arrays)


@ti.func
def add_drag_adjoints(block: ti.template(), adj, arrays: ti.template()):
    """Add the adjoints of g / xi of a block's particles to those of their solids and, if xi varies, of positions."""
    features, lanes = arrays.features, arrays.features.lanes
    contact, drag = contact_at(block.number, 0, arrays), block.scratch + features.scratch.drag
    arrays.scratch[drag] = present(block.number, arrays) * adj
    for lane in range(lanes):
        if arrays.lanes[(contact + Contact.DELTA) * lanes + lane] > 0.0:
            face = face_number(arrays.lanes[(contact + Contact.FACE) * lanes + lane])
            value = ti.cast(arrays.scratch_lanes[drag * lanes + lane], ti.f64)
            solid = solid_of(face, block.scene, arrays)
            x = lane_numbers(arrays.history_lanes, block.after * lanes + lane, arrays)
            share, along, across = drag_share(solid, x, block.scene, arrays)
            arrays.drag_adjoints[block.scene, solid] += ti.cast(share, ti.f64) * value
            if ti.static(features.dimension == 3):
                scaled = arrays.drags[block.scene, solid] * ti.cast(value, float)
                arrays.adjoint_lanes[block.adj * lanes + lane] += scaled * along
                arrays.adjoint_lanes[(block.adj + 2) * lanes + lane] += scaled * across


@ti.func
def jump_reverse(block: ti.template(), strained: ti.template(), modulus, adj, arrays: ti.template()):
    """From the adjoint of `jump_at_contact` to those of the grid's velocity, in `scratch`, of C, contact and stress.

    strained: C, contact and stress. Returns the adjoint of the modulus.
    """
    size = ti.static(arrays.features.dimension)
    affine, contact, stress = strained
    numbers = ti.static(((grid_motion(block, arrays), affine, contact), stress, modulus))
    jump = ti.static([Pullback(jump_at_contact, numbers, (block.dt, size))])[0]
    adj_motion, adj_stress, adj_modulus = ti.static(jump([adj]))
    add_motion(block, adj_motion, arrays)
    add_adjoints(block, arrays.features.state.stress, adj_stress, arrays)
    return adj_modulus
