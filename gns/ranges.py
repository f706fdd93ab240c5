"""The quantities whose ranges bound a surrogate's validity, without units as the model sees them.

With l, g and rho, length of the released body, gravity and density (`gns.units.Units`), lengths are over l, speeds over
sqrt(g l), times over sqrt(l / g), stresses over rho g l: a scene is within the training data, or outside, at any size.
"""

import dataclasses
import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from datasets.geometry.ground import ground_raster
from datasets.geometry.placement import heights_above_ground, remembers_gaps
from datasets.scene import Scene
from gns.settings import ModelSettings
from gns.units import Units

MARGIN = 0.1
"""Admitted extrapolation beyond a range, as a fraction of its width on the quantity's scale."""
SMALLEST = 1.0e-3
"""Tangent of an angle, or length over l, below which logarithms do not fall further [-]."""
GROUND_SPACING = 0.05
"""Distance between two elevations of which the steepness of terrain is taken, over l [-]."""

Range = tuple[float, float]
Floats = NDArray[np.float64]


def logarithm(value: float) -> float:
    """ln x, the scale of what varies by factors; that of `SMALLEST` for all that is smaller."""
    return math.log(max(value, SMALLEST))


def logarithm_of_tangent(degrees: float) -> float:
    """ln tan(phi): sand of 5 degrees is to that of 8 what a friction of 0.09 is to one of 0.14."""
    return logarithm(math.tan(math.radians(degrees)))


@dataclass(frozen=True, kw_only=True)
class Quantity:
    """A quantity of a scene whose range bounds a surrogate's validity."""

    unit: str = ""
    below: bool = True
    """Whether a smaller value than those of the training data is outside."""
    above: bool = True
    """Whether a larger one is."""
    scale: Callable[[float], float] = float
    """Increasing function of a value, of which the width of its range is taken."""


QUANTITIES: dict[str, Quantity] = {
    "friction_deg": Quantity(unit="deg", scale=logarithm_of_tangent),
    "cohesion": Quantity(unit="rho g l"),
    "tension_cutoff": Quantity(unit="of the cohesion"),
    "young": Quantity(unit="rho g l", above=False),
    "poisson": Quantity(),
    "dilation_deg": Quantity(unit="deg"),
    "softening_length": Quantity(unit="l"),
    "k0": Quantity(),
    "barriers": Quantity(),
    "volume_correction": Quantity(),
    "relaxation_time": Quantity(unit="sqrt(cell / g)"),
    "floor_friction": Quantity(),
    "wall_friction": Quantity(),
    "baffle_friction": Quantity(),
    "ground_friction": Quantity(),
    "ground_deg": Quantity(unit="deg", below=False),
    "ground_relief": Quantity(unit="l", below=False),
    "damping": Quantity(),
    "slope_deg": Quantity(unit="deg"),
    "slope_length": Quantity(unit="l", below=False),
    "masses": Quantity(),
    "mass_aspect": Quantity(scale=logarithm),
    "mass_length": Quantity(unit="l", scale=logarithm),
    "mass_height": Quantity(unit="l", scale=logarithm),
    "mass_width": Quantity(unit="l", scale=logarithm),
    "drop": Quantity(unit="l", below=False),
    "room_along": Quantity(unit="l", above=False),
    "room_across": Quantity(unit="l", above=False),
    "speed": Quantity(unit="sqrt(g l)"),
    "upward_speed": Quantity(unit="sqrt(g l)"),
    "spin": Quantity(unit="sqrt(g / l)"),
    "baffles": Quantity(),
    "baffle_length": Quantity(unit="l"),
    "baffle_height": Quantity(unit="l"),
    "baffle_foot": Quantity(unit="l"),
    "baffle_width": Quantity(unit="l"),
    "baffle_distance": Quantity(unit="l"),
    "duration": Quantity(unit="sqrt(l / g)", below=False),
    "spacing": Quantity(unit="l", below=False),
    "length": Quantity(unit="m"),
    "density": Quantity(unit="kg/m^3"),
    "gravity": Quantity(unit="m/s^2"),
}
ABSOLUTE = ("length", "density", "gravity")
"""What a model that scales its scenes does not see."""


def values_of(scene: Scene) -> dict[str, list[float]]:
    """The values of each quantity in a scene with gravity, in its unit; none where the scene has no such thing."""
    body, masses, baffles = Units.of_body(scene), scene.masses, scene.baffles
    sand = [scene.material_of(mass) for mass in masses]
    # Where all masses together begin and end along each axis.
    low = [min(mass.lower[axis] for mass in masses) for axis in range(scene.dimension)]
    high = [max(mass.lower[axis] + mass.size[axis] for mass in masses) for axis in range(scene.dimension)]
    extents = [last - first for first, last in zip(low, high, strict=True)]
    rooms = [whole - own for whole, own in zip(scene.domain.size, extents, strict=True)]
    # None of a mass at rest.
    velocities = [(mass.velocity,) if mass.velocity else () for mass in masses]
    stresses = [
        each.poisson / (1.0 - each.poisson) if isinstance(mass.k0, str) else mass.k0
        for mass, each in zip(masses, sand, strict=True)
        if mass.k0 is not None
    ]
    held = sum(mass.release is not None for mass in masses)
    # That which the scene would not have by itself.
    corrected = scene.volume_correction
    usual = corrected is None or corrected == remembers_gaps(dataclasses.replace(scene, volume_correction=None))
    lengths = {
        "softening_length": [each.softening_length for each in sand if each.softening_length is not None],
        "slope_length": [scene.domain.size[0]] if scene.slope_deg != 0.0 or scene.solids else [],
        "mass_length": extents[:1],
        "mass_height": extents[1:2],
        "mass_width": extents[2:],
        "drop": [float(heights_above_ground(scene).max())],
        "room_along": rooms[:1],
        "room_across": rooms[2:],
        "baffle_length": [each.size[0] for each in baffles],
        "baffle_height": [each.size[1] for each in baffles],
        "baffle_foot": [each.lower[1] for each in baffles],
        "baffle_width": [each.size[2] for each in baffles if len(each.size) > 2],
        # Along x from the masses, negative beside or beneath one.
        "baffle_distance": [max(each.lower[0] - high[0], low[0] - each.lower[0] - each.size[0]) for each in baffles],
        "spacing": [scene.particle_spacing],
    }
    return {
        **terrain(scene, body.length),
        **{name: [length / body.length for length in found] for name, found in lengths.items()},
        "friction_deg": [each.friction_deg for each in sand],
        "cohesion": [
            each.cohesion_at(depth) / body.stress
            for mass, each in zip(masses, sand, strict=True)
            for depth in (0.0, mass.size[1])
        ],
        "tension_cutoff": [each.tension_limit / each.cohesion for each in sand if each.cohesion > 0.0],
        "young": [each.young / body.stress for each in sand],
        "poisson": [each.poisson for each in sand],
        "dilation_deg": [each.dilation_deg for each in sand],
        "k0": stresses,
        "barriers": [float(held)] if held else [],
        "volume_correction": [] if usual else [float(bool(corrected))],
        "relaxation_time": [scene.relaxation * math.sqrt(scene.gravity / scene.domain.cell)],
        "floor_friction": [scene.floor_friction],
        "wall_friction": [scene.wall_friction],
        "baffle_friction": [scene.baffle_friction if each.friction is None else each.friction for each in baffles],
        "damping": [scene.damping],
        "slope_deg": [abs(scene.slope_deg)],
        "masses": [float(len(masses))],
        "mass_aspect": [extents[1] / extents[0]],
        "speed": [max((math.hypot(*each) for each in some), default=0.0) / body.speed for some in velocities],
        "upward_speed": [each[1] / body.speed for some in velocities for each in some],
        "spin": [float(abs(mass.spin).max()) * body.time for mass in masses],
        "baffles": [float(len(baffles))],
        "duration": [scene.duration / body.time],
        "length": [body.length],
        "density": [sand[0].density],
        "gravity": [scene.gravity],
    }


def terrain(scene: Scene, length: float) -> dict[str, list[float]]:
    """Friction, steepest angle along an axis [deg], and relief over l of the terrain; length: l [m]."""
    if not scene.solids:
        return {}
    spacing = GROUND_SPACING * length
    elevation, friction, _ = ground_raster(scene, spacing)
    rise = max(float(np.abs(np.diff(elevation, axis=axis)).max()) for axis in range(elevation.ndim))
    return {
        "ground_friction": [float(friction.min()), float(friction.max())],
        "ground_deg": [math.degrees(math.atan(rise / spacing))],
        "ground_relief": [float(np.ptp(elevation)) / length],
    }


def ranges_of(scenes: Iterable[Scene], settings: ModelSettings) -> dict[str, Range]:
    """Least and greatest value of each quantity over `scenes`; without those that they have none of.

    Particles may be as far apart as a cell of the model is long: it follows one of each cell.
    """
    found: dict[str, list[float]] = {name: [] for name in QUANTITIES}
    for scene in scenes:
        for name, values in values_of(scene).items():
            found[name] += values
        body = settings.body_length or Units.of_body(scene).length
        found["spacing"].append(settings.cell / body)
    if settings.body_length is not None:
        for name in ABSOLUTE:
            del found[name]
    return {name: (round(min(values), 9), round(max(values), 9)) for name, values in found.items() if values}


def outside(scene: Scene, ranges: dict[str, Range]) -> list[str]:
    """The quantities of `scene` outside of `ranges`: each with its value, the range and by how much it is outside."""
    if scene.gravity <= 0.0:
        return ["gravity 0 (none in the training data)"]
    found, present = [], values_of(scene)
    scaled = not any(name in ranges for name in ABSOLUTE)
    for name, quantity in QUANTITIES.items():
        if scaled and name in ABSOLUTE:
            continue
        values, unit = present.get(name), f" {quantity.unit}" if quantity.unit else ""
        if not values:
            continue
        if name not in ranges:
            found.append(f"{name} {values[0]:.3g}{unit} (none in the training data)")
            continue
        low, high = ranges[name]
        least, most = quantity.scale(low), quantity.scale(high)
        slack = MARGIN * (most - least) + 1.0e-6 * max(abs(least), abs(most))
        below = quantity.below and quantity.scale(min(values)) < least - slack
        above = quantity.above and quantity.scale(max(values)) > most + slack
        if not (below or above):
            continue
        trained = f"{low:.3g}" if low == high else f"{low:.3g} to {high:.3g}"
        worst = max(values) if above else min(values)
        by = f"{worst - high:.2g} above" if above else f"{low - worst:.2g} below"
        found.append(f"{name} {worst:.3g}{unit} (trained: {trained}, {by})")
    return found
