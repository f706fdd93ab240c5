"""Twenty 2D scenes that no training data of the shipped surrogates are like, each for one reason."""

import dataclasses
import math
from typing import Any

from datasets.material import Material
from datasets.scene import Baffle, Domain, Mass, Scene
from gns.model.settings import ModelSettings

LENGTH, HEIGHT = 0.2, 0.4
"""Of the column that all of them are made from [m]."""
AREA = LENGTH * HEIGHT


def column(**changes: Any) -> Scene:
    """A column of sand as in the middle of the training data, changed in what is named."""
    whole = Scene(
        domain=Domain(size=(2.0, 1.0), cell=0.01),
        material=Material(friction_deg=30.0, young=1.0e6),
        masses=(Mass(lower=(0.0, 0.0), size=(LENGTH, HEIGHT)),),
        duration=1.2,
        frame_dt=0.02,
        floor_friction=0.4,
        wall_friction=0.2,
        step_fraction=0.9,
    )
    return dataclasses.replace(whole, **changes)


def of_sand(**changes: Any) -> Scene:
    """The column of another material."""
    return column(material=dataclasses.replace(column().material, **changes))


def of_mass(**changes: Any) -> Scene:
    """The column with another mass."""
    return column(masses=(dataclasses.replace(column().masses[0], **changes),))


def of_aspect(aspect: float, box: tuple[float, float]) -> Scene:
    """A column of the same area, so many times as high as long."""
    size = (math.sqrt(AREA / aspect), math.sqrt(AREA * aspect))
    return column(masses=(Mass(lower=(0.0, 0.0), size=size),), domain=Domain(size=box, cell=0.01))


def stack(count: int) -> tuple[Mass, ...]:
    """The column cut into layers."""
    part = HEIGHT / count
    return tuple(Mass(lower=(0.0, index * part), size=(LENGTH, part)) for index in range(count))


def row(count: int) -> tuple[Baffle, ...]:
    """Thin baffles one behind the other."""
    return tuple(Baffle(lower=(0.4 + 0.15 * index, 0.0), size=(0.03, 0.05)) for index in range(count))


def out_of_range(settings: ModelSettings) -> dict[str, Scene]:
    """The scenes by their reasons, for a model in 2D."""
    assert settings.dimension == 2
    return {
        "angle of friction of 5°": of_sand(friction_deg=5.0),
        "angle of friction of 60°": of_sand(friction_deg=60.0),
        "cohesion of 15 kPa, three times the weight": of_sand(cohesion=15.0e3, tension_cutoff=7.5e3),
        "strength that grows by 40 kPa/m": of_sand(strength_gradient=4.0e4),
        "dilation of 15° for ever": of_sand(dilation_deg=15.0),
        "softening to 20°": of_sand(softening_length=0.02, residual_friction_deg=20.0),
        "Poisson's ratio of 0.45": of_sand(poisson=0.45),
        "thirty times as soft": of_sand(young=3.0e4),
        "floor friction of 2": column(floor_friction=2.0),
        "damping of 0.7": column(damping=0.7),
        "slope of 50°": column(slope_deg=50.0),
        "20 times as high as long": of_aspect(20.0, (2.0, 1.4)),
        "20 times as long as high": of_aspect(0.05, (3.0, 1.0)),
        "thrown at 8 m/s": of_mass(velocity=(8.0, 0.0)),
        "dropped from 2 m": column(
            masses=(Mass(lower=(0.5, 2.0), size=(LENGTH, HEIGHT)),), domain=Domain(size=(2.0, 3.0), cell=0.01)
        ),
        "spinning at 30 rad/s": of_mass(lower=(0.5, 0.3), angular_velocity=30.0),
        "twenty layers": column(masses=stack(20)),
        "eight baffles": column(baffles=row(8)),
        "a baffle 0.9 m high": column(baffles=(Baffle(lower=(0.6, 0.0), size=(0.1, 0.9)),)),
        "initial stress, K0 of 0.5": of_mass(k0=0.5),
    }
