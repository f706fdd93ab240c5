"""Of the faces listed for a cell, the one nearest to a particle, and the first that its displacement crosses.

Lists and lines: `mpm.solids.obstacles`. What it finds is what `datasets.geometry.nearest` finds for all faces.
"""

import taichi as ti

from mpm.arrays.access import node_strides
from mpm.arrays.layout import PADDING, Offset, Setting

SKIN = 1.0e-3
"""Cells by which rounding may have put a particle behind the face it rests on."""
TINY = 1.0e-20
"""Keeps quotients finite."""


@ti.func
def face_vector(face, column, arrays: ti.template()):
    """D numbers of a face from `column` on."""
    return ti.Vector([arrays.faces[face, column + k] for k in ti.static(range(arrays.features.dimension))])


@ti.func
def cell_of(x, scene, arrays: ti.template()):
    """Index in `cell_faces` of the cell that the position `x` [m] lies in."""
    features = arrays.features
    strides = node_strides(scene, arrays)
    index = arrays.offsets[scene, Offset.GEOMETRY]
    for k in ti.static(range(features.dimension)):
        along = ti.floor(x[k] / arrays.settings[scene, Setting.CELL]) + PADDING
        last = arrays.offsets[scene, Offset.CELLS_X + k] + 2 * PADDING
        index += ti.max(0, ti.min(ti.cast(along, ti.i32), last)) * strides[k]
    return index


@ti.func
def first_crossed(start, end, cell_index, cell, arrays: ti.template()):
    """The first face through which the segment from `start` to `end` [m] enters a solid; -1 where it enters none."""
    features = arrays.features
    nearest, found = 0.0 * cell + 2.0, -1
    for at in range(arrays.cell_faces[cell_index], arrays.cell_faces[cell_index + 1]):
        face = arrays.near_faces[at]
        corner, normal = face_vector(face, 0, arrays), face_vector(face, features.face.normal, arrays)
        before, after = (start - corner).dot(normal), (end - corner).dot(normal)
        if after < 0.0 - SKIN * cell and before >= 0.0 - 2.0 * SKIN * cell and after < before:
            part = ti.max(before, 0.0) / (before - after)
            if part < nearest and covers_point(face, start + part * (end - start), arrays):
                nearest, found = part, face
    return found


@ti.func
def covers_point(face, point, arrays: ti.template()):
    """Whether a point [m] in the plane of a face lies in it, or by rounding beside it."""
    features = arrays.features
    a = face_vector(face, 0, arrays)
    b = face_vector(face, features.dimension, arrays)
    if ti.static(features.dimension == 2):
        t = (point - a).dot(b - a) / (b - a).dot(b - a)
        return t > 0.0 - SKIN and t < 1.0 + SKIN
    else:
        c = face_vector(face, 2 * features.dimension, arrays)
        normal = face_vector(face, features.face.normal, arrays)
        area = (b - a).cross(c - a).dot(normal)
        one = (c - b).cross(point - b).dot(normal)
        two = (a - c).cross(point - c).dot(normal)
        return one > 0.0 - SKIN * area and two > 0.0 - SKIN * area and one + two < (1.0 + SKIN) * area


@ti.func
def solid_of(face, arrays: ti.template()):
    """The number of a face's solid."""
    return ti.cast(arrays.faces[face, arrays.features.face.solid], ti.i32)


@ti.func
def foot_on_face(x, face, arrays: ti.template()):
    """Of the foot of `x` [m] on a face: the weights of its corners, the part it lies on, and x less the foot [m]."""
    dimension = ti.static(arrays.features.dimension)
    w, part, from_foot = 0.0 * x, 0, x
    if ti.static(dimension == 2):
        w, part = foot_on_segment(x, face, arrays)
    else:
        w, part = foot_on_triangle(x, face, arrays)
    for k in ti.static(range(dimension)):
        from_foot = from_foot - w[k] * face_vector(face, k * dimension, arrays)
    return w, part, from_foot


@ti.func
def nearest_face(x, last, cell_index, arrays: ti.template()):
    """Of the faces listed for a cell that nearest to `x` [m]: its number, its part that is nearest, the weights of its
    corners at the foot, the normal n [-] and the signed distance d [m], negative inside, with x = foot + d n. last:
    where to look first.
    """
    features = arrays.features
    dimension = ti.static(features.dimension)
    smallest = 0.0 * x[0] + 1.0e30
    face, feature = last, 0
    weights, offset = 0.0 * x, 0.0 * x
    first = arrays.cell_faces[cell_index]
    for number in range(arrays.cell_faces[cell_index + 1] - first + 1):
        candidate, known = last, False
        if number > 0:
            candidate = arrays.near_faces[first + number - 1]
            known = candidate == last
        # No point of a face is nearer than its plane.
        height = (x - face_vector(candidate, 0, arrays)).dot(face_vector(candidate, features.face.normal, arrays))
        if height * height < smallest and not known:
            w, part, from_foot = foot_on_face(x, candidate, arrays)
            square = from_foot.dot(from_foot)
            if square < smallest:
                smallest, face, feature, weights, offset = square, candidate, part, w, from_foot
    # The face's own normal, or at a corner or an edge the mean of its neighbours' (Baerentzen & Aanaes 2005).
    column = features.face.normal + feature * dimension
    normal = face_vector(face, column, arrays)
    d = offset.dot(normal)
    if feature > 0:
        sign = 1.0
        if d < 0.0:
            sign = -1.0
        length = ti.sqrt(smallest)
        d = sign * length
        if length > TINY:
            normal = offset * (sign / length)
    return face, feature, weights, normal, d


@ti.func
def free_path(x, face, weights, normal, d, cell_index, cell, arrays: ti.template()):
    """How far a particle at `x` [m] outside of the solids may move and be nearest to the inside of `face` still [m].

    Its foot has to stay there, it in its cell, which lists no faces but those that its points need, and no face that
    lies in part in front of this one may come nearer: both distances change by no more than its path. 0 where the
    friction varies along the face.
    """
    features = arrays.features
    dimension = ti.static(features.dimension)
    free = cell
    for k in ti.static(range(dimension)):
        above = x[k] - ti.floor(x[k] / cell) * cell
        free = ti.min(free, above, cell - above)
        a = face_vector(face, k * dimension, arrays)
        b = face_vector(face, ti.static((k + 1) % dimension * dimension), arrays)
        if ti.static(dimension == 2):
            free = ti.min(free, weights[k] * (b - a).norm())
        else:
            c = face_vector(face, ti.static((k + 2) % dimension * dimension), arrays)
            free = ti.min(free, weights[k] * (b - a).cross(c - a).norm() / (c - b).norm())
        if arrays.faces[face, features.face.friction + k] != arrays.faces[face, features.face.friction]:
            free = 0.0 * free
    corner = face_vector(face, 0, arrays)
    for at in range(arrays.cell_faces[cell_index], arrays.cell_faces[cell_index + 1]):
        other = arrays.near_faces[at]
        highest = 0.0 * d
        for k in ti.static(range(dimension)):
            highest = ti.max(highest, (face_vector(other, k * dimension, arrays) - corner).dot(normal))
        if highest > SKIN * cell:
            _, _, from_foot = foot_on_face(x, other, arrays)
            free = ti.min(free, 0.5 * (from_foot.norm() - d))
    return free


@ti.func
def foot_on_segment(x, face, arrays: ti.template()):
    """Weights of the corners at the point of a segment nearest to `x` [m]; 0: inside it, 1, 2: that corner."""
    a, b = face_vector(face, 0, arrays), face_vector(face, 2, arrays)
    t = (x - a).dot(b - a) / (b - a).dot(b - a)
    part = 0
    if t <= 0.0:
        t, part = 0.0 * t, 1
    elif t >= 1.0:
        t, part = 0.0 * t + 1.0, 2
    return ti.Vector([1.0 - t, t]), part


@ti.func
def foot_on_triangle(x, face, arrays: ti.template()):
    """Weights of the corners at the point of a triangle nearest to `x` [m] (Ericson 2005, section 5.1.5).

    0: inside it; 1, 2, 3: that corner; 4, 5, 6: the edge from corner 1 to 2, 2 to 3, 3 to 1.
    """
    a, b, c = face_vector(face, 0, arrays), face_vector(face, 3, arrays), face_vector(face, 6, arrays)
    ab, ac = b - a, c - a
    d1, d2 = ab.dot(x - a), ac.dot(x - a)
    d3, d4 = ab.dot(x - b), ac.dot(x - b)
    d5, d6 = ab.dot(x - c), ac.dot(x - c)
    va, vb, vc = d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2
    part = 0
    w = ti.Vector([va, vb, vc]) / ti.max(va + vb + vc, TINY)
    if d1 <= 0.0 and d2 <= 0.0:
        w, part = ti.Vector([1.0, 0.0, 0.0]) + 0.0 * w, 1
    elif d3 >= 0.0 and d4 <= d3:
        w, part = ti.Vector([0.0, 1.0, 0.0]) + 0.0 * w, 2
    elif d6 >= 0.0 and d5 <= d6:
        w, part = ti.Vector([0.0, 0.0, 1.0]) + 0.0 * w, 3
    elif vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        t = d1 / (d1 - d3)
        w, part = ti.Vector([1.0 - t, t, 0.0]), 4
    elif va <= 0.0 and d4 >= d3 and d5 >= d6:
        t = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        w, part = ti.Vector([0.0, 1.0 - t, t]), 5
    elif vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        t = d2 / (d2 - d6)
        w, part = ti.Vector([1.0 - t, 0.0, t]), 6
    return w, part
