"""Held-out shapes: training scenes that would be too close to a shipped scene.

Two scenes are neighbours if, in units of the released body's own length and measured from its lower corner, every
corner of every mass and baffle of the one lies within `MARGIN` of the same corner of the other, mirrored or not, and
their masses touch the same sides of the box. For a turned baffle, the corners are those of the box around it. Angles,
velocities and friction do not count: a neighbour is excluded with any material.
"""

import dataclasses
from collections.abc import Iterator
from functools import cache
from itertools import product

import numpy as np
from numpy.typing import NDArray

from datasets.geometry.ground import Floats, plan_axes
from datasets.scene import Baffle, Mass, Scene
from datasets.scene.library import SCENES, read_scene
from datasets.scene.particles import released_volume

MARGIN = 0.06  # distance of corners within which two scenes are neighbours, over the length of the body [-]
GAPS = 0.06  # share of a box that masses may leave empty and still count as one mass [-]
ASPECTS = (0.5, 0.8, 1.0, 2.0, 3.0)
"""Height over length of columns at a wall that are reserved for tests of generalisation, besides the shipped scenes."""
ASPECT_MARGIN = 0.04  # relative distance from these within which a column at a wall counts as a neighbour [-]


def is_held_out(scene: Scene) -> bool:
    """Whether `scene` is a neighbour of a shipped scene, or a column at a wall with a held-out aspect ratio."""
    scene = joined(scene)
    mass = scene.masses[0]
    if len(scene.masses) == 1 and scene.dimension == 2 and mass.kind == "box" and touches(scene).any():
        aspect = mass.size[1] / mass.size[0]
        if any(abs(aspect / other - 1.0) <= ASPECT_MARGIN for other in ASPECTS):
            return True
    return any(neighbours(scene, other) for other in shipped(scene.dimension))


def joined(scene: Scene) -> Scene:
    """The scene, with its masses merged if they are boxes of one sand at rest that together fill a box."""
    masses = scene.masses
    alike = len({scene.material_of(mass) for mass in masses}) == 1 and not any(mass.velocity for mass in masses)
    if len(masses) == 1 or not alike or any(mass.kind != "box" for mass in masses):
        return scene
    corners = boxes(masses, scene.dimension)
    lower, upper = corners[:, 0].min(axis=0), corners[:, 1].max(axis=0)
    if released_volume(scene) < (1.0 - GAPS) * float(np.prod(upper - lower)):
        return scene
    whole = dataclasses.replace(masses[0], lower=tuple(lower.tolist()), size=tuple((upper - lower).tolist()))
    return dataclasses.replace(scene, masses=(whole,))


@cache
def shipped(dimension: int) -> tuple[Scene, ...]:
    """The shipped scenes of a dimension."""
    scenes = (read_scene(path.stem) for path in sorted(SCENES.glob("*.toml")))
    return tuple(scene for scene in scenes if scene.dimension == dimension)


def neighbours(scene: Scene, other: Scene) -> bool:
    """Whether two scenes of one dimension are neighbours."""
    if (len(scene.masses), len(scene.baffles)) != (len(other.masses), len(other.baffles)):
        return False
    theirs, walls = next(images(other))
    return any(np.array_equal(touched, walls) and all(map(matched, mine, theirs)) for mine, touched in images(scene))


def matched(mine: Floats, theirs: Floats) -> bool:
    """Whether boxes [K, 2, D] can be paired with as many others such that all their corners are within `MARGIN`."""
    from scipy.optimize import linear_sum_assignment

    near = np.asarray((np.abs(mine[:, None] - theirs) <= MARGIN).all(axis=(2, 3)))
    return bool(near[linear_sum_assignment(near, maximize=True)].all())


def images(scene: Scene) -> Iterator[tuple[list[Floats], NDArray[np.bool_]]]:
    """A scene and its mirror images along x and, in 3D, z and both: the boxes of masses and of baffles, [K, 2, D], over
    the body's length and from its lower corner [-]; and which sides the masses touch [H, 2]."""
    unit = released_volume(scene) ** (1.0 / scene.dimension)
    level, contact = plan_axes(scene.dimension), touches(scene)
    for flips in product((False, True), repeat=len(level)):
        groups = [boxes(group, scene.dimension) for group in (scene.masses, scene.baffles)]
        touched = contact.copy()
        for number, axis in enumerate(level):
            if flips[number]:
                touched[number] = touched[number, ::-1]
                for corners in groups:
                    corners[..., axis] = scene.domain.size[axis] - corners[:, ::-1, axis]
        corner = groups[0][:, 0].min(axis=0)
        yield [(corners - corner) / unit for corners in groups], touched


def boxes(group: tuple[Mass, ...] | tuple[Baffle, ...], dimension: int) -> Floats:
    """Lower and upper corner of each [m], for a turned baffle of the box around it; shape [K, 2, D]."""
    lower, size = (np.array([getattr(body, key) for body in group]).reshape(-1, dimension) for key in ("lower", "size"))
    turn = np.radians([getattr(body, "turned_deg", 0.0) for body in group])
    plane = [0, dimension - 1]
    cosine, sine = np.abs(np.cos(turn))[:, None], np.abs(np.sin(turn))[:, None]
    extent = size.astype(np.float64)
    extent[:, plane] = cosine * size[:, plane] + sine * size[:, plane[::-1]]
    middle = lower + 0.5 * size
    return np.stack((middle - 0.5 * extent, middle + 0.5 * extent), axis=1)


def touches(scene: Scene) -> NDArray[np.bool_]:
    """Whether any mass touches the lower and the upper side of the box along x and, in 3D, z; shape [H, 2]."""
    slack, level = 0.5 * scene.domain.cell, plan_axes(scene.dimension)
    lower, upper = np.moveaxis(boxes(scene.masses, scene.dimension)[..., level], 1, 0)
    highest = np.array(scene.domain.size)[level] - slack
    return np.asarray(np.stack((lower <= slack, upper >= highest), axis=-1).any(axis=0))
