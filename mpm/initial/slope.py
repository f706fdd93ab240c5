"""The initial stress of flat masses without `k0` on inclined ground, and the first guess for "elastic" ones: that of an
infinite slope.

Without initial stress a layer would settle under gravity, bounce, and slide while its pressure on the ground
oscillates. With the unit normal n of the ground, depth d = (depth below the top) n_y normal to it, and g = g_n n + g_t,

    sigma_n = -rho |g_n| d,    tau = t rho |g_n| d towards g_t,    t = min(|g_t| / |g_n|, mu, tan(phi) + c / sigma_0)
    sigma_t = K sigma_n,       sigma_b = nu (sigma_n + sigma_t)                                   (tension positive)

where sigma_0 is the normal stress at the foot. A slope steeper than mu accelerates as a whole, and tau is the friction;
else it is at rest. Masses stacked on a box load it. K is that of an elastic half-space, nu / (1 - nu), within the
active and passive limits beside tau (Rankine 1857; s = sin phi, reduced by MARGIN for the jitter of single particles):

    K = [1 + s^2 -+ 2 sqrt(s^2 - (1 - s^2) t^2)] / (1 - s^2)        (root 0 where it would be imaginary)
"""

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from datasets.geometry.bodies import height
from datasets.geometry.ground import highest, plan_axes
from datasets.scene import INFLOW, TOLERANCE, Baffle, Mass, Scene, Solid, coefficient
from datasets.scene.material import MOHR_COULOMB
from datasets.scene.particles import Particles

Floats = NDArray[np.float64]
Counts = Callable[[Mass], bool]

FLAT = 5.0  # length over height from which a mass is a layer and no column
NEAR, MOST = 0.05, 0.9  # a sheet's lower side lies within NEAR cells of the ground over at least this share
SAMPLES = 33  # most sampling points along an axis for the ground beneath a box
LEAST = 1.0e-6  # least share of the normal stress that grains bear
MARGIN = 0.1  # share by which sin(phi) is reduced for K


def begins_as_slope(scene: Scene, mass: Mass) -> bool:
    """Whether a mass is a sheet whose grains, and those of its stack, begin with the stress of an infinite slope."""
    return is_sheet(scene, mass, takes_stress)


def anything(_: Mass) -> bool:
    """Every mass."""
    return True


def takes_stress(mass: Mass) -> bool:
    """Whether nothing else says how the grains of `mass` begin."""
    return not isinstance(mass.k0, float) and mass.release is None and mass.angular_velocity is None


def is_sheet(scene: Scene, mass: Mass, counts: Counts = anything) -> bool:
    """Whether a layer or polygon lies along inclined ground or, if tilted, a box on level ground or boxes; only masses
    that pass `counts` are sheets."""
    if not lies_flat(scene, mass, counts):
        return False
    tilted = scene.slope_deg != 0.0
    if mass.kind != "box":
        inclined = tilted or any(solid.kind == "terrain" for solid in scene.solids)
        return inclined and (mass.kind == "layer" or follows_ground(scene, mass))
    stack = [mass, *(other for other in scene.masses if above(other, mass))]
    return tilted and all(
        lies_flat(scene, body, counts) and foundation(scene, body, counts) is not None for body in stack
    )


def lies_flat(scene: Scene, mass: Mass, counts: Counts) -> bool:
    """Whether `mass`, of friction, is a sheet and no column."""
    frictional = scene.material_of(mass).law == MOHR_COULOMB and mass.kind not in ("mesh", INFLOW)
    if not (frictional and counts(mass) and scene.gravity > 0.0):
        return False
    tall = FLAT * height(scene, mass)
    return all(
        mass.size[axis] >= tall or (axis == 2 and mass.size[axis] >= scene.domain.size[axis] - TOLERANCE)
        for axis in plan_axes(scene.dimension)
    )


def follows_ground(scene: Scene, mass: Mass) -> bool:
    """Whether the lower side of a polygon lies on terrain or floor, except near its ends."""
    x, bottom, _ = sides(mass, scene.domain.cell)
    apart = np.abs(bottom - highest(scene.solids, scene.domain, x[:, None], 0.0)[0])
    return bool(np.mean(apart <= NEAR * scene.domain.cell) >= MOST)


def sides(mass: Mass, cell: float) -> tuple[Floats, Floats, Floats]:
    """Lower and upper side of a polygon [m] at x [m]: x, y and y, each of shape [X], closer than a cell of the grid."""
    start = np.array(mass.vertices)
    end = np.roll(start, -1, axis=0)
    steep = start[:, 0] == end[:, 0]
    start, end = start[~steep], end[~steep]
    low, high = float(start[:, 0].min()), float(start[:, 0].max())
    x = np.linspace(low, high, 4 * math.ceil((high - low) / cell) + 1)
    share = (x[:, None] - start[:, 0]) / (end - start)[:, 0]
    y = start[:, 1] + share * (end - start)[:, 1]
    crossed = (share >= -TOLERANCE) & (share <= 1.0 + TOLERANCE)
    return x, np.where(crossed, y, np.inf).min(axis=1), np.where(crossed, y, -np.inf).max(axis=1)


def depth_below_top(scene: Scene, mass: Mass, positions: Floats, depth: Floats) -> Floats:
    """Depth [m] below the top at the same x, z, [N]; depth: of its particles; in a polygon below its highest point."""
    if mass.kind != "polygon":
        return depth
    x, _, top = sides(mass, scene.domain.cell)
    return np.asarray(np.maximum(np.interp(positions[:, 0], x, top) - positions[:, 1], 0.0))


def foundation(scene: Scene, mass: Mass, counts: Counts = anything) -> Mass | None:
    """The lowest box of the stack of sheets below and with a box, if it lies fully on level ground; else None."""
    if mass.kind != "box":
        return None
    level = plan_axes(scene.dimension)
    low, size = np.array(mass.lower)[level], np.array(mass.size)[level]
    numbers = [min(SAMPLES, math.ceil(length / scene.domain.cell) + 1) for length in size]
    axes = [np.linspace(0.0, 1.0, number) for number in numbers]
    plan = low + size * np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(level))
    if (np.abs(level_ground(scene, plan, mass.lower[1])[0] - mass.lower[1]) <= TOLERANCE).all():
        return mass
    for other in scene.masses:
        flush = other.kind == "box" and abs(other.lower[1] + other.size[1] - mass.lower[1]) <= TOLERANCE
        if flush and within(plan, other, level).all() and lies_flat(scene, other, counts):
            return foundation(scene, other, counts)
    return None


def level_ground(scene: Scene, plan: Floats, foot: float) -> tuple[Floats, Floats]:
    """Elevation [m] of ground and Coulomb coefficient at places in plan [m], [N, D - 1]: floor, terrain, or boxes and
    baffles whose tops are at `foot` [m]. Each of shape [N]."""
    level, floor = plan_axes(scene.dimension), coefficient(scene.floor_friction)
    elevation, friction, top = highest(scene.solids, scene.domain, plan, floor)
    stuck = np.array([*(solid.contact == "no-slip" for solid in scene.solids), False])[top]
    friction = np.where(stuck, np.inf, friction)
    boxes = list[tuple[Baffle | Solid, float]]()
    boxes += [(baffle, coefficient(scene.friction_of(baffle))) for baffle in scene.baffles if baffle.turned_deg == 0.0]
    for solid in scene.solids:
        if solid.kind == "box" and solid.turned_deg == 0.0:
            boxes.append((solid, math.inf if solid.contact == "no-slip" else float(np.max(solid.friction))))
    for obstacle, mu in boxes:
        top_of = np.add(obstacle.lower or (), obstacle.size or ())[1]
        here = within(plan, obstacle, level) & (abs(top_of - foot) <= TOLERANCE)
        elevation, friction = np.where(here, foot, elevation), np.where(here, mu, friction)
    return elevation, friction


def within(plan: Floats, box: Mass | Baffle | Solid, level: list[int]) -> NDArray[np.bool_]:
    """Which places in plan [m], [N, D - 1], lie over or under a box, up to rounding."""
    low, size = np.array(box.lower or ())[level], np.array(box.size or ())[level]
    return np.asarray(((plan >= low - TOLERANCE) & (plan <= low + size + TOLERANCE)).all(axis=1))


def above(other: Mass, mass: Mass) -> bool:
    """Whether another mass begins above the foot of `mass`, over a part of it in plan."""
    return other.lower[1] > mass.lower[1] and meet_in_plan(other, mass, -TOLERANCE)


def meet_in_plan(one: Mass, other: Mass, reach: float) -> bool:
    """Whether two masses overlap in plan, or are within `reach` [m] of it."""
    return all(
        one.lower[axis] < other.lower[axis] + other.size[axis] + reach
        and other.lower[axis] < one.lower[axis] + one.size[axis] + reach
        for axis in plan_axes(len(one.lower))
    )


def slope_stress(scene: Scene, particles: Particles, positions: Floats, share: Floats | None) -> tuple[Floats, Floats]:
    """Stress [Pa], [N, 3, 3], of particles at `positions` [m], [N, D], and shear traction of the ground on them [Pa],
    [N, D]; 0 in masses that do not begin as a slope. A field of friction is not considered.

    share: part of the normal stress that grains bear beside water, [N]; None: all."""
    stress, traction = np.zeros((len(positions), 3, 3)), np.zeros(positions.shape)
    for number, mass in enumerate(scene.masses):
        if not begins_as_slope(scene, mass):
            continue
        of_mass = particles.mass == number
        normal, friction = ground_beneath(scene, mass, positions[of_mass])
        gravity = np.array(scene.gravity_vector)
        across = normal @ gravity
        along = gravity - across[:, None] * normal
        steep = np.linalg.norm(along, axis=1)
        level_x = np.broadcast_to(np.eye(scene.dimension)[0], along.shape).copy()
        downhill = np.divide(along, steep[:, None], out=level_x, where=steep[:, None] > 1.0e-9)
        material, up = scene.material_of(mass), normal[:, 1]
        weight = material.density * np.abs(across)
        load = np.abs(across) * mass_above(scene, mass, positions[of_mass])
        foot = np.maximum(weight * height(scene, mass) * up + load, 1.0e-9)
        strength = material.friction + material.cohesion / foot
        borne = 1.0 if share is None else np.maximum(share[of_mass], LEAST)
        ratio = np.minimum(np.minimum(steep / np.abs(across) / borne, friction), strength)
        across_stress = -weight * depth_below_top(scene, mass, positions[of_mass], particles.depth[of_mass]) * up - load
        across_stress *= borne
        square = (math.sin(math.radians(material.phi_deg)) * (1.0 - MARGIN)) ** 2
        half = 2.0 * np.sqrt(np.maximum(square - (1.0 - square) * ratio**2, 0.0))
        least, most = ((1.0 + square + sign * half) / (1.0 - square) for sign in (-1.0, 1.0))
        level = np.clip(material.poisson / (1.0 - material.poisson), least, most) * across_stress
        shear = -ratio * across_stress
        third = material.poisson * (across_stress + level)
        n, e = (np.pad(vector, ((0, 0), (0, 3 - scene.dimension))) for vector in (normal, downhill))
        b = np.cross(n, e)
        outer = (vector[:, :, None] * vector[:, None, :] for vector in (n, e, b))
        parts = zip((across_stress, level, third), outer, strict=True)
        mixed = n[:, :, None] * e[:, None, :]
        stress[of_mass] = sum(value[:, None, None] * dyad for value, dyad in parts)
        stress[of_mass] += shear[:, None, None] * (mixed + mixed.swapaxes(1, 2))
        traction[of_mass] = -shear[:, None] * downhill
    return stress, traction


def mass_above(scene: Scene, mass: Mass, positions: Floats) -> Floats:
    """Mass per area stacked on a box over `positions` [m], [N, D]: [kg/m^(D - 1)], shape [N]."""
    total = np.zeros(len(positions))
    level = plan_axes(scene.dimension)
    for other in scene.masses if mass.kind == "box" else ():
        if above(other, mass):
            total += scene.material_of(other).density * other.size[1] * within(positions[:, level], other, level)
    return total


def ground_beneath(scene: Scene, mass: Mass, positions: Floats) -> tuple[Floats, Floats]:
    """Unit normal of the ground, [N, D], over a cell, and its Coulomb coefficient, [N], beneath `positions` [m]."""
    level, half, base = plan_axes(scene.dimension), 0.5 * scene.domain.cell, foundation(scene, mass)
    plan = positions[:, level]
    friction = level_ground(scene, plan, -math.inf if base is None else base.lower[1])[1]
    normal = np.tile(np.eye(scene.dimension)[1], (len(plan), 1))
    for column, axis in enumerate(level if base is None else []):
        step = half * np.eye(len(level))[column]
        ends = [highest(scene.solids, scene.domain, plan + side * step, 0.0)[0] for side in (-1.0, 1.0)]
        normal[:, axis] = (ends[0] - ends[1]) / (2.0 * half)
    return normal / np.linalg.norm(normal, axis=1)[:, None], friction
