"""The held-out scenes: columns and layers in 2D, baffles in 3D."""

import dataclasses
import math
from dataclasses import dataclass

import numpy as np

from datasets.library import read_scene
from datasets.scene import Domain, Mass, Scene
from validation.bench.columns.paper import read_paper

ASPECTS = (0.5, 0.8, 1.0, 2.0, 3.0)
"""Height over length of the columns; `datasets.definitions.held_out` keeps a distance from them."""
ANGLES = (12.0, 18.0, 21.0, 26.0, 33.0, 42.0, 48.0)
"""Angles of friction [deg]."""
TRAINED = (15.0, 45.0)
"""The angles of the training data [deg]."""
AREA = 0.08
"""Of each column [m^2]."""
MILLIMETRE = 1.0e-3
LAYERS_SEED = 4
BAFFLES = ("baffles-2", "baffles-5")


@dataclass(frozen=True, kw_only=True)
class HeldOutColumn:
    """A column that is released at the left wall."""

    aspect: float
    """Height over length."""
    friction_deg: float

    @property
    def trained(self) -> bool:
        """Whether the angle is inside the training range."""
        return TRAINED[0] <= self.friction_deg <= TRAINED[1]

    @property
    def scene(self) -> Scene:
        """The paper's scene with this column."""
        length = round(math.sqrt(AREA / self.aspect) / MILLIMETRE) * MILLIMETRE
        size = (round(length, 3), round(AREA / length, 3))
        scene = read_scene("column-short-21").with_friction_deg(self.friction_deg)
        return dataclasses.replace(scene, masses=(Mass(lower=(0.0, 0.0), size=size),))


def columns(aspects: tuple[float, ...] = ASPECTS, angles: tuple[float, ...] = ANGLES) -> list[HeldOutColumn]:
    """All aspects at all angles."""
    return [HeldOutColumn(aspect=aspect, friction_deg=angle) for aspect in aspects for angle in angles]


def paper_columns() -> dict[str, HeldOutColumn]:
    """The paper's four, which are among `columns`, by name."""
    found = {}
    for scenario in read_paper().scenarios:
        scene = read_scene(f"column-{scenario.name}")
        length, height = scene.masses[0].size
        found[scenario.name] = HeldOutColumn(aspect=round(height / length, 3), friction_deg=scene.material.friction_deg)
    return found


def layers() -> dict[str, Scene]:
    """The paper's ten layers: its velocities, the same from the top down, and others drawn from the same range."""
    scene = read_scene("layers-10")
    speeds = [mass.velocity[0] for mass in scene.masses if mass.velocity]
    drawn = np.random.default_rng(LAYERS_SEED).uniform(0.0, max(speeds), len(speeds)).round(3)
    return {
        "the paper's, falling": scene,
        "rising": with_speeds(scene, speeds[::-1]),
        "random": with_speeds(scene, drawn.tolist()),
    }


def with_speeds(scene: Scene, speeds: list[float]) -> Scene:
    """`scene` with another velocity along x [m/s] of each mass."""
    masses = tuple(
        dataclasses.replace(mass, velocity=(speed, *(0.0,) * (scene.dimension - 1)))
        for mass, speed in zip(scene.masses, speeds, strict=True)
    )
    return dataclasses.replace(scene, masses=masses)


def on_cells(scene: Scene, cells: int) -> Scene:
    """`scene` with so many cells along its first axis."""
    return dataclasses.replace(scene, domain=Domain(size=scene.domain.size, cell=scene.domain.size[0] / cells))


def scaled(scene: Scene, factor: float) -> Scene:
    """Box and masses `factor` times as large, on the same cells."""

    def larger(lengths: tuple[float, ...]) -> tuple[float, ...]:
        return tuple(factor * length for length in lengths)

    masses = tuple(dataclasses.replace(mass, lower=larger(mass.lower), size=larger(mass.size)) for mass in scene.masses)
    domain = Domain(size=larger(scene.domain.size), cell=scene.domain.cell)
    return dataclasses.replace(scene, domain=domain, masses=masses)
