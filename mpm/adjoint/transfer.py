"""The reverse of the two transfers (`mpm.physics.transfer`).

Particles gather n_i = (u_i, u_i - kappa v_i) from the nodes. With v', C', change' the adjoints of their sums,

    b_ip = (v' + (4 / dx^2) C' x_ip, change'),    n_i' = sum_p w_ip b_ip
    x_p' = sum_i dw_ip/dx_p (n_i . b_ip) - (4 / dx^2) C'^T sum_i w_ip u_i

They contribute g_ip = (m v + m C x_ip, m, -V0 (4 / dx^2) sigma x_ip) to the nodes. With N_i' the nodes' adjoints,

    Z = sum_i w_ip N_i',    Y_j = sum_i w_ip x_ip,j N_i',    g_ip = g_0 + sum_j g_j x_ip,j
    g_0' = Z,   g_j' = Y_j,    x_p' = sum_i dw_ip/dx_p (N_i' . g_ip) - sum_j (g_j . Z) e_j

So the first is a sum at the nodes of terms linear in the node's position, like the step's own particles-to-grid
transfer; the second gathers at a particle, like grid to particles. In both, the weights' motion enters through the sum
over i of dw_ip/dx_p times the product of the node's value and the particle's contribution.
"""

import taichi as ti

from mpm.adjoint.layout import add_setting_adjoint, adjoints_of
from mpm.adjoint.pullback import Pullback
from mpm.arrays.access import add, columns_deep, no_overflow, vectors
from mpm.arrays.features import NODE
from mpm.arrays.layout import PADDING, Address, Setting
from mpm.arrays.nodes import zero_node
from mpm.physics.columns import node_at
from mpm.physics.transfer import lowest_column, node_sums, three_vectors
from mpm.physics.volume_correction import held_affine, looseness


@ti.func
def prepare_weights(block: ti.template(), arrays: ti.template()):
    """Store in `scratch` the slopes of the weights of a block [1/m] and the weights times distances [m]."""
    layout, scratch = arrays.layout, block.scratch
    dx = arrays.settings[block.scene, Setting.CELL]
    per_dx = 1.0 / dx
    for k in ti.static(range(arrays.features.dimension)):
        x_cells = arrays.state[block.state + k] * per_dx + PADDING
        f = x_cells - ti.floor(x_cells - 0.5)
        slopes = (f - 1.5) * per_dx, (2.0 - 2.0 * f) * per_dx, (f - 0.5) * per_dx
        for a in ti.static(range(3)):
            w = arrays.scratch[scratch + 3 * k + a]
            arrays.scratch[scratch + layout.scratch.slopes + 3 * k + a] = slopes[a]
            arrays.scratch[scratch + layout.scratch.levers + 3 * k + a] = w * (ti.static(float(a)) - f) * dx


@ti.func
def node_vector(arrays: ti.template(), scratch, group: ti.template(), lane, varies: ti.template()):
    """What a block has stored for the nodes of the particle in `lane`: value (group 0) or slope along an axis.

    Unless `varies`, mass, side friction and distance differ between nodes only by the weight: they have no slopes.
    """
    features = arrays.features
    first = ti.static(features.scratch.values + group * NODE)
    at = no_overflow(scratch * features.lanes + lane)
    return ti.Vector(
        [
            arrays.scratch_lanes[at + (first + k) * features.lanes]
            if k < features.node.size
            and (group == 0 or varies or (k != features.dimension and k <= 2 * features.dimension))
            else 0.0
            for k in ti.static(range(NODE))
        ]
    )


@ti.func
def transfer_reverse(block: ti.template(), scatters: ti.template(), arrays: ti.template()):
    """The reverse of one transfer, between a block and its nodes, and the sums that move its weights.

    scatters: add the values and slopes that the block has stored in `scratch` to the adjoints of the nodes, and store
    the sum of w_ip n_i over the nodes. Otherwise store Z, Y_j of each particle from the adjoints of the nodes.
    """
    features, layout, lanes = arrays.features, arrays.layout, arrays.features.lanes
    size = ti.static(features.dimension)
    scratch, deep = block.scratch, columns_deep(block.scene, arrays)
    # With volume correction the adjoint of the mass differs from node to node.
    varies = ti.static(scatters and features.volume_correction)
    for lane in range(lanes):
        column, j = lowest_column(arrays, scratch, lane, block.table, deep)
        weight = no_overflow(scratch * lanes + lane)
        slope, lever = weight + layout.scratch.slopes * lanes, weight + layout.scratch.levers * lanes
        w = [three_vectors(arrays, weight + 3 * k * lanes) for k in ti.static(range(size))]
        d = [three_vectors(arrays, slope + 3 * k * lanes) for k in ti.static(range(size))]
        levers = [three_vectors(arrays, lever + 3 * k * lanes) for k in ti.static(range(size))]
        value = node_vector(arrays, scratch, 0, lane, varies)
        steps = [node_vector(arrays, scratch, 1 + k, lane, varies) for k in ti.static(range(size))]
        sums = [zero_node() for _ in ti.static(range(1 + size))]
        forces = [zero_node() for _ in ti.static(range(size))]
        for a in ti.static(range(3)):
            along = value
            for b in ti.static(range(3 if size == 3 else 1)):
                first = node_at(no_overflow(column + a * deep) + b, j, arrays)
                outer, arm = outer_weights(w, d, a, b, size), outer_weights(w, levers, a, b, size)
                row, lever_row, product, slope_product = zero_node(), zero_node(), zero_node(), zero_node()
                here = along
                for c in ti.static(range(3)):
                    node = zero_node()
                    if ti.static(scatters):
                        node = arrays.grid[first + c]
                        add(arrays.grid_adjoints, first + c, (outer[0] * w[1][c]) * here, arrays)
                    else:
                        node = arrays.grid_adjoints[first + c]
                        lever_row = lever_row + levers[1][c] * node
                    both = node * here
                    row = row + w[1][c] * node
                    product = product + w[1][c] * both
                    slope_product = slope_product + d[1][c] * both
                    here = here + steps[1]
                sums[0] = sums[0] + outer[0] * row
                # x and, in 3D, z.
                for k in ti.static(range(size - 1)):
                    sums[1 + 2 * k] = sums[1 + 2 * k] + arm[1 + k] * row
                    forces[2 * k] = forces[2 * k] + outer[1 + k] * product
                sums[2] = sums[2] + outer[0] * lever_row
                forces[1] = forces[1] + outer[0] * slope_product
                along = along + steps[ti.static(2 * size - 4)]
            value = value + steps[0]
        store_forces(forces, scratch, lane, arrays)
        for k in ti.static(range(1 if scatters else 1 + size)):
            store_sum(sums[k], k, scratch, lane, arrays)


@ti.func
def outer_weights(w: ti.template(), d: ti.template(), a: ti.template(), b: ti.template(), size: ti.template()):
    """For three nodes of a column: the weight from the other axes, then the same with each axis's weight from `d`."""
    if ti.static(size == 2):
        return w[0][a], d[0][a]
    else:
        return w[0][a] * w[2][b], d[0][a] * w[2][b], w[0][a] * d[2][b]


@ti.func
def gather_moments(block: ti.template(), arrays: ti.template()):
    """Store sum_i w_ip n_i and sum_i w_ip x_ip n_i over the nodes, for each particle of a block."""
    lanes, deep, scratch = arrays.features.lanes, columns_deep(block.scene, arrays), block.scratch
    for lane in range(lanes):
        column, j = lowest_column(arrays, scratch, lane, block.table, deep)
        weight, grid = no_overflow(scratch * lanes + lane), arrays.addresses[Address.GRID]
        lever = weight + arrays.layout.scratch.levers * lanes
        sums = node_sums(grid, column, j, deep, weight, lever, arrays)
        for k in ti.static(range(1 + arrays.features.dimension)):
            store_sum(sums[k], k, scratch, lane, arrays)


@ti.func
def moments_of(block: ti.template(), first: ti.template(), count: ti.template(), scale, arrays: ti.template()):
    """`scale` times sum_i w_ip x_ip n_i for `count` numbers of the nodes from `first` on: D values for each number."""
    size = ti.static(arrays.features.dimension)
    sums = block.scratch + arrays.layout.scratch.sums
    places = ti.static([(1 + k % size) * NODE + first + k // size for k in range(size * count)])
    return [scale * arrays.scratch[sums + place] for place in ti.static(places)]


@ti.func
def store_sum(value, group: ti.template(), scratch, lane, arrays: ti.template()):
    """Store a gathered node in the lane's `group` of sums."""
    features, layout, lanes = arrays.features, arrays.layout, arrays.features.lanes
    at = no_overflow(scratch * lanes + lane) + (layout.scratch.sums + group * NODE) * lanes
    for k in ti.static(range(features.node.size)):
        arrays.scratch_lanes[at + k * lanes] = value[k]


@ti.func
def store_forces(products: ti.template(), scratch, lane, arrays: ti.template()):
    """Store the sum over the numbers of a node for each of the D `products`."""
    features, layout, lanes = arrays.features, arrays.layout, arrays.features.lanes
    at = no_overflow(scratch * lanes + lane) + layout.scratch.forces * lanes
    for k in ti.static(range(features.dimension)):
        total = products[k][0]
        for number in ti.static(range(1, features.node.size)):
            total = total + products[k][number]
        arrays.scratch_lanes[at + k * lanes] = total


@ti.func
def affine_reverse(block: ti.template(), arrays: ti.template()):
    """Adjoints of the D x D slopes of the grid's velocity u and then of its change, and of kappa, from that of C after
    the step; stores that of C before it, and adds that of C_s^2.

    C differs from the slope of u only if a loose particle is held back.
    """
    features = arrays.features
    count = ti.static(features.dimension**2)
    adj, first = adjoints_of(block, features.state.affine, count, arrays), block.adj + features.state.affine
    if ti.static(features.volume_correction):
        scale = 4.0 / arrays.settings[block.scene, Setting.CELL] ** 2
        slopes = moments_of(block, 0, features.dimension, scale, arrays)
        changes = moments_of(block, features.node.change, features.dimension, scale, arrays)
        affine = vectors(arrays.state, block.state + features.state.affine, count)
        slow = arrays.settings[block.scene, Setting.SLOW_AFFINE]
        constants = ti.static((looseness(block.number, arrays), features.dimension))
        held = ti.static([Pullback(held_affine, ((slopes, changes), affine, block.kappa, slow), constants)])[0]
        adj_moved, adj_affine, adj_kappa, adj_slow = ti.static(held(adj))
        for k in ti.static(range(count)):
            arrays.adjoints[first + k] = adj_affine[k]
        add_setting_adjoint(block, Setting.SLOW_AFFINE, adj_slow, arrays)
        return adj_moved[0] + adj_moved[1], adj_kappa
    else:
        none = [0.0 * adj[0] for _ in ti.static(range(count))]
        for k in ti.static(range(count)):
            arrays.adjoints[first + k] = none[k]
        return adj + none, none[0]
