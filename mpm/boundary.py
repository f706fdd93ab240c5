"""Rigid walls of the box: no flow through them, Coulomb friction along them.

A node on or beyond a wall that moves into it by v_n loses v_n, and of its tangential velocity at most mu v_n
(Bardenhagen et al. 2000, eq. 18): an impulse balance, so no step size appears in it.
"""

import taichi as ti

from mpm.layout import PADDING


@ti.func
def stopped(v, axis: ti.template(), friction):
    """Velocity `v` after a wall across `axis` has stopped it: the normal part goes, friction takes of the rest."""
    grip = friction * ti.abs(v[axis])
    v[axis] = 0.0
    speed = v.norm()
    keep = 0.0
    if speed > grip:
        keep = 1.0 - grip / speed
    return keep * v


@ti.func
def stopped_by(v, normal, friction):
    """Velocity `v` after a surface with the unit `normal`, into which it points, has stopped it; shape [D] each."""
    into = v.dot(normal)
    along = v - into * normal
    speed, grip = along.norm(), 0.0 - friction * into
    keep = 0.0
    if speed > grip:
        keep = 1.0 - grip / speed
    return keep * along


@ti.func
def against_walls(v, node, cells, floor_friction, wall_friction):
    """Velocity `v` of the node with the indices `node` after all walls of a box of `cells`; shape [D] each."""
    for axis in ti.static(range(v.n)):
        if node[axis] <= PADDING and v[axis] < 0.0:
            friction = wall_friction
            if ti.static(axis == 1):
                friction = floor_friction
            v = stopped(v, axis, friction)
        elif node[axis] >= PADDING + cells[axis] and v[axis] > 0.0:
            v = stopped(v, axis, wall_friction)
    return v
