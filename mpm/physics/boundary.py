"""Rigid walls of the box: no flow through them, Coulomb friction along them; a side may be open instead.

A node on or beyond a wall that moves into it by v_n loses v_n, and of its tangential velocity at most mu v_n
(Bardenhagen et al. 2000, eq. 18): an impulse balance, so no step size appears in it. On an edge all walls stop it
before any rubs: what presses on one is no sliding along the other. Water presses on a wall by a traction of its own
(`mpm.physics.pore_pressure`), so that v_n is what grains press. It is the contact of `mpm.physics.contact` where the
surface lies on the nodes, at the price of a comparison. Where a solid covers a wall, under a terrain or behind a
lining, there is no wall: its nodes are the solid's (`mpm.solids.obstacles`).
"""

import taichi as ti

from mpm.arrays.access import add, minimum
from mpm.arrays.layout import PADDING, Offset, Setting, Worker
from mpm.solids.face_lookup import SKIN, entry_of
from mpm.solids.terrain import column_height


@ti.func
def with_friction(v, limit):
    """Velocity `v` along a surface less what friction takes of it, at most `limit` [m/s]."""
    speed, keep = v.norm(), 0.0
    if speed > limit:
        keep = 1.0 - limit / speed
    return keep * v


@ti.func
def after_contact(v, normal, friction):
    """Velocity `v` after a surface with the unit `normal`, into which it points, has stopped it; shape [D] each."""
    into = v.dot(normal)
    return with_friction(v - into * normal, 0.0 - friction * into)


@ti.func
def contact_delta(d, width):
    """delta_h [1/m] of `mpm.physics.contact` at the distance `d` [m] from a surface, not negative."""
    q = minimum(d / width, 1.0)
    return 2.0 / width * (1.0 - q * q * (3.0 - 2.0 * q))


@ti.func
def apply_walls(v, node, cells, axes: ti.template(), mass, worker, scene, arrays: ti.template()):
    """Velocity `v` [m/s] of the node `node` of `mass` [kg] once the walls of a box of `cells` have stopped it and those
    across the first `axes` have rubbed on it; v, node, cells: [D].
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
    """The side of the box across `axis` that stops velocity `v` at the node `node`, 0 to 2 D - 1; -1: none does."""
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
    """1 where a side of the box lies in the bed of a terrain, at a node beyond it and a cell around that, else 0.

    Of an upright side the highest of the places around the node decides.
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
    """Add `momentum` [N s], [D], to what a solid has taken; behind these stand the box's sides and the barriers."""
    features = arrays.features
    at = arrays.workers[worker, Worker.IMPULSE] + solid * features.dimension
    for k in ti.static(range(features.dimension)):
        add(arrays.impulse_lanes, (at + k) * features.lanes + lane, momentum[k], arrays)
