"""The nearest face of each particle, and the displacement of a step, which ends at a face that it meets.

No particle passes a face: a displacement that crosses one ends there and continues along it. In a block, all lanes at
once, first come the particles whose nearest face is the same as before (`follow_faces`). Each of the others is stopped
at that face (`stop_at_face`), follows its nearest edge (`follow_edge`) or searches (`find_contact`). A terrain in 3D is
not among the listed faces: last, for all lanes at once, its bed replaces a face that is farther away (`find_bed`), and
particles inside it are moved out.
"""

import taichi as ti

from mpm.arrays.access import (
    add,
    dot,
    lane_numbers,
    maximum,
    minimum,
    no_overflow,
    over_lanes,
    present,
    put_lane_numbers,
    vectors,
)
from mpm.arrays.layout import FIRST_FACE, Contact, Offset, Setting, TerrainNumber, Worker
from mpm.physics.boundary import add_impulse, after_contact, contact_delta
from mpm.physics.contact import contact_at
from mpm.solids.face_lookup import (
    TINY,
    cell_of,
    corners_of,
    face_number,
    first_crossed,
    foot_on_face,
    free_path,
    frictions_of,
    list_of,
    nearest_face,
    normal_of,
    solid_of,
    unlisted_distance,
)
from mpm.solids.terrain import bed_contact, bed_spacing, lowest_node, nine, place_in_bed, spline_sums, varied_friction

FAR = 1.0e30  # distance [m] of an absent solid
MAX_CROSSINGS = 3  # faces that deflect the displacement of one step; at more, the particle stays where it was
LONGER = 0.25  # cells beyond the searched distance up to which a face is followed; particles there need no search


@ti.func
def find_contacts(block, scratch, mass, worker, scene, arrays: ti.template()):
    """Keep the particles of a block, already moved, out of the solids, and find the nearest face of each; `mass` [kg]
    of each lane. A particle at distance d that has moved by s is at least d - s away: no search is needed while that is
    beyond the contact, or while the nearest face is known (`free_path`).
    """
    features, lanes = arrays.features, arrays.features.lanes
    size = ti.static(features.dimension)
    x, distance = block * features.state.size, contact_at(block, Contact.DISTANCE, arrays)
    origin = scratch + features.scratch.origin
    moved = [arrays.state[x + k] - arrays.scratch[origin + k] for k in ti.static(range(size))]
    path = 1.001 * ti.sqrt(dot(moved, moved))
    lower_bound = arrays.state[distance] - path
    nearby = arrays.settings[scene, Setting.SEARCH_DISTANCE]
    if over_lanes(minimum, lower_bound, arrays.features.lanes) >= followed_distance(scene, arrays):
        arrays.state[distance] = lower_bound
    else:
        arrays.scratch[scratch + features.scratch.push + 1] = mass * present(block, arrays)
        if ti.static(features.listed):
            if follow_faces(block, scratch, moved, path, nearby, scene, arrays):
                for lane in range(lanes):
                    bound = arrays.scratch_lanes[(scratch + features.scratch.push) * lanes + lane]
                    if bound < nearby:
                        keep_out(block, scratch, lane, bound, worker, scene, arrays)
        if ti.static(features.terrain):
            if arrays.offsets[scene, Offset.TERRAIN] > 0:
                find_bed(block, scratch, nearby, worker, scene, arrays)
        turn_traction(block, arrays)


@ti.func
def followed_distance(scene, arrays: ti.template()):
    """Distance from solids beyond which faces are not followed [m]."""
    longer = ti.static(LONGER * arrays.features.listed)
    return arrays.settings[scene, Setting.SEARCH_DISTANCE] + longer * arrays.settings[scene, Setting.CELL]


@ti.func
def follow_faces(block, scratch, moved: ti.template(), path, nearby, scene, arrays: ti.template()):
    """Contact of the particles of a block that are still nearest to the inside of the same face, or to none `nearby`.

    moved: their displacement [m], D vectors; path: at least its length [m]. Stores in `scratch` a lower bound of the
    distance for each unfinished particle, and `nearby` for the others; returns whether there are unfinished ones: most
    need a search, but those with `Contact.FREE` above zero have moved into their face by a negative distance. For
    particles on a bed, `Contact.FREE` bounds the distance to listed faces.
    """
    features = arrays.features
    size = ti.static(features.dimension)
    contact, width = contact_at(block, 0, arrays), arrays.settings[scene, Setting.CONTACT_WIDTH]
    before, d = arrays.state[contact + Contact.FREE], arrays.state[contact + Contact.DISTANCE]
    # Below zero for particles at an edge, which `follow_edge` follows.
    free, bound = ti.select(before < 0.0, minimum(before + path, 0.0), maximum(before - path, 0.0)), d - path
    if ti.static(features.terrain):
        bed = 1.0 * arrays.offsets[scene, Offset.TERRAIN_FACE] - FIRST_FACE
        on_bed = arrays.state[contact + Contact.FACE] >= bed
        bound = ti.select(on_bed, maximum(bound, free), bound)
        free = ti.select(on_bed, 0.0, free)
    for k in ti.static(range(size)):
        d = d + moved[k] * arrays.state[contact + Contact.NORMAL + k]
    # While the face is the nearest, a path on its outer side meets no face, and a path into it no other face.
    follows = free > 0.0
    d = ti.select(follows, d, bound)
    arrays.state[contact + Contact.DISTANCE] = d
    arrays.state[contact + Contact.DELTA] = ti.select(follows, contact_delta(maximum(d, 0.0), width), 0.0)
    # Beyond that the distance becomes a bound, from which no face can be followed.
    arrays.state[contact + Contact.FREE] = ti.select(d < followed_distance(scene, arrays), free, 0.0)
    bound = ti.select(follows & (d >= 0.0), nearby, bound)
    arrays.scratch[scratch + features.scratch.push] = bound
    return over_lanes(minimum, bound, arrays.features.lanes) < nearby


@ti.func
def find_bed(block, scratch, nearby, worker, scene, arrays: ti.template()):
    """Contact of the particles of a block that are nearer to the bed of the terrain than to any listed face, whose
    contact is in the state; particles inside the bed are moved out and stopped.
    """
    features, lanes = arrays.features, arrays.features.lanes
    first, contact, bed = block * features.state.size, contact_at(block, 0, arrays), scratch + features.scratch.bed
    position, spacing = vectors(arrays.state, first, 3), bed_spacing(scene, arrays)
    i, corner_x = lowest_node(position[0], 0, scene, arrays)
    k, corner_z = lowest_node(position[2], 2, scene, arrays)
    arrays.scratch[bed], arrays.scratch[bed + 1] = i, k
    arrays.scratch[bed + 2], arrays.scratch[bed + 3] = corner_x, corner_z
    start, rough, row = place_in_bed(0, 0, scene, arrays)
    varied, friction = varied_friction(scene, arrays), arrays.terrain[rough]
    for lane in range(lanes):
        at = no_overflow(bed * lanes + lane)
        low, near = ti.cast(arrays.scratch_lanes[at], ti.i32), ti.cast(arrays.scratch_lanes[at + lanes], ti.i32)
        node = no_overflow(low * row + near)
        if varied:
            x = lane_numbers(arrays.lanes, first * lanes + lane, arrays)
            corner = [arrays.scratch_lanes[at + 2 * lanes], arrays.scratch_lanes[at + 3 * lanes]]
            friction, _, _ = spline_sums([x[0], x[1], x[2]], nine(rough + node, row, 1, arrays), corner, spacing)
        heights = nine(start + node, row, 1, arrays)
        for number in ti.static(range(9)):
            arrays.scratch_lanes[at + number * lanes] = heights[number]
        arrays.scratch_lanes[at + 9 * lanes] = friction
    above, d, normal = bed_contact(position, vectors(arrays.scratch, bed, 9), [corner_x, corner_z], spacing)
    frictions, other = arrays.scratch[bed + 9], 0.0 * d + FAR
    if ti.static(features.listed):
        other = arrays.state[contact + Contact.DISTANCE]
    nearest = (d < other) & (d < nearby)
    inside = d < 0.0
    outside = maximum(d, 0.0)
    delta = contact_delta(outside, arrays.settings[scene, Setting.CONTACT_WIDTH])
    velocity = vectors(arrays.state, first + features.state.velocity, 3)
    into = dot(velocity, normal)
    along = [velocity[axis] - into * normal[axis] for axis in ti.static(range(3))]
    keep = maximum(1.0 + frictions * into / ti.sqrt(dot(along, along) + TINY), 0.0)
    stopped = inside & (into < 0.0)
    mass = arrays.scratch[scratch + features.scratch.push + 1]
    impulse = arrays.workers[worker, Worker.IMPULSE] + arrays.offsets[scene, Offset.TERRAIN_SOLID] * 3
    for axis in ti.static(range(3)):
        x = first + axis
        arrays.state[x] = ti.select(inside, position[axis] - d * normal[axis], position[axis])
        lost = ti.select(stopped, velocity[axis] - keep * along[axis], 0.0)
        arrays.state[x + features.state.velocity] = velocity[axis] - lost
        add(arrays.impulse, impulse + axis, mass * lost, arrays)
        put_known(contact + Contact.NORMAL + axis, nearest, normal[axis], arrays)
    face = 0.0 * d + (1.0 * arrays.offsets[scene, Offset.TERRAIN_FACE] - FIRST_FACE)
    put_known(contact + Contact.FRICTION, nearest, frictions, arrays)
    put_known(contact + Contact.FACE, nearest, face, arrays)
    put_known(contact + Contact.FREE, nearest, other, arrays)
    # A lower bound beyond the search; the distance of a nearer face stays.
    nearness = arrays.terrain[arrays.offsets[scene, Offset.TERRAIN] + TerrainNumber.NEARNESS]
    bound = ti.select(other < nearby, other, minimum(other, above * nearness))
    arrays.state[contact + Contact.DISTANCE] = ti.select(nearest, outside, bound)
    if ti.static(features.listed):
        put_known(contact + Contact.DELTA, nearest, delta, arrays)
    else:
        arrays.state[contact + Contact.DELTA] = ti.select(nearest, delta, 0.0)


@ti.func
def put_known(at, known, value, arrays: ti.template()):
    """Put `value` in the lanes `known` of a vector of the state."""
    arrays.state[at] = ti.select(known, value, arrays.state[at])


@ti.func
def turn_traction(block, arrays: ti.template()):
    """Turn the shear traction of a block with the surface; it ends when a particle leaves the surface."""
    size = ti.static(arrays.features.dimension)
    contact = contact_at(block, 0, arrays)
    normal = vectors(arrays.state, contact + Contact.NORMAL, size)
    q = vectors(arrays.state, contact + Contact.NORMAL + size, size)
    pressed, touching = dot(q, normal), arrays.state[contact + Contact.DELTA] > 0.0
    for k in ti.static(range(size)):
        arrays.state[contact + Contact.NORMAL + size + k] = ti.select(touching, q[k] - pressed * normal[k], 0.0)


@ti.func
def keep_out(block, scratch, lane, bound, worker, scene, arrays: ti.template()):
    """Contact of the particle in `lane`, at least `bound` [m] away, that does not follow the inside of a face."""
    free = arrays.lanes[contact_at(block, Contact.FREE, arrays) * arrays.features.lanes + lane]
    if free > 0.0:
        stop_at_face(block, scratch, lane, worker, scene, arrays)
    elif free < 0.0 and bound > 0.0:
        follow_edge(block, lane, scene, arrays)
    else:
        find_contact(block, scratch, lane, bound, worker, scene, arrays)


@ti.func
def stop_at_face(block, scratch, lane, worker, scene, arrays: ti.template()):
    """Move the particle in `lane` of a block out of the one face that it has entered, and stop it there."""
    features, lanes = arrays.features, arrays.features.lanes
    first, contact = block * features.state.size * lanes + lane, contact_at(block, 0, arrays) * lanes + lane
    face, x = face_number(arrays.lanes[contact + Contact.FACE * lanes]), lane_numbers(arrays.lanes, first, arrays)
    corner, _, _ = corners_of(face, arrays)
    normal = normal_of(face, arrays)
    # Computed anew: the distance of a followed face accumulates the rounding of its steps.
    d = (x - corner).dot(normal)
    put_lane_numbers(arrays.lanes, first, x - ti.min(d, 0.0 * d) * normal, arrays)
    arrays.lanes[contact + Contact.DISTANCE * lanes] = ti.max(d, 0.0 * d)
    velocity = lane_numbers(arrays.lanes, first + features.state.velocity * lanes, arrays)
    if velocity.dot(normal) < 0.0:
        v = after_contact(velocity, normal, arrays.lanes[contact + Contact.FRICTION * lanes])
        put_lane_numbers(arrays.lanes, first + features.state.velocity * lanes, v, arrays)
        mass = arrays.scratch_lanes[(scratch + features.scratch.push + 1) * lanes + lane]
        add_impulse(solid_of(face, scene, arrays), mass * (velocity - v), lane, worker, arrays)


@ti.func
def follow_edge(block, lane, scene, arrays: ti.template()):
    """Contact of the particle in `lane` of a block that is still nearest to the same edge."""
    lanes, contact = arrays.features.lanes, contact_at(block, 0, arrays) * arrays.features.lanes + lane
    x = lane_numbers(arrays.lanes, block * arrays.features.state.size * lanes + lane, arrays)
    a, b, c = corners_of(face_number(arrays.lanes[contact + Contact.FACE * lanes]), arrays)
    _weights, _part, from_foot = foot_on_face(x, a, b, c, arrays)
    d = from_foot.norm()
    delta = contact_delta(d, arrays.settings[scene, Setting.CONTACT_WIDTH])
    arrays.lanes[contact + Contact.DELTA * lanes] = delta
    arrays.lanes[contact + Contact.DISTANCE * lanes] = d
    put_lane_numbers(arrays.lanes, contact + Contact.NORMAL * lanes, from_foot / d, arrays)


@ti.func
def find_contact(block, scratch, lane, bound, worker, scene, arrays: ti.template()):
    """Contact of the particle in `lane` of a block: the end of its displacement, and the face nearest to it.

    bound: lower bound of its distance [m]; if it is positive, the particle has met no face.
    """
    features, lanes = arrays.features, arrays.features.lanes
    first = block * features.state.size * lanes + lane
    contact = contact_at(block, 0, arrays) * lanes + lane
    x = lane_numbers(arrays.lanes, first, arrays)
    v = lane_numbers(arrays.lanes, first + features.state.velocity * lanes, arrays)
    velocity, solid, moved = v, -1, False
    cell = arrays.settings[scene, Setting.CELL]
    if bound <= 0.0:
        start = lane_numbers(arrays.scratch_lanes, (scratch + features.scratch.origin) * lanes + lane, arrays)
        start_entry = cell_of(start, scene, arrays)
        for rotation in range(MAX_CROSSINGS):
            face, corner, normal = first_crossed(start, x, start_entry, cell, arrays)
            if face < 0:
                break
            x = x - (x - corner).dot(normal) * normal
            if rotation == MAX_CROSSINGS - 1:
                x = start
            moved = True
            if v.dot(normal) < 0.0:
                v = after_contact(v, normal, frictions_of(face, arrays)[0])
                solid = solid_of(face, scene, arrays)
    entry = cell_of(x, scene, arrays)
    delta, distance, free = 0.0 * cell, unlisted_distance(x, entry, scene, arrays), 0.0 * cell
    _, listed = list_of(entry, arrays)
    if listed > 0:
        last = face_number(arrays.lanes[contact + Contact.FACE * lanes])
        face, feature, weights, normal, d, bound = nearest_face(x, last, entry, scene, arrays)
        friction, outside = weights.dot(frictions_of(face, arrays)), d > 0.0
        if d < 0.0:
            x = x - d * normal
            d, moved = 0.0 * d, True
            if v.dot(normal) < 0.0:
                v = after_contact(v, normal, friction)
                solid = solid_of(face, scene, arrays)
        if d < followed_distance(scene, arrays) and (outside or feature == 0):
            free = free_path(x, face, feature, weights, normal, d, entry, cell, scene, arrays)
        distance = ti.min(d, bound)
        delta = contact_delta(d, arrays.settings[scene, Setting.CONTACT_WIDTH])
        arrays.lanes[contact + Contact.FRICTION * lanes] = friction
        arrays.lanes[contact + Contact.FACE * lanes] = face - FIRST_FACE
        put_lane_numbers(arrays.lanes, contact + Contact.NORMAL * lanes, normal, arrays)
    if moved:
        put_lane_numbers(arrays.lanes, first, x, arrays)
        put_lane_numbers(arrays.lanes, first + features.state.velocity * lanes, v, arrays)
        if solid >= 0:
            mass = arrays.scratch_lanes[(scratch + features.scratch.push + 1) * lanes + lane]
            add_impulse(solid, mass * (velocity - v), lane, worker, arrays)
    arrays.lanes[contact + Contact.DELTA * lanes] = delta
    arrays.lanes[contact + Contact.DISTANCE * lanes] = distance
    arrays.lanes[contact + Contact.FREE * lanes] = free
