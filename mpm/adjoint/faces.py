"""The reverse of the search for contact: distance, normal and friction at the nearest face, and moving back onto it.

Distance d, normal n and friction belong to the point of the nearest face that is nearest to x. Whether this point lies
inside the face, on an edge or at a corner is given: so all three are closed forms, which are traced (`at_face`), as for
the bed of a terrain (`at_bed`), whose elevations have no adjoint.

A particle that a step has moved back onto a face lost d n of its displacement, x'' = x' - d n, and the part of its
velocity that `after_contact` takes. The adjoints of faces are those of their corners, normals and friction, each as if
independent: moving a solid moves all of them (`mpm.adjoint.gradient.Gradient.along`). Where a node begins to be deep in
a solid, or the nearest face changes, the flow has a kink in the position of the solid, and the adjoint is that of one
side. A particle moved back beyond the end of the face that it crossed, over a ridge, counts as not moved back.
"""

import taichi as ti

from mpm.adjoint.boundary import after_contact_reverse
from mpm.adjoint.layout import impulse_adjoint
from mpm.adjoint.pullback import Pullback
from mpm.arrays.access import dot, lane_numbers, put_lane_numbers
from mpm.arrays.layout import Contact, Setting
from mpm.arrays.properties import GAP_CUTOFF
from mpm.physics.boundary import after_contact
from mpm.physics.contact import contact_at
from mpm.solids.face_lookup import TINY, corners_of, face_number, foot_on_face, frictions_of, normal_of, solid_of
from mpm.solids.terrain import (
    bed_contact,
    bed_hold,
    bed_spacing,
    bed_under,
    in_terrain,
    lowest_node,
    nine,
    node_position,
    place_in_bed,
    spline_sums,
    varied_friction,
)

PUT_BACK = 1.0e-6  # distance from a face [cells] within which a particle has been moved back onto it


@ti.func
def found_reverse(block: ti.template(), put_back: ti.template(), arrays: ti.template()):
    """Adjoints of position, velocity and shear traction of a block before its contact is found, and those of the faces.

    Computed from the adjoints afterwards, with the later state in the history. put_back: whether a particle may have
    been kept out of a solid; then the scratch holds the earlier velocity from `before` on, followed by the shear
    traction. If the objective depends on impulses, the mass [kg] of each particle replaces `Contact.FREE`, which has no
    adjoint, and its adjoint is stored there.
    """
    features, layout, lanes, scene = arrays.features, arrays.layout, arrays.features.lanes, block.scene
    size = ti.static(features.dimension)
    dx, width = arrays.settings[scene, Setting.CELL], arrays.settings[scene, Setting.CONTACT_WIDTH]
    velocity, contacts = features.state.velocity * lanes, features.state.contacts * lanes
    shear = (Contact.NORMAL + size) * lanes
    for lane in range(lanes):
        here = arrays.lanes[(block.state + features.state.present) * lanes + lane]
        adj_at, then = block.adj * lanes + lane, block.after * lanes + lane
        at, contact = adj_at + contacts, then + contacts
        scratch = (block.scratch + layout.scratch.before) * lanes + lane
        delta = arrays.history_lanes[contact + Contact.DELTA * lanes]
        adj_x = lane_numbers(arrays.adjoint_lanes, adj_at, arrays)
        adj_v = lane_numbers(arrays.adjoint_lanes, adj_at + velocity, arrays)
        adj_q = lane_numbers(arrays.adjoint_lanes, at + shear, arrays)
        adj_mass = 0.0 * here
        if depends(then, scene, arrays) and here > 0.0:
            x = lane_numbers(arrays.history_lanes, then, arrays)
            n = lane_numbers(arrays.history_lanes, contact + Contact.NORMAL * lanes, arrays)
            distance = arrays.history_lanes[contact + Contact.DISTANCE * lanes]
            friction = arrays.history_lanes[contact + Contact.FRICTION * lanes]
            face = face_number(arrays.history_lanes[contact + Contact.FACE * lanes])
            adj_n = lane_numbers(arrays.adjoint_lanes, at + Contact.NORMAL * lanes, arrays)
            adj_friction = arrays.adjoint_lanes[at + Contact.FRICTION * lanes]
            share = ti.min(distance / width, 1.0)
            adj_delta = arrays.adjoint_lanes[at + Contact.DELTA * lanes]
            adj_d = arrays.adjoint_lanes[at + Contact.DISTANCE * lanes]
            adj_d += adj_delta * (12.0 / (width * width)) * share * (share - 1.0)
            back = False
            if ti.static(put_back):
                before = lane_numbers(arrays.scratch_lanes, scratch, arrays)
                q = lane_numbers(arrays.scratch_lanes, scratch + size * lanes, arrays)
                if delta == 0.0:
                    adj_q = 0.0 * adj_q
                adj_n = adj_n - q.dot(n) * adj_q - n.dot(adj_q) * q
                adj_q = adj_q - adj_q.dot(n) * n
                back = distance < PUT_BACK * dx
                if back:
                    if before.dot(n) < 0.0:
                        adj_momentum = 0.0 * adj_v
                        if ti.static(layout.impulses):
                            mass = arrays.lanes[contact_at(block.number, Contact.FREE, arrays) * lanes + lane]
                            stopped = lane_numbers(arrays.history_lanes, then + velocity, arrays)
                            adj_taken = impulse_adjoint(solid_of(face, scene, arrays), block.worker, arrays)
                            adj_momentum = mass * adj_taken
                            adj_mass += adj_taken.dot(before - stopped)
                        turned, adj_normal, slid = after_contact_reverse(adj_v - adj_momentum, before, n, friction)
                        adj_v = turned + adj_momentum
                        adj_n = adj_n + adj_normal
                        adj_friction += slid
                    # The lost displacement is the depth along n, which turns where a bed is curved.
                    adj_d = 0.0 - adj_x.dot(n)
                    if ti.static(features.terrain):
                        if in_terrain(face, scene, arrays):
                            start = lane_numbers(arrays.lanes, block.state * lanes + lane, arrays)
                            way = (block.scratch + layout.scratch.sums) * lanes + lane
                            place = start + block.dt * lane_numbers(arrays.scratch_lanes, way, arrays)
                            adj_n = adj_n - (place - x).dot(n) * adj_x
                            x = place
            adj_x = adj_x + foot_reverse(x, n, face, (adj_friction, adj_d, adj_n), back, scene, arrays)
        elif ti.static(put_back):
            adj_q = 0.0 * adj_q
        put_lane_numbers(arrays.adjoint_lanes, adj_at, adj_x, arrays)
        put_lane_numbers(arrays.adjoint_lanes, adj_at + velocity, adj_v, arrays)
        put_lane_numbers(arrays.adjoint_lanes, at + shear, adj_q, arrays)
        for column in ti.static(range(len(Contact) - 1 + size)):
            arrays.adjoint_lanes[at + column * lanes] = 0.0 * here
        if ti.static(layout.impulses and put_back):
            arrays.adjoint_lanes[at + Contact.FREE * lanes] = adj_mass


@ti.func
def depends(then, scene, arrays: ti.template()):
    """Whether a lane, whose first number in the history is `then`, depends on its solid: within the width of contact;
    with volume correction out to where a solid hides mass.
    """
    lanes = arrays.features.lanes
    contact = then + arrays.features.state.contacts * lanes
    if ti.static(arrays.features.volume_correction):
        distance = arrays.history_lanes[contact + Contact.DISTANCE * lanes]
        return distance < GAP_CUTOFF * arrays.settings[scene, Setting.CELL]
    else:
        return arrays.history_lanes[contact + Contact.DELTA * lanes] > 0.0


@ti.func
def foot_reverse(x, n, face, adj: ti.template(), back, scene, arrays: ti.template()):
    """Adjoint of the position `x` [m] from those of the friction, distance and normal at its face, shape [D].

    back: whether it was moved back onto the face; it is then nearest to its inside. Adds the adjoints of the face.
    """
    adj_x = 0.0 * x
    if ti.static(arrays.features.listed):
        if not in_terrain(face, scene, arrays):
            adj_x = face_reverse(x, n, face, adj, back, arrays)
    if ti.static(arrays.features.terrain):
        if in_terrain(face, scene, arrays):
            adj_x = bed_reverse(x, adj, scene, arrays)
    return adj_x


@ti.func
def face_reverse(x, n, face, adj: ti.template(), back, arrays: ti.template()):
    """`foot_reverse` of a listed face."""
    features = arrays.features
    size = ti.static(features.dimension)
    part = 0
    a, b, c = corners_of(face, arrays)
    facing, mu = normal_of(face, arrays), frictions_of(face, arrays)
    if not back:
        _, part, _ = foot_on_face(x, a, b, c, arrays)
    corners = [point[k] for point in ti.static((a, b, c)[:size]) for k in ti.static(range(size))]
    normal = [facing[k] for k in ti.static(range(size))]
    frictions = [mu[k] for k in ti.static(range(size))]
    numbers = ti.static(([x[k] for k in range(size)], corners, normal, frictions))
    pullback = ti.static([Pullback(at_face, numbers, (part, [n[k] for k in range(size)], size))])[0]
    adj_found = [adj[0], adj[1]] + [adj[2][k] for k in ti.static(range(size))]
    adj_x, adj_corners, adj_normal, adj_frictions = ti.static(pullback(adj_found))
    for k in ti.static(range(size * size)):
        add_face(face, k, adj_corners[k], arrays)
    for k in ti.static(range(size)):
        add_face(face, features.face.normal + k, adj_normal[k], arrays)
        add_face(face, features.face.friction + k, adj_frictions[k], arrays)
    return ti.Vector([adj_x[k] for k in ti.static(range(size))])


@ti.func
def bed_reverse(x, adj: ti.template(), scene, arrays: ti.template()):
    """`foot_reverse` of the bed of a terrain."""
    i, corner_x = lowest_node(x[0], 0, scene, arrays)
    k, corner_z = lowest_node(x[2], 2, scene, arrays)
    height, friction, row = place_in_bed(ti.cast(i, ti.i32), ti.cast(k, ti.i32), scene, arrays)
    varied, spacing = ti.cast(varied_friction(scene, arrays), ti.i32), bed_spacing(scene, arrays)
    heights, frictions = nine(height, row, 1, arrays), nine(friction, varied * row, varied, arrays)
    numbers = ti.static(([x[axis] for axis in range(3)], frictions))
    pullback = ti.static([Pullback(at_bed, numbers, (heights, [corner_x, corner_z], spacing))])[0]
    adj_found = [adj[0], adj[1]] + [adj[2][axis] for axis in ti.static(range(3))]
    adj_x, adj_frictions = ti.static(pullback(adj_found))
    at = varied * (ti.cast(i, ti.i32) * row + ti.cast(k, ti.i32))
    for a, b in ti.static(ti.ndrange(3, 3)):
        arrays.terrain_adjoints[scene, at + varied * (a * row + b)] += ti.cast(adj_frictions[3 * a + b], ti.f64)
    return ti.Vector([adj_x[axis] for axis in ti.static(range(3))])


def at_bed(x, frictions, heights, corner, spacing):
    """Friction, distance [m] and normal at `x` [m] of a bed; traced."""
    friction, _, _ = spline_sums(x, frictions, corner, spacing)
    _, distance, n = bed_contact(x, heights, corner, spacing)
    return friction, distance, n


def at_face(x, corners, normal, frictions, part, side, dimension):
    """Friction, distance [m] and normal at the point of a face nearest to `x` [m]; traced.

    part: as in `mpm.solids.face_lookup.foot_on_triangle`; side: roughly the normal."""
    points = [corners[k * dimension : (k + 1) * dimension] for k in range(dimension)]
    weights = foot_weights(x, points, part, dimension)
    foot = [dot(weights, [point[i] for point in points]) for i in range(dimension)]
    offset = between(foot, x)
    length = ti.sqrt(dot(offset, offset))
    signed = ti.select(dot(offset, side) < 0.0, 0.0 - length, ti.select(length > TINY, length, 1.0))
    inside = (part == 0) | (length <= TINY)
    distance = ti.select(part == 0, dot(between(points[0], x), normal), signed)
    n = [ti.select(inside, normal[i], offset[i] / signed) for i in range(dimension)]
    return dot(weights, frictions), distance, n


def foot_weights(x, points, part, dimension):
    """Weights of the corners of a face at the point nearest to `x`, which lies in its `part`; traced."""
    from_corner = [between(point, x) for point in points]
    edges = [between(points[k], points[(k + 1) % dimension]) for k in range(dimension)]
    along = [dot(from_corner[k], edges[k]) / dot(edges[k], edges[k]) for k in range(dimension)]
    if dimension == 2:
        inside = [1.0 - along[0], along[0]]
    else:
        across = between(points[0], points[2])
        d = [(dot(edges[0], offset), dot(across, offset)) for offset in from_corner]
        areas = [d[k - 2][0] * d[k - 1][1] - d[k - 1][0] * d[k - 2][1] for k in range(3)]
        inside = [area / (areas[0] + areas[1] + areas[2]) for area in areas]
    weights = []
    for k in range(dimension):
        weight = ti.select(part == 0, inside[k], ti.select(part == 1 + k, 1.0, 0.0 * inside[k]))
        if dimension == 3:
            before = (k + 2) % 3
            weight = ti.select(part == 4 + before, along[before], ti.select(part == 4 + k, 1.0 - along[k], weight))
        weights.append(weight)
    return weights


def between(a, b):
    """Vector from a to b; traced."""
    return [b[k] - a[k] for k in range(len(a))]


@ti.func
def add_face(face, column: ti.template(), value, arrays: ti.template()):
    """Add to the adjoint of a number of a listed face."""
    arrays.face_adjoints[face, column] += ti.cast(value, ti.f64)


@ti.func
def hold_reverse(adj, v, normal, friction, share):
    """Adjoints of a node's `v` [m/s], normal, friction and share of a hold, from that of share (v - A v)."""
    through, adj_normal, adj_friction = after_contact_reverse((0.0 - share) * adj, v, normal, friction)
    return share * adj + through, adj_normal, adj_friction, adj.dot(v - after_contact(v, normal, friction))


@ti.func
def bed_hold_reverse(adj, v, node, scene, arrays: ti.template()):
    """Adjoint of a node's velocity `v` [m/s] from that of the part that the bed takes; adds that of its friction."""
    adj_v = 0.0 * v
    share, normal, friction = bed_hold(node, bed_under(node, scene, arrays), scene, arrays)
    if share > 0.0 and v.dot(normal) < 0.0:
        adj_v, _normal, adj_friction, _share = hold_reverse(adj, v, normal, friction, share)
        none = 0.0 * v
        bed_reverse(node_position(node, scene, arrays), (adj_friction, 0.0 * adj_friction, none), scene, arrays)
    return adj_v
