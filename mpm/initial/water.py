"""The pore pressure in which saturated masses begin, and which share of their weight it leaves to the grains.

    p = r_u sigma_n                                 of a mass with `initial_pore_pressure_ratio` r_u
    p = rho_w g_n min(depth, depth below the level)      of others: at rest below the water table

with the total stress sigma_n = rho g_n d normal to the ground, d the depth normal to it and what rests on it. Above the
level material is moist: p = 0, and it has no water that could be pressed. Water that stands above the ground is none
here. The rest, 1 - p / sigma_n of the normal stress, grains bear, by `mpm.initial.stress`.
"""

import numpy as np
from numpy.typing import NDArray

from datasets.errors import InputError
from datasets.scene import Scene, keyed
from datasets.scene.particles import Particles
from datasets.scene.water import DENSITY
from mpm.initial.slope import begins_as_slope, depth_below_top, ground_beneath, mass_above

Floats = NDArray[np.float64]


def initial_water(scene: Scene, particles: Particles) -> Floats:
    """p [Pa] of each particle, 1 where water fills its pores and else 0, and the share of the normal stress that grains
    bear [-], shape [N, 3]. Raises InputError for a saturated mass that begins without a stress.
    """
    # Imported here: it needs a sparse solver.
    from mpm.initial.stress import overburden

    positions = particles.positions
    pressure, wet, share = np.zeros((3, len(positions)))
    share += 1.0
    level = np.inf if scene.water is None or scene.water.level is None else scene.water.level
    for number, (key, mass) in enumerate(keyed(scene, "masses").items()):
        if not scene.material_of(mass).saturated:
            continue
        own = particles.mass == number
        depth = depth_below_top(scene, mass, positions[own], particles.depth[own])
        across = np.full(own.sum(), -scene.gravity_vector[1])
        if begins_as_slope(scene, mass):
            normal, _ = ground_beneath(scene, mass, positions[own])
            across, up = np.abs(normal @ np.array(scene.gravity_vector)), normal[:, 1]
            whole = across * (scene.material_of(mass).density * depth * up + mass_above(scene, mass, positions[own]))
        elif mass.k0 is not None:
            up, whole = np.ones_like(across), overburden(scene, mass, positions[own], depth)
        else:
            message = "expected a k0: a saturated mass begins with its weight on grains and water, got none"
            raise InputError(message, key=f"{key}.k0")
        below = np.clip(level - positions[own, 1], 0.0, depth)
        ratio = mass.initial_pore_pressure_ratio
        p = DENSITY * across * below * up if ratio is None else ratio * whole
        wet[own] = positions[own, 1] < level
        pressure[own] = np.where(positions[own, 1] < level, np.minimum(p, whole), 0.0)
        share[own] -= np.divide(pressure[own], whole, out=np.zeros_like(whole), where=whole > 0.0)
    return np.stack([pressure, wet, share], axis=1)
