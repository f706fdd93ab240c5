"""The MLS-MPM step (Hu et al. 2018), explicit, quadratic B-splines, APIC (Jiang et al. 2015): the one hot kernel.

Per step, with w_ip the weight of node i at point p, x_ip = x_i - x_p, V0 the point's initial volume and dx the cell:

    m_i     = sum_p w_ip m_p
    (m v)_i = sum_p w_ip [m_p v_p + m_p C_p x_ip] + dt f_i
    f_i     = -sum_p w_ip V0 (4 / dx^2) sigma_p x_ip + m_i g              (Hu et al. 2018, eq. 16)
    v_p     = sum_i w_ip v_i,    C_p = (4 / dx^2) sum_i w_ip v_i x_ip^T
    x_p    += dt v_p

and the stress follows from C_p (`mpm.stress`). Local damping (Cundall 1987), as CB-Geo MPM applies it at a node,
takes alpha |f_i| sign(v_i) off each component of f_i, |f_i| being the length of the whole force (Cundall's own form
takes each component's); a scene without it neither stores nor sums f_i apart.

How it is laid out, and why: one scene runs on one thread from the first substep of a launch to the last, so there are
no atomics, no barriers, and the result is the same to the bit on any number of threads. `a = a + b` on the grid, not
`a += b`, which Taichi turns into a compare-and-swap loop (three times slower). Flat arrays with one offset per point,
not index tuples (1.6 times). Only the bounding box of the material is cleared and updated.
"""

import taichi as ti

from mpm.layout import PADDING, Energy, Place, Property, Setting
from mpm.stress import plastic_return, trial_stress
from mpm.walls import against_walls

PLAIN_NODE = 3
"""Numbers per node: momentum (x, y) and mass; velocity in place of momentum after the update."""
DAMPED_NODE = 5
"""The same and the force (x, y)."""
STABILITY = 1.0
"""Largest (wave speed + point speed) dt / dx. Measured clean up to 1.1 in 2D."""
RUNAWAY = 10.0
"""Point speed over wave speed at which a run has blown up."""
TURNS = 512

Array = ti.types.ndarray()
Flat = ti.types.ndarray(ndim=1)


@ti.func
def spline(f):
    """Quadratic B-spline weights of the three nodes around a point, `f` in [0.5, 1.5) cells from the first one."""
    return ti.Vector([0.5 * (1.5 - f) * (1.5 - f), 0.75 - (f - 1.0) * (f - 1.0), 0.5 * (f - 0.5) * (f - 0.5)])


@ti.func
def first_node(place):
    """Lowest of the three nodes that a point at `place` [cells] reaches; the padding keeps the cast away from zero."""
    return ti.cast(place - 0.5, ti.i32)


@ti.kernel
def advance(
    x: Flat,
    v: Flat,
    c: Flat,
    sigma: Flat,
    material: Flat,
    grid: Flat,
    settings: Array,
    properties: Array,
    places: Array,
    record: Flat,
    energy: Array,
    first_frame: ti.i32,
    last_frame: ti.i32,
    damped: ti.template(),
    dilates: ti.template(),
    several: ti.template(),
):
    """Advance every scene from `first_frame` to `last_frame` and record its positions and energies.

    `x`, `v` [2 N], `c` [4 N] (rows of C), `sigma` [4 N] (xx, yy, xy, zz), `material` [N], `grid`: all scenes in a row.
    `damped`, `dilates`, `several` (materials) are compiled in only where a scene of the batch needs them.
    """
    ti.loop_config(block_dim=TURNS)
    # A thread is handed no fewer than 512 turns of a loop: one scene for each of them.
    for turn in range(places.shape[0] * TURNS):
        if turn % TURNS != 0:
            continue
        scene = turn // TURNS
        width = ti.static(DAMPED_NODE if damped else PLAIN_NODE)
        dx = settings[scene, Setting.CELL]
        inverse_dx = 1.0 / dx
        volume = settings[scene, Setting.VOLUME]
        gravity_x, gravity_y = settings[scene, Setting.GRAVITY_X], settings[scene, Setting.GRAVITY_Y]
        floor_friction = settings[scene, Setting.FLOOR_FRICTION]
        wall_friction = settings[scene, Setting.WALL_FRICTION]
        damping = settings[scene, Setting.DAMPING]
        first = places[scene, Place.POINT]
        last = first + places[scene, Place.POINTS]
        cells_x, cells_y = places[scene, Place.CELLS_X], places[scene, Place.CELLS_Y]
        row = (cells_y + 2 * PADDING + 1) * width
        origin = places[scene, Place.NODE] * width
        # -V0 4 / dx^2 times dx: lengths on the grid are in cells.
        force_scale = -4.0 * volume * inverse_dx

        # With one material in the batch these are its constants for good; with several, each point loads its own.
        kind = 0
        lame, shear = properties[kind, Property.LAME], properties[kind, Property.SHEAR]
        sin_phi, sin_psi = properties[kind, Property.SIN_PHI], properties[kind, Property.SIN_PSI]
        strength, limit = properties[kind, Property.STRENGTH], properties[kind, Property.LIMIT]
        mass = volume * properties[kind, Property.DENSITY]

        for frame in range(first_frame, ti.min(last_frame, places[scene, Place.FRAMES])):
            speed2 = 0.0
            for p in range(first, last):
                here = v[2 * p] * v[2 * p] + v[2 * p + 1] * v[2 * p + 1]
                if ti.math.isnan(here):
                    here = ti.math.inf
                speed2 = ti.max(speed2, here)
            wave_speed = settings[scene, Setting.WAVE_SPEED]
            frame_dt = settings[scene, Setting.FRAME_DT]
            # A point that outruns the elastic wave many times over is no longer physics: the scene ends here.
            lost = speed2 > (RUNAWAY * wave_speed) ** 2
            needed = 0
            if not lost:
                needed = ti.cast(ti.ceil(frame_dt * (wave_speed + ti.sqrt(speed2)) * inverse_dx / STABILITY), ti.i32)
            substeps = ti.max(needed, places[scene, Place.SUBSTEPS])
            if lost:
                places[scene, Place.FRAMES] = frame
                break
            places[scene, Place.STEPS] = places[scene, Place.STEPS] + substeps
            dt = frame_dt / substeps

            for _ in range(substeps):
                left, right = places[scene, Place.BOX_LEFT], places[scene, Place.BOX_RIGHT]
                bottom, top = places[scene, Place.BOX_BOTTOM], places[scene, Place.BOX_TOP]

                for i in range(left, right):
                    for n in range(origin + i * row + bottom * width, origin + i * row + top * width):
                        grid[n] = 0.0

                for p in range(first, last):
                    if ti.static(several):
                        mass = volume * properties[material[p], Property.DENSITY]
                    px, py = x[2 * p] * inverse_dx + PADDING, x[2 * p + 1] * inverse_dx + PADDING
                    i, j = first_node(px), first_node(py)
                    fx, fy = px - i, py - j
                    wx, wy = spline(fx), spline(fy)
                    sxx, syy, sxy = (
                        sigma[4 * p] * force_scale,
                        sigma[4 * p + 1] * force_scale,
                        sigma[4 * p + 2] * force_scale,
                    )
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

                for i in range(left, right):
                    for j in range(bottom, top):
                        n = origin + i * row + j * width
                        if grid[n + 2] > 0.0:
                            inverse_mass = 1.0 / grid[n + 2]
                            vx, vy = grid[n] * inverse_mass, grid[n + 1] * inverse_mass
                            if ti.static(damped):
                                ax, ay = grid[n + 3] * inverse_mass + gravity_x, grid[n + 4] * inverse_mass + gravity_y
                                drag = damping * ti.sqrt(ax * ax + ay * ay)
                                vx += dt * (ax - drag * ti.math.sign(vx))
                                vy += dt * (ay - drag * ti.math.sign(vy))
                            else:
                                vx += dt * gravity_x
                                vy += dt * gravity_y
                            vx, vy = against_walls(vx, vy, i, j, cells_x, cells_y, floor_friction, wall_friction)
                            grid[n], grid[n + 1] = vx, vy

                left, right, bottom, top = cells_x + PADDING, 0, cells_y + PADDING, 0
                for p in range(first, last):
                    px, py = x[2 * p] * inverse_dx + PADDING, x[2 * p + 1] * inverse_dx + PADDING
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
                    spread = 4.0 * inverse_dx
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
                    i, j = first_node(new_x * inverse_dx + PADDING), first_node(new_y * inverse_dx + PADDING)
                    left, right = ti.min(left, i), ti.max(right, i)
                    bottom, top = ti.min(bottom, j), ti.max(top, j)

                    if ti.static(several):
                        kind = material[p]
                        lame, shear = properties[kind, Property.LAME], properties[kind, Property.SHEAR]
                        sin_phi, sin_psi = properties[kind, Property.SIN_PHI], properties[kind, Property.SIN_PSI]
                        strength, limit = properties[kind, Property.STRENGTH], properties[kind, Property.LIMIT]
                    stress = ti.Vector([sigma[4 * p], sigma[4 * p + 1], sigma[4 * p + 2], sigma[4 * p + 3]])
                    gradient = dt * ti.Matrix([[cxx, cxy], [cyx, cyy]])
                    stress = trial_stress(stress, gradient, lame, shear)
                    stress = plastic_return(stress, sin_phi, sin_psi, strength, limit, lame, shear, dilates)
                    for k in ti.static(range(4)):
                        sigma[4 * p + k] = stress[k]

                places[scene, Place.BOX_LEFT], places[scene, Place.BOX_RIGHT] = left, right + 3
                places[scene, Place.BOX_BOTTOM], places[scene, Place.BOX_TOP] = bottom, top + 3

            kinetic, potential, elastic = 0.0, 0.0, 0.0
            offset = places[scene, Place.RECORD] + 2 * frame * (last - first)
            for p in range(first, last):
                if ti.static(several):
                    kind = material[p]
                    mass = volume * properties[kind, Property.DENSITY]
                record[offset + 2 * (p - first)], record[offset + 2 * (p - first) + 1] = x[2 * p], x[2 * p + 1]
                vv = v[2 * p] * v[2 * p] + v[2 * p + 1] * v[2 * p + 1]
                cc = 0.0
                for k in ti.static(range(4)):
                    cc += c[4 * p + k] * c[4 * p + k]
                # APIC carries the energy of the affine motion too: the spline's inertia is dx^2 / 4.
                kinetic += 0.5 * mass * (vv + 0.25 * dx * dx * cc)
                potential -= mass * (gravity_x * x[2 * p] + gravity_y * x[2 * p + 1])
                sxx, syy, sxy, szz = sigma[4 * p], sigma[4 * p + 1], sigma[4 * p + 2], sigma[4 * p + 3]
                square = sxx * sxx + syy * syy + szz * szz + 2.0 * sxy * sxy
                trace = sxx + syy + szz
                deviator, spherical = (
                    properties[kind, Property.ELASTIC_DEVIATOR],
                    properties[kind, Property.ELASTIC_TRACE],
                )
                elastic += volume * (deviator * square - spherical * trace * trace)
            line = frame + places[scene, Place.ENERGY]
            energy[line, Energy.KINETIC] = kinetic
            energy[line, Energy.POTENTIAL] = potential
            energy[line, Energy.ELASTIC] = elastic
