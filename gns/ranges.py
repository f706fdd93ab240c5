"""The quantities whose ranges bound a surrogate's validity, dimensionless as the model sees them.

With length l of the released body, gravity g and density rho (`gns.surroundings.units.Units`), lengths are divided by
l, speeds by sqrt(g l), times by sqrt(l / g) and stresses by rho g l. Whether a scene lies in the training range does
not depend on its size.
"""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from datasets.geometry.bodies import height
from datasets.geometry.ground import ground_raster
from datasets.geometry.placement import heights_above_ground, remembers_gaps
from datasets.scene import Scene, coefficient
from datasets.scene.grid_field import THICKNESS
from datasets.scene.particles import initial_particles
from gns.settings import ModelSettings
from gns.surroundings.units import Units

MARGIN = 0.1  # admitted extrapolation beyond a range, as a fraction of its width on the quantity's scale
SMALLEST = 1.0e-3  # tangent of an angle, or length over l, at which logarithms are cut off [-]
GROUND_SPACING = 0.05  # distance over which the steepness of terrain is measured, over l [-]

Range = tuple[float, float]


def logarithm(value: float) -> float:
    """ln x, the scale of quantities that vary by factors; values below `SMALLEST` count as `SMALLEST`."""
    return math.log(max(value, SMALLEST))


def logarithm_of_tangent(degrees: float) -> float:
    """ln tan(phi): angles of 5 and 8 degrees are as far apart as frictions of 0.09 and 0.14."""
    return logarithm(math.tan(math.radians(degrees)))


@dataclass(frozen=True)
class RangedQuantity:
    """A quantity of a scene whose range bounds a surrogate's validity."""

    values: Sequence[float]  # in its unit; empty if the scene does not have the quantity
    unit: str = ""
    below: bool = True  # whether a smaller value than those of the training data is outside
    above: bool = True  # whether a larger one is
    scale: Callable[[float], float] = float  # increasing function; the width of a range is measured on it


ABSOLUTE = ("length", "density", "gravity")  # hidden from a model that scales its scenes


def quantities(scene: Scene) -> dict[str, RangedQuantity]:
    """The quantities of a scene with gravity."""
    body, masses, baffles = Units.of_body(scene), scene.masses, scene.baffles
    sand = [scene.material_of(mass) for mass in masses]
    layers = list(zip(masses, sand, strict=True))
    # Where all masses together begin and end along each axis.
    low = [min(mass.lower[axis] for mass in masses) for axis in range(scene.dimension)]
    high = [max(mass.lower[axis] + mass.size[axis] for mass in masses) for axis in range(scene.dimension)]
    extents = [last - first for first, last in zip(low, high, strict=True)]
    rooms = [whole - extent for whole, extent in zip(scene.domain.size, extents, strict=True)]
    frictions, velocities, upwards = sands(scene)
    chosen, by_itself = scene.volume_correction, replace(scene, volume_correction=None)
    elevation, roughness, steepness, floor = terrain(scene, GROUND_SPACING * body.length)
    turbulences = [float(np.min(solid.turbulence)) for solid in scene.solids if solid.turbulence]

    def ranged(values: Iterable[float | None], unit: str = "", *, over: float = 1.0, **bounds: Any) -> RangedQuantity:
        return RangedQuantity([value / over for value in values if value is not None], unit, **bounds)

    angles, stresses = partial(ranged, unit="deg"), partial(ranged, unit="rho g l", over=body.stress)
    lengths, speeds = partial(ranged, unit="l", over=body.length), partial(ranged, unit="sqrt(g l)", over=body.speed)
    return {
        "friction_deg": angles(frictions, scale=logarithm_of_tangent),
        "friction_limit_deg": angles(material.friction_limit_deg for material in sand),
        "cohesion": stresses(material.cohesion_at(z) for mass, material in layers for z in (0.0, height(scene, mass))),
        "tension_cutoff": ranged(
            (material.tension_limit / material.cohesion for material in sand if material.cohesion > 0.0),
            "of the cohesion",
        ),
        "young": stresses((material.modulus for material in sand), above=False),
        "poisson": ranged(material.poisson for material in sand),
        "dilation_deg": angles(material.dilation_deg for material in sand),
        "softening_length": lengths(material.softening_length for material in sand),
        # For an elastic initial stress nu / (1 - nu).
        "k0": ranged(
            material.poisson / (1.0 - material.poisson) if isinstance(mass.k0, str) else mass.k0
            for mass, material in layers
        ),
        "barriers": ranged([sum(mass.release is not None for mass in masses) or None]),
        # Only if the scene differs from its default.
        "volume_correction": ranged([None if chosen == remembers_gaps(by_itself) else chosen]),
        "relaxation_time": ranged([scene.relaxation * math.sqrt(scene.gravity / scene.domain.cell)], "sqrt(cell / g)"),
        "floor_friction": ranged(floor),
        "wall_friction": ranged([coefficient(scene.wall_friction)]),
        "baffle_friction": ranged(coefficient(scene.friction_of(baffle)) for baffle in baffles),
        "channel": lengths([scene.channel.width if scene.channel else None]),
        "ground_friction": ranged(roughness),
        "ground_turbulence": ranged(turbulences, "g", over=scene.gravity, above=False, scale=logarithm),
        "ground_deg": angles(steepness, below=False),
        "ground_relief": lengths(elevation, below=False),
        "damping": ranged([scene.damping]),
        "slope_deg": angles([abs(scene.slope_deg)]),
        "slope_length": lengths(scene.domain.size[:1] if scene.slope_deg != 0.0 or scene.solids else (), below=False),
        "masses": ranged([len(masses)]),
        "mass_aspect": ranged([extents[1] / extents[0]], scale=logarithm),
        "mass_length": lengths(extents[:1], scale=logarithm),
        "mass_height": lengths(extents[1:2], scale=logarithm),
        "mass_width": lengths(extents[2:], scale=logarithm),
        "drop": lengths([float(heights_above_ground(scene).max())], below=False),
        "room_along": lengths(rooms[:1], above=False),
        "room_across": lengths(rooms[2:], above=False),
        "speed": speeds(velocities),
        "upward_speed": speeds(upwards),
        "spin": ranged((float(abs(mass.spin).max()) * body.time for mass in masses), "sqrt(g / l)"),
        "baffles": ranged([len(baffles)]),
        "baffle_length": lengths(baffle.size[0] for baffle in baffles),
        "baffle_height": lengths(baffle.size[1] for baffle in baffles),
        "baffle_foot": lengths(baffle.lower[1] for baffle in baffles),
        "baffle_width": lengths(baffle.size[2] for baffle in baffles if len(baffle.size) > 2),
        # Along x from the masses, negative beside or beneath one.
        "baffle_distance": lengths(max(box.lower[0] - high[0], low[0] - box.lower[0] - box.size[0]) for box in baffles),
        "duration": ranged([scene.duration], "sqrt(l / g)", over=body.time, below=False),
        "spacing": lengths([scene.particle_spacing], below=False),
        "length": ranged([body.length], "m"),
        "density": ranged([sand[0].density], "kg/m^3"),
        "gravity": ranged([scene.gravity], "m/s^2"),
    }


def sands(scene: Scene) -> tuple[list[float], list[float], list[float]]:
    """Angles of friction [deg], speeds and upward velocities [m/s] of the masses; where fields vary any of these, the
    extremes of the particles."""
    if all(field.quantity == THICKNESS for field in scene.fields):
        thrown = [mass.velocity for mass in scene.masses if mass.velocity]
        angles = [scene.material_of(mass).phi_deg for mass in scene.masses]
        return angles, [math.hypot(*(mass.velocity or ())) for mass in scene.masses], [vector[1] for vector in thrown]
    particles = initial_particles(scene)
    of_particles = np.degrees(np.arctan(particles.friction)), np.linalg.norm(particles.velocities, axis=1)
    angles, velocities, upwards = (
        [float(values.min()), float(values.max())] for values in (*of_particles, particles.velocities[:, 1])
    )
    return angles, velocities, upwards


def terrain(scene: Scene, spacing: float) -> tuple[list[float], ...]:
    """Relief [m], friction, steepest angle along an axis [deg] of the terrain, if any; friction of the floor, unless
    terrain covers all of it; spacing: of its raster [m]."""
    floor = [coefficient(scene.floor_friction)]
    if not scene.solids:
        return [], [], [], floor
    elevation, friction, top = ground_raster(scene, spacing)
    rise = max(float(np.abs(np.diff(elevation, axis=axis)).max()) for axis in range(elevation.ndim))
    steepest = math.degrees(math.atan(rise / spacing))
    frictions = [float(friction.min()), float(friction.max())]
    return [float(np.ptp(elevation))], frictions, [steepest], floor if (top < 0).any() else []


def ranges_of(scenes: Iterable[Scene], settings: ModelSettings) -> dict[str, Range]:
    """Least and greatest value of each quantity that `scenes` have. Particles may be as far apart as a cell of the
    model is long, since the model follows one per cell."""
    gathered: dict[str, list[float]] = {}
    for scene in scenes:
        for name, quantity in quantities(scene).items():
            gathered.setdefault(name, []).extend(quantity.values)
        gathered["spacing"].append(settings.cell / (settings.body_length or Units.of_body(scene).length))
    hidden = () if settings.body_length is None else ABSOLUTE
    kept = {name: values for name, values in gathered.items() if values and name not in hidden}
    return {name: (round(min(values), 9), round(max(values), 9)) for name, values in kept.items()}


def outside(scene: Scene, ranges: dict[str, Range]) -> list[str]:
    """The quantities of `scene` outside `ranges`, each with its value, its range and the distance to it."""
    if scene.gravity <= 0.0:
        return ["gravity 0 (none in the training data)"]
    outliers = []
    scaled = not any(name in ranges for name in ABSOLUTE)
    for name, quantity in quantities(scene).items():
        values, unit = quantity.values, f" {quantity.unit}" if quantity.unit else ""
        if not values or (scaled and name in ABSOLUTE):
            continue
        if name not in ranges:
            outliers.append(f"{name} {values[0]:.3g}{unit} (none in the training data)")
            continue
        low, high = ranges[name]
        least, most = quantity.scale(low), quantity.scale(high)
        slack = MARGIN * (most - least) + 1.0e-6 * max(abs(least), abs(most))
        below = quantity.below and quantity.scale(min(values)) < least - slack
        above = quantity.above and quantity.scale(max(values)) > most + slack
        if below or above:
            trained = f"{low:.3g}" if low == high else f"{low:.3g} to {high:.3g}"
            worst = max(values) if above else min(values)
            by = f"{worst - high:.2g} above" if above else f"{low - worst:.2g} below"
            outliers.append(f"{name} {worst:.3g}{unit} (trained: {trained}, {by})")
    return outliers
