"""The two transfers of MLS-MPM: particles to grid, grid to particles.

With w_ip the quadratic B-spline weight of node i at particle p, x_ip = x_i - x_p, V0 the particle's initial volume and
dx the cell (Hu et al. 2018; APIC: Jiang et al. 2015; AFLIP: Fei et al. 2021, eqs. 4 and 5):

    m_i     = sum_p w_ip m_p
    (m v)_i = sum_p w_ip m_p (v_p + C_p x_ip)
    f_i     = -sum_p w_ip V0 (4 / dx^2) sigma_p x_ip                     (Hu et al. 2018, eq. 16)
    v_i*    = v_i + dt (g + f_i / m_i), then the boundaries              (`mpm.physics.grid`)
    v_p     = sum_i w_ip v_i* + kappa (v_p - sum_i w_ip v_i),   kappa = exp(-dt / tau)
    C_p     = (4 / dx^2) sum_i w_ip v_i* x_ip^T
    x_p     = x_p + dt sum_i w_ip v_i*

The part of a particle's velocity that the grid cannot represent decays with the relaxation time tau, which belongs to
the scene, not to the step. APIC is tau = 0: it loses that part in every step, so that a shorter step, or a stiffer sand
that needs one, makes the flow more viscous. The change of the velocity needs f_i apart from (m v)_i.

While v_p is kept, C_p is computed anew in every step. Where stress-free particles cross, this would create the energy
of their affine motion, m_p dx^2 / 8 C_p : C_p. With volume correction, the C_p of such a particle, without the forces
of the step, therefore never exceeds C_s = sqrt(2 g / dx), which lifts it by a quarter of a cell:

    C_p = C_p* - kappa (1 - max(|C_p|, C_s) / |C_p'|)_+ C_p',    C_p' = (4 / dx^2) sum_i w_ip v_i x_ip^T
with C_p* from the equation above. C carries no momentum, so none is lost.

Quantities of particles are computed for a block at once, in vectors of lanes, and stored in `scratch`; then single
lanes are summed at the nodes. A particle's contribution is its value at its lowest node and a slope per axis.
"""

import taichi as ti

from mpm.arrays.access import clamp, columns_deep, minimum, no_overflow, vectors
from mpm.arrays.features import NODE
from mpm.arrays.layout import PADDING, Address, Contact, Offset, Property, Setting, Worker, component
from mpm.arrays.nodes import (
    add_to_column,
    column_sums,
    fused,
    fused_first,
    nodes_of,
    pair_of,
    read_ahead,
    turn,
    zero_node,
    zero_pair,
)
from mpm.physics.channel import side_friction
from mpm.physics.columns import node_at
from mpm.physics.contact import contact_at, push, touches
from mpm.physics.inflow import waits
from mpm.physics.pore_pressure import from_wall, presses_on, total_stress, wall_pressure
from mpm.physics.volume_correction import held_affine, is_loose, looseness


@ti.func
def property_of(scene, block, column: ti.template(), arrays: ti.template()):
    """A property of the particles: one number per scene, or one per lane where it differs between particles."""
    features = arrays.features
    if ti.static(features.heterogeneous or (features.uneven and column == Property.VOLUME)):
        return arrays.state[block * features.state.size + features.state.properties + column]
    else:
        return arrays.properties[scene, column]


@ti.func
def volume_of(scene, block, arrays: ti.template()):
    """Initial volume [m^D] of the particles of a block, 0 for those that have left the box."""
    features = arrays.features
    if ti.static(features.outflow):
        here = arrays.state[block * features.state.size + features.state.present]
        return property_of(scene, block, Property.VOLUME, arrays) * here
    else:
        return property_of(scene, block, Property.VOLUME, arrays)


@ti.func
def lowest_column(arrays: ti.template(), scratch, lane, table, deep):
    """Column of the lowest node of the particle in `lane`, and its j; columns count from `table`, `deep` along z."""
    features = arrays.features
    at = no_overflow(scratch * features.lanes + lane) + features.scratch.lowest * features.lanes
    column = table + ti.cast(arrays.scratch_lanes[at], ti.i32) * deep
    if ti.static(features.dimension == 3):
        column += ti.cast(arrays.scratch_lanes[at + 2 * features.lanes], ti.i32)
    return column, ti.cast(arrays.scratch_lanes[at + features.lanes], ti.i32)


@ti.func
def particles_to_grid(worker, scene, arrays: ti.template()):
    """Add mass, momentum and force of every particle of `worker` to its nodes."""
    features, lanes = arrays.features, arrays.features.lanes
    table, deep = arrays.workers[worker, Worker.COLUMN], columns_deep(scene, arrays)
    scratch = arrays.workers[worker, Worker.SCRATCH]
    rows = (scratch + features.scratch.rows) * lanes // NODE
    grid, state = arrays.addresses[Address.GRID], arrays.addresses[Address.STATE]
    for block in range(arrays.workers[worker, Worker.FIRST], arrays.workers[worker, Worker.LAST]):
        prepare_contributions(scene, block, scratch, arrays)
        turn("to_rows", scratch + features.scratch.values, scratch + features.scratch.rows, arrays)
        count = particles_in(scene, block, arrays)
        if ti.static(features.inflow):
            if waits(block, arrays):
                count = 0
        for lane in range(count):
            read_ahead(state, block + 1, lane, arrays)
            column, j = lowest_column(arrays, scratch, lane, table, deep)
            weight, row = no_overflow(scratch * lanes + lane), no_overflow(rows + 4 * lane)
            wx, wy = three_vectors(arrays, weight), three_vectors(arrays, weight + 3 * lanes)
            value, slope_x, slope_y = arrays.rows[row], arrays.rows[row + 1], arrays.rows[row + 2]
            if ti.static(features.dimension == 2):
                for a in ti.static(range(3)):
                    node = node_at(no_overflow(column) + a, j, arrays)
                    add_to_column(grid, node, wy, wx[a] * value, wx[a] * slope_y, arrays)
                    value = value + slope_x
            else:
                wz, slope_z = three_vectors(arrays, weight + 6 * lanes), arrays.rows[row + 3]
                for a in ti.static(range(3)):
                    first = no_overflow(column + a * deep)
                    along, z_step, y_slope = wx[a] * value, wx[a] * slope_z, wx[a] * slope_y
                    for b in ti.static(range(3)):
                        add_to_column(grid, node_at(first + b, j, arrays), wy, wz[b] * along, wz[b] * y_slope, arrays)
                        along = along + z_step
                    value = value + slope_x


@ti.func
def number_to_grid(table, block, k, deep, arrays: ti.template()):
    """Add the k-th of the numbers that a block of one particle has stored to its nodes in the columns from `table` on.

    On a GPU each number has a thread: those of a node, neighbours in memory, are added in one transaction.
    """
    features = arrays.features
    scratch = no_overflow(block * features.scratch.size)
    column, j = lowest_column(arrays, scratch, 0, table, deep)
    values = scratch + features.scratch.values + k
    value = arrays.scratch_lanes[values]
    slope = ti.Vector([0.0 * value for _ in ti.static(range(features.dimension))])
    if k != features.dimension and k <= 2 * features.dimension:
        for axis in ti.static(range(features.dimension)):
            slope[axis] = arrays.scratch_lanes[values + (1 + axis) * NODE]
    w = [three_vectors(arrays, scratch + 3 * axis) for axis in ti.static(range(features.dimension))]
    for a, b in ti.static(ti.ndrange(3, 3 if features.dimension == 3 else 1)):
        at = node_at(column + a * deep + b, j, arrays)
        along, here = w[0][a], value + a * slope[0]
        if ti.static(features.dimension == 3):
            along, here = along * w[2][b], here + b * slope[2]
        for c in ti.static(range(3)):
            ti.atomic_add(arrays.grid[at + c][k], along * w[1][c] * (here + c * slope[1]))


@ti.func
def weights_of(scene, block, scratch, per_dx, arrays: ti.template()):
    """Store weights and lowest nodes of a block in `scratch`; return its positions above these nodes [cells], [D]."""
    features = arrays.features
    first = no_overflow(block * features.state.size)
    f = [arrays.state[first + k] * per_dx + PADDING for k in ti.static(range(features.dimension))]
    for k in ti.static(range(features.dimension)):
        low = ti.floor(f[k] - 0.5)
        if ti.static(features.outflow):
            # A particle that has left through an open side, without mass, stays on the grid.
            low = clamp(low, 0.0, ti.cast(arrays.offsets[scene, Offset.CELLS_X + k] + (2 * PADDING - 2), float))
        arrays.scratch[scratch + features.scratch.lowest + k] = low
        # From 0.5 to 1.5 cells above the lowest node.
        u = f[k] - low
        f[k] = u
        w = 0.5 * (1.5 - u) * (1.5 - u), 0.75 - (u - 1.0) * (u - 1.0), 0.5 * (u - 0.5) * (u - 0.5)
        for a in ti.static(range(3)):
            arrays.scratch[scratch + 3 * k + a] = w[a]
    return f


@ti.func
def prepare_contributions(scene, block, scratch, arrays: ti.template()):
    """Store in `scratch` the weights, lowest nodes, values and slopes of a block."""
    features = arrays.features
    first = no_overflow(block * features.state.size)
    dx = arrays.settings[scene, Setting.CELL]
    volume, zero = volume_of(scene, block, arrays), 0.0 * arrays.state[first]
    mass = volume * property_of(scene, block, Property.DENSITY, arrays) + zero
    f = weights_of(scene, block, scratch, 1.0 / dx, arrays)
    leave_contributions(scene, block, scratch, mass, volume, f, dx, arrays)
    if ti.static(features.contact):
        if touches(block, arrays):
            push(block, scratch, arrays)
            pushed = vectors(arrays.scratch, scratch + features.scratch.push, 2 * features.dimension)
            pull, forces = contributions_of_contact(pushed, volume, f, dx, features.dimension)
            at = scratch + features.scratch.values + features.node.force
            for i in ti.static(range(features.dimension)):
                arrays.scratch[at + i] = arrays.scratch[at + i] + pull[i]
                for j in ti.static(range(features.dimension)):
                    slope = at + (1 + j) * NODE + i
                    arrays.scratch[slope] = arrays.scratch[slope] + forces[i * features.dimension + j]
    if ti.static(features.wet):
        for side in ti.static(range(2 * features.dimension)):
            if presses_on(block, side, scene, arrays):
                axis = ti.static(side // 2)
                pressed = volume * wall_pressure(block, side, scene, arrays)
                force = (-4.0 / dx) * from_wall(block, side, scene, arrays) * pressed
                at = scratch + features.scratch.values + features.node.force + axis
                pull = ti.static(1.0 - 2.0 * (side % 2)) * pressed - force * f[axis]
                arrays.scratch[at] = arrays.scratch[at] + pull
                arrays.scratch[at + (1 + axis) * NODE] = arrays.scratch[at + (1 + axis) * NODE] + force


@ti.func
def leave_contributions(scene, block, scratch, mass, volume, f: ti.template(), dx, arrays: ti.template()):
    """Store in `scratch` the values and slopes of a block, without those of contact."""
    features = arrays.features
    first, values = no_overflow(block * features.state.size), scratch + features.scratch.values
    velocity = vectors(arrays.state, first + features.state.velocity, features.dimension)
    affine = vectors(arrays.state, first + features.state.affine, features.dimension**2)
    stress = total_stress(block, [], arrays)
    momentum, slopes, pull, forces = contributions((velocity, affine, stress), mass, volume, f, dx, features)
    if ti.static(features.seeps):
        for i in ti.static(range(features.dimension)):
            pull[i] = pull[i] + volume * arrays.state[first + features.state.seepage + i]
    for i in ti.static(range(features.dimension)):
        arrays.scratch[values + i] = momentum[i]
        arrays.scratch[values + features.node.force + i] = pull[i]
        for j in ti.static(range(features.dimension)):
            at = values + (1 + j) * NODE + i
            arrays.scratch[at] = slopes[i * features.dimension + j]
            arrays.scratch[at + features.node.force] = forces[i * features.dimension + j]
    arrays.scratch[values + features.dimension] = mass
    if ti.static(features.channel):
        grip = arrays.settings[scene, Setting.GRIP]
        grains = vectors(arrays.state, first + features.state.stress, features.stresses)
        arrays.scratch[values + features.node.side_friction] = side_friction(grains, volume, grip)
    if ti.static(not features.processor.gpu):
        for k in ti.static(features.not_given):
            arrays.scratch[values + k] = 0.0 * mass
    if ti.static(features.turbulent):
        away = arrays.state[contact_at(block, Contact.DISTANCE, arrays)]
        widths = minimum(away / arrays.settings[scene, Setting.CONTACT_WIDTH], 1.0)
        arrays.scratch[values + features.node.distance] = mass * widths


@ti.func
def contributions(carried: ti.template(), mass, volume, f: ti.template(), dx, features: ti.template()):
    """Contribution of a particle to the node that lies `f` cells below it: momentum, its D x D slopes per cell row by
    row, and the force and its slopes. carried: its velocity, C and stress.
    """
    velocity, affine, stress = carried
    # Lengths on the grid are in cells: times dx.
    force_scale = -4.0 * volume * (1.0 / dx)
    momentum = [mass * velocity[i] for i in ti.static(range(features.dimension))]
    pull = [0.0 * mass for _ in ti.static(range(features.dimension))]
    slopes = [mass * dx * affine[k] for k in ti.static(range(features.dimension**2))]
    forces = [force_scale * stress[0] for _ in ti.static(range(features.dimension**2))]
    for i in ti.static(range(features.dimension)):
        for j in ti.static(range(features.dimension)):
            at = ti.static(i * features.dimension + j)
            forces[at] = force_scale * stress[ti.static(component(i, j))]
            pull[i] = pull[i] - forces[at] * f[j]
            momentum[i] = momentum[i] - slopes[at] * f[j]
    return momentum, slopes, pull, forces


@ti.func
def contributions_of_contact(pushed: ti.template(), volume, f: ti.template(), dx, dimension: ti.template()):
    """The part of the `surface_force` of solids, `pushed`, in that force and its slopes."""
    force_scale = -4.0 * volume * (1.0 / dx)
    pull = [volume * pushed[i] for i in ti.static(range(dimension))]
    square = ti.static(range(dimension**2))
    forces = [force_scale * pushed[k // dimension] * pushed[dimension + k % dimension] for k in square]
    for i in ti.static(range(dimension)):
        for j in ti.static(range(dimension)):
            pull[i] = pull[i] - forces[ti.static(i * dimension + j)] * f[j]
    return pull, forces


@ti.func
def particles_in(scene, block, arrays: ti.template()):
    """Lanes of a block that hold a particle: all, but in a scene's last block. The others mirror the last particle."""
    lanes = arrays.features.lanes
    before = (block - arrays.offsets[scene, Offset.BLOCK]) * lanes
    return ti.min(lanes, arrays.offsets[scene, Offset.PARTICLES] - before)


@ti.func
def grid_to_block(table, scene, block, scratch, per_dx, kappa, arrays: ti.template()):
    """Give a block the motion of its nodes in the columns from `table` on, v and C, and their mass if needed."""
    deep = columns_deep(scene, arrays)
    features, lanes = arrays.features, arrays.features.lanes
    first = no_overflow(block * features.state.size)
    # Weights, and weights times distance, of three nodes along each axis.
    f = weights_of(scene, block, scratch, per_dx, arrays)
    for k in ti.static(range(features.dimension)):
        for a in ti.static(range(3)):
            w, apart = arrays.scratch[scratch + 3 * k + a], ti.static(float(a)) - f[k]
            arrays.scratch[scratch + 3 * (features.dimension + k) + a] = (4.0 * per_dx) * w * apart
    loose = is_loose(block, arrays)
    values, rows = scratch + features.scratch.values, (scratch + features.scratch.rows) * lanes // NODE
    grid, state = arrays.addresses[Address.GRID], arrays.addresses[Address.STATE]
    for lane in range(lanes):
        if ti.static(not features.processor.gpu):
            read_ahead(state, block + 1, lane, arrays)
        column, j = lowest_column(arrays, scratch, lane, table, deep)
        weight = no_overflow(scratch * lanes + lane)
        sums = node_sums(grid, column, j, deep, weight, weight + 3 * features.dimension * lanes, arrays)
        for group in ti.static(range(1 + features.dimension)):
            if ti.static(features.processor.gpu):
                for k in ti.static(range(features.node.size)):
                    arrays.scratch[values + group * NODE + k] = sums[group][k]
            else:
                arrays.rows[no_overflow(rows + 4 * lane) + group] = sums[group]
    if ti.static(not features.processor.gpu):
        turn("to_lanes", scratch + features.scratch.rows, values, arrays)
    share_sums(first, scratch, loose, arrays)
    if ti.static(features.volume_correction):
        if loose:
            hold_affine(scene, block, scratch, kappa, arrays)


@ti.func
def node_sums(grid, column, j, deep, weight, lever, arrays: ti.template()):
    """Sums over a particle's nodes, from node j of `column` on, with its weights and with its levers by axis."""
    lanes = arrays.features.lanes
    wx, wy = three_vectors(arrays, weight), three_vectors(arrays, weight + 3 * lanes)
    lx, ly = three_vectors(arrays, lever), three_vectors(arrays, lever + 3 * lanes)
    both = [pair_of(wy[c], ly[c], arrays) for c in ti.static(range(3))]
    # The sum with weights and the sum with levers along y, side by side.
    v, x_slope, z_slope = zero_pair(), zero_node(), zero_node()
    # Sums along a column first: its nodes share the other weights.
    for a in ti.static(range(3)):
        u, t = zero_pair(), zero_node()
        first = no_overflow(column + a * deep)
        if ti.static(arrays.features.dimension == 2):
            u = column_sums(grid, node_at(first, j, arrays), both, arrays)
        else:
            wz, lz = three_vectors(arrays, weight + 6 * lanes), three_vectors(arrays, lever + 6 * lanes)
            for b in ti.static(range(3)):
                along = column_sums(grid, node_at(first + b, j, arrays), both, arrays)
                u = fused(wz[b], along, u, "add_scaled_pair", arrays)
                t = fused_first(lz[b], along, t, arrays)
        v = fused(wx[a], u, v, "add_scaled_pair", arrays)
        x_slope = fused_first(lx[a], u, x_slope, arrays)
        z_slope = fused(wx[a], t, z_slope, "add_scaled", arrays)
    value, y_slope = nodes_of(v, arrays)
    return value, x_slope, y_slope, z_slope


@ti.func
def three_vectors(arrays: ti.template(), at):
    """Numbers of three successive vectors of `scratch` in one lane; at: the place of the first."""
    lanes = arrays.features.lanes
    return arrays.scratch_lanes[at], arrays.scratch_lanes[at + lanes], arrays.scratch_lanes[at + 2 * lanes]


@ti.func
def share_sums(first, scratch, loose, arrays: ti.template()):
    """Store the sums of a block: the grid's velocity at each particle, its change, and C.

    In a loose block `hold_affine` sets C; this also stores the grid's mass [kg] and its slopes [kg/m].
    """
    features = arrays.features
    size = ti.static(features.dimension)
    values, at = scratch + features.scratch.values, scratch + features.scratch.lowest + size
    if ti.static(features.turbulent):
        arrays.scratch[scratch + features.scratch.layer] = arrays.scratch[values + size]
        arrays.scratch[scratch + features.scratch.layer + 1] = arrays.scratch[values + features.node.distance]
    for i in ti.static(range(size)):
        arrays.scratch[at + i] = arrays.scratch[values + i]
        arrays.scratch[at + size + i] = arrays.scratch[values + features.node.change + i]
    if ti.static(features.volume_correction):
        if loose:
            arrays.scratch[scratch + features.scratch.density] = arrays.scratch[values + size]
            for j in ti.static(range(size)):
                slope = values + ti.static((1 + j) * NODE)
                arrays.scratch[scratch + features.scratch.density + 1 + j] = arrays.scratch[slope + size]
                for i in ti.static(range(size)):
                    k = ti.static(size * i + j)
                    arrays.scratch[scratch + features.scratch.gradient + k] = arrays.scratch[slope + i]
                    change = arrays.scratch[slope + features.node.change + i]
                    arrays.scratch[scratch + features.scratch.changes + k] = change
    if not loose:
        for i, j in ti.static(ti.ndrange(size, size)):
            arrays.state[first + features.state.affine + size * i + j] = arrays.scratch[values + (1 + j) * NODE + i]


@ti.func
def hold_affine(scene, block, scratch, kappa, arrays: ti.template()):
    """Store C of the particles of a block; it is limited for particles in a spray."""
    features = arrays.features
    first = no_overflow(block * features.state.size)
    count = ti.static(features.dimension**2)
    slopes = vectors(arrays.scratch, scratch + features.scratch.gradient, count)
    changes = vectors(arrays.scratch, scratch + features.scratch.changes, count)
    affine = vectors(arrays.state, first + features.state.affine, count)
    slow = arrays.settings[scene, Setting.SLOW_AFFINE]
    held = held_affine((slopes, changes), affine, kappa, slow, looseness(block, arrays), features.dimension)
    for k in ti.static(range(count)):
        arrays.state[first + features.state.affine + k] = held[k]
