"""The pore pressure in which saturated masses begin, and which share of their weight it leaves to the grains.

    p = r_u sigma                                     of a mass with `initial_pore_pressure_ratio` r_u
    p = rho_w a (min(s, top) - y)                     of others below the water table y = s(x, z), else 0

with the total stress sigma = rho a (top - y), of all that rests on a place up to `top`. Pressure grows with the
vertical depth, a = -g_y: water at rest below a level table, and a common assumption below any other one, which leaves
out what seepage takes of it. In a sheet along a slope, with the unit normal n of its ground, water flows along it:
a = |g . n| n_y, and sigma is the stress normal to it. Above the table material is moist: p = 0, and it has no water
that could be pressed. Where the table is above the ground, the water that stood there is gone, and the pressure that
its weight had made in the pores with it (B = 1: Bishop 1954; Morgenstern 1963, rapid drawdown). The rest, 1 - p / sigma
of the normal stress, grains bear, by `mpm.initial.stress`.

**A slope at rest** (`Water.fixed`) needs no more of water than the force per volume -grad p: buoyancy and seepage, and
the effective stress of its surface is 0 also beneath a pool, which adds rho_w g (pool - top) to p where it stands.
"""

import math
from collections.abc import Callable
from functools import partial

import numpy as np
from numpy.typing import NDArray

from datasets.errors import InputError
from datasets.geometry.bodies import filling
from datasets.geometry.ground import elevation, interpolated, plan_axes
from datasets.scene import TOLERANCE, Mass, Scene, keyed
from datasets.scene.particles import Particles
from datasets.scene.parts import Water
from datasets.scene.water import DENSITY
from mpm.initial.slope import begins_as_slope, ground_beneath, mass_above, sides, within

Floats = NDArray[np.float64]


def initial_water(scene: Scene, particles: Particles, near: NDArray[np.bool_] | None = None) -> tuple[Floats, Floats]:
    """p [Pa] of each particle, 1 where water fills its pores and else 0, and the share of the normal stress that grains
    bear [-], shape [N, 3]; and grad p [Pa/m], shape [N, D]. near: of flows those that need it, which are beside
    surfaces, [N]; all where absent. Raises InputError for a saturated mass that begins without a stress.
    """
    positions, cell = particles.positions, scene.domain.cell
    pressure, wet, share = np.zeros((3, len(positions)))
    share += 1.0
    slopes = np.zeros(positions.shape)
    for number, (key, mass) in enumerate(keyed(scene, "masses").items()):
        if not scene.material_of(mass).saturated:
            continue
        of_mass = particles.mass == number
        if mass.k0 is None and not begins_as_slope(scene, mass):
            message = "expected a k0: a saturated mass begins with its weight on grains and water, got none"
            raise InputError(message, key=f"{key}.k0")
        whole, head = np.nan_to_num(stresses(scene, mass, positions[of_mass]))
        full = positions[of_mass, 1] < table(scene, mass, positions[of_mass][:, plan_axes(scene.dimension)])
        pore_pressure = np.where(full, np.maximum(head, 0.0), 0.0)
        fixed = (scene.water or Water()).fixed
        sloping = np.ones(len(head), bool) if fixed or near is None else near[of_mass]
        sloping = np.flatnonzero(of_mass)[sloping & (pore_pressure > 0.0)]
        _, slopes[sloping] = gradient(partial(stresses, scene, mass), positions[sloping], 0.5 * cell)
        if not fixed:
            pore_pressure = np.minimum(pore_pressure, whole)
        wet[of_mass], pressure[of_mass] = full, pore_pressure
        share[of_mass] -= np.divide(pore_pressure, whole, out=np.zeros_like(whole), where=whole > 0.0)
    return np.stack([pressure, wet, share], axis=1), slopes


def stresses(scene: Scene, mass: Mass, positions: Floats) -> Floats:
    """Total stress sigma and p at `positions` [m], [N, D], in and beside a mass [Pa], shape [2, N]: below 0 where they
    are above its top or the water table, NaN where it is not in plan.
    """
    # Imported here: it needs a sparse solver.
    from mpm.initial.stress import overburden

    plan, y = positions[:, plan_axes(scene.dimension)], positions[:, 1]
    water, down = scene.water or Water(), -scene.gravity_vector[1]
    _, top = extent(scene, mass, plan)
    across = np.full(len(y), down)
    # Its ground is the same where a stress has been asked for.
    if begins_as_slope(scene, mass):
        normal, _ = ground_beneath(scene, mass, positions)
        across = np.abs(normal @ np.array(scene.gravity_vector)) * normal[:, 1]
        load = across / normal[:, 1] * mass_above(scene, mass, positions)
        whole = across * scene.material_of(mass).density * (top - y) + load
    else:
        whole = overburden(scene, mass, positions, top - y)
    highest = column_top(scene, mass, plan)
    if mass.initial_pore_pressure_ratio is not None:
        p = mass.initial_pore_pressure_ratio * whole
    else:
        p = DENSITY * across * (np.minimum(table(scene, mass, plan), highest) - y)
    if water.pool is not None:
        p = p + DENSITY * down * np.maximum(water.pool - highest, 0.0)
    return np.stack([whole, p])


def table(scene: Scene, mass: Mass, plan: Floats) -> Floats:
    """Elevation [m] of the water table over places in plan [m], [N, D - 1]; inf where water stands to the top. [N]."""
    water = scene.water or Water()
    if water.table is not None:
        rows = np.array(water.table, np.float64)
        if scene.dimension == 2:
            return np.asarray(np.interp(plan[:, 0], *rows.T))
        steps = zip(water.origin or (), water.spacing or (), rows.shape, strict=True)
        return interpolated([first + step * np.arange(count) for first, step, count in steps], rows, plan)
    pool = water.pool if mass.initial_pore_pressure_ratio is None else None
    level = pool if water.level is None else water.level
    return np.full(len(plan), math.inf if level is None else level)


def column_top(scene: Scene, mass: Mass, plan: Floats) -> Floats:
    """Top [m] of a mass and of the saturated ones that rest on it, over places in plan [m], [N, D - 1]; shape [N]."""
    _, top = extent(scene, mass, plan)
    for other in sorted(scene.masses, key=lambda body: body.lower[1]):
        if other is not mass and scene.material_of(other).saturated:
            foot, above = extent(scene, other, plan)
            top = np.where((foot <= top + TOLERANCE) & (above > top), above, top)
    return top


def extent(scene: Scene, mass: Mass, plan: Floats) -> tuple[Floats, Floats]:
    """Lower and upper end [m] of a mass over places in plan [m], [N, D - 1]; NaN where it is not. Each [N]."""
    level = plan_axes(scene.dimension)
    inside = within(plan, mass, level)
    if mass.kind == "polygon":
        x, *both = sides(mass, scene.domain.cell)
        ends = [np.interp(plan[:, 0], x, side) for side in both]
    elif mass.kind == "box":
        ends = [np.full(len(plan), mass.lower[1]), np.full(len(plan), mass.lower[1] + mass.size[1])]
    elif mass.kind == "layer":
        body, foot = filling(scene, mass), elevation(scene.solids, scene.domain, plan)
        ends = [foot, foot + body.depth(np.insert(plan, 1, foot, axis=1))]
        inside = inside & (ends[1] > foot)
    else:
        # The columns of the lattice that fills a mesh.
        body = filling(scene, mass)
        first, steps = body.lattice.min(axis=0), body.spacing
        index = np.rint((body.lattice - first) / steps).astype(np.int64)[:, level]
        shape = tuple(index.max(axis=0) + 1)
        lows, highs = np.full(shape, np.inf), np.full(shape, -np.inf)
        np.minimum.at(lows, tuple(index.T), body.lattice[:, 1] - 0.5 * steps[1])
        np.maximum.at(highs, tuple(index.T), body.lattice[:, 1] + 0.5 * steps[1])
        at = np.rint((plan - first[level]) / steps[level]).astype(np.int64)
        ends = [values[tuple(np.clip(at, 0, np.array(shape) - 1).T)] for values in (lows, highs)]
        inside = inside & (ends[0] <= ends[1])
    return np.where(inside, ends[0], np.nan), np.where(inside, ends[1], np.nan)


def gradient(function: Callable[[Floats], Floats], positions: Floats, step: float) -> Floats:
    """Of function(positions) [..., N] by differences over `step` [m] where it is known either way; [..., N, D]."""
    here, slopes = function(positions), []
    for direction in step * np.eye(positions.shape[1]):
        ends = [function(positions + side * direction) for side in (-1.0, 1.0)]
        finite = [np.isfinite(end) for end in ends]
        rise = np.where(finite[1], ends[1], here) - np.where(finite[0], ends[0], here)
        slopes.append(rise / np.maximum(step * (1.0 * finite[0] + finite[1]), step))
    return np.stack(slopes, axis=-1)
