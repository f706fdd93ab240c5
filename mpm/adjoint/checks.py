"""What the adjoint asks of a scene, and how long a step single particles of it can stand."""

import math
from collections.abc import Sequence

from datasets.errors import InputError
from datasets.material import Material
from datasets.scene import Scene
from mpm.arrays.features import Features


def lone_particle_step(material: Material, dimension: int) -> float:
    """The largest stable `step_fraction` of a particle that has its nodes to itself, compressed alike along all axes.

    Its C and stress swing as dC/dt = -4 p / (rho dx^2), dp/dt = (D lambda + 2 mu) C per axis, whatever its place in the
    cell, and explicit steps follow that up to 2 / omega; waves in a body are slower than this.
    """
    swinging = dimension * material.lame + 2.0 * material.shear_modulus
    return math.sqrt((material.lame + 2.0 * material.shear_modulus) / swinging)


def checked_frames(scenes: Sequence[Scene], frames: Sequence[int]) -> list[int]:
    """`frames` in ascending order, once each. Raises InputError for one that a scene has not."""
    shortest = min(scene.frames for scene in scenes)
    found = sorted(set(frames))
    if not found or found[0] < 0 or found[-1] >= shortest or found[-1] == 0:
        raise InputError(f"expected frames from 0 to {shortest - 1}, one of them after the first, got {list(frames)}")
    return found


def check(features: Features) -> None:
    """Raise InputError where the adjoint does not know something that scenes with `features` have."""
    if features.volume_correction and features.softens and features.cohesive:
        what = "volume_correction of a cohesive material that softens"
        raise InputError(f"expected a scene that the adjoint knows, it has no reverse of {what} yet", key="scene")
