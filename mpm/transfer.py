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

`a = a + b` on the grid, not `a += b`: Taichi makes the latter a compare-and-swap loop, three times slower. Flat arrays
with one offset per point, not index tuples: 1.6 times faster.
"""

import taichi as ti

from mpm.layout import PADDING, Place, Property, Setting
from mpm.nodes import node_width, row_width
from mpm.stress import plastic_return, trial_stress


@ti.func
def spline(f):
    """Quadratic B-spline weights of the three nodes around a point, `f` in [0.5, 1.5) cells from the first one."""
    return ti.Vector([0.5 * (1.5 - f) * (1.5 - f), 0.75 - (f - 1.0) * (f - 1.0), 0.5 * (f - 0.5) * (f - 0.5)])


@ti.func
def first_node(place):
    """Lowest of the three nodes that a point at `place` [cells] reaches; the padding keeps the cast away from zero."""
    return ti.cast(place - 0.5, ti.i32)


@ti.func
def points_to_grid(
    scene,
    dt,
    x: ti.template(),
    v: ti.template(),
    c: ti.template(),
    sigma: ti.template(),
    material: ti.template(),
    grid: ti.template(),
    settings: ti.template(),
    properties: ti.template(),
    places: ti.template(),
    damped: ti.template(),
    several: ti.template(),
):
    """Add mass, momentum and force of every point to its nine nodes."""
    dx = settings[scene, Setting.CELL]
    per_dx = 1.0 / dx
    volume = settings[scene, Setting.VOLUME]
    width, row = ti.static(node_width(damped)), row_width(scene, places, damped)
    origin = places[scene, Place.NODE] * width
    first = places[scene, Place.POINT]
    mass = volume * properties[places[scene, Place.MATERIAL], Property.DENSITY]
    # -V0 4 / dx^2, times dx: lengths on the grid are in cells.
    force_scale = -4.0 * volume * per_dx
    for p in range(first, first + places[scene, Place.POINTS]):
        if ti.static(several):
            mass = volume * properties[material[p], Property.DENSITY]
        px, py = x[2 * p] * per_dx + PADDING, x[2 * p + 1] * per_dx + PADDING
        i, j = first_node(px), first_node(py)
        fx, fy = px - i, py - j
        wx, wy = spline(fx), spline(fy)
        sxx, syy, sxy = sigma[4 * p] * force_scale, sigma[4 * p + 1] * force_scale, sigma[4 * p + 2] * force_scale
        axx, axy = mass * dx * c[4 * p], mass * dx * c[4 * p + 1]
        ayx, ayy = mass * dx * c[4 * p + 2], mass * dx * c[4 * p + 3]
        if ti.static(not damped):
            axx += dt * sxx
            axy += dt * sxy
            ayx += dt * sxy
            ayy += dt * syy
        # Values at the first of the nine nodes; the affine parts add up from there.
        mx = mass * v[2 * p] - axx * fx - axy * fy
        my = mass * v[2 * p + 1] - ayx * fx - ayy * fy
        gx, gy = -sxx * fx - sxy * fy, -sxy * fx - syy * fy
        corner = origin + i * row + j * width
        for a in ti.static(range(3)):
            for b in ti.static(range(3)):
                n = corner + a * row + b * width
                w = wx[a] * wy[b]
                grid[n] = grid[n] + w * (mx + axx * a + axy * b)
                grid[n + 1] = grid[n + 1] + w * (my + ayx * a + ayy * b)
                grid[n + 2] = grid[n + 2] + w * mass
                if ti.static(damped):
                    grid[n + 3] = grid[n + 3] + w * (gx + sxx * a + sxy * b)
                    grid[n + 4] = grid[n + 4] + w * (gy + sxy * a + syy * b)


@ti.func
def grid_to_points(
    scene,
    dt,
    x: ti.template(),
    v: ti.template(),
    c: ti.template(),
    sigma: ti.template(),
    material: ti.template(),
    grid: ti.template(),
    settings: ti.template(),
    properties: ti.template(),
    places: ti.template(),
    damped: ti.template(),
    dilates: ti.template(),
    several: ti.template(),
):
    """Give every point the motion of its nine nodes, move it, and bring its stress along."""
    dx = settings[scene, Setting.CELL]
    per_dx = 1.0 / dx
    cells_x, cells_y = places[scene, Place.CELLS_X], places[scene, Place.CELLS_Y]
    width, row = ti.static(node_width(damped)), row_width(scene, places, damped)
    origin = places[scene, Place.NODE] * width
    first = places[scene, Place.POINT]
    kind = places[scene, Place.MATERIAL]
    lame, shear = properties[kind, Property.LAME], properties[kind, Property.SHEAR]
    sin_phi, sin_psi = properties[kind, Property.SIN_PHI], properties[kind, Property.SIN_PSI]
    strength, limit = properties[kind, Property.STRENGTH], properties[kind, Property.LIMIT]
    left, right, bottom, top = cells_x + PADDING, 0, cells_y + PADDING, 0
    for p in range(first, first + places[scene, Place.POINTS]):
        px, py = x[2 * p] * per_dx + PADDING, x[2 * p + 1] * per_dx + PADDING
        i, j = first_node(px), first_node(py)
        fx, fy = px - i, py - j
        wx, wy = spline(fx), spline(fy)
        corner = origin + i * row + j * width
        vx, vy = 0.0, 0.0
        cxx, cxy, cyx, cyy = 0.0, 0.0, 0.0, 0.0
        for a in ti.static(range(3)):
            # Sums along the column first: they share the weight in x.
            ux, uy, sx, sy = 0.0, 0.0, 0.0, 0.0
            for b in ti.static(range(3)):
                n = corner + a * row + b * width
                ux += wy[b] * grid[n]
                uy += wy[b] * grid[n + 1]
                sx += wy[b] * b * grid[n]
                sy += wy[b] * b * grid[n + 1]
            vx += wx[a] * ux
            vy += wx[a] * uy
            cxx += wx[a] * a * ux
            cyx += wx[a] * a * uy
            cxy += wx[a] * sx
            cyy += wx[a] * sy
        spread = 4.0 * per_dx
        cxx, cxy = spread * (cxx - vx * fx), spread * (cxy - vx * fy)
        cyx, cyy = spread * (cyx - vy * fx), spread * (cyy - vy * fy)
        v[2 * p], v[2 * p + 1] = vx, vy
        c[4 * p], c[4 * p + 1], c[4 * p + 2], c[4 * p + 3] = cxx, cxy, cyx, cyy

        free_x, free_y = x[2 * p] + dt * vx, x[2 * p + 1] + dt * vy
        new_x = ti.math.clamp(free_x, 0.0, cells_x * dx)
        new_y = ti.math.clamp(free_y, 0.0, cells_y * dx)
        if new_x != free_x or new_y != free_y:
            places[scene, Place.CLAMPED] = places[scene, Place.CLAMPED] + 1
        x[2 * p], x[2 * p + 1] = new_x, new_y
        i, j = first_node(new_x * per_dx + PADDING), first_node(new_y * per_dx + PADDING)
        left, right = ti.min(left, i), ti.max(right, i)
        bottom, top = ti.min(bottom, j), ti.max(top, j)

        if ti.static(several):
            kind = material[p]
            lame, shear = properties[kind, Property.LAME], properties[kind, Property.SHEAR]
            sin_phi, sin_psi = properties[kind, Property.SIN_PHI], properties[kind, Property.SIN_PSI]
            strength, limit = properties[kind, Property.STRENGTH], properties[kind, Property.LIMIT]
        stress = ti.Vector([sigma[4 * p], sigma[4 * p + 1], sigma[4 * p + 2], sigma[4 * p + 3]])
        stress = trial_stress(stress, dt * ti.Matrix([[cxx, cxy], [cyx, cyy]]), lame, shear)
        stress = plastic_return(stress, sin_phi, sin_psi, strength, limit, lame, shear, dilates)
        for k in ti.static(range(4)):
            sigma[4 * p + k] = stress[k]
    places[scene, Place.BOX_LEFT], places[scene, Place.BOX_RIGHT] = left, right + 3
    places[scene, Place.BOX_BOTTOM], places[scene, Place.BOX_TOP] = bottom, top + 3
