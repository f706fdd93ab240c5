"""Rigid walls of the box: no flow through them, Coulomb friction along them.

A node on or beyond a wall that moves into it by v_n loses v_n, and of its tangential velocity at most mu v_n
(Bardenhagen et al. 2000, eq. 18): an impulse balance, so no step size appears in it.
"""

import taichi as ti

from mpm.layout import PADDING


@ti.func
def stopped(normal, tangential, friction):
    """Tangential velocity that is left when the velocity `normal` into a wall is stopped."""
    grip = friction * ti.abs(normal)
    return tangential - ti.math.clamp(tangential, -grip, grip)


@ti.func
def against_walls(u, v, i, j, cells_x, cells_y, floor_friction, wall_friction):
    """Velocity (u, v) of node (i, j) after the four walls."""
    if (i <= PADDING and u < 0.0) or (i >= PADDING + cells_x and u > 0.0):
        v = stopped(u, v, wall_friction)
        u = 0.0
    if j <= PADDING and v < 0.0:
        u = stopped(v, u, floor_friction)
        v = 0.0
    elif j >= PADDING + cells_y and v > 0.0:
        u = stopped(v, u, wall_friction)
        v = 0.0
    return u, v
