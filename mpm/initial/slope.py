"""The stress in which flat masses without `k0` begin on inclined ground: that of an infinite slope.

Free of stress a layer would fall by what gravity compresses it, bounce, and slide while its pressure on the ground
swings. With the unit normal n of the ground, depth d = (depth below the top) n_y normal to it, and g = g_n n + g_t,

    sigma_n = -rho |g_n| d,    tau = t rho |g_n| d towards g_t,    t = min(|g_t| / |g_n|, mu, tan(phi) + c / sigma_0)
    sigma_t = K sigma_n,       sigma_b = nu (sigma_n + sigma_t)                                   (tension positive)

where sigma_0 is the normal stress at the foot. A slope steeper than mu accelerates as a whole, and tau is what friction
bears; else it is at rest. K is that of an elastic half-space, nu / (1 - nu), within active and passive yield beside tau
(Rankine 1857; s = sin phi, reduced by MARGIN for what jitter does to single particles):

    K = [1 + s^2 -+ 2 sqrt(s^2 - (1 - s^2) t^2)] / (1 - s^2)        (root 0 where t is beyond it)
"""

import math

import numpy as np
from numpy.typing import NDArray

from datasets.geometry.bodies import height
from datasets.geometry.ground import highest, plan_axes
from datasets.scene import TOLERANCE, Mass, Scene, coefficient
from datasets.scene.material import MOHR_COULOMB
from datasets.scene.particles import Particles

Floats = NDArray[np.float64]

FLAT = 5.0
"""Lengths over height from which on a mass is a layer and no column."""
MARGIN = 0.1
"""Share by which sin(phi) is reduced for K."""


def begins_as_slope(scene: Scene, mass: Mass) -> bool:
    """Whether `mass`, of friction and without `k0`, lies flat on inclined ground: a box on a tilted floor, a layer."""
    frictional = scene.material_of(mass).law == MOHR_COULOMB
    if not frictional or mass.k0 is not None or mass.angular_velocity is not None or scene.gravity <= 0.0:
        return False
    tilted = scene.slope_deg != 0.0
    if mass.kind == "layer":
        lies = tilted or any(solid.kind == "terrain" for solid in scene.solids)
    else:
        alone = not any(above(other, mass, scene) for other in scene.masses)
        lies = mass.kind == "box" and tilted and mass.lower[1] <= TOLERANCE and alone
    if not lies:
        return False
    tall = FLAT * height(scene, mass)
    return all(
        mass.size[axis] >= tall or (axis == 2 and mass.size[axis] >= scene.domain.size[axis] - TOLERANCE)
        for axis in plan_axes(scene.dimension)
    )


def above(other: Mass, mass: Mass, scene: Scene) -> bool:
    """Whether another mass lies over a part of `mass` in plan."""
    return other is not mass and all(
        other.lower[axis] < mass.lower[axis] + mass.size[axis] - TOLERANCE
        and mass.lower[axis] < other.lower[axis] + other.size[axis] - TOLERANCE
        for axis in plan_axes(scene.dimension)
    )


def slope_stress(scene: Scene, particles: Particles, positions: Floats) -> tuple[Floats, Floats]:
    """Of particles at `positions` [m], [N, D]: their stress [Pa], [N, 3, 3], and the shear traction of the ground on
    them [Pa], [N, D]; 0 in masses that do not begin so. A field of friction does not enter.
    """
    stress, traction = np.zeros((len(positions), 3, 3)), np.zeros(positions.shape)
    for number, mass in enumerate(scene.masses):
        if not begins_as_slope(scene, mass):
            continue
        own = particles.mass == number
        normal, friction = ground_beneath(scene, positions[own])
        gravity = np.array(scene.gravity_vector)
        across = normal @ gravity
        along = gravity - across[:, None] * normal
        steep = np.linalg.norm(along, axis=1)
        level_x = np.broadcast_to(np.eye(scene.dimension)[0], along.shape).copy()
        downhill = np.divide(along, steep[:, None], out=level_x, where=steep[:, None] > 1.0e-9)
        material, up = scene.material_of(mass), normal[:, 1]
        sine = math.sin(math.radians(material.phi_deg))
        weight = material.density * np.abs(across)
        foot = np.maximum(weight * height(scene, mass) * up, 1.0e-9)
        strength = material.friction + material.cohesion / foot
        ratio = np.minimum(np.minimum(steep / np.abs(across), friction), strength)
        across_stress = -weight * particles.depth[own] * up
        level = lateral_ratio(material.poisson, sine, ratio) * across_stress
        shear = -ratio * across_stress
        third = material.poisson * (across_stress + level)
        n, e = (np.pad(each, ((0, 0), (0, 3 - scene.dimension))) for each in (normal, downhill))
        b = np.cross(n, e)
        outer = (each[:, :, None] * each[:, None, :] for each in (n, e, b))
        parts = zip((across_stress, level, third), outer, strict=True)
        mixed = n[:, :, None] * e[:, None, :]
        stress[own] = sum(value[:, None, None] * each for value, each in parts)
        stress[own] += shear[:, None, None] * (mixed + mixed.swapaxes(1, 2))
        traction[own] = -shear[:, None] * downhill
    return stress, traction


def ground_beneath(scene: Scene, positions: Floats) -> tuple[Floats, Floats]:
    """Unit normal of the ground, [N, D], over a cell, and its Coulomb coefficient, [N], beneath `positions` [m]."""
    level, floor = plan_axes(scene.dimension), coefficient(scene.floor_friction)
    plan, half = positions[:, level], 0.5 * scene.domain.cell
    _, friction, top = highest(scene.solids, scene.domain, plan, floor)
    stuck = np.array([*(solid.contact == "no-slip" for solid in scene.solids), False])[top]
    normal = np.zeros(positions.shape)
    normal[:, 1] = 1.0
    for column, axis in enumerate(level):
        step = half * np.eye(len(level))[column]
        ends = [highest(scene.solids, scene.domain, plan + side * step, floor)[0] for side in (-1.0, 1.0)]
        normal[:, axis] = (ends[0] - ends[1]) / (2.0 * half)
    return normal / np.linalg.norm(normal, axis=1)[:, None], np.where(stuck, np.inf, friction)


def lateral_ratio(poisson: float, sine: float, ratio: Floats) -> Floats:
    """K = sigma_t / sigma_n [-] beside shear of tau / |sigma_n| = `ratio`, [N]."""
    square = (sine * (1.0 - MARGIN)) ** 2
    half = 2.0 * np.sqrt(np.maximum(square - (1.0 - square) * ratio**2, 0.0))
    low, high = ((1.0 + square + sign * half) / (1.0 - square) for sign in (-1.0, 1.0))
    return np.asarray(np.clip(poisson / (1.0 - poisson), low, high))
