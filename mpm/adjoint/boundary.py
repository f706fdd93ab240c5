"""The reverse of `mpm.physics.boundary`: walls of the box, node by node.

A wall that stops v_n along its axis leaves u = (1 - mu |v_n| / |w|) w of the rest w where |w| > mu |v_n|, so

    w' = u' - mu |v_n| / |w| (u' - w (w . u') / |w|^2),    (mu |v_n|)' = -(w . u') / |w|

and 0 where the node sticks; on an edge w is what no wall there stops. At |w| = mu |v_n| the derivative jumps, and the
side that the step took is taken.
"""

import taichi as ti

from mpm.physics.boundary import apply_walls, friction_of, stopping_side


@ti.func
def wall_reverse(bar, v_star, node, cells, scene, arrays: ti.template()):
    """Bar of the velocity `v_star` before all walls from that after them, shape [D], and of floor and wall friction."""
    dimension = ti.static(arrays.features.dimension)
    floor_bar, wall_bar, into = 0.0 * bar[0], 0.0 * bar[0], 0.0 * bar
    for reverse in ti.static(range(dimension)):
        axis = ti.static(dimension - 1 - reverse)
        side = stopping_side(v_star, node, cells, axis, scene, arrays)
        if side >= 0:
            friction, normal = friction_of(side, scene, arrays), ti.abs(v_star[axis])
            # What this wall rubs on; no impulse of walls is recorded here.
            along = apply_walls(v_star, node, cells, axis, 0.0, 0, scene, arrays)
            bar, limit_bar = with_friction_reverse(bar, along, friction * normal)
            into[axis] = friction * limit_bar * (v_star[axis] / normal)
            if side == 2:
                floor_bar += normal * limit_bar
            else:
                wall_bar += normal * limit_bar
    for axis in ti.static(range(dimension)):
        if stopping_side(v_star, node, cells, axis, scene, arrays) >= 0:
            bar[axis] = into[axis]
    return bar, floor_bar, wall_bar


@ti.func
def with_friction_reverse(bar, v, limit):
    """Bars of (v, limit) from that of `mpm.physics.boundary.with_friction`, shape [D] and a number."""
    speed, limit_bar = v.norm(), 0.0 * limit
    if speed > limit:
        across = v.dot(bar) / speed
        bar = bar - (limit / speed) * (bar - (across / speed) * v)
        limit_bar = 0.0 - across
    else:
        bar = 0.0 * bar
    return bar, limit_bar


@ti.func
def after_contact_reverse(bar, v, normal, friction):
    """Bars of (v, normal, friction) from that of `mpm.physics.boundary.after_contact`, shape [D] twice and a number."""
    into = v.dot(normal)
    along = v - into * normal
    along_bar, limit_bar = with_friction_reverse(bar, along, 0.0 - friction * into)
    into_bar = 0.0 - friction * limit_bar - normal.dot(along_bar)
    return along_bar + into_bar * normal, into_bar * v - into * along_bar, 0.0 - into * limit_bar
