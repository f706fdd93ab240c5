"""Small scenes for all tests: masses in a box, and flows by positions that a test knows."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from datasets import Baffle, Domain, Mass, Material, Scene, Solid, Trajectory

SAND = Material(friction_deg=30.0)
COLUMN = Mass(lower=(0.0, 0.0), size=(0.2, 0.2))


def scene_of(
    *masses: Mass, size: tuple[float, ...] = (1.0, 1.0), cell: float = 0.02, material: Material = SAND, **changes: Any
) -> Scene:
    """Masses in a box of `size` [m] on cells of `cell` [m]."""
    return Scene(domain=Domain(size=size, cell=cell), material=material, masses=masses or (COLUMN,), **changes)


def with_masses(scene: Scene, *masses: Mass, **changes: Any) -> Scene:
    """The scene of these masses, and with other changes."""
    return replace(scene, masses=masses, **changes)


def box(*masses: Mass, **changes: Any) -> Scene:
    """Masses in a box of 1 m on cells of 2 cm, for 0.1 s in frames of 5 ms unless changed."""
    return scene_of(*masses, **{"duration": 0.1, "frame_dt": 0.005} | changes)


def room(*masses: Mass, **changes: Any) -> Scene:
    """The same in 3D, a box of 0.8 m on cells of 4 cm, for 0.05 s."""
    return box(*masses, **{"duration": 0.05, "size": (0.8, 0.8, 0.8), "cell": 0.04} | changes)


def scaled(scene: Scene, length: float, *, gravity: float = 9.81, density: float = 1800.0) -> Scene:
    """A similar scene: lengths times `length`, under another gravity [m/s^2] and of another density [kg/m^3]."""
    time, sand = math.sqrt(length * scene.gravity / gravity), scene.material
    stress = density * gravity / (sand.density * scene.gravity) * length

    def long(values: tuple[float, ...], factor: float = length) -> tuple[float, ...]:
        return tuple(factor * value for value in values)

    def shape(body: Mass | Baffle) -> dict[str, Any]:
        return {"lower": long(body.lower), "size": long(body.size)}

    def ground(solid: Solid) -> dict[str, Any]:
        rows = {name: tuple(map(long, value)) for name in ("points", "heights") if (value := getattr(solid, name))}
        return rows | {name: long(value) for name in ("origin", "spacing") if (value := getattr(solid, name))}

    stresses = {"young": sand.modulus, "cohesion": sand.cohesion, "tension_cutoff": sand.tension_cutoff}
    larger = {name: value and stress * value for name, value in stresses.items()}
    return replace(
        scene,
        domain=Domain(size=long(scene.domain.size), cell=length * scene.domain.cell),
        material=replace(sand, density=density, **larger),
        masses=tuple(
            replace(mass, **shape(mass), velocity=mass.velocity and long(mass.velocity, length / time))
            for mass in scene.masses
        ),
        baffles=tuple(replace(baffle, **shape(baffle)) for baffle in scene.baffles),
        solids=tuple(replace(solid, **ground(solid)) for solid in scene.solids),
        duration=time * scene.duration,
        frame_dt=time * scene.frame_dt,
        gravity=gravity,
    )


def flow_of(scene: Scene, positions: ArrayLike, **others: Any) -> Trajectory:
    """The trajectory of `scene` with these positions [m], shape [T, N, D], frame by frame; it begins at rest.

    others: further arrays of a trajectory, or in place of its own.
    """
    frames = np.asarray(positions, np.float32)
    defaults = {
        "time": np.arange(len(frames)) * scene.frame_dt,
        "velocity0": np.zeros(frames.shape[1:], np.float32),
        "friction": np.full(frames.shape[1], scene.material.friction, np.float32),
    }
    return Trajectory(positions=frames, scene=scene, **{**defaults, **others})
