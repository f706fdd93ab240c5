"""Geostatic stress, the first guess of `mpm.initial.stress`, and how far a solution is from its thrust."""

import warnings

import numpy as np
from numpy.typing import NDArray

from datasets.scene import TOLERANCE, Mass, Scene, keyed
from datasets.scene.particles import Particles
from mpm.initial.grid_operators import clings

Floats = NDArray[np.float64]

FAR = 0.01
"""Share of the thrust that may be missing without a word."""


def geostatic(scene: Scene, particles: Particles, positions: Floats) -> Floats:
    """sigma_v = -overburden and sigma_h = K0 sigma_v of the masses with a number for `k0` [Pa], shape [N, 3, 3]."""
    stress = np.zeros((len(positions), 3, 3))
    for number, mass in enumerate(scene.masses):
        if mass.k0 is None or isinstance(mass.k0, str):
            continue
        selected = particles.mass == number
        vertical = -overburden(scene, mass, positions[selected], particles.depth[selected])
        stress[selected] = vertical[:, None, None] * np.diag([mass.k0, 1.0, mass.k0])
    return stress


def lateral_shortfall(scene: Scene, particles: Particles, guess: Floats, stress: Floats) -> Floats:
    """Which share of the level stresses of `guess` is missing in `stress` on average over a mass [-], [N, 3, 3].

    Of boxes with a number for `k0`, between smooth walls: this mean is the thrust through each section of a box,
    whatever the jitter does to single particles (virtual work of a uniform strain). 0 elsewhere.
    """
    lacking = np.zeros_like(stress)
    for number, mass in enumerate(scene.masses):
        if mass.k0 is None or clings(mass):
            continue
        own = particles.mass == number
        for axis in (0, 2)[: scene.dimension - 1]:
            required, found = (float(particles.volume[own] @ each[own, axis, axis]) for each in (guess, stress))
            lacking[own, axis, axis] = 1.0 - found / required if required < 0.0 else 0.0
    return lacking


def warn_of_ratio(scene: Scene, particles: Particles, lacking: Floats) -> None:
    """One UserWarning for each box whose thrust is not that of its `k0`."""
    for number, (key, mass) in enumerate(keyed(scene, "masses").items()):
        share = float(np.abs(lacking[particles.mass == number]).max(initial=0.0))
        if share > FAR:
            warnings.warn(
                f"no initial stress within the yield surface has the ratio {key}.k0 = {mass.k0:g} on this grid: "
                f"the thrust is {100.0 * share:.2g} % off",
                stacklevel=5,
            )


def overburden(scene: Scene, mass: Mass, positions: Floats, depth: Floats) -> Floats:
    """Weight per area of what lies above `positions` in `mass` [Pa], shape [n], `depth` [m] below its surface.

    It counts masses that rest on it without a gap and have a `k0` themselves: others bear nothing yet, and so press on
    nothing.
    """
    gravity = -scene.gravity_vector[1]
    top = positions[:, 1] + depth if mass.kind == "layer" else np.full(len(positions), mass.lower[1] + mass.size[1])
    load = scene.material_of(mass).density * (top - positions[:, 1])
    level = [axis for axis in range(scene.dimension) if axis != 1]
    for above in sorted(scene.masses, key=lambda each: each.lower[1]):
        if above is mass or above.k0 is None:
            continue
        low, size = np.array(above.lower)[level], np.array(above.size)[level]
        inside = (positions[:, level] >= low) & (positions[:, level] <= low + size)
        rests = inside.all(axis=1) & (np.abs(above.lower[1] - top) <= TOLERANCE)
        load = load + np.where(rests, scene.material_of(above).density * above.size[1], 0.0)
        top = np.where(rests, above.lower[1] + above.size[1], top)
    return np.asarray(gravity * load)
