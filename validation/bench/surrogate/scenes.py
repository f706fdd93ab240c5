"""The scenes: columns and layers in 2D, baffles in 3D, none of them near a scene of the training data."""

import dataclasses
import math
from dataclasses import dataclass

import numpy as np

from datasets.library import read_scene
from datasets.scene import Domain, Mass, Scene
from validation.bench.columns.paper import read_paper

ASPECTS = (0.5, 0.8, 1.0, 2.0, 3.0)
"""Height over length of the columns, as `datasets.definitions.releases2d` keeps them out of its heaps."""
AREA = 0.08
"""Of each column [m^2]."""
ANGLES = (12.0, 18.0, 21.0, 26.0, 33.0, 42.0, 48.0)
"""Angles of friction [deg]."""
TRAINED = (15.0, 45.0)
"""The angles of the training data [deg]."""
MILLIMETRE = 1.0e-3
LAYERS_SEED = 4
BAFFLES = ("baffles-2", "baffles-5")


@dataclass(frozen=True, kw_only=True)
class Column:
    """A column that is let go at the left wall."""

    aspect: float
    """Height over length."""
    friction_deg: float

    @property
    def trained(self) -> bool:
        """Whether the angle is inside the training range."""
        return TRAINED[0] <= self.friction_deg <= TRAINED[1]

    @property
    def name(self) -> str:
        """As in the tables."""
        return f"{self.aspect:g}, {self.friction_deg:g}°"

    @property
    def scene(self) -> Scene:
        """All but the column as in the paper's."""
        length = round(math.sqrt(AREA / self.aspect) / MILLIMETRE) * MILLIMETRE
        size = (round(length, 3), round(AREA / length, 3))
        scene = read_scene("column-short-21").with_friction_deg(self.friction_deg)
        return dataclasses.replace(scene, masses=(Mass(lower=(0.0, 0.0), size=size),))


def columns(*, aspects: tuple[float, ...] = ASPECTS, angles: tuple[float, ...] = ANGLES) -> list[Column]:
    """All aspects at all angles."""
    return [Column(aspect=aspect, friction_deg=angle) for aspect in aspects for angle in angles]


def paper_columns() -> dict[str, Column]:
    """The paper's four, which are among these, by name."""
    found = {}
    for scenario in read_paper().scenarios:
        scene = read_scene(f"column-{scenario.name}")
        length, height = scene.masses[0].size
        found[scenario.name] = Column(
            aspect=round(height / length, 3),
            friction_deg=scene.material.friction_deg,
        )
    return found


def layers() -> dict[str, Scene]:
    """The paper's ten layers: its velocities, the same from the top down, and others drawn from the same range."""
    scene = read_scene("layers-10")
    velocities = [mass.velocity for mass in scene.masses]
    speeds = [velocity[0] for velocity in velocities if velocity]
    drawn = np.random.default_rng(LAYERS_SEED).uniform(0.0, max(speeds), len(speeds))
    return {
        "the paper's, falling": scene,
        "rising": with_speeds(scene, speeds[::-1]),
        "random": with_speeds(scene, [round(float(speed), 3) for speed in drawn]),
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
    masses = tuple(
        dataclasses.replace(
            mass,
            lower=tuple(factor * place for place in mass.lower),
            size=tuple(factor * length for length in mass.size),
        )
        for mass in scene.masses
    )
    size = tuple(factor * length for length in scene.domain.size)
    return dataclasses.replace(scene, domain=Domain(size=size, cell=scene.domain.cell), masses=masses)
