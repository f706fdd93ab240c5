"""The reverse of finding contact: distance, normal and friction at the nearest face, and being put onto it.

Distance d, normal n and friction at the nearest face are those of the point of it that is nearest to x. Whether that
lies inside the face, on an edge or at a corner is given: so they are closed forms, which are traced (`at_face`).

A particle that a step has put back onto a face lost d n of its displacement, x'' = x' - d n, and of its velocity what
`after_contact` takes. The bars of faces are those of their corners, normals and friction, each as if it stood
alone: whoever moves a solid moves all of them (`mpm.adjoint.gradient.Gradient.along`). Where a node begins to be deep
in a solid, or the nearest face changes, the flow has a corner in the position of the solid, and the bar is that of one
side. A particle that is put back beyond the end of the face that it crossed, over a ridge, is taken as not put back.
"""

import taichi as ti

from mpm.adjoint.boundary import after_contact_reverse
from mpm.adjoint.layout import impulse_bar
from mpm.adjoint.pullback import Pullback
from mpm.arrays.access import dot, lane_numbers, put_lane_numbers
from mpm.arrays.layout import Contact, Setting
from mpm.arrays.properties import GAP_CUTOFF
from mpm.physics.boundary import after_contact
from mpm.physics.contact import contact_at
from mpm.solids.face_lookup import (
    TINY,
    corners_of,
    face_number,
    foot_on_face,
    frictions_of,
    normal_of,
    reach_of,
    solid_of,
)
from mpm.solids.obstacles import BLEND
from mpm.solids.terrain import (
    cell_code,
    cell_of_triangle,
    corner_frictions,
    in_terrain,
    triangle_corners,
    triangle_number,
)
from mpm.solids.terrain_holds import cells_over, hold_share, hold_weight, node_position

PUT_BACK = 1.0e-6
"""Distance from a face [cells] within which a particle has been put back onto it."""


@ti.func
def found_reverse(worker, block, scratch, after, put_back: ti.template(), scene, arrays: ti.template()):
    """Bars of position, velocity and shear traction of a block before its contact is found, and those of the faces.

    After: those in the history. put_back: whether a particle may have been kept out of a solid; then the velocity
    before that is in the scratch from `before`, and the shear traction behind it. Where the objective depends on
    impulses, the mass [kg] of each particle is in place of `Contact.FREE`, which has no bar, and its bar is left there.
    """
    features, layout, lanes = arrays.features, arrays.layout, arrays.features.lanes
    size = ti.static(features.dimension)
    dx, width = arrays.settings[scene, Setting.CELL], arrays.settings[scene, Setting.CONTACT_WIDTH]
    own = block * layout.width
    for lane in range(lanes):
        present = arrays.lanes[(block * features.state.size + features.state.present) * lanes + lane]
        at = (own + features.state.contacts) * lanes + lane
        then = after * lanes + lane
        contact = then + features.state.contacts * lanes
        delta = arrays.history_lanes[contact + Contact.DELTA * lanes]
        x_bar = lane_numbers(arrays.adjoint_lanes, own * lanes + lane, arrays)
        v_bar = lane_numbers(arrays.adjoint_lanes, (own + features.state.velocity) * lanes + lane, arrays)
        shear_to = (Contact.NORMAL + size) * lanes
        q_bar = lane_numbers(arrays.adjoint_lanes, at + shear_to, arrays)
        mass_bar = 0.0 * present
        if depends(then, scene, arrays) and present > 0.0:
            x = lane_numbers(arrays.history_lanes, then, arrays)
            n = lane_numbers(arrays.history_lanes, contact + Contact.NORMAL * lanes, arrays)
            distance = arrays.history_lanes[contact + Contact.DISTANCE * lanes]
            friction = arrays.history_lanes[contact + Contact.FRICTION * lanes]
            face = face_number(arrays.history_lanes[contact + Contact.FACE * lanes])
            n_bar = lane_numbers(arrays.adjoint_lanes, at + Contact.NORMAL * lanes, arrays)
            friction_bar = arrays.adjoint_lanes[at + Contact.FRICTION * lanes]
            share = ti.min(distance / width, 1.0)
            delta_bar = arrays.adjoint_lanes[at + Contact.DELTA * lanes]
            d_bar = arrays.adjoint_lanes[at + Contact.DISTANCE * lanes]
            d_bar += delta_bar * (12.0 / (width * width)) * share * (share - 1.0)
            back = False
            if ti.static(put_back):
                before = lane_numbers(arrays.scratch_lanes, (scratch + layout.scratch.before) * lanes + lane, arrays)
                q = lane_numbers(arrays.scratch_lanes, (scratch + layout.scratch.before + size) * lanes + lane, arrays)
                if delta == 0.0:
                    q_bar = 0.0 * q_bar
                n_bar = n_bar - q.dot(n) * q_bar - n.dot(q_bar) * q
                q_bar = q_bar - q_bar.dot(n) * n
                back = distance < PUT_BACK * dx
                if back:
                    if before.dot(n) < 0.0:
                        momentum_bar = 0.0 * v_bar
                        if ti.static(layout.impulses):
                            mass = arrays.lanes[contact_at(block, Contact.FREE, arrays) * lanes + lane]
                            stopped = lane_numbers(arrays.history_lanes, then + features.state.velocity * lanes, arrays)
                            taken_bar = impulse_bar(solid_of(face, scene, arrays), worker, arrays)
                            momentum_bar = mass * taken_bar
                            mass_bar += taken_bar.dot(before - stopped)
                        turned, normal_bar, slid = after_contact_reverse(v_bar - momentum_bar, before, n, friction)
                        v_bar = turned + momentum_bar
                        n_bar = n_bar + normal_bar
                        friction_bar += slid
                    # What was lost of the displacement is the depth along n.
                    d_bar = 0.0 - x_bar.dot(n)
            x_bar = x_bar + foot_reverse(x, n, face, d_bar, n_bar, friction_bar, back, scene, arrays)
        elif ti.static(put_back):
            q_bar = 0.0 * q_bar
        put_lane_numbers(arrays.adjoint_lanes, own * lanes + lane, x_bar, arrays)
        put_lane_numbers(arrays.adjoint_lanes, (own + features.state.velocity) * lanes + lane, v_bar, arrays)
        put_lane_numbers(arrays.adjoint_lanes, at + shear_to, q_bar, arrays)
        for column in ti.static(range(len(Contact) - 1 + size)):
            arrays.adjoint_lanes[at + column * lanes] = 0.0 * present
        if ti.static(layout.impulses and put_back):
            arrays.adjoint_lanes[at + Contact.FREE * lanes] = mass_bar


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
def foot_reverse(x, n, face, d_bar, n_bar, friction_bar, back, scene, arrays: ti.template()):
    """Bar of the position `x` [m] from those of its distance, normal and friction at its face, shape [D].

    back: it has been put onto the face, whose inside it is then nearest to. Adds the bars of the face's numbers.
    """
    features = arrays.features
    size = ti.static(features.dimension)
    part = 0
    a, b, c = corners_of(face, scene, arrays)
    facing, mu = normal_of(face, scene, arrays), frictions_of(face, scene, arrays)
    if not back:
        _, part, _ = foot_on_face(x, a, b, c, arrays)
    corners = [point[k] for point in ti.static((a, b, c)[:size]) for k in ti.static(range(size))]
    normal = [facing[k] for k in ti.static(range(size))]
    frictions = [mu[k] for k in ti.static(range(size))]
    numbers = ti.static(([x[k] for k in range(size)], corners, normal, frictions))
    found = ti.static([Pullback(at_face, numbers, (part, [n[k] for k in range(size)], size))])[0]
    bars = [friction_bar, d_bar] + [n_bar[k] for k in ti.static(range(size))]
    x_bar, corners_bar, normal_bar, frictions_bar = ti.static(found(bars))
    for k in ti.static(range(size * size)):
        add_face(face, k, corners_bar[k], scene, arrays)
    for k in ti.static(range(size)):
        add_face(face, features.face.normal + k, normal_bar[k], scene, arrays)
        add_face(face, features.face.friction + k, frictions_bar[k], scene, arrays)
    return ti.Vector([x_bar[k] for k in ti.static(range(size))])


def at_face(x, corners, normal, frictions, part, side, dimension):
    """Friction, distance [m] and normal at the point of a face nearest to `x` [m]; traced.

    part: as `mpm.solids.face_lookup.foot_on_triangle` has it; side: roughly the normal.
    """
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
        d = [(dot(edges[0], each), dot(across, each)) for each in from_corner]
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
    """From a to b; traced."""
    return [b[k] - a[k] for k in range(len(a))]


@ti.func
def add_face(face, column: ti.template(), value, scene, arrays: ti.template()):
    """Add to the bar of a number of a face; of a height field to that of its friction alone, its heights are given."""
    first, size = ti.static(arrays.features.face.friction, arrays.features.dimension)
    if ti.static(arrays.features.listed):
        if not in_terrain(face, scene, arrays):
            arrays.face_adjoints[face, column] += ti.cast(value, ti.f64)
    if ti.static(arrays.features.terrain and first <= column < first + size):
        if in_terrain(face, scene, arrays):
            i, k, half = cell_of_triangle(face, scene, arrays)
            a, b, c = corner_frictions(i, k, half, cell_code(i, k, scene, arrays), scene, arrays)
            at = ti.static([a, b, c])[ti.static(column - first)]
            arrays.terrain_adjoints[scene, at] += ti.cast(value, ti.f64)


@ti.func
def terrain_reverse(bar, v, node, scene, arrays: ti.template()):
    """Bar of a node's velocity `v` [m/s] from that of what the height field takes of it, and this; shape [D] each.

    Adds the bars of friction. The reverse of `mpm.solids.terrain_holds.meet_holds`.
    """
    x, removed, v_bar, total = node_position(node, scene, arrays), 0.0 * v, 0.0 * v, 0.0 * v[0]
    i0, k0, i1, k1 = cells_over(x, scene, arrays)
    blend, limit = BLEND * arrays.settings[scene, Setting.CELL], reach_of(scene, arrays) ** 2
    depth, nearest, share = 0.0 * blend, limit, 0.0 * blend
    # The nearest, the sum of the weights, and what each of the triangles takes.
    for search in range(3):
        if search == 1:
            depth = ti.sqrt(nearest)
            limit = (depth + blend) ** 2
        elif search == 2:
            share = hold_share(depth, total, scene, arrays)
        for i in range(i0, i1):
            for k in range(k0, k1):
                code = cell_code(i, k, scene, arrays)
                for half in range(2 - (code & 2)):
                    a, b, c = triangle_corners(i, k, half, code, scene, arrays)
                    normal = (b - a).cross(c - b).normalized()
                    w, _, from_foot = foot_on_face(x, a, b, c, arrays)
                    square, behind = from_foot.dot(from_foot), 0.0 - from_foot.dot(normal)
                    if search == 0:
                        nearest = ti.min(nearest, square)
                    elif behind > 0.0 and square < limit:
                        weight = hold_weight(square, behind, depth, blend)
                        if search == 1:
                            total += weight
                        elif v.dot(normal) < 0.0:
                            face = triangle_number(i, k, half, scene, arrays)
                            friction, part = w.dot(frictions_of(face, scene, arrays)), share * weight
                            removed += part * (v - after_contact(v, normal, friction))
                            left_bar = (0.0 - part) * bar
                            through, _normal, friction_bar = after_contact_reverse(left_bar, v, normal, friction)
                            v_bar += part * bar + through
                            for corner in ti.static(range(3)):
                                column = ti.static(arrays.features.face.friction + corner)
                                add_face(face, column, w[corner] * friction_bar, scene, arrays)
    return v_bar, removed
