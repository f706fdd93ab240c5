"""The reverse of `mpm.physics.boundary`: walls of the box, node by node.

A wall that stops v_n along its axis leaves u = (1 - mu |v_n| / |w|) w of the rest w where |w| > mu |v_n|, so

    w' = u' - mu |v_n| / |w| (u' - w (w . u') / |w|^2),    (mu |v_n|)' = -(w . u') / |w|

and 0 where the node sticks; on an edge w is the part that no wall there stops. At |w| = mu |v_n| the derivative jumps;
the reverse uses the side that the step took.
"""

import taichi as ti

from mpm.physics.boundary import apply_walls, friction_of, stopping_side


@ti.func
def wall_reverse(adj, v_star, node, cells, scene, arrays: ti.template()):
    """Adjoints of `v_star` before all walls, [D], of the friction of floor and of walls, from that of v after them."""
    dimension = ti.static(arrays.features.dimension)
    adj_floor, adj_wall, into = 0.0 * adj[0], 0.0 * adj[0], 0.0 * adj
    for reverse in ti.static(range(dimension)):
        axis = ti.static(dimension - 1 - reverse)
        side = stopping_side(v_star, node, cells, axis, scene, arrays)
        if side >= 0:
            friction, normal = friction_of(side, scene, arrays), ti.abs(v_star[axis])
            # The velocity on which the friction of this wall acts; no impulse of walls is recorded here.
            along = apply_walls(v_star, node, cells, axis, 0.0, 0, scene, arrays)
            adj, adj_limit = with_friction_reverse(adj, along, friction * normal)
            into[axis] = friction * adj_limit * (v_star[axis] / normal)
            if side == 2:
                adj_floor += normal * adj_limit
            else:
                adj_wall += normal * adj_limit
    for axis in ti.static(range(dimension)):
        if stopping_side(v_star, node, cells, axis, scene, arrays) >= 0:
            adj[axis] = into[axis]
    return adj, adj_floor, adj_wall


@ti.func
def with_friction_reverse(adj, v, limit):
    """Adjoints of (v, limit) from that of `mpm.physics.boundary.with_friction`, shape [D] and a number."""
    speed, adj_limit = v.norm(), 0.0 * limit
    if speed > limit:
        across = v.dot(adj) / speed
        adj = adj - (limit / speed) * (adj - (across / speed) * v)
        adj_limit = 0.0 - across
    else:
        adj = 0.0 * adj
    return adj, adj_limit


@ti.func
def after_contact_reverse(adj, v, normal, friction):
    """Adjoints of (v, normal, friction) from that of `mpm.physics.boundary.after_contact`: [D] twice and a number."""
    into = v.dot(normal)
    along = v - into * normal
    adj_along, adj_limit = with_friction_reverse(adj, along, 0.0 - friction * into)
    adj_into = 0.0 - friction * adj_limit - normal.dot(adj_along)
    return adj_along + adj_into * normal, adj_into * v - into * adj_along, 0.0 - into * adj_limit
