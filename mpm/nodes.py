"""The grid between the transfers: cleared, then momentum becomes velocity under gravity, damping and the walls.

    v_i = (m v)_i / m_i + dt (g + f_i / m_i - alpha |g + f_i / m_i| sign v_i)

The last term is local damping (Cundall 1987) as CB-Geo MPM applies it at a node: |f| is the length of the whole force,
the sign is each component's (Cundall's own form takes each component's force too). A scene without damping neither
stores nor sums f_i apart. Only the bounding box of the material is cleared and updated.
"""

import taichi as ti

from mpm.layout import PADDING, Place, Setting
from mpm.walls import against_walls

PLAIN_NODE = 3
"""Numbers per node: momentum (x, y) and mass; velocity in place of momentum after the update."""
DAMPED_NODE = 5
"""The same and the force (x, y)."""


def node_width(damped: bool) -> int:
    """Numbers per node."""
    return DAMPED_NODE if damped else PLAIN_NODE


@ti.func
def row_width(scene, places: ti.template(), damped: ti.template()):
    """Numbers from a node to its neighbour in x."""
    return (places[scene, Place.CELLS_Y] + 2 * PADDING + 1) * ti.static(node_width(damped))


@ti.func
def clear(scene, grid: ti.template(), places: ti.template(), damped: ti.template()):
    """Set the nodes around the material to zero."""
    width, row = ti.static(node_width(damped)), row_width(scene, places, damped)
    origin = places[scene, Place.NODE] * width
    bottom, top = places[scene, Place.BOX_BOTTOM], places[scene, Place.BOX_TOP]
    for i in range(places[scene, Place.BOX_LEFT], places[scene, Place.BOX_RIGHT]):
        for n in range(origin + i * row + bottom * width, origin + i * row + top * width):
            grid[n] = 0.0


@ti.func
def update_nodes(scene, dt, grid: ti.template(), settings: ti.template(), places: ti.template(), damped: ti.template()):
    """Momentum to velocity, under gravity, damping and the walls."""
    width, row = ti.static(node_width(damped)), row_width(scene, places, damped)
    origin = places[scene, Place.NODE] * width
    gravity_x, gravity_y = settings[scene, Setting.GRAVITY_X], settings[scene, Setting.GRAVITY_Y]
    floor_friction, wall_friction = settings[scene, Setting.FLOOR_FRICTION], settings[scene, Setting.WALL_FRICTION]
    cells_x, cells_y = places[scene, Place.CELLS_X], places[scene, Place.CELLS_Y]
    bottom, top = places[scene, Place.BOX_BOTTOM], places[scene, Place.BOX_TOP]
    for i in range(places[scene, Place.BOX_LEFT], places[scene, Place.BOX_RIGHT]):
        for j in range(bottom, top):
            n = origin + i * row + j * width
            if grid[n + 2] > 0.0:
                inverse_mass = 1.0 / grid[n + 2]
                vx, vy = grid[n] * inverse_mass, grid[n + 1] * inverse_mass
                ax, ay = gravity_x, gravity_y
                if ti.static(damped):
                    ax += grid[n + 3] * inverse_mass
                    ay += grid[n + 4] * inverse_mass
                    drag = settings[scene, Setting.DAMPING] * ti.sqrt(ax * ax + ay * ay)
                    ax -= drag * ti.math.sign(vx)
                    ay -= drag * ti.math.sign(vy)
                vx += dt * ax
                vy += dt * ay
                vx, vy = against_walls(vx, vy, i, j, cells_x, cells_y, floor_friction, wall_friction)
                grid[n], grid[n + 1] = vx, vy
