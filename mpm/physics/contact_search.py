"""The face that each particle is nearest to, and the way of a step that ends where it meets one.

No particle passes a face: a displacement that crosses one ends there and goes on along it. Of a block, all lanes at
once, first those particles are done whose nearest face is the same as before (`follow_faces`), then those whose nearest
triangle of a height field is known by one look (`find_terrain`); each of the others searches (`find_contact`).

**One look at a height field.** Let p be the distance of x from the plane of a triangle T, and the foot of x lie in T, e
from its edges. With t the largest tan of an angle between T and triangles around it, a point of these that is l from
the foot along T rises by at most t (l - e) towards x. The square of its distance is at least l^2 + p^2 - 2 p t (l - e),
which is no less than p^2 if e >= p t / 2: T is the nearest. A point within p of x is within p along T and, as it may
be as deep, 2 p in plan: among the triangles around T if p is no more than the distance between posts and t at most 1.
For the same reason a way of length s that ends at x is clear of the others where it is t (s - e) above T. It counts as
clear down to CUT_BUMP below that: a particle may cut such a bump of the ground, and is put out of T where it ends.
"""

import taichi as ti

from mpm.arrays.access import add, dot, lane_numbers, maximum, minimum, over_lanes, put_lane_numbers, vectors
from mpm.arrays.layout import FIRST_FACE, Contact, Look, Offset, Setting, Worker
from mpm.physics.boundary import add_impulse, after_contact
from mpm.physics.contact import contact_at, present
from mpm.solids.face_lookup import (
    TINY,
    cell_of,
    face_number,
    first_crossed,
    free_path,
    frictions_of,
    list_of,
    nearest_face,
    solid_of,
    unlisted_distance,
)
from mpm.solids.terrain import (
    UNKNOWN,
    corner_frictions,
    post_spacing,
    tilt_around,
    triangle_corners,
    triangle_number,
    triangle_under,
)

CUT_BUMP = 0.02
"""Height [cells] of what the way of a step may cut off a height field, whose contact is a cell wide."""
MAX_CROSSINGS = 3
"""Faces along which the displacement of one step is led; beyond them the particle stays where it was."""


@ti.func
def find_contacts(block, scratch, mass, worker, scene, arrays: ti.template()):
    """Keep the particles of a block, moved already, out of the solids, and find the face that each is nearest to;
    `mass` [kg] of each lane. A particle whose distance was d and that has moved by s has one of at least d - s now: as
    long as that is beyond the contact no face is searched, nor where the nearest one is known to be (`free_path`).
    """
    features, lanes = arrays.features, arrays.features.lanes
    size = ti.static(features.dimension)
    x, distance = block * features.state.size, contact_at(block, Contact.DISTANCE, arrays)
    origin = scratch + features.scratch.origin
    moved = [arrays.state[x + k] - arrays.scratch[origin + k] for k in ti.static(range(size))]
    path = 1.001 * ti.sqrt(dot(moved, moved))
    lower_bound = arrays.state[distance] - path
    nearby = arrays.settings[scene, Setting.SEARCH_DISTANCE]
    if over_lanes(minimum, lower_bound, arrays.features.lanes) >= nearby:
        arrays.state[distance] = lower_bound
    else:
        arrays.scratch[scratch + features.scratch.push + 1] = mass * present(block, arrays)
        searched = follow_faces(block, scratch, moved, path, nearby, scene, arrays)
        if ti.static(features.terrain):
            if searched and arrays.offsets[scene, Offset.POSTS_X] > 0:
                searched = find_terrain(block, scratch, moved, path, nearby, worker, scene, arrays)
        if searched:
            for lane in range(lanes):
                bound = arrays.scratch_lanes[(scratch + features.scratch.push) * lanes + lane]
                if bound < nearby:
                    find_contact(block, scratch, lane, bound, worker, scene, arrays)


@ti.func
def follow_faces(block, scratch, moved: ti.template(), path, nearby, scene, arrays: ti.template()):
    """Contact of the particles of a block that are still nearest to the inside of the same face, or to none `nearby`.

    moved: their displacement [m], D vectors; path: no less than its length [m]. Leaves in `scratch` the lower bound of
    the distance of each particle whose face has to be searched, and `nearby` of the others; returns whether there are
    any to search.
    """
    features = arrays.features
    size = ti.static(features.dimension)
    contact, width = contact_at(block, 0, arrays), arrays.settings[scene, Setting.CONTACT_WIDTH]
    bound, free = arrays.state[contact + Contact.DISTANCE] - path, arrays.state[contact + Contact.FREE] - path
    d = arrays.state[contact + Contact.DISTANCE]
    for k in ti.static(range(size)):
        d = d + moved[k] * arrays.state[contact + Contact.NORMAL + k]
    # As long as the face is the nearest, a way on its outer side meets none.
    follows = (free > 0.0) & (d > 0.0)
    d = ti.select(follows, d, bound)
    delta = ti.select(follows, contact_delta(d, width), 0.0)
    bound = ti.select(follows, nearby, bound)
    arrays.state[contact + Contact.DISTANCE] = d
    arrays.state[contact + Contact.DELTA] = delta
    # Beyond the search the distance becomes a bound, from which no face can be followed.
    arrays.state[contact + Contact.FREE] = ti.select(d < nearby, free, 0.0)
    for k in ti.static(range(size)):
        at = contact + Contact.NORMAL + size + k
        arrays.state[at] = ti.select(follows & (delta == 0.0), 0.0, arrays.state[at])
    arrays.scratch[scratch + features.scratch.push] = bound
    return over_lanes(minimum, bound, arrays.features.lanes) < nearby


@ti.func
def find_terrain(block, scratch, moved, path, nearby, worker, scene, arrays: ti.template()):
    """As `follow_faces`, of those it left to search whose nearest triangle of a height field is known by one look."""
    features = arrays.features
    position = vectors(arrays.state, block * features.state.size, 3)
    seen, push = scratch + features.scratch.look, scratch + features.scratch.push
    for k in ti.static(range(3)):
        arrays.scratch[seen + k] = position[k]
    for look in range(2):
        for lane in range(features.lanes):
            if arrays.scratch_lanes[push * features.lanes + lane] < nearby:
                # Over the foot there may be another triangle than over the particle.
                if look == 0 or arrays.scratch_lanes[(seen + Look.EDGE) * features.lanes + lane] <= 0.0:
                    look_at_terrain(seen * features.lanes + lane, look, scene, arrays)
        facing, square = plane_of(seen, arrays)
        apart = [position[k] - arrays.scratch[seen + Look.CORNERS + k] for k in ti.static(range(3))]
        scaled = dot(apart, facing) / square
        for k in ti.static(range(3)):
            arrays.scratch[seen + k] = position[k] - scaled * facing[k]
        _, arrays.scratch[seen + Look.EDGE] = foot_weights(seen, facing, square, arrays)
    across, size = plane_of(seen, arrays)
    weights, edge = foot_weights(seen, across, size, arrays)
    length = ti.sqrt(size)
    d = dot([position[k] - arrays.scratch[seen + Look.CORNERS + k] for k in ti.static(range(3))], across) / length
    normal = [across[k] / length for k in ti.static(range(3))]
    tilt, bound = arrays.scratch[seen + Look.TILT], arrays.scratch[push]
    limit = arrays.scratch[seen + Look.LIMIT]
    depth, before = maximum(d, 0.0 - d), d - dot(moved, normal)
    free = minimum((edge - 0.5 * depth * tilt) / (1.0 + 0.5 * tilt), limit - depth)
    post = post_spacing(scene, arrays)
    bump = CUT_BUMP * arrays.settings[scene, Setting.CELL]
    clear = minimum(maximum(d, 0.0), before) + bump > tilt * maximum(path - edge, 0.0)
    clear = (clear & (tilt < UNKNOWN) & (path < post)) | ((bound > 0.0) & (d > 0.0))
    known = (bound < nearby) & (free > 0.0) & clear
    put_terrain_contact(block, scratch, known, d, normal, weights, free, worker, scene, arrays)
    arrays.scratch[push] = ti.select(known, nearby, bound)
    return over_lanes(minimum, arrays.scratch[push], arrays.features.lanes) < nearby


@ti.func
def look_at_terrain(at, look, scene, arrays: ti.template()):
    """Leave from `at` on in `scratch_lanes` what a `look`, 0 at a particle, 1 at its foot, sees of the triangle."""
    lanes = arrays.features.lanes
    place = lane_numbers(arrays.scratch_lanes, at, arrays)
    i, k, half, code = triangle_under(place, scene, arrays)
    number = 1.0 * (triangle_number(i, k, half, scene, arrays) - FIRST_FACE)
    if look == 0:
        limit = post_spacing(scene, arrays)
        if ti.static(arrays.features.listed):
            entry = cell_of(place, scene, arrays)
            _, listed = list_of(entry, arrays)
            limit = ti.min(limit, unlisted_distance(place, entry, scene, arrays))
            if listed > 0:
                limit = 0.0 * limit
        arrays.scratch_lanes[at + Look.LIMIT * lanes] = limit
    if look == 0 or number != arrays.scratch_lanes[at + Look.FACE * lanes]:
        arrays.scratch_lanes[at + Look.TILT * lanes] = tilt_around(i, k, half, scene, arrays)
        first, second, third = corner_frictions(i, k, half, code, scene, arrays)
        friction = ti.Vector([arrays.terrain[first], arrays.terrain[second], arrays.terrain[third]])
        put_lane_numbers(arrays.scratch_lanes, at + Look.FRICTION * lanes, friction, arrays)
        a, b, c = triangle_corners(i, k, half, code, scene, arrays)
        put_lane_numbers(arrays.scratch_lanes, at + Look.CORNERS * lanes, a, arrays)
        put_lane_numbers(arrays.scratch_lanes, at + (Look.CORNERS + 3) * lanes, b, arrays)
        put_lane_numbers(arrays.scratch_lanes, at + (Look.CORNERS + 6) * lanes, c, arrays)
        arrays.scratch_lanes[at + Look.FACE * lanes] = number


@ti.func
def cross(a: ti.template(), b: ti.template()):
    """As `dot`, of three components."""
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


@ti.func
def side_of(seen, first: ti.template(), second: ti.template(), arrays: ti.template()):
    """From one place in the scratch to another [m], a list of three vectors: the foot is 0, the corners are 1 to 3."""
    return [arrays.scratch[seen + 3 * second + k] - arrays.scratch[seen + 3 * first + k] for k in ti.static(range(3))]


@ti.func
def plane_of(seen, arrays: ti.template()):
    """The normal of the triangles that `look_at_terrain` left, as long as twice their areas, and its square."""
    across = cross(side_of(seen, 1, 2, arrays), side_of(seen, 2, 3, arrays))
    return across, dot(across, across)


@ti.func
def foot_weights(seen, across: ti.template(), size, arrays: ti.template()):
    """The weights of the corners at the feet [-], a list of three, and no more than their distances from edges [m]."""
    ab, bc, ca = side_of(seen, 1, 2, arrays), side_of(seen, 2, 3, arrays), side_of(seen, 3, 1, arrays)
    first = dot(cross(bc, side_of(seen, 2, 0, arrays)), across) / size
    second = dot(cross(ca, side_of(seen, 3, 0, arrays)), across) / size
    third = 1.0 - first - second
    longest = maximum(maximum(dot(ab, ab), dot(bc, bc)), dot(ca, ca))
    return [first, second, third], minimum(minimum(first, second), third) * ti.sqrt(size / longest)


@ti.func
def put_terrain_contact(
    block, scratch, known, d, normal: ti.template(), weights: ti.template(), free, worker, scene, arrays: ti.template()
):
    """Contact of the lanes `known` of a block with a height field; what is inside is put out and stopped.

    d: their signed distances [m]; weights: of the corners at their feet; free: how far they may move [m].
    """
    features = arrays.features
    first, contact = block * features.state.size, contact_at(block, 0, arrays)
    seen, nearby = scratch + features.scratch.look, arrays.settings[scene, Setting.SEARCH_DISTANCE]
    rough = [arrays.scratch[seen + Look.FRICTION + k] for k in ti.static(range(3))]
    friction = dot(weights, rough)
    alike = (rough[0] == rough[1]) & (rough[1] == rough[2])
    friction = ti.select(alike, rough[0], friction)
    inside = known & (d < 0.0)
    outside = maximum(d, 0.0)
    delta = contact_delta(outside, arrays.settings[scene, Setting.CONTACT_WIDTH])
    velocity = vectors(arrays.state, first + features.state.velocity, 3)
    into = dot(velocity, normal)
    along = [velocity[k] - into * normal[k] for k in ti.static(range(3))]
    speed = ti.sqrt(dot(along, along) + TINY)
    keep = maximum(1.0 + friction * into / speed, 0.0)
    stopped = inside & (into < 0.0)
    mass = arrays.scratch[scratch + features.scratch.push + 1]
    impulse = arrays.workers[worker, Worker.IMPULSE] + arrays.offsets[scene, Offset.TERRAIN_SOLID] * 3
    q = vectors(arrays.state, contact + Contact.NORMAL + 3, 3)
    pressed = dot(q, normal)
    for k in ti.static(range(3)):
        arrays.state[first + k] = ti.select(inside, arrays.state[first + k] - d * normal[k], arrays.state[first + k])
        lost = ti.select(stopped, velocity[k] - keep * along[k], 0.0)
        arrays.state[first + features.state.velocity + k] = velocity[k] - lost
        add(arrays.impulse, impulse + k, mass * lost, arrays)
        # The shear traction turns with the surface, and ends where the particle leaves it.
        shear = ti.select(delta > 0.0, q[k] - pressed * normal[k], 0.0)
        at = contact + Contact.NORMAL + k
        arrays.state[at] = ti.select(known, normal[k], arrays.state[at])
        arrays.state[at + 3] = ti.select(known, shear, arrays.state[at + 3])
    put_known(contact + Contact.FRICTION, known, friction, arrays)
    put_known(contact + Contact.FACE, known, arrays.scratch[seen + Look.FACE], arrays)
    put_known(contact + Contact.DELTA, known, delta, arrays)
    put_known(contact + Contact.DISTANCE, known, outside, arrays)
    put_known(contact + Contact.FREE, known, ti.select(alike & (d > 0.0) & (d < nearby), free, 0.0), arrays)


@ti.func
def put_known(at, known, value, arrays: ti.template()):
    """Put `value` in the lanes `known` of a vector of the state."""
    arrays.state[at] = ti.select(known, value, arrays.state[at])


@ti.func
def contact_delta(d, width):
    """delta_h [1/m] of the distance `d` [m], not negative."""
    q = minimum(d / width, 1.0)
    return 2.0 / width * (1.0 - q * q * (3.0 - 2.0 * q))


@ti.func
def find_contact(block, scratch, lane, bound, worker, scene, arrays: ti.template()):
    """Contact of the particle in `lane` of a block: where its displacement ends, and the face nearest to that.

    bound: its distance is no less [m]; if that is positive it has met no face.
    """
    features, lanes = arrays.features, arrays.features.lanes
    dimension = ti.static(features.dimension)
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
            face, corner, normal = first_crossed(start, x, start_entry, cell, scene, arrays)
            if face < 0:
                break
            x = x - (x - corner).dot(normal) * normal
            if rotation == MAX_CROSSINGS - 1:
                x = start
            moved = True
            if v.dot(normal) < 0.0:
                v = after_contact(v, normal, frictions_of(face, scene, arrays)[0])
                solid = solid_of(face, scene, arrays)
    entry = cell_of(x, scene, arrays)
    delta, distance, free = 0.0 * cell, unlisted_distance(x, entry, scene, arrays), 0.0 * cell
    _, listed = list_of(entry, arrays)
    if ti.static(features.terrain) or listed > 0:
        last = face_number(arrays.lanes[contact + Contact.FACE * lanes])
        face, feature, weights, normal, d, bound, free = nearest_face(x, last, entry, scene, arrays)
        if feature == 0 and d > 0.0 and d < arrays.settings[scene, Setting.SEARCH_DISTANCE]:
            free = free_path(x, face, weights, normal, d, free, entry, cell, scene, arrays)
        else:
            free = 0.0 * free
        friction = weights.dot(frictions_of(face, scene, arrays))
        if d < 0.0:
            x = x - d * normal
            d, moved = 0.0 * d, True
            if v.dot(normal) < 0.0:
                v = after_contact(v, normal, friction)
                solid = solid_of(face, scene, arrays)
        distance = ti.min(d, bound)
        delta = contact_delta(d, arrays.settings[scene, Setting.CONTACT_WIDTH])
        arrays.lanes[contact + Contact.FRICTION * lanes] = friction
        arrays.lanes[contact + Contact.FACE * lanes] = face - FIRST_FACE
        # The shear traction turns with the surface, and ends where the particle leaves it.
        shear = lane_numbers(arrays.lanes, contact + (Contact.NORMAL + dimension) * lanes, arrays)
        shear = shear - shear.dot(normal) * normal
        if delta == 0.0:
            shear = 0.0 * shear
        put_lane_numbers(arrays.lanes, contact + Contact.NORMAL * lanes, normal, arrays)
        put_lane_numbers(arrays.lanes, contact + (Contact.NORMAL + dimension) * lanes, shear, arrays)
    if moved:
        put_lane_numbers(arrays.lanes, first, x, arrays)
        put_lane_numbers(arrays.lanes, first + features.state.velocity * lanes, v, arrays)
        if solid >= 0:
            mass = arrays.scratch_lanes[(scratch + features.scratch.push + 1) * lanes + lane]
            add_impulse(solid, mass * (velocity - v), lane, worker, arrays)
    arrays.lanes[contact + Contact.DELTA * lanes] = delta
    arrays.lanes[contact + Contact.DISTANCE * lanes] = distance
    arrays.lanes[contact + Contact.FREE * lanes] = free
