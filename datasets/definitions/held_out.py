"""Held-out shapes: which training scenes would be too close to one that ships.

Two scenes are neighbours if, in units of the released body's own length and measured from its lower corner, every
corner of every mass and baffle of the one lies within `MARGIN` of the same corner of the other, mirrored or not, and
the masses are as close to the box's sides or not in contact with them either. Angles, velocities and friction do not
count: a neighbour is excluded at every material.
"""

from functools import cache

import numpy as np
from numpy.typing import NDArray

from datasets.library import SCENES, read_scene
from datasets.particles import released_volume
from datasets.scene import Baffle, Mass, Scene

MARGIN = 0.06
"""Distance of corners within which two scenes are neighbours, over the body's length (the root of its area) [-]."""
ASPECTS = (0.5, 0.8, 1.0, 2.0, 3.0)
"""Height over length of columns at a wall that are kept for tests of generalisation, beside the scenes that ship."""
ASPECT_MARGIN = 0.04
"""Relative distance from these within which a column at a wall is their neighbour [-]."""


def is_held_out(scene: Scene) -> bool:
    """Whether `scene` is a neighbour of a scene that ships, or a column of a held-out aspect at a wall."""
    return held_out_column(scene) or any(neighbours(scene, other) for other in shipped(scene.dimension))


@cache
def shipped(dimension: int) -> tuple[Scene, ...]:
    """The scenes that ship, of a dimension."""
    scenes = (read_scene(path.stem) for path in sorted(SCENES.glob("*.toml")))
    return tuple(scene for scene in scenes if scene.dimension == dimension)


def held_out_column(scene: Scene) -> bool:
    """Whether a scene is a single box at a wall whose aspect is kept for tests."""
    mass = scene.masses[0]
    if len(scene.masses) > 1 or scene.dimension != 2 or mass.kind != "box" or not touches(scene, mass).any():
        return False
    aspect = mass.size[1] / mass.size[0]
    return any(abs(aspect / other - 1.0) <= ASPECT_MARGIN for other in ASPECTS)


def neighbours(scene: Scene, other: Scene) -> bool:
    """Whether two scenes of one dimension are neighbours."""
    if (len(scene.masses), len(scene.baffles)) != (len(other.masses), len(other.baffles)):
        return False
    theirs = shape(other)
    return any(
        bool((np.abs(mine - theirs) <= MARGIN).all()) and np.array_equal(walls, touches_all(other))
        for mine, walls in ((shape(scene), touches_all(scene)), mirrored(scene))
    )


def shape(scene: Scene) -> NDArray[np.float64]:
    """Corners of masses, then of baffles, each in order of their lower corner, in body lengths; shape [K, 2, D]."""
    masses, baffles = (boxes(group, scene.dimension) for group in (scene.masses, scene.baffles))
    unit = released_volume(scene) ** (1.0 / scene.dimension)
    origin = masses[:, 0].min(axis=0)
    return (np.concatenate((ordered(masses), ordered(baffles))) - origin) / unit


def mirrored(scene: Scene) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """`shape` and `touches_all` of the scene mirrored along x."""
    unit = released_volume(scene) ** (1.0 / scene.dimension)
    parts = []
    for group in (scene.masses, scene.baffles):
        corners = boxes(group, scene.dimension)
        corners[:, :, 0] = scene.domain.size[0] - corners[:, ::-1, 0]
        parts.append(ordered(corners))
    origin = parts[0][:, 0].min(axis=0)
    return (np.concatenate(parts) - origin) / unit, touches_all(scene)[::-1]


def boxes(group: tuple[Mass, ...] | tuple[Baffle, ...], dimension: int) -> NDArray[np.float64]:
    """Lower and upper corner of each, shape [K, 2, D]."""
    lower, size = (np.array([getattr(each, key) for each in group]).reshape(-1, dimension) for key in ("lower", "size"))
    return np.stack((lower, lower + size), axis=1)


def ordered(corners: NDArray[np.float64]) -> NDArray[np.float64]:
    """The boxes in the order of their lower corners."""
    return corners[np.lexsort(corners[:, 0].T)] if len(corners) else corners


def touches(scene: Scene, mass: Mass) -> NDArray[np.bool_]:
    """Whether a mass leans on the left and on the right side of the box, shape [2]."""
    slack = 0.5 * scene.domain.cell
    return np.array([mass.lower[0] <= slack, mass.lower[0] + mass.size[0] >= scene.domain.size[0] - slack])


def touches_all(scene: Scene) -> NDArray[np.bool_]:
    """Whether any mass leans on the left and on the right side of the box, shape [2]."""
    return np.any([touches(scene, mass) for mass in scene.masses], axis=0)
