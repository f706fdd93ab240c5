"""The two transfers of MLS-MPM: points to grid, grid to points.

With w_ip the quadratic B-spline weight of node i at point p, x_ip = x_i - x_p, V0 the point's initial volume and dx the
cell (Hu et al. 2018; APIC: Jiang et al. 2015):

    m_i     = sum_p w_ip m_p
    (m v)_i = sum_p w_ip (m_p v_p + m_p C_p x_ip) + dt f_i
    f_i     = -sum_p w_ip V0 (4 / dx^2) sigma_p x_ip                     (Hu et al. 2018, eq. 16)
    v_p     = sum_i w_ip v_i
    C_p     = (4 / dx^2) sum_i w_ip v_i x_ip^T
    x_p     = x_p + dt v_p

Where a scene is damped, f_i stays apart from the momentum: the damping needs it (`mpm.nodes`).

Everything that belongs to a point is computed for a block of points at once, in vectors of lanes, and left in
`scratch`; then point by point meets node by node, where a node (momentum, mass, force) is one short vector. What a
point gives to a node is linear in the node's place: its value at the lowest node, and one slope per axis.
"""

import taichi as ti

from mpm.lanes import add
from mpm.layout import PADDING, Place, Property, Setting, Worker


@ti.func
def spline(f):
    """Quadratic B-spline weights of the three nodes around a point, `f` in [0.5, 1.5) cells from the first one."""
    return 0.5 * (1.5 - f) * (1.5 - f), 0.75 - (f - 1.0) * (f - 1.0), 0.5 * (f - 0.5) * (f - 0.5)


@ti.func
def property_of(scene, block, column: ti.template(), of: ti.template()):
    """A material property: one number per scene, or one per lane where the scene has several materials."""
    needs = of.needs
    if ti.static(needs.several):
        return of.state[block * needs.block + needs.properties + column]
    else:
        return of.properties[scene, column]


@ti.func
def lowest_node(of: ti.template(), scratch, lane, grid, rows: ti.template()):
    """Index of the lowest node of the point in `lane`, in the whole array of nodes."""
    needs = of.needs
    n = grid
    for axis in ti.static(range(needs.dimension)):
        n += ti.cast(of.scratch_lanes[(scratch + needs.lowest + axis) * needs.lanes + lane], ti.i32) * rows[axis]
    return n


@ti.func
def node_vector(of: ti.template(), scratch, group: ti.template(), lane):
    """What a block has left for the nodes of the point in `lane`: value (group 0) or slope along an axis."""
    needs = of.needs
    first = scratch + needs.reach + group * needs.node
    return ti.Vector([of.scratch_lanes[(first + k) * needs.lanes + lane] for k in ti.static(range(needs.node))])


@ti.func
def points_to_grid(worker, scene, dt, rows: ti.template(), of: ti.template()):
    """Add mass, momentum and force of every point of `worker` to its nodes."""
    scratch = of.workers[worker, Worker.SCRATCH]
    for block in range(of.workers[worker, Worker.FIRST], of.workers[worker, Worker.LAST]):
        block_to_grid(of.workers[worker, Worker.NODE], scene, block, scratch, dt, rows, of)


@ti.func
def block_to_grid(grid, scene, block, scratch, dt, rows: ti.template(), of: ti.template()):
    """Add mass, momentum and force of the points of a block to the nodes from `grid` on."""
    needs, lanes = of.needs, of.needs.lanes
    prepare_giving(scene, block, scratch, dt, of)
    for lane in range(points_in(scene, block, of)):
        n = lowest_node(of, scratch, lane, grid, rows)
        weight = scratch * lanes + lane
        value = node_vector(of, scratch, 0, lane)
        slope_x, slope_y = node_vector(of, scratch, 1, lane), node_vector(of, scratch, 2, lane)
        if ti.static(needs.dimension == 2):
            for a in ti.static(range(3)):
                here = value
                for b in ti.static(range(3)):
                    add(of.grid, n + a * rows[0] + b, of.scratch_lanes[weight + (3 * a + b) * lanes] * here, of)
                    here = here + slope_y
                value = value + slope_x
        else:
            slope_z = node_vector(of, scratch, 3, lane)
            for a in ti.static(range(3)):
                along = value
                for b in ti.static(range(3)):
                    here = along
                    for c in ti.static(range(3)):
                        w = of.scratch_lanes[weight + (9 * a + 3 * b + c) * lanes]
                        add(of.grid, n + a * rows[0] + b * rows[1] + c, w * here, of)
                        here = here + slope_z
                    along = along + slope_y
                value = value + slope_x


@ti.func
def prepare_giving(scene, block, scratch, dt, of: ti.template()):
    """Leave in `scratch` the weights, lowest nodes, values and slopes of a block."""
    needs = of.needs
    first = block * needs.block
    dx = of.settings[scene, Setting.CELL]
    per_dx, volume = 1.0 / dx, of.settings[scene, Setting.VOLUME]
    mass = volume * property_of(scene, block, Property.DENSITY, of) + 0.0 * of.state[first]
    place = [of.state[first + k] * per_dx + PADDING for k in ti.static(range(needs.dimension))]
    low = [ti.floor(p - 0.5) for p in ti.static(place)]
    f = [place[k] - low[k] for k in ti.static(range(needs.dimension))]
    for k in ti.static(range(needs.dimension)):
        of.scratch[scratch + needs.lowest + k] = low[k]
    wx, wy = spline(f[0]), spline(f[1])
    if ti.static(needs.dimension == 2):
        for a in ti.static(range(3)):
            for b in ti.static(range(3)):
                of.scratch[scratch + 3 * a + b] = wx[a] * wy[b]
    else:
        wz = spline(f[2])
        for a in ti.static(range(3)):
            for b in ti.static(range(3)):
                wxy = wx[a] * wy[b]
                for c in ti.static(range(3)):
                    of.scratch[scratch + 9 * a + 3 * b + c] = wxy * wz[c]
    # Lengths on the grid are in cells: times dx.
    force_scale = -4.0 * volume * per_dx
    values = scratch + needs.reach
    for i in ti.static(range(needs.dimension)):
        momentum = mass * of.state[first + needs.velocity + i]
        pull = 0.0 * mass
        for j in ti.static(range(needs.dimension)):
            slope = mass * dx * of.state[first + needs.affine + i * needs.dimension + j]
            force = force_scale * of.state[first + needs.stress + ti.static(component(i, j, needs.dimension))]
            if ti.static(needs.damped):
                pull = pull - force * f[j]
                of.scratch[values + (1 + j) * needs.node + needs.force + i] = force
            else:
                slope = slope + dt * force
            momentum = momentum - slope * f[j]
            of.scratch[values + (1 + j) * needs.node + i] = slope
        of.scratch[values + i] = momentum
        if ti.static(needs.damped):
            of.scratch[values + needs.force + i] = pull
    of.scratch[values + needs.dimension] = mass


def component(i: int, j: int, dimension: int) -> int:
    """Where sigma_ij stands among the components xx, yy, zz, xy, yz, zx; no yz, zx in 2D."""
    return i if i == j else {(0, 1): 3, (1, 2): 4, (0, 2): 5}[min(i, j), max(i, j)]


@ti.func
def points_in(scene, block, of: ti.template()):
    """Lanes of a block that hold a point: all, but in a scene's last block. The others mirror the last point."""
    needs = of.needs
    return ti.min(needs.lanes, of.places[scene, Place.POINTS] - (block - of.places[scene, Place.BLOCK]) * needs.lanes)


@ti.func
def grid_to_block(grid, block, scratch, per_dx, rows: ti.template(), of: ti.template()):
    """Give every point of a block the motion of the nodes from `grid` on: v and C."""
    needs, lanes = of.needs, of.needs.lanes
    first = block * needs.block
    # Weights, and weights times distance, of three nodes along each axis.
    for k in ti.static(range(needs.dimension)):
        place = of.state[first + k] * per_dx + PADDING
        low = ti.floor(place - 0.5)
        f = place - low
        w = spline(f)
        of.scratch[scratch + needs.lowest + k] = low
        for a in ti.static(range(3)):
            of.scratch[scratch + 3 * k + a] = w[a]
            of.scratch[scratch + 3 * (needs.dimension + k) + a] = (4.0 * per_dx) * w[a] * (ti.static(float(a)) - f)
    for lane in range(lanes):
        n = lowest_node(of, scratch, lane, grid, rows)
        weight = scratch * lanes + lane
        lever = weight + 3 * needs.dimension * lanes
        target = first * lanes + lane
        v, x_slope, y_slope = node_zero(of), node_zero(of), node_zero(of)
        if ti.static(needs.dimension == 2):
            for a in ti.static(range(3)):
                # Sums along the column first: they share the weight in x.
                u, s = node_zero(of), node_zero(of)
                for b in ti.static(range(3)):
                    node = of.grid[n + a * rows[0] + b]
                    u = u + of.scratch_lanes[weight + (3 + b) * lanes] * node
                    s = s + of.scratch_lanes[lever + (3 + b) * lanes] * node
                v = v + of.scratch_lanes[weight + a * lanes] * u
                x_slope = x_slope + of.scratch_lanes[lever + a * lanes] * u
                y_slope = y_slope + of.scratch_lanes[weight + a * lanes] * s
            for i in ti.static(range(2)):
                of.lanes[target + (needs.velocity + i) * lanes] = v[i]
                of.lanes[target + (needs.affine + 2 * i) * lanes] = x_slope[i]
                of.lanes[target + (needs.affine + 2 * i + 1) * lanes] = y_slope[i]
        else:
            z_slope = node_zero(of)
            for a in ti.static(range(3)):
                u, s, t = node_zero(of), node_zero(of), node_zero(of)
                for b in ti.static(range(3)):
                    uu, tt = node_zero(of), node_zero(of)
                    for c in ti.static(range(3)):
                        node = of.grid[n + a * rows[0] + b * rows[1] + c]
                        uu = uu + of.scratch_lanes[weight + (6 + c) * lanes] * node
                        tt = tt + of.scratch_lanes[lever + (6 + c) * lanes] * node
                    u = u + of.scratch_lanes[weight + (3 + b) * lanes] * uu
                    s = s + of.scratch_lanes[lever + (3 + b) * lanes] * uu
                    t = t + of.scratch_lanes[weight + (3 + b) * lanes] * tt
                v = v + of.scratch_lanes[weight + a * lanes] * u
                x_slope = x_slope + of.scratch_lanes[lever + a * lanes] * u
                y_slope = y_slope + of.scratch_lanes[weight + a * lanes] * s
                z_slope = z_slope + of.scratch_lanes[weight + a * lanes] * t
            for i in ti.static(range(3)):
                of.lanes[target + (needs.velocity + i) * lanes] = v[i]
                of.lanes[target + (needs.affine + 3 * i) * lanes] = x_slope[i]
                of.lanes[target + (needs.affine + 3 * i + 1) * lanes] = y_slope[i]
                of.lanes[target + (needs.affine + 3 * i + 2) * lanes] = z_slope[i]


@ti.func
def node_zero(of: ti.template()):
    """A node's vector of zeros."""
    needs = of.needs
    return ti.Vector([0.0 for _ in ti.static(range(needs.node))])
