"""What a user must know of a flow beside its numbers, a line each: it still moves, a wall holds it, part of it left."""

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from datasets.geometry.bodies import scene_height
from datasets.scene import DOMAIN_SIDES, Scene
from datasets.scene.particles import Particles, unresolved

AT_REST = 1e-3
"""Kinetic energy of a deposit at rest, over its largest, at most."""
SLOW = 2e-3
"""Root mean square speed below which nothing moves, over sqrt(g H), H the height of the body at the start."""
SHARE = 0.005
"""Of the particles: what is beyond the front."""
NEAR = 2.0
"""Cells from a wall: sand against it comes to lie a part of a cell off, its tongue is a layer of particles."""
FEWEST_CELLS = 3.0
"""Cells across a body or a layer."""


def caveats(
    scene: Scene,
    particles: Particles,
    deposit: NDArray[np.floating],
    *,
    kinetic: NDArray[np.floating],
    end_time: float,
    outflow: Mapping[str, float],
) -> list[str]:
    """Lines on a flow of `particles`, none where all is well.

    deposit: positions at the end [m], shape [N, D]; kinetic: energy of every frame [J], shape [T]; end_time: until when
    the flow was computed [s]; outflow: mass that left through each open side [kg]. In 2D both are per metre of width.
    """
    lines = []
    mass, start = float(np.sum(particles.density * particles.volume)), particles.positions
    speed = math.sqrt(2.0 * float(kinetic[-1]) / mass)
    if kinetic[-1] > AT_REST * kinetic.max() and speed > SLOW * math.sqrt(scene.gravity * scene_height(scene)):
        moving = f"at t = {end_time:g} s, the end, it still moves at {speed:.2g} m/s (rms)"
        lines.append(f"not at rest: {moving}; front and deposit are not final")
    for number, side in enumerate(DOMAIN_SIDES[: 2 * scene.dimension]):
        axis, upper = divmod(number, 2)
        if side in (*scene.open_sides, "y-"):
            continue
        wall, close = scene.domain.size[axis] if upper else 0.0, NEAR * scene.domain.cell
        near = [float(np.mean(np.abs(each[:, axis] - wall) < close)) for each in (start, deposit)]
        if not near[0] and near[1] > SHARE:
            share = f"{near[1]:.2g} of the particles"
            lines.append(f"the side {side} of the box holds {share}, which would have spread further")
    for side, left in outflow.items():
        if left > 0.0:
            lines.append(f"{left / mass:.2g} of the mass left the box through its open side {side}")
    return lines + [line for line in [unresolved(scene, FEWEST_CELLS)] if line]
