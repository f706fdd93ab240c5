"""Contact with all solids except the walls of the box: baffles, ground, obstacles; their union has one surface.

The reasons are in docs/theory/contact.md. n is the normal out of the solid, d the distance of a particle from it, h one
cell (`mpm.arrays.properties.CONTACT_WIDTH`): with half a cell, particles close to a face are so stiff that a step of
0.9 is unstable.

**Kinematics.** The velocity jumps to zero at the surface; its gradient there, v n times a delta, strains the particle:

    L_p = C_p + delta_h(d_p) (n . v_f) n n^T,    v_f = sum_i w_ip v_i* - d_p C_p n
    delta_h(d) = (2 / h) (1 - 3 q^2 + 2 q^3),    q = d / h in [0, 1];    its integral over d is 1

Sand that leaves a surface, n . v_f > 0, is strained in a step by at most (-sigma_nn)_+ / M, with the constrained
modulus M = lambda + 2 mu: until it no longer presses on the surface. This is continuous in sigma_nn; with a switch at
the sign of sigma_nn, rounding would decide for particles that carry no stress.

**Forces.** The traction t = -sigma_nn n + q of the surface, whose normal part pushes and never pulls, does work on v_f.
By virtual power (Nitsche 1971; Peskin 2002, section 6) a particle contributes to a node

    f_ip = w_ip V0 [delta t - (4 / dx^2) (sigma + delta d t n^T) x_ip]

**Friction.** The shear traction q is elastic until it slips, dq/dt = -mu_s delta (v_f - n (n . v_f)) with the sand's
shear modulus mu_s, and is then scaled back to Coulomb's bound |q| <= mu (-sigma_nn) (Cundall & Strack 1979).

**Turbulence.** A solid with a coefficient xi [m/s^2] also brakes with the square of the speed (Voellmy 1955; Salm
1993). With the particle's density rho and v_t = v_f - n (n . v_f),

    |q| <= mu (-sigma_nn)_+ + rho g |v_t|^2 / (xi I),    I = 2 e (1 - 7/2 D^2 + 3 D^3),    D <= e / 2
    e = min(max(2 D, phi / SHEET, THINNEST), 1),    phi_p = sum_i w_ip m_i / (rho dx^dim)
    D_p = sum_i w_ip H_i / sum_i w_ip m_i,    H_i = sum_p w_ip m_p min(d_p / h, 1)

I is the integral of delta over a layer of e widths whose mean distance from the bed is D, so that a thin layer feels
the whole drag; phi is the filled share of the space around a particle, which is the integral of w^2, SHEET = 11/20, per
cell of thickness of a thin sheet. Below e = THINNEST the drag fades: a single grain on the bed has no thickness. The
drag acts on all particles within the width of the contact, whether or not they press at that moment. Deep nodes and
particles stopped at a face have only Coulomb friction, mu times the impulse: delta already gives the whole drag.

**Deep nodes.** A node deep in a solid is in the support of only the first row of particles, which cannot balance it. It
is held like a node behind a wall of the box (`mpm.physics.boundary`), partly by each face k that it lies behind: v <- v
- sum_k share_k (v - A_k v), with A_k v the velocity that face k admits (`mpm.solids.obstacles`).

**Position.** No particle passes a face: see `mpm.physics.contact_search`.
"""

import taichi as ti

from mpm.arrays.access import add, lane_numbers, maximum, minimum, over_lanes, present, vectors
from mpm.arrays.layout import FIRST_FACE, Contact, Offset, Setting, Worker, component
from mpm.physics.boundary import add_impulse, after_contact
from mpm.physics.pore_pressure import total_stress
from mpm.solids.face_lookup import TINY, entry_of, face_number, holds_of_node, normal_of, solid_of
from mpm.solids.terrain import bed_hold

NO_FACE = -2.0 * FIRST_FACE  # below the number of any face, as a real number
SHEET = 0.55  # phi at a thin sheet, per cell of its thickness: the integral of w^2 [-]
THINNEST = 0.1  # thickness [widths of contact] of the thinnest layer that feels the whole drag


@ti.func
def contact_at(block, column: ti.template(), arrays: ti.template()):
    """Index of the vector `column` among those that describe the contact of a block."""
    return block * arrays.features.state.size + arrays.features.state.contacts + column


@ti.func
def contact_of(block, arrays: ti.template()):
    """The vectors of `mpm.arrays.layout.Contact` of a block, n and the shear traction q behind them, as a list."""
    return [arrays.state[contact_at(block, k, arrays)] for k in ti.static(range(arrays.features.contact_vectors))]


@ti.func
def touches(block, arrays: ti.template()):
    """Whether a particle of a block is within the width of the contact; most blocks have none."""
    return over_lanes(maximum, arrays.state[contact_at(block, Contact.DELTA, arrays)], arrays.features.lanes) > 0.0


@ti.func
def normal_stress(stress: ti.template(), contact: ti.template(), dimension: ti.template()):
    """sigma_nn [Pa] across the normals of `contact`."""
    value = 0.0 * contact[Contact.NORMAL]
    for i in ti.static(range(dimension)):
        for j in ti.static(range(dimension)):
            both = contact[Contact.NORMAL + i] * contact[Contact.NORMAL + j]
            value = value + both * stress[ti.static(component(i, j))]
    return value


@ti.func
def surface_force(stress: ti.template(), contact: ti.template(), dimension: ti.template()):
    """The force of the surface per volume of a particle, delta t [Pa/m], and its arm d n [m]; a list of D and D."""
    delta, distance = contact[Contact.DELTA], contact[Contact.DISTANCE]
    n = [contact[Contact.NORMAL + k] for k in ti.static(range(dimension))]
    q = [contact[Contact.NORMAL + dimension + k] for k in ti.static(range(dimension))]
    pull = minimum(normal_stress(stress, contact, dimension), 0.0 * delta)
    force = [delta * (q[k] - pull * n[k]) for k in ti.static(range(dimension))]
    return force + [distance * n[k] for k in ti.static(range(dimension))]


@ti.func
def foot_velocity(motion: ti.template(), dimension: ti.template()):
    """v_f [m/s], of the material at the foot, a list of D, and n . v_f; motion: the grid's velocity, C, and contact."""
    velocity, affine, contact = motion
    foot = [velocity[i] for i in ti.static(range(dimension))]
    for i in ti.static(range(dimension)):
        rotation = 0.0 * contact[Contact.NORMAL]
        for j in ti.static(range(dimension)):
            rotation = rotation + affine[i * dimension + j] * contact[Contact.NORMAL + j]
        foot[i] = velocity[i] - contact[Contact.DISTANCE] * rotation
    opening = 0.0 * foot[0]
    for k in ti.static(range(dimension)):
        opening = opening + contact[Contact.NORMAL + k] * foot[k]
    return foot, opening


@ti.func
def jump_at_contact(motion: ti.template(), stress: ti.template(), modulus, dt, dimension: ti.template()):
    """The strain increment [-] of contact along n, min(dt delta n . v_f, (-sigma_nn)_+ / M); modulus: M [Pa]."""
    _, opening = foot_velocity(motion, dimension)
    pressure = maximum(0.0 - normal_stress(stress, motion[2], dimension), 0.0)
    return minimum(dt * motion[2][Contact.DELTA] * opening, pressure / modulus)


@ti.func
def with_jump(increment: ti.template(), jump, contact: ti.template(), dimension: ti.template()):
    """The strain increment with that of contact, G + jump n n^T [-], both row by row."""
    return [
        increment[k] + jump * contact[Contact.NORMAL + k // dimension] * contact[Contact.NORMAL + k % dimension]
        for k in ti.static(range(dimension**2))
    ]


@ti.func
def sheared_traction(
    motion: ti.template(), stress: ti.template(), shear, turbulence: ti.template(), dt, dx, dimension: ti.template()
):
    """The shear traction q [Pa] after a step, a list of D, within the bound for the new `stress`.

    turbulence: rho [kg/m^3], g / xi [1/m], sum w m [kg] and sum w H [kg] if solids have it; else an empty list.
    """
    contact = motion[2]
    foot, opening = foot_velocity(motion, dimension)
    square, stiffness = TINY + 0.0 * foot[0], dt * shear * contact[Contact.DELTA]
    q = [contact[Contact.NORMAL + dimension + k] for k in ti.static(range(dimension))]
    slip = [foot[k] - opening * contact[Contact.NORMAL + k] for k in ti.static(range(dimension))]
    for k in ti.static(range(dimension)):
        q[k] = q[k] - stiffness * slip[k]
        square = square + q[k] * q[k]
    bound = contact[Contact.FRICTION] * maximum(0.0 - normal_stress(stress, contact, dimension), 0.0)
    if ti.static(len(turbulence) > 0):
        drag = turbulence[0] * turbulence[1] / weight_in_layer(turbulence, dx**dimension)
        for k in ti.static(range(dimension)):
            bound = bound + drag * slip[k] * slip[k]
    scale = minimum(bound / ti.sqrt(square), 1.0)
    return [scale * q[k] for k in ti.static(range(dimension))]


@ti.func
def weight_in_layer(turbulence: ti.template(), volume):
    """I [-], the integral of delta over the layer around a particle; volume: of a cell [m^D]."""
    mass = maximum(turbulence[2], TINY)
    middle, filled = turbulence[3] / mass, mass / (turbulence[0] * volume)
    e = maximum(minimum(maximum(2.0 * middle, filled / SHEET), 1.0), THINNEST)
    middle = minimum(middle, 0.5 * e)
    return 2.0 * e * (1.0 - middle * middle * (3.5 - 3.0 * middle))


@ti.func
def drag_share(solid, x, scene, arrays: ti.template()):
    """1 / xi [s^2/m] at `x` [m] of a solid whose xi varies, and its slopes along x and z; for others 1 and no slopes.

    Bilinear between the posts of its terrain; constant beyond their edge.
    """
    share, along, across = 1.0 + 0.0 * x[0], 0.0 * x[0], 0.0 * x[0]
    if ti.static(arrays.features.dimension == 3):
        at = arrays.drag_places[scene, solid]
        if at > 0:
            per_x, per_z = arrays.drag_posts[at + 1], arrays.drag_posts[at + 3]
            rows, columns = ti.cast(arrays.drag_posts[at + 4], ti.i32), ti.cast(arrays.drag_posts[at + 5], ti.i32)
            u, v = (x[0] - arrays.drag_posts[at]) * per_x, (x[2] - arrays.drag_posts[at + 2]) * per_z
            i, k = ti.cast(ti.floor(u), ti.i32), ti.cast(ti.floor(v), ti.i32)
            i, k = ti.max(0, ti.min(i, rows - 2)), ti.max(0, ti.min(k, columns - 2))
            u, v = ti.max(0.0, ti.min(u - i, 1.0)), ti.max(0.0, ti.min(v - k, 1.0))
            first = at + 6 + i * columns + k
            a, b = arrays.drag_posts[first], arrays.drag_posts[first + 1]
            c, d = arrays.drag_posts[first + columns], arrays.drag_posts[first + columns + 1]
            low, high = a + v * (b - a), c + v * (d - c)
            share = low + u * (high - low)
            if u > 0.0 and u < 1.0:
                along = per_x * (high - low)
            if v > 0.0 and v < 1.0:
                across = per_z * (b - a + u * (d - c - b + a))
    return share, along, across


@ti.func
def find_drags(scene, block, scratch, places: ti.template(), first, arrays: ti.template()):
    """Store g / xi [1/m] of the solid next to each particle of a block in `scratch`; 0 for those that touch none.

    places: array that holds the positions of the block from lane `first` on.
    """
    features, lanes = arrays.features, arrays.features.lanes
    contact, drag = contact_at(block, 0, arrays), scratch + features.scratch.drag
    for lane in range(lanes):
        value = 0.0 * arrays.drags[scene, 0]
        if arrays.lanes[(contact + Contact.DELTA) * lanes + lane] > 0.0:
            face = face_number(arrays.lanes[(contact + Contact.FACE) * lanes + lane])
            solid = solid_of(face, scene, arrays)
            share, _along, _across = drag_share(solid, lane_numbers(places, first + lane, arrays), scene, arrays)
            value = arrays.drags[scene, solid] * share
        arrays.scratch_lanes[drag * lanes + lane] = value


@ti.func
def turbulence_at(scratch, density, arrays: ti.template()):
    """The argument `turbulence` of `sheared_traction` for a block, after `find_drags`; density: [kg/m^3]."""
    count = ti.static(int(arrays.features.turbulent))
    drags = vectors(arrays.scratch, scratch + arrays.features.scratch.drag, 3 * count)
    return [density for _ in ti.static(range(count))] + drags


@ti.func
def motion_and_stress(block, scratch, arrays: ti.template()):
    """The motion of a block, as `foot_velocity` takes it, and the stress of its grains; lists of vectors."""
    features = arrays.features
    first, moved = block * features.state.size, scratch + features.scratch.lowest + features.dimension
    velocity = vectors(arrays.scratch, moved, features.dimension)
    affine = vectors(arrays.state, first + features.state.affine, features.dimension**2)
    stress = vectors(arrays.state, first + features.state.stress, features.stresses)
    return (velocity, affine, contact_of(block, arrays)), stress


@ti.func
def push(block, scratch, arrays: ti.template()):
    """Store the `surface_force` of each particle of a block in `scratch`: the force, then its arm; D vectors each."""
    features = arrays.features
    contact = contact_of(block, arrays)
    away = 0.0 - contact[Contact.DISTANCE]
    foot = [away * contact[Contact.NORMAL + k] for k in ti.static(range(features.dimension))]
    pushed = surface_force(total_stress(block, foot, arrays), contact, features.dimension)
    for k in ti.static(range(2 * features.dimension)):
        arrays.scratch[scratch + features.scratch.push + k] = pushed[k]


@ti.func
def shear_traction_step(scene, block, scratch, dt, shear, density, arrays: ti.template()):
    """Advance the shear tractions q of a block by a step."""
    dimension = ti.static(arrays.features.dimension)
    if ti.static(arrays.features.turbulent):
        position = block * arrays.features.state.size * arrays.features.lanes
        find_drags(scene, block, scratch, arrays.lanes, position, arrays)
    motion, stress = motion_and_stress(block, scratch, arrays)
    turbulence = turbulence_at(scratch, density, arrays)
    dx = arrays.settings[scene, Setting.CELL]
    q = sheared_traction(motion, stress, shear, turbulence, dt, dx, dimension)
    for k in ti.static(range(dimension)):
        arrays.state[contact_at(block, Contact.NORMAL + dimension + k, arrays)] = q[k]


@ti.func
def record_traction(block, scratch, volume, dt, worker, arrays: ti.template()):
    """Add the momentum that contact takes from a touching block in a step, -dt V0 delta t, to its solids."""
    features = arrays.features
    push(block, scratch, arrays)
    pushed = scratch + features.scratch.push
    for k in ti.static(range(features.dimension)):
        arrays.scratch[pushed + k] = (0.0 - dt) * volume * present(block, arrays) * arrays.scratch[pushed + k]
    first, scene = contact_at(block, 0, arrays), arrays.workers[worker, Worker.SCENE]
    faces = ti.select(arrays.state[first + Contact.DELTA] > 0.0, arrays.state[first + Contact.FACE], NO_FACE)
    face = over_lanes(maximum, faces, features.lanes)
    while face > NO_FACE:
        solid = solid_of(face_number(face), scene, arrays)
        at = arrays.workers[worker, Worker.IMPULSE] + solid * features.dimension
        for k in ti.static(range(features.dimension)):
            add(arrays.impulse, at + k, ti.select(faces == face, arrays.scratch[pushed + k], 0.0), arrays)
        faces = ti.select(faces == face, NO_FACE, faces)
        face = over_lanes(maximum, faces, features.lanes)


@ti.func
def apply_solids(v, mass, node, bed, worker, scene, recorded: ti.template(), arrays: ti.template()):
    """Velocity `v` [m/s], shape [D], of a node after its holds; node: its index, [D], mass: [kg].

    bed: under the node, `BedUnder`; recorded: whether the momentum taken is added to the impulses of the solids.
    """
    after, entry = v, entry_of(node, scene, arrays)
    first, end = holds_of_node(entry, arrays)
    for hold in range(first, end):
        face, removed = removed_by(hold, v, arrays)
        after = after - removed
        if ti.static(recorded):
            add_impulse(solid_of(face, scene, arrays), mass * removed, 0, worker, arrays)
    if ti.static(arrays.features.terrain):
        removed = removed_by_bed(after, node, bed, scene, arrays)
        after = after - removed
        if ti.static(recorded):
            add_impulse(arrays.offsets[scene, Offset.TERRAIN_SOLID], mass * removed, 0, worker, arrays)
    return after


@ti.func
def removed_by(hold, v, arrays: ti.template()):
    """The face of a hold and the part that it removes from a velocity `v` [m/s], share_k (v - A_k v)."""
    face, removed = face_number(arrays.holds[hold, 0]), 0.0 * v
    normal = normal_of(face, arrays)
    if v.dot(normal) < 0.0:
        removed = arrays.holds[hold, 2] * (v - after_contact(v, normal, arrays.holds[hold, 1]))
    return face, removed


@ti.func
def removed_by_bed(v, node, bed, scene, arrays: ti.template()):
    """The part that the `bed` under a node, an index of shape [D], removes from its velocity `v` [m/s]; shape [D]."""
    removed = 0.0 * v
    share, normal, friction = bed_hold(node, bed, scene, arrays)
    if share > 0.0 and v.dot(normal) < 0.0:
        removed = share * (v - after_contact(v, normal, friction))
    return removed
