"""The face nearest to a particle, and the first face that its displacement crosses.

The search covers the faces listed for the particle's cell (`mpm.solids.obstacles`). The result equals that of
`datasets.geometry.nearest` for all faces.
"""

import taichi as ti

from mpm.arrays.layout import FIRST_FACE, PADDING, Offset, Setting
from mpm.solids.terrain import in_terrain

SKIN = 1.0e-3  # cells by which rounding may move a particle behind the face it rests on
SLACK = 0.25  # cells by which a particle may be outside its cell and still find the nearest face in its list
TINY = 1.0e-20  # keeps quotients finite


@ti.func
def face_number(value):
    """The number of a face from its value stored as a real."""
    return ti.cast(value, ti.i32) + FIRST_FACE


@ti.func
def listed_vector(face, column, arrays: ti.template()):
    """D numbers of a listed face from `column` on."""
    return ti.Vector([arrays.faces[face, column + k] for k in ti.static(range(arrays.features.dimension))])


@ti.func
def corners_of(face, arrays: ti.template()):
    """The corners of a face [m], three vectors of shape [D]; a segment repeats its last."""
    size = ti.static(arrays.features.dimension)
    last = ti.static(size * (size - 1))
    return listed_vector(face, 0, arrays), listed_vector(face, size, arrays), listed_vector(face, last, arrays)


@ti.func
def normal_of(face, arrays: ti.template()):
    """The outward unit normal of a face, shape [D]."""
    return listed_vector(face, arrays.features.face.normal, arrays)


@ti.func
def frictions_of(face, arrays: ti.template()):
    """The Coulomb coefficients at the corners of a face [-], shape [D]."""
    return listed_vector(face, arrays.features.face.friction, arrays)


@ti.func
def solid_of(face, scene, arrays: ti.template()):
    """The number of a face's solid."""
    solid = 0
    if ti.static(arrays.features.listed):
        if not in_terrain(face, scene, arrays):
            solid = ti.cast(arrays.faces[face, arrays.features.face.solid], ti.i32)
    if ti.static(arrays.features.terrain):
        if in_terrain(face, scene, arrays):
            solid = arrays.offsets[scene, Offset.TERRAIN_SOLID]
    return solid


@ti.func
def entry_of(node, scene, arrays: ti.template()):
    """The entry of a node, [D], or of the cell above it in `cell_faces`, `node_holds` and `covered`; -1 if none."""
    entry, inside = 0, True
    for k in ti.static(range(arrays.features.dimension)):
        along = node[k] - arrays.offsets[scene, Offset.WINDOW_LOW_X + k]
        count = arrays.offsets[scene, Offset.WINDOW_X + k]
        inside = inside and along >= 0 and along < count
        entry = entry * count + along
    entry += arrays.offsets[scene, Offset.GEOMETRY]
    if not inside:
        entry = -1
    return entry


@ti.func
def cell_of(x, scene, arrays: ti.template()):
    """The entry of the cell that the position `x` [m] lies in."""
    cell = arrays.settings[scene, Setting.CELL]
    place = [ti.cast(ti.floor(x[k] / cell), ti.i32) + PADDING for k in ti.static(range(arrays.features.dimension))]
    return entry_of(place, scene, arrays)


@ti.func
def list_of(entry, arrays: ti.template()):
    """Start of the faces listed for a cell in `near_faces`, and their number."""
    first, count = 0, 0
    if ti.static(arrays.features.listed):
        if entry >= 0:
            first = arrays.cell_faces[entry]
            count = arrays.cell_faces[entry + 1] - first
    return first, count


@ti.func
def holds_of_node(entry, arrays: ti.template()):
    """The range [first, end) of the holds of a node in `holds`, by its entry."""
    first, end = 0, 0
    if ti.static(arrays.features.listed):
        if entry >= 0:
            first, end = arrays.node_holds[entry], arrays.node_holds[entry + 1]
    return first, end


@ti.func
def unlisted_distance(x, entry, scene, arrays: ti.template()):
    """A lower bound of the distance of `x` [m] from the faces that are not listed for its cell [m]."""
    cell = arrays.settings[scene, Setting.CELL]
    bound = 0.0 * cell + 1.0e30
    if ti.static(arrays.features.listed):
        if entry >= 0:
            bound = arrays.cell_distance[entry]
        elif arrays.offsets[scene, Offset.WINDOW_X] > 0:
            square = 0.0 * cell
            for k in ti.static(range(arrays.features.dimension)):
                low = arrays.offsets[scene, Offset.WINDOW_LOW_X + k] - PADDING
                low_x, high_x = low * cell, (low + arrays.offsets[scene, Offset.WINDOW_X + k]) * cell
                apart = ti.max(low_x - x[k], x[k] - high_x, 0.0 * cell)
                square += apart * apart
            # Beyond the distance up to which faces are listed (`mpm.solids.obstacles.farthest`).
            bound = arrays.settings[scene, Setting.SEARCH_DISTANCE] + cell + ti.sqrt(square)
    return bound


@ti.func
def first_crossed(start, end, entry, cell, arrays: ti.template()):
    """The first face through which the segment from `start` to `end` [m] enters a solid, -1 if it enters none, with its
    first corner and its normal. entry: of the cell of its start.
    """
    nearest, crossed, corner, facing = 0.0 * cell + 2.0, -1, 0.0 * start, 0.0 * start
    first, listed = list_of(entry, arrays)
    for number in range(listed):
        face = arrays.near_faces[first + number]
        a, b, c = corners_of(face, arrays)
        normal = normal_of(face, arrays)
        part = crossed_part(start, end, a, b, c, normal, cell, arrays)
        if part < nearest:
            nearest, crossed, corner, facing = part, face, a, normal
    return crossed, corner, facing


@ti.func
def crossed_part(start, end, a, b, c, normal, cell, arrays: ti.template()):
    """The part of the segment from `start` to `end` [m] before it enters a solid through a face; 2: it does not."""
    crossing = 0.0 * cell + 2.0
    before, after = (start - a).dot(normal), (end - a).dot(normal)
    if after < 0.0 - SKIN * cell and before >= 0.0 - 2.0 * SKIN * cell and after < before:
        part = ti.max(before, 0.0) / (before - after)
        if covers_point(a, b, c, normal, start + part * (end - start), arrays):
            crossing = part
    return crossing


@ti.func
def covers_point(a, b, c, normal, point, arrays: ti.template()):
    """Whether a point [m] in the plane of a face lies in the face, up to rounding."""
    if ti.static(arrays.features.dimension == 2):
        t = (point - a).dot(b - a) / (b - a).dot(b - a)
        return t > 0.0 - SKIN and t < 1.0 + SKIN
    else:
        area = (b - a).cross(c - a).dot(normal)
        one = (c - b).cross(point - b).dot(normal)
        two = (a - c).cross(point - c).dot(normal)
        return one > 0.0 - SKIN * area and two > 0.0 - SKIN * area and one + two < (1.0 + SKIN) * area


@ti.func
def foot_on_segment(x, a, b):
    """Weights of the corners at the point of a segment nearest to `x` [m]; 0: inside it, 1, 2: that corner."""
    t = (x - a).dot(b - a) / (b - a).dot(b - a)
    part = 0
    if t <= 0.0:
        t, part = 0.0 * t, 1
    elif t >= 1.0:
        t, part = 0.0 * t + 1.0, 2
    return ti.Vector([1.0 - t, t]), part


@ti.func
def foot_on_triangle(x, a, b, c):
    """Weights of the corners at the point of a triangle nearest to `x` [m] (Ericson 2005, section 5.1.5).

    0: inside it; 1, 2, 3: that corner; 4, 5, 6: the edge from corner 1 to 2, 2 to 3, 3 to 1.
    """
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


@ti.func
def foot_on_face(x, a, b, c, arrays: ti.template()):
    """For the foot of `x` [m] on a face: the weights of the corners, the part it lies on, and x minus the foot [m]."""
    w, part, from_foot = 0.0 * x, 0, x
    if ti.static(arrays.features.dimension == 2):
        w, part = foot_on_segment(x, a, b)
        from_foot = x - w[0] * a - w[1] * b
    else:
        w, part = foot_on_triangle(x, a, b, c)
        from_foot = x - w[0] * a - w[1] * b - w[2] * c
    return w, part, from_foot


@ti.func
def nearest_face(x, last, entry, scene, arrays: ti.template()):
    """The face nearest to `x` [m] among those listed for a cell: its number, its nearest part, the weights of its
    corners at the foot, the normal n [-] and the signed distance d [m], negative inside, with x = foot + d n; and a
    lower bound of the distance from all faces not examined [m]. last: the face to try first.
    """
    smallest, bound = 0.0 * x[0] + 1.0e30, unlisted_distance(x, entry, scene, arrays)
    face, feature = last, -1
    weights, offset = 0.0 * x, 0.0 * x
    first, listed = list_of(entry, arrays)
    for number in range(listed + 1):
        candidate, counts = last, not in_terrain(last, scene, arrays)
        if number > 0:
            candidate = arrays.near_faces[first + number - 1]
            counts = candidate != last
        if counts:
            a, b, c = corners_of(candidate, arrays)
            # No point of a face is nearer than its plane.
            if (x - a).dot(normal_of(candidate, arrays)) ** 2 < smallest:
                w, part, from_foot = foot_on_face(x, a, b, c, arrays)
                square = from_foot.dot(from_foot)
                if square < smallest:
                    smallest, face, feature, weights, offset = square, candidate, part, w, from_foot
    # The face's own normal, or at a corner or edge the mean of neighbouring normals (Baerentzen & Aanaes 2005).
    column = arrays.features.face.normal + ti.max(feature, 0) * arrays.features.dimension
    normal = listed_vector(face, column, arrays)
    d = offset.dot(normal)
    if feature > 0:
        sign, length = 1.0, offset.norm()
        if d < 0.0:
            sign = -1.0
        d = sign * length
        if length > TINY:
            normal = offset * (sign / length)
    return face, feature, weights, normal, d, bound


@ti.func
def margin(x, weights, part, a, b, c, arrays: ti.template()):
    """How far `x` may move with its foot (`foot_on_face`) on the same part of a face [m]; 0 at a triangle's corner."""
    free = 0.0 * x[0]
    if ti.static(arrays.features.dimension == 2):
        along, length = b - a, (b - a).norm()
        free = ti.min(weights[0], weights[1]) * length
        if part == 1:
            free = (a - x).dot(along) / length
        elif part == 2:
            free = (x - b).dot(along) / length
    elif part == 0:
        area = (b - a).cross(c - a).norm()
        free = ti.min(weights[0] * area / (c - b).norm(), weights[1] * area / (a - c).norm())
        free = ti.min(free, weights[2] * area / (b - a).norm())
    elif part > 3:
        start, end, other, low, high = a, b, c, weights[0], weights[1]
        if part == 5:
            start, end, other, low, high = b, c, a, weights[1], weights[2]
        elif part == 6:
            start, end, other, low, high = c, a, b, weights[2], weights[0]
        length = (end - start).norm()
        along = (end - start) / length
        inwards = other - start - (other - start).dot(along) * along
        free = ti.min(ti.min(low, high) * length, (start - x).dot(inwards) / inwards.norm())
    return free


@ti.func
def free_path(x, face, feature, weights, normal, d, entry, cell, scene, arrays: ti.template()):
    """How far a particle at `x` [m] outside the solids may move and still be nearest to the same part of `face` [m];
    negative for an edge.

    Its foot has to stay on that part (for an edge, of all its faces), the particle near its cell, and no other face may
    come nearer (for the inside of a face, no face that lies partly in front of it): both distances change by at most
    its path. 0 if the friction varies along the face.
    """
    dimension = ti.static(arrays.features.dimension)
    a, b, c = corners_of(face, arrays)
    free, friction = ti.min(cell, margin(x, weights, feature, a, b, c, arrays)), frictions_of(face, arrays)
    for k in ti.static(range(1, dimension)):
        if friction[k] != friction[0]:
            free = 0.0 * free
    first, listed = list_of(entry, arrays)
    for k in ti.static(range(dimension)):
        above = x[k] - ti.floor(x[k] / cell) * cell
        free = ti.min(free, ti.min(above, cell - above) + SLACK * cell)
    for number in range(listed):
        p, q, r = corners_of(arrays.near_faces[first + number], arrays)
        # Whether it lies partly in front of the plane of `face`.
        in_front = ti.max((p - a).dot(normal), (q - a).dot(normal), (r - a).dot(normal)) > SKIN * cell
        if feature > 0 or in_front:
            w, part, from_foot = foot_on_face(x, p, q, r, arrays)
            if feature == 0 or (from_foot - d * normal).norm() > SKIN * cell:
                free = ti.min(free, 0.5 * (from_foot.norm() - d))
            else:
                free = ti.min(free, margin(x, w, part, p, q, r, arrays))
    if feature > 0:
        free = 0.0 - ti.max(free, 0.0 * free)
    return free
