"""Rigid walls of the box: no flow through them, Coulomb friction along them; a side may be open instead.

A node on or beyond a wall that moves into it with v_n loses v_n, and at most mu v_n of its tangential velocity
(Bardenhagen et al. 2000, eq. 18): an impulse balance, without a step size. On an edge all walls stop the node before
friction acts, since motion into one wall is no sliding along the other. Water presses on a wall with its own traction
(`mpm.physics.pore_pressure`), so that v_n comes from the grains alone. This equals the contact of `mpm.physics.contact`
for a surface on the nodes, at the cost of a comparison. A wall covered by a solid, under a terrain or behind a lining,
does not act: its nodes belong to the solid (`mpm.solids.obstacles`).
"""

import taichi as ti

from mpm.arrays.access import add, minimum
from mpm.arrays.layout import PADDING, Offset, Setting, Worker
from mpm.solids.face_lookup import SKIN, entry_of
from mpm.solids.terrain import column_height


@ti.func
def with_friction(v, limit):
    """Velocity `v` along a surface after friction, which takes at most `limit` [m/s]."""
    speed, keep = v.norm(), 0.0
    if speed > limit:
        keep = 1.0 - limit / speed
    return keep * v


@ti.func
def after_contact(v, normal, friction):
    """Velocity `v`, which points into a surface with the unit `normal`, after contact with it; shape [D] each."""
    into = v.dot(normal)
    return with_friction(v - into * normal, 0.0 - friction * into)


@ti.func
def contact_delta(d, width):
    """delta_h [1/m] of `mpm.physics.contact` at the distance `d` [m] from a surface, not negative."""
    q = minimum(d / width, 1.0)
    return 2.0 / width * (1.0 - q * q * (3.0 - 2.0 * q))


@ti.func
def apply_walls(v, node, cells, axes: ti.template(), mass, worker, scene, arrays: ti.template()):
    """Velocity `v` [m/s] of the node `node` of `mass` [kg] after the walls of a box of `cells` have stopped it, with
    the friction of the walls across the first `axes`; v, node, cells: [D].
    """
    features, along = arrays.features, v
    for axis in ti.static(range(features.dimension)):
        if stopping_side(v, node, cells, axis, scene, arrays) >= 0:
            along[axis] = 0.0
    for axis in ti.static(range(axes)):
        side = stopping_side(v, node, cells, axis, scene, arrays)
        if side >= 0:
            taken = along
            along = with_friction(along, friction_of(side, scene, arrays) * ti.abs(v[axis]))
            if ti.static(features.recorded.walls):
                taken = taken - along
                taken[axis] = v[axis]
                add_impulse(arrays.offsets[scene, Offset.OBSTACLES] + side, mass * taken, 0, worker, arrays)
    return along


@ti.func
def stopping_side(v, node, cells, axis: ti.template(), scene, arrays: ti.template()):
    """The side of the box across `axis`, 0 to 2 D - 1, that stops velocity `v` at the node `node`; -1 if none does."""
    side = -1
    if node[axis] <= PADDING and v[axis] < 0.0:
        side = 2 * axis
    elif node[axis] >= PADDING + cells[axis] and v[axis] > 0.0:
        side = 2 * axis + 1
    # Taichi computes both sides of `and`.
    if side >= 0:
        if is_wall(side, scene, arrays) == 0 or is_covered(side, node, scene, arrays) == 1:
            side = -1
    return side


@ti.func
def friction_of(side, scene, arrays: ti.template()):
    """Coulomb coefficient [-] of a side of the box."""
    friction = arrays.settings[scene, Setting.WALL_FRICTION]
    if side == 2:
        friction = arrays.settings[scene, Setting.FLOOR_FRICTION]
    return friction


@ti.func
def is_wall(side, scene, arrays: ti.template()):
    """1 where a side of the box, 0 to 2 D - 1 for x-, x+, y-, ..., is a wall, 0 where it is open."""
    result = 1
    if ti.static(arrays.features.outflow):
        result = 1 - ((arrays.offsets[scene, Offset.OPEN] >> side) & 1)
    return result


@ti.func
def is_covered(side, node, scene, arrays: ti.template()):
    """1 where a solid lies between a node beyond a side of the box and the material, else 0; node: [D]."""
    result = 0
    if ti.static(arrays.features.contact):
        entry = entry_of(node, scene, arrays)
        if ti.static(arrays.features.listed):
            if entry >= 0:
                result = (arrays.covered[entry] >> side) & 1
        if ti.static(arrays.features.terrain):
            if entry < 0:
                result = in_terrain_beyond(side, node, scene, arrays)
    return result


@ti.func
def in_terrain_beyond(side, node, scene, arrays: ti.template()):
    """1 where a side of the box lies in the bed of a terrain, at a node beyond the side and one cell around it, else 0.

    For an upright side, the highest of the places around the node decides.
    """
    result, axis, cell = 1, side // 2, arrays.settings[scene, Setting.CELL]
    wall = PADDING + arrays.offsets[scene, Offset.CELLS_X + axis] * (side % 2)
    i, k, y = node[0], node[2], (node[1] + 1 - PADDING + 0.5 * SKIN) * cell
    if axis == 0:
        i = wall
    elif axis == 1:
        y = (wall - PADDING + SKIN * ((side % 2) - 0.5)) * cell
    else:
        k = wall
    for along in range(-1, 2):
        for aside in range(-1, 2):
            if (axis != 0 or along == 0) and (axis != 2 or aside == 0) and result == 1:
                if column_height(i + along, k + aside, scene, arrays) <= y:
                    result = 0
    return result


@ti.func
def add_impulse(solid, momentum, lane, worker, arrays: ti.template()):
    """Add `momentum` [N s], [D], to the impulse of a solid; the sides of the box and the barriers follow the solids."""
    features = arrays.features
    at = arrays.workers[worker, Worker.IMPULSE] + solid * features.dimension
    for k in ti.static(range(features.dimension)):
        add(arrays.impulse_lanes, (at + k) * features.lanes + lane, momentum[k], arrays)
