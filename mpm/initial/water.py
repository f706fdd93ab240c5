"""The initial pore pressure of saturated masses, and the share of their weight that it leaves to the grains.

    p = r_u sigma                                     of a mass with `initial_pore_pressure_ratio` r_u
    p = rho_w a (min(s, top) - y)                     of others below the water table y = s(x, z), else 0

with the total stress sigma = rho a (top - y) of all material above a place, up to `top`. Pressure grows with the
vertical depth, a = -g_y: exact for water at rest below a level table, and a common assumption below any other table,
which neglects the effect of seepage. In a sheet along a slope, sigma is the stress normal to its ground, a = |g . n|
n_y with the ground's unit normal n, and water flows along its surface: n is then that of the table, or of the ground
where the table is above it; a pool is level. Above the table material is moist: p = 0, and it has no water that could
be compressed. Where the table is above the ground, the water that stood there is gone, and with it the pore pressure
due to its weight (B = 1: Bishop 1954; Morgenstern 1963, rapid drawdown). The grains bear the rest, 1 - p / sigma of the
normal stress, by `mpm.initial.stress`.

**A slope at rest** (`Water.fixed`) needs only the force per volume -grad p of the water: buoyancy and seepage. The
effective stress of its surface is 0 also beneath a pool, which adds rho_w g (pool - top) to p; the table is no lower
than the pool there. Across a steep free face p falls to that of the pool, or to 0. This fall is spread over the cell
inside the face, where p is lower by J (1 - d / h), with the fall J, the distance d and the cell h: the force of water
stays a gradient, which has no effect in material whose strength is independent of pressure.
"""

import math
from collections.abc import Callable, Mapping
from functools import partial

import numpy as np
from numpy.typing import NDArray

from datasets.errors import InputError
from datasets.geometry.bodies import filling, height
from datasets.geometry.ground import elevation, interpolated, plan_axes
from datasets.geometry.nearest import inside
from datasets.geometry.surface import solids_of, surface_in
from datasets.scene import DOMAIN_SIDES, TOLERANCE, Mass, Scene, keyed
from datasets.scene.particles import Particles
from datasets.scene.parts import Water
from datasets.scene.water import DENSITY
from mpm.initial.slope import begins_as_slope, ground_beneath, is_sheet, mass_above, sides, within

Floats = NDArray[np.float64]
Booleans = NDArray[np.bool_]
Known = Mapping[tuple[int, float], Booleans] | None  # for an axis and a side, 1 or -1, at which of N places, [N]

HALVINGS = 12  # halvings of a cell to locate a face
BEYOND = 0.1  # cells beyond a face at which the material there is looked up


def initial_water(scene: Scene, particles: Particles, near: Booleans | None = None) -> tuple[Floats, Floats]:
    """p [Pa] of each particle, 1 where water fills its pores and else 0, and the share of the normal stress that grains
    bear [-], shape [N, 3]; and grad p [Pa/m], shape [N, D]. near: in flows, the particles beside surfaces, which need
    it, [N]; None: all. Raises InputError for a saturated mass without an initial stress."""
    positions = particles.positions
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
        plan = positions[of_mass][:, plan_axes(scene.dimension)]
        whole = np.nan_to_num(stresses(scene, mass, positions[of_mass])[0])
        pore_pressure, full = pressure_in(scene, mass, positions[of_mass])
        fixed = (scene.water or Water()).fixed
        sloping = np.ones(len(whole), bool) if fixed or near is None else near[of_mass]
        sloping = np.flatnonzero(of_mass)[sloping & (pore_pressure > 0.0)]
        slopes[sloping] = (force_slope if fixed else pressure_slope)(scene, mass, positions[sloping])
        if not fixed:
            pore_pressure = np.minimum(pore_pressure, whole)
        wet[of_mass], pressure[of_mass] = full, pore_pressure
        # Only water carries the weight of a pool.
        carried = np.maximum(pore_pressure - np.nan_to_num(pool_pressure(scene, mass, plan)), 0.0)
        share[of_mass] -= np.divide(carried, whole, out=np.zeros_like(whole), where=whole > 0.0)
    return np.stack([pressure, wet, share], axis=1), slopes


def pressure_in(scene: Scene, mass: Mass, positions: Floats) -> tuple[Floats, Booleans]:
    """p at `positions` [m], [N, D], in a mass [Pa], at least 0, and whether water fills the pores there; both [N]."""
    full = positions[:, 1] < table(scene, mass, positions[:, plan_axes(scene.dimension)])
    return np.where(full, np.maximum(np.nan_to_num(stresses(scene, mass, positions)[1]), 0.0), 0.0), full


def stresses(scene: Scene, mass: Mass, positions: Floats) -> Floats:
    """Total stress sigma, without the weight of a pool, and p at `positions` [m], [N, D], in and beside a mass [Pa],
    shape [2, N]: below 0 where they are above its top or the water table, NaN where it is not in plan."""
    # Imported here: it needs a sparse solver.
    from mpm.initial.stress import overburden

    plan, y = positions[:, plan_axes(scene.dimension)], positions[:, 1]
    _, top = extent(scene, mass, plan)
    water_weight = np.full(len(y), -scene.gravity_vector[1])
    # The ground is the same as for its initial stress.
    if is_sheet(scene, mass):
        normal, _ = ground_beneath(scene, mass, positions)
        across = normal_weight(scene, normal)
        load = across / normal[:, 1] * mass_above(scene, mass, positions)
        whole = across * scene.material_of(mass).density * (top - y) + load
        water_weight = weight_in_sheet(scene, mass, plan, across)
    else:
        whole = overburden(scene, mass, positions, top - y)
    if mass.initial_pore_pressure_ratio is not None:
        p = mass.initial_pore_pressure_ratio * whole
    else:
        p = DENSITY * water_weight * (np.minimum(table(scene, mass, plan), column_top(scene, mass, plan)) - y)
    return np.stack([whole, p + pool_pressure(scene, mass, plan)])


def pool_pressure(scene: Scene, mass: Mass, plan: Floats) -> Floats:
    """Pressure [Pa] of the pool on the ground over places in plan [m], [N, D - 1]; 0 without a pool. Shape [N]."""
    pool = (scene.water or Water()).pool
    if pool is None:
        return np.zeros(len(plan))
    return np.asarray(-DENSITY * scene.gravity_vector[1] * np.maximum(pool - column_top(scene, mass, plan), 0.0))


def normal_weight(scene: Scene, normal: Floats) -> Floats:
    """|g . n| n_y [m/s^2] of surfaces with the unit normals n, [N, D], along which water flows: the growth of p / rho_w
    per vertical depth below the surface. Shape [N]."""
    return np.asarray(np.abs(normal @ np.array(scene.gravity_vector)) * normal[:, 1])


def weight_in_sheet(scene: Scene, mass: Mass, plan: Floats, across: Floats) -> Floats:
    """Growth of p / rho_w per vertical depth in a sheet [m/s^2], over places in plan [m], [N, D - 1]: below a pool as
    in water at rest, else as in water that flows along its table, or along the ground where that is lower. `across`
    [m/s^2], [N]: the value along the ground. p is continuous: the transition spans a height of the sheet. [N]."""
    water, down, tall = scene.water or Water(), -scene.gravity_vector[1], height(scene, mass)
    surface, top = np.full(len(plan), down), column_top(scene, mass, plan)
    if water.table is not None:
        normal = np.tile(np.eye(scene.dimension)[1], (len(plan), 1))
        level = plan_axes(scene.dimension)
        rise = gradient(partial(table, scene, mass), plan, 0.5 * scene.domain.cell)
        normal[:, level] = -rise
        surface = normal_weight(scene, normal / np.linalg.norm(normal, axis=1)[:, None])
    above = np.clip((table(scene, mass, plan) - top) / tall, 0.0, 1.0)
    weight: Floats = surface + (across - surface) * above
    if water.pool is not None:
        weight = down + (weight - down) * np.clip((top - water.pool) / tall, 0.0, 1.0)
    return weight


def table(scene: Scene, mass: Mass, plan: Floats) -> Floats:
    """Elevation [m] of the water table over places in plan [m], [N, D - 1]: at least that of a pool, for a sloping
    table only where the pool stands on the ground; inf where water fills it to the top. [N]."""
    water = scene.water or Water()
    if water.table is None:
        pool = water.pool if mass.initial_pore_pressure_ratio is None else None
        level = pool if water.level is None else water.level
        elevations = np.full(len(plan), math.inf if level is None else level)
    elif scene.dimension == 2:
        elevations = np.interp(plan[:, 0], *np.array(water.table, np.float64).T)
    else:
        rows = np.array(water.table, np.float64)
        steps = zip(water.origin or (), water.spacing or (), rows.shape, strict=True)
        elevations = interpolated([first + step * np.arange(count) for first, step, count in steps], rows, plan)
    if water.pool is None:
        return elevations
    covered = (water.table is None) | (column_top(scene, mass, plan) <= water.pool + TOLERANCE)
    return np.where(covered, np.maximum(elevations, water.pool), elevations)


def column_top(scene: Scene, mass: Mass, plan: Floats) -> Floats:
    """Top [m] of a mass and of the saturated ones that rest on it, over places in plan [m], [N, D - 1]; shape [N]."""
    _, top = extent(scene, mass, plan)
    for other in sorted(scene.masses, key=lambda body: body.lower[1]):
        if other is not mass and scene.material_of(other).saturated:
            foot, above = extent(scene, other, plan)
            top = np.where((foot <= top + TOLERANCE) & (above > top), above, top)
    return top


def extent(scene: Scene, mass: Mass, plan: Floats) -> tuple[Floats, Floats]:
    """Lower and upper end [m] of a mass over places in plan [m], [N, D - 1]; NaN outside of it. Each [N]. Between the
    cells of a layer the top has ramps: differences across a step would depend on rounding."""
    level = plan_axes(scene.dimension)
    inside = within(plan, mass, level)
    if mass.kind == "polygon":
        x, *both = sides(mass, scene.domain.cell)
        ends = [np.interp(plan[:, 0], x, side) for side in both]
    elif mass.kind == "box":
        ends = [np.full(len(plan), mass.lower[1]), np.full(len(plan), mass.lower[1] + mass.size[1])]
    else:
        foot_and_top = filling(scene, mass).ends
        assert foot_and_top is not None, "of a mesh or a layer"
        ends = list(foot_and_top(plan))
    return np.where(inside, ends[0], np.nan), np.where(inside, ends[1], np.nan)


def pressure_slope(scene: Scene, mass: Mass, positions: Floats) -> Floats:
    """grad p at `positions` [m], [N, D], of a mass [Pa/m], shape [N, D]."""
    return np.asarray(gradient(partial(stresses, scene, mass), positions, 0.5 * scene.domain.cell)[1])


def force_slope(scene: Scene, mass: Mass, positions: Floats) -> Floats:
    """grad p at `positions` [m], [N, D], of a mass [Pa/m], including the fall of p across its faces: the gradient of p
    - J (1 - d / h) at a distance d from a face, within a cell h of it, shape [N, D]."""
    cell, up = scene.domain.cell, 0.5 * scene.domain.cell * np.eye(scene.dimension)[1]
    slopes, falls = pressure_and_falls(scene, mass, positions)
    near = np.flatnonzero(np.any([kind > 0.0 for kind, _, _ in falls.values()], axis=0))
    beside = [pressure_and_falls(scene, mass, positions[near] + end)[1] for end in (-up, up)]
    in_body = [within_body(scene, mass, positions[near] + end) for end in (-up, up)]
    for (axis, side), fall in falls.items():
        kind, across, missing = fall[:, near]
        slopes[near, axis] -= side * across / cell
        # Differences over the height only along one face.
        ends = [end[axis, side] for end in beside]
        alike = [(end[0] == kind) & inner for end, inner in zip(ends, in_body, strict=True)]
        low, high = (np.where(same, end[2], missing) for end, same in zip(ends, alike, strict=True))
        slopes[near, 1] -= (high - low) / np.maximum(0.5 * cell * (1.0 * alike[0] + alike[1]), 0.5 * cell)
    return slopes


def pressure_and_falls(scene: Scene, mass: Mass, positions: Floats) -> tuple[Floats, dict[tuple[int, float], Floats]]:
    """grad p at `positions` [m], [N, D], in a mass [Pa/m], [N, D], and for each level axis and side, 1 or -1, [3, N]:
    1 where within a cell there is a free face and 2 where there is another mass with water, else 0; the fall J of p
    across it [Pa]; and what p is less by, J (1 - d / h) [Pa]."""
    faces, function = free_faces(scene, mass, positions), partial(stresses, scene, mass)
    pressure, known = function(positions)[1], {key: ~free for key, (free, _, _) in faces.items()}
    slopes = gradient(function, positions, 0.5 * scene.domain.cell, known)[1]
    falls = {}
    for (axis, side), (free, distance, beyond) in faces.items():
        at_face = np.maximum(pressure[free] + side * slopes[free, axis] * distance[free], 0.0)
        pool, inner = pressure_beyond(scene, mass, beyond[free])
        # Between two masses each takes half of the fall, up to the mean of both.
        across = at_face - np.where(inner > 0.0, 0.5 * (at_face + inner), pool)
        fall = falls[axis, side] = np.zeros((3, len(positions)))
        fall[:, free] = np.where(inner > 0.0, 2.0, 1.0), across, across * (1.0 - distance[free] / scene.domain.cell)
    return slopes, falls


def free_faces(scene: Scene, mass: Mass, positions: Floats) -> dict[tuple[int, float], tuple[Booleans, Floats, Floats]]:
    """For each level axis and side, 1 or -1: which of `positions` [m], [N, D], in a mass are less than a cell from its
    top or its outline there, with neither a solid nor a wall of the box behind, [N]; how far it is [m], [N]; and a
    place beyond [m], [N, D]."""
    faces, cell = {}, scene.domain.cell
    for axis in plan_axes(scene.dimension):
        for side in (-1.0, 1.0):
            step = side * cell * np.eye(scene.dimension)[axis]
            left = np.flatnonzero(~within_body(scene, mass, positions + step))
            low, high = np.zeros(len(left)), np.ones(len(left))
            for _ in range(HALVINGS):
                middle = 0.5 * (low + high)
                here = within_body(scene, mass, positions[left] + middle[:, None] * step)
                low, high = np.where(here, middle, low), np.where(here, high, middle)
            distance, beyond = np.full(len(positions), cell), positions + step
            distance[left], beyond[left] = high * cell, positions[left] + (high + BEYOND)[:, None] * step
            free = np.zeros(len(positions), bool)
            free[left] = ~closed(scene, mass, beyond[left], axis, side)
            faces[axis, side] = free, distance, beyond
    return faces


def within_body(scene: Scene, mass: Mass, positions: Floats) -> Booleans:
    """Which `positions` [m], [N, D], lie between the foot and the top of a mass, shape [N]."""
    plan, y = positions[:, plan_axes(scene.dimension)], positions[:, 1]
    foot, top = extent(scene, mass, plan)
    inner = (y >= foot - TOLERANCE) & (y <= top + TOLERANCE)
    if mass.kind == "layer":
        inner &= filling(scene, mass).contains(np.insert(plan, 1, 0.0, axis=1))
    return inner


def closed(scene: Scene, mass: Mass, beyond: Floats, axis: int, side: float) -> Booleans:
    """Whether at places `beyond` [m], [N, D], a mass on a side, 1 or -1, of an axis there is a solid, a wall of the
    box, or what is below the foot of the mass, shape [N]."""
    plan, y = beyond[:, plan_axes(scene.dimension)], beyond[:, 1]
    solid = (y < elevation(scene.solids, scene.domain, plan)) | (y < extent(scene, mass, plan)[0])
    others = [pair for pair in zip(*solids_of(scene), strict=True) if pair[0].kind != "terrain"]
    if others:
        bodies, keys = zip(*others, strict=True)
        solid |= inside(surface_in(scene.domain, bodies, keys), beyond)
    wall = beyond[:, axis] > scene.domain.size[axis] if side > 0.0 else beyond[:, axis] < 0.0
    opened = DOMAIN_SIDES[2 * axis + int(side > 0.0)] in scene.open_sides
    return np.asarray(solid | (wall & (not opened)))


def pressure_beyond(scene: Scene, mass: Mass, beyond: Floats) -> Floats:
    """Pressure of the pool, or 0, and that of water in another mass, else 0, at places `beyond` a mass [m], [N, D], in
    Pa; shape [2, N]."""
    pool = (scene.water or Water()).pool
    depth = np.zeros(len(beyond)) if pool is None else np.maximum(pool - beyond[:, 1], 0.0)
    inner = np.zeros(len(beyond))
    for other in scene.masses:
        if other is not mass and scene.material_of(other).saturated:
            there = within_body(scene, other, beyond)
            inner[there] = pressure_in(scene, other, beyond[there])[0]
    return np.stack([-DENSITY * scene.gravity_vector[1] * depth, inner])


def gradient(function: Callable[[Floats], Floats], positions: Floats, step: float, known: Known = None) -> Floats:
    """Gradient of function(positions) [..., N] by differences over `step` [m], central where possible; [..., N, D].
    known: where the function is known on that side; None: everywhere."""
    here, slopes, everywhere = function(positions), [], np.ones(len(positions), bool)
    for axis, direction in enumerate(step * np.eye(positions.shape[1])):
        ends = [function(positions + side * direction) for side in (-1.0, 1.0)]
        finite = [np.isfinite(end) for end in ends]
        there = [(known or {}).get((axis, side), everywhere) for side in (-1.0, 1.0)]
        inner = [end & seen for end, seen in zip(finite, there, strict=True)]
        # Where it is known neither way, the values beyond are better than none.
        low, high = (one | (end & ~(inner[0] | inner[1])) for one, end in zip(inner, finite, strict=True))
        rise = np.where(high, ends[1], here) - np.where(low, ends[0], here)
        slopes.append(rise / np.maximum(step * (1.0 * low + high), step))
    return np.stack(slopes, axis=-1)
