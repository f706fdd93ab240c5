"""What a height field takes of the velocity of a node deep in it: the holds of `mpm.solids.obstacles`, as they are met.

Of the triangles k of the raster, with the distance d_k of the node, the normal N_k and the direction n_k to the foot,

    removed = s(min d) sum_k w_k (v - A_k v) / sum_k w_k,    w_k = (n_k . N_k)_+ (1 - (d_k - min d) / b)_+^2

The weights are those of the place of the node alone. Each thread of a CPU keeps those of as many columns of nodes as
its particles need, and then those of others in place of the oldest: memory follows the material, not the box.
"""

import taichi as ti

from mpm.arrays.access import columns_deep
from mpm.arrays.layout import KEPT, KEPT_NODES, KEPT_NUMBERS, PADDING, Offset, Setting, Span, TerrainNumber, Worker
from mpm.physics.boundary import after_contact
from mpm.solids.face_lookup import foot_on_face, frictions_of, reach_of
from mpm.solids.obstacles import BLEND, FADE
from mpm.solids.terrain import (
    cell_code,
    cells_within,
    column_height,
    height_above,
    squared_plan_distance,
    terrain_number,
    triangle_corners,
    triangle_number,
)

FIRST_HOLD = 2
"""Where the holds of a node begin in its line, after its place in its column, from 1 on, and their number."""


@ti.func
def node_position(node, scene, arrays: ti.template()):
    """Of a node by its index [m], shape [D]."""
    cell = arrays.settings[scene, Setting.CELL]
    return ti.Vector([(node[k] - PADDING) * cell for k in ti.static(range(arrays.features.dimension))])


@ti.func
def cells_over(x, scene, arrays: ti.template()):
    """The cells of the raster whose triangles may hold a node at `x` [m], as `cells_within`; none where none does."""
    i0, k0, i1, k1 = 0, 0, 0, 0
    if arrays.offsets[scene, Offset.POSTS_X] > 0:
        above, listed = height_above(x, scene, arrays)
        depth, reach = 0.0 - above, reach_of(scene, arrays)
        if depth > 0.0 and depth * terrain_number(TerrainNumber.NEARNESS, scene, arrays) < reach:
            radius = ti.min(depth, reach)
            if listed == 1:
                radius = reach
            radius += BLEND * arrays.settings[scene, Setting.CELL]
            i0, k0, i1, k1 = cells_within(x - radius, x + radius, scene, arrays)
    return i0, k0, i1, k1


@ti.func
def hold_weight(square, behind, depth, blend):
    """w_k of a triangle at the root of `square` [m^2] from a node that is `behind` its plane [m]; depth: min d [m]."""
    distance = ti.max(ti.sqrt(square), 1.0e-20)
    near = ti.max(1.0 - (distance - depth) / blend, 0.0)
    return ti.max(behind / distance, 0.0) * near * near


@ti.func
def hold_share(depth, total, scene, arrays: ti.template()):
    """s(depth) over the sum of all weights."""
    part = ti.min(depth / (FADE * arrays.settings[scene, Setting.CELL]), 1.0)
    return part * part * (3.0 - 2.0 * part) / ti.max(total, 1.0e-30)


@ti.func
def removed_by_terrain(v, node, worker, scene, arrays: ti.template()):
    """What the height field takes of the velocity `v` [m/s] of a node, an index of shape [D]; shape [D]."""
    removed, near = 0.0 * v, False
    if arrays.offsets[scene, Offset.POSTS_X] > 0:
        # Below the height field, no deeper than is searched.
        depth = column_height(node[0], node[2], scene, arrays) - node_position(node, scene, arrays)[1]
        near = depth > 0.0 and depth * terrain_number(TerrainNumber.NEARNESS, scene, arrays) < reach_of(scene, arrays)
    if ti.static(arrays.features.processor.gpu):
        if near:
            removed, _share, _depth = meet_holds(v, 0, node, False, scene, arrays)
    elif near:
        slot, known = slot_of(node, worker, scene, arrays)
        if not known:
            meet_holds(v, slot, node, True, scene, arrays)
        for hold in range(ti.cast(arrays.kept_holds[slot, 1], ti.i32)):
            at = FIRST_HOLD + hold * KEPT_NUMBERS
            normal = kept_normal(slot, at, arrays)
            if v.dot(normal) < 0.0:
                share, friction = arrays.kept_holds[slot, at], arrays.kept_holds[slot, at + 1]
                removed += share * (v - after_contact(v, normal, friction))
    return removed


@ti.func
def slot_of(node, worker, scene, arrays: ti.template()):
    """The line of `kept_holds` in which a worker keeps the holds of a node, and whether they are there."""
    column = node[0] * columns_deep(scene, arrays) + node[2]
    at = arrays.workers[worker, Worker.COLUMN] + column
    group = arrays.spans[at, Span.KEPT]
    if group == 0 or arrays.kept_columns[group] != column:
        # Twice as many as there are columns, so that those in use stay.
        number = arrays.workers[worker, Worker.NEXT_GROUP]
        if number >= ti.min(2 * arrays.workers[worker, Worker.ACTIVE] + 256, arrays.workers[worker, Worker.GROUPS]):
            number = 0
        arrays.workers[worker, Worker.NEXT_GROUP] = number + 1
        group = arrays.workers[worker, Worker.KEPT] + number
        arrays.kept_columns[group], arrays.spans[at, Span.KEPT] = column, group
        for k in range(KEPT_NODES):
            arrays.kept_holds[group * KEPT_NODES + k, 0] = 0.0
    slot, place = group * KEPT_NODES + (node[1] & (KEPT_NODES - 1)), 1.0 + node[1]
    known = arrays.kept_holds[slot, 0] == place
    arrays.kept_holds[slot, 0] = place
    return slot, known


@ti.func
def meet_holds(v, slot, node, kept: ti.template(), scene, arrays: ti.template()):
    """What the holds of a node take of its velocity `v` [m/s], shape [D], the factor from `hold_weight` to a share [-]
    and the depth of the node [m]; where they are `kept`, their number, and of each its share [-], friction [-] and
    normal [-], are left in the line `slot`.

    Of those that are kept, those with one normal and one friction are one; where there are more than KEPT others, so
    are those whose normals differ least.
    """
    x, removed, total, count = node_position(node, scene, arrays), 0.0 * v, 0.0 * v[0], 0
    i0, k0, i1, k1 = cells_over(x, scene, arrays)
    blend, limit = BLEND * arrays.settings[scene, Setting.CELL], reach_of(scene, arrays) ** 2
    depth, nearest = 0.0 * blend, limit
    # First the nearest, then all that are nearly as near.
    for search in range(2):
        if search == 1:
            depth = ti.sqrt(nearest)
            limit = (depth + blend) ** 2
        for i in range(i0, i1):
            for k in range(k0, k1):
                code = cell_code(i, k, scene, arrays)
                if code < 2 and squared_plan_distance(x, i, k, scene, arrays) < limit:
                    for half in range(2):
                        a, b, c = triangle_corners(i, k, half, code, scene, arrays)
                        across = (b - a).cross(c - b)
                        height, size = (x - a).dot(across), across.dot(across)
                        if height < 0.0 and height * height < limit * size:
                            w, _, from_foot = foot_on_face(x, a, b, c, arrays)
                            square = from_foot.dot(from_foot)
                            if search == 0:
                                nearest = ti.min(nearest, square)
                                limit = nearest
                            elif square < limit:
                                normal = across / ti.sqrt(size)
                                weight = hold_weight(square, 0.0 - from_foot.dot(normal), depth, blend)
                                face = triangle_number(i, k, half, scene, arrays)
                                friction = w.dot(frictions_of(face, scene, arrays))
                                total += weight
                                if ti.static(kept):
                                    count = add_hold(slot, count, weight, friction, normal, arrays)
                                elif v.dot(normal) < 0.0:
                                    removed += weight * (v - after_contact(v, normal, friction))
    share = hold_share(depth, total, scene, arrays)
    if ti.static(kept):
        arrays.kept_holds[slot, 1] = count
        for hold in range(count):
            at = FIRST_HOLD + hold * KEPT_NUMBERS
            weight, friction = arrays.kept_holds[slot, at], arrays.kept_holds[slot, at + 1]
            put_hold(slot, at, share * weight, friction, kept_normal(slot, at, arrays).normalized(), arrays)
    return share * removed, share, depth


@ti.func
def kept_normal(slot, at, arrays: ti.template()):
    """The normal [-] of the hold that begins at `at` in a line of `kept_holds`."""
    return ti.Vector([arrays.kept_holds[slot, at + 2 + k] for k in ti.static(range(3))])


@ti.func
def put_hold(slot, at, weight, friction, normal, arrays: ti.template()):
    """Write a hold from `at` on in a line of `kept_holds`."""
    arrays.kept_holds[slot, at], arrays.kept_holds[slot, at + 1] = weight, friction
    for k in ti.static(range(3)):
        arrays.kept_holds[slot, at + 2 + k] = normal[k]


@ti.func
def add_hold(slot, count, weight, friction, normal, arrays: ti.template()):
    """Add a hold to the `count` that are kept in a slot; how many there are then."""
    closest, alike = -1, 0.0 * weight - 2.0
    for hold in range(count):
        at = FIRST_HOLD + hold * KEPT_NUMBERS
        cosine = kept_normal(slot, at, arrays).dot(normal)
        if arrays.kept_holds[slot, at + 1] != friction:
            cosine -= 1.0e-3
        if cosine > alike:
            closest, alike = hold, cosine
    result = count
    if weight > 0.0 and (alike > 1.0 - 1.0e-14 or count == KEPT):
        at = FIRST_HOLD + closest * KEPT_NUMBERS
        total, rubs = arrays.kept_holds[slot, at] + weight, arrays.kept_holds[slot, at + 1]
        part, facing = weight / total, kept_normal(slot, at, arrays)
        put_hold(slot, at, total, rubs + part * (friction - rubs), facing + part * (normal - facing), arrays)
    elif weight > 0.0:
        put_hold(slot, FIRST_HOLD + count * KEPT_NUMBERS, weight, friction, normal, arrays)
        result = count + 1
    return result
