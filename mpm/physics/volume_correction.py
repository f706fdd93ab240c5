"""Volume correction: gaps between particles that have come apart.

A rate law for stress does not know how far sand has opened. So a particle carries its gap, the volume strain e by which
it opened without stress, and e must close before the particle carries stress (Tampubolon et al. 2017; the direction of
cracks: `mpm.physics.stress.with_cracks`). Integrated strain alone drifts: a single particle keeps its affine fit C, and
with it a strain rate, for ever. If a particle that carries next to no tension, T <= T_0 = rho_0 g dx / 10, is open, its
gap therefore relaxes to that of the grid's density, backward in time over T_g = sqrt(dx / g) / 4:

    e <- (e + dt / T_g min(e_s, max(15 e, e_s - 0.04))) / (1 + dt / T_g)
    e_s = max(0, 2 (1 - r) / (1 + r)) = -ln r + O((1 - r)^3)
    r = rho_p / (rho_0 f (1 - 2 |o|)),           rho_p = sum_i w_ip m_i / dx^D
    o = sum_i w_ip m_i x_ip / (dx sum_i w_ip m_i)

rho_p is exact on average inside a body, but single particles scatter by 3 % at the default jitter, ten times the
elastic strain of a bed. So within the scatter, up to 0.04, the grid's value counts as at most 15 times the particle's
own gap: a bed that rebounds for a few milliseconds opens by its own strain (with the scatter, one pressed on a baffle
with 1.25 times its static thrust), and sand in free fall follows the grid fully after 2 T_g. Beyond the scatter the
grid's value counts at once: sand that flies apart must not carry stress meanwhile, which would create energy.

Near a free surface rho_p is too low, down to 0.62 rho_0 at the outer one of two particles in a cell. There the centre
of mass o lies inwards, by 0.2 cells, and 1 - 2 |o| is the share that such a surface leaves. A wall of the box or a
solid hides mass, too, but is no surface: at y cells from it the share f = 1 - n^2 / 2, n = 1 - y / 1.7, is left, and o
points away from it by 0.2 min(n - 0.1, 0.6)_+ / f (both fitted to a half-space whose nodes have B-spline weights). Only
its shortfall from that counts as a surface: a dense layer of half a cell on a floor is not taken for loose sand.

At a boundary between soils of different density the grid's density is not the particle's own.
"""

import taichi as ti

from mpm.arrays.access import TINY, clamp, magnitude, maximum, minimum, no_overflow, over_lanes
from mpm.arrays.layout import Contact
from mpm.arrays.properties import GAP_CUTOFF

DEEPEST = 0.25  # least share of the density that a free surface is assumed to leave
SCATTER, FASTEST = 0.04, 15.0
"""Volume strain [-] that the scatter of particles can mimic, and its largest effect over the particle's own gap [-]: a
gap grows by at most e^14 in T_g."""

LEAST = 1.0e-8  # volume strain [-] that counts as none: the size of rounding errors


@ti.func
def slope_beside(near, mass, dx):
    """Slope of the grid's mass [kg/m] away from a wall or solid that hides mass, without a surface; `near`: n [-]."""
    lever = 0.2 * clamp(near - 0.1, 0.0, 0.6)
    return 4.0 * mass * lever / (dx * (1.0 - 0.5 * near * near))


@ti.func
def grid_gap(
    grid: ti.template(), x: ti.template(), contact: ti.template(), density, box: ti.template(), features: ti.template()
):
    """e_s [-] of particles at `x` [m], D vectors: the volume strain that follows from the grid's density.

    grid: sum_i w_ip m_i [kg] and its D slopes [kg/m]; contact: `mpm.physics.contact.contact_of`, if there are solids in
    the box; box: the length of a cell, and how many it has along each axis.
    """
    dx, cells = box
    # Lanes without mass keep a finite quotient.
    mass = maximum(grid[0], TINY)
    full = density * dx**features.dimension + 0.0 * mass
    square, across, near = 0.0 * mass, 0.0 * mass, 0.0 * mass
    if ti.static(features.contact):
        # No mass lies in a solid or beyond a wall, which shifts the centre of mass away from it along its normal.
        near = maximum(1.0 - contact[Contact.DISTANCE] / (GAP_CUTOFF * dx), 0.0)
        full = full * (1.0 - 0.5 * near * near)
        for k in ti.static(range(features.dimension)):
            across = across + grid[1 + k] * contact[Contact.NORMAL + k]
        across = ti.select(near > 0.0, maximum(across, slope_beside(near, mass, dx)), 0.0)
    for k in ti.static(range(features.dimension)):
        slope = grid[1 + k]
        if ti.static(features.contact):
            slope = slope - across * contact[Contact.NORMAL + k]
        x_cells = x[k] / (GAP_CUTOFF * dx)
        length = cells[k] / GAP_CUTOFF
        low, high = maximum(1.0 - x_cells, 0.0), maximum(1.0 - length + x_cells, 0.0)
        if ti.static(features.contact):
            # Where a solid covers a wall, only the solid hides mass.
            along = ti.select(near > 0.0, 2.0 * contact[Contact.NORMAL + k], 0.0)
            low, high = low * clamp(1.0 - along, 0.0, 1.0), high * clamp(1.0 + along, 0.0, 1.0)
        full = full * (1.0 - 0.5 * (low * low + high * high))
        slope = slope - ti.select(low > 0.0, maximum(slope, slope_beside(low, mass, dx)), 0.0)
        slope = slope - ti.select(high > 0.0, minimum(slope, 0.0 - slope_beside(high, mass, dx)), 0.0)
        square = square + slope * slope
    inwards = 0.25 * dx * ti.sqrt(square) / mass
    packed = mass / (full * maximum(1.0 - 2.0 * inwards, DEEPEST))
    return maximum(2.0 * (1.0 - packed) / (1.0 + packed), 0.0)


@ti.func
def updated_gap(opened, tension, bulk, rate, gap):
    """K e [Pa]: remembered or, if open without tension, relaxed to the grid's `gap` e_s [-]; rate: dt / T_g [-];
    tension: T - T_0 [Pa].
    """
    shown = minimum(bulk * gap, maximum(FASTEST * opened, bulk * (gap - SCATTER)))
    followed = (opened + rate * shown) / (1.0 + rate)
    return ti.select((opened > 0.0) & (tension <= 0.0), followed, opened)


@ti.func
def kept_gap(opened, mean, tension, bulk):
    """K e [Pa] that is remembered after a step: at least K LEAST where sand without tension carries no stress.

    Sand that starts to fall strains by rounding alone, whose sign must not decide whether it is open. mean: mean stress
    [Pa]; tension: T - T_0 [Pa]; bulk: K [Pa].
    """
    least = LEAST * bulk
    bears = (mean <= 0.0 - least) | (tension > 0.0)
    return ti.select(opened > least, opened, ti.select(bears, 0.0 * opened, least + 0.0 * opened))


@ti.func
def looseness(block, arrays: ti.template()):
    """K e [Pa] of the particles of a block, and 1 for those that have not carried stress yet: positive if loose."""
    features, first = arrays.features, no_overflow(block * arrays.features.state.size)
    bears = 0.0 * arrays.state[first]
    for k in ti.static(range(3)):
        bears = bears + magnitude(arrays.state[first + features.state.stress + k])
    return ti.select(bears > 0.0, arrays.state[first + features.state.gap], 1.0)


@ti.func
def is_loose(block, arrays: ti.template()):
    """Whether a particle of a block is loose; in most blocks none is, and the grid's density is not needed."""
    if ti.static(arrays.features.volume_correction):
        return over_lanes(maximum, looseness(block, arrays), arrays.features.lanes) > 0.0
    else:
        return False


@ti.func
def held_affine(moved: ti.template(), affine: ti.template(), kappa, slow, loose, size: ti.template()):
    """C [1/s] from `moved`, slopes of the grid's velocity and its change, and C before (`mpm.physics.transfer`).

    slow: C_s^2 [1/s^2]; loose: what `looseness` gives.
    """
    slopes, changes = moved
    before_squared, now_squared = 0.0 * loose, 0.0 * loose
    for k in ti.static(range(size**2)):
        old, new = kappa * affine[k], slopes[k] - changes[k]
        before_squared, now_squared = before_squared + old * old, now_squared + new * new
    most = maximum(before_squared, slow + 0.0 * loose)
    held = (loose > 0.0) & (now_squared > most)
    excess = ti.select(held, 1.0 - ti.sqrt(most / ti.select(held, now_squared, 1.0)), 0.0)
    return [slopes[k] - excess * (slopes[k] - changes[k]) for k in ti.static(range(size**2))]
