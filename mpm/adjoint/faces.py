"""The reverse of finding contact: distance, normal and friction at the nearest face, and being put onto it.

For a particle whose nearest point lies inside a face with corner a, d = (x - a) . n, so d' moves x along n and a
against it, and n' is the face's. At a corner c (in 3D also an edge with direction t and weights w_k of its ends)
d = |x - c| and

    dn = (I - n n^T - t t^T) (dx - sum_k w_k dc_k) / d - t (n . (dc_2 - dc_1)) / length

A particle that a step has put back onto a face lost d n of its displacement, x'' = x' - d n, and of its velocity what
`after_contact` takes. The bars of faces are those of their corners, normals, friction and adhesion, each as if it stood
alone: whoever moves a solid moves all of them (`mpm.adjoint.gradient.Gradient.along`). Where a node begins to be deep
in a solid, or the nearest face changes, the flow has a corner in the position of the solid, and the bar is that of one
side. Friction that differs along a face, mu = sum_k w_k mu_k, has a slope grad mu in it, by which x moves along and
corner k by -w_k against it. A particle that is put back beyond the end of the face that it crossed, over a ridge, is
taken as not put back.
"""

import taichi as ti

from mpm.adjoint.access import lane_numbers, put_lane_numbers
from mpm.adjoint.boundary import after_contact_reverse
from mpm.arrays.layout import Contact, Setting, Worker
from mpm.arrays.properties import GAP_CUTOFF
from mpm.solids.face_lookup import face_vector, foot_on_segment, foot_on_triangle, solid_of

PUT_BACK = 1.0e-6
"""Distance from a face [cells] within which a particle has been put back onto it."""
TINY = 1.0e-20
"""Keeps quotients finite, as in the step."""


@ti.func
def found_reverse(worker, block, scratch, after, put_back: ti.template(), scene, arrays: ti.template()):
    """Bars of position, velocity and shear traction of a block before its contact is found, and those of the faces.

    After: those in the history. put_back: whether a particle may have been kept out of a solid; then the velocity
    before that is in the scratch from `layout.before`, and the shear traction behind it. Where the objective depends on
    impulses, the mass [kg] of each particle is in `Contact.IMPULSE`, where its bar is left.
    """
    features, layout, lanes = arrays.features, arrays.layout, arrays.features.lanes
    size = ti.static(features.dimension)
    dx, width = arrays.settings[scene, Setting.CELL], arrays.settings[scene, Setting.CONTACT_WIDTH]
    own = block * layout.width
    for lane in range(lanes):
        present = arrays.lanes[(block * features.block + features.present) * lanes + lane]
        at = (own + layout.contacts) * lanes + lane
        then = after * lanes + lane
        contact = then + layout.history_contacts * lanes
        delta = arrays.history_lanes[contact + Contact.DELTA * lanes]
        x_bar, v_bar = (
            lane_numbers(arrays.adjoint_lanes, own * lanes + lane, arrays),
            lane_numbers(arrays.adjoint_lanes, (own + features.velocity) * lanes + lane, arrays),
        )
        shear_to = (Contact.NORMAL + size) * lanes
        q_bar = lane_numbers(arrays.adjoint_lanes, at + shear_to, arrays)
        mass_bar = 0.0 * present
        if depends(then, scene, arrays) and present > 0.0:
            x = lane_numbers(arrays.history_lanes, then, arrays)
            n = lane_numbers(arrays.history_lanes, contact + Contact.NORMAL * lanes, arrays)
            distance = arrays.history_lanes[contact + Contact.DISTANCE * lanes]
            friction = arrays.history_lanes[contact + Contact.FRICTION * lanes]
            face = ti.cast(arrays.history_lanes[contact + Contact.FACE * lanes], ti.i32)
            n_bar = lane_numbers(arrays.adjoint_lanes, at + Contact.NORMAL * lanes, arrays)
            friction_bar = arrays.adjoint_lanes[at + Contact.FRICTION * lanes]
            add_face(face, features.face_adhesion, arrays.adjoint_lanes[at + Contact.ADHESION * lanes], arrays)
            share = ti.min(distance / width, 1.0)
            d_bar = arrays.adjoint_lanes[at + Contact.DISTANCE * lanes] + arrays.adjoint_lanes[
                at + Contact.DELTA * lanes
            ] * (12.0 / (width * width)) * share * (share - 1.0)
            back = False
            if ti.static(put_back):
                before = lane_numbers(arrays.scratch_lanes, (scratch + layout.before) * lanes + lane, arrays)
                q = lane_numbers(arrays.scratch_lanes, (scratch + layout.before + size) * lanes + lane, arrays)
                if delta == 0.0:
                    q_bar = 0.0 * q_bar
                n_bar = n_bar - q.dot(n) * q_bar - n.dot(q_bar) * q
                q_bar = q_bar - q_bar.dot(n) * n
                back = distance < PUT_BACK * dx
                if back:
                    if before.dot(n) < 0.0:
                        momentum_bar = 0.0 * v_bar
                        if ti.static(layout.impulses):
                            mass = arrays.lanes[
                                (block * features.block + features.contacts + Contact.IMPULSE) * lanes + lane
                            ]
                            first = arrays.workers[worker, Worker.IMPULSE] + solid_of(face, arrays) * size
                            stopped = lane_numbers(arrays.history_lanes, then + features.velocity * lanes, arrays)
                            for k in ti.static(range(size)):
                                momentum_bar[k] = mass * arrays.impulse_adjoints[first + k]
                                mass_bar += arrays.impulse_adjoints[first + k] * (before[k] - stopped[k])
                        turned, normal_bar, slid = after_contact_reverse(v_bar - momentum_bar, before, n, friction)
                        v_bar = turned + momentum_bar
                        n_bar = n_bar + normal_bar
                        friction_bar += slid
                    # What was lost of the displacement is the depth along n.
                    d_bar = 0.0 - x_bar.dot(n)
            x_bar = x_bar + foot_reverse(x, n, face, d_bar, n_bar, friction_bar, back, arrays)
        elif ti.static(put_back):
            q_bar = 0.0 * q_bar
        put_lane_numbers(arrays.adjoint_lanes, own * lanes + lane, x_bar, arrays)
        put_lane_numbers(arrays.adjoint_lanes, (own + features.velocity) * lanes + lane, v_bar, arrays)
        put_lane_numbers(arrays.adjoint_lanes, at + shear_to, q_bar, arrays)
        for column in ti.static(range(len(Contact) - 1 + size)):
            arrays.adjoint_lanes[at + column * lanes] = 0.0 * present
        if ti.static(layout.impulses and put_back):
            arrays.adjoint_lanes[at + Contact.IMPULSE * lanes] = mass_bar


@ti.func
def depends(then, scene, arrays: ti.template()):
    """Whether a lane, whose first number in the history is `then`, depends on its solid: within the width of contact;

    with volume correction out to where a solid hides mass.
    """
    layout, lanes = arrays.layout, arrays.features.lanes
    contact = then + layout.history_contacts * lanes
    if ti.static(arrays.features.volume_correction):
        return (
            arrays.history_lanes[contact + Contact.DISTANCE * lanes] < GAP_CUTOFF * arrays.settings[scene, Setting.CELL]
        )
    else:
        return arrays.history_lanes[contact + Contact.DELTA * lanes] > 0.0


@ti.func
def foot_reverse(x, n, face, d_bar, n_bar, friction_bar, back, arrays: ti.template()):
    """Bar of the position `x` [m] from those of its distance, normal and friction at its face, shape [D].

    back: it has been put onto the face, whose inside it is then nearest to. Adds the bars of the face's numbers.
    """
    features = arrays.features
    size = ti.static(features.dimension)
    w, part = 0.0 * x, 0
    if ti.static(size == 2):
        w, part = foot_on_segment(x, face, arrays)
    else:
        w, part = foot_on_triangle(x, face, arrays)
    if back:
        part = 0
    result = d_bar * n
    for k in ti.static(range(size)):
        add_face(face, features.face_friction + k, w[k] * friction_bar, arrays)
    if part == 0:
        corner = face_vector(face, 0, arrays)
        for k in ti.static(range(size)):
            add_face(face, k, 0.0 - d_bar * n[k], arrays)
            add_face(face, features.face_normal + k, d_bar * (x[k] - corner[k]) + n_bar[k], arrays)
    else:
        offset, along, length = x, 0.0 * x, 0.0 * d_bar + 1.0
        for k in ti.static(range(size)):
            offset = offset - w[k] * face_vector(face, k * size, arrays)
        first, second = 0, 0
        if ti.static(size == 3):  # noqa: SIM102 (only of edges is there a part above 3)
            if part > 3:
                first, second = part - 4, (part - 3) % 3
                along = face_vector(face, second * size, arrays) - face_vector(face, first * size, arrays)
                length = along.norm()
                along = along / length
        square = offset.norm()
        if square > TINY:
            across = (n_bar - n_bar.dot(n) * n - n_bar.dot(along) * along) / offset.dot(n)
            result = result + across
        turn = n_bar.dot(along) / length
        for k in ti.static(range(size)):
            for i in ti.static(range(size)):
                add_face(face, k * size + i, 0.0 - w[k] * result[i], arrays)
        if ti.static(size == 3):  # noqa: SIM102 (only of edges is there a part above 3)
            if part > 3:
                for i in ti.static(range(size)):
                    add_face(face, second * size + i, 0.0 - turn * n[i], arrays)
                    add_face(face, first * size + i, turn * n[i], arrays)
    return result + friction_reverse(x, n, w, face, part, friction_bar, arrays)


@ti.func
def friction_reverse(x, n, w, face, part, bar, arrays: ti.template()):
    """Bar of the position `x` [m] from that of the friction between the corners of its face, shape [D].

    w, part: as `foot_on_triangle` has them. Adds the bars of the corners: along the face the foot moves by -w_k of what
    corner k does, and where a corner moves by h along n the face turns, by which the foot moves by d h grad w_k.
    """
    features = arrays.features
    size = ti.static(features.dimension)
    slope, distance = 0.0 * x, x.dot(n)
    for k in ti.static(range(size)):
        slope += arrays.faces[face, features.face_friction + k] * weight_slope(face, part, k, arrays)
        distance -= w[k] * face_vector(face, k * size, arrays).dot(n)
    for k in ti.static(range(size)):
        turned = distance * slope.dot(weight_slope(face, part, k, arrays))
        for i in ti.static(range(size)):
            add_face(face, k * size + i, bar * (turned * n[i] - w[k] * slope[i]), arrays)
    return bar * slope


@ti.func
def weight_slope(face, part, k: ti.template(), arrays: ti.template()):
    """grad w_k [1/m] of corner k of a face along it, at its inside or on an edge; 0 at a corner; shape [D]."""
    size = ti.static(arrays.features.dimension)
    this = face_vector(face, k * size, arrays)
    after = face_vector(face, ti.static((k + 1) % size) * size, arrays)
    slope = 0.0 * this
    if ti.static(size == 2):
        if part == 0:
            slope = (this - after) / (this - after).norm_sqr()
    else:
        last = face_vector(face, ti.static((k + 2) % size) * size, arrays)
        if part == 0:
            n = face_vector(face, arrays.features.face_normal, arrays)
            slope = n.cross(last - after) / (after - this).cross(last - this).dot(n)
        # The edge from this corner to the one after it, then that from the one before it.
        if part == 4 + k:
            slope = (this - after) / (this - after).norm_sqr()
        if part == 4 + (k + 2) % 3:
            slope = (this - last) / (this - last).norm_sqr()
    return slope


@ti.func
def add_face(face, column, value, arrays: ti.template()):
    """Add to the bar of a number of a face."""
    arrays.face_adjoints[face, column] += ti.cast(value, ti.f64)
