"""The quantities whose ranges bound a surrogate's validity, without units as the model sees them.

With l, g and rho, length of the released body, gravity and density (`gns.state.Units`), lengths are over l, speeds over
sqrt(g l), times over sqrt(l / g), stresses over rho g l: a scene is within the training data, or outside, at any size.
"""

import dataclasses
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from enum import Enum, auto

import numpy as np
from numpy.typing import NDArray

from datasets.geometry.ground import ground_raster
from datasets.geometry.placement import heights_above_ground, remembers_gaps
from datasets.material import Material
from datasets.particles import released_volume
from datasets.scene import Baffle, Mass, Scene
from gns.settings import ModelSettings

MARGIN = 0.1
"""Admitted extrapolation beyond a range, as a fraction of its width on the quantity's scale."""
SMALLEST = 1.0e-3
"""Tangent of an angle, or length over l, below which logarithms do not fall further [-]."""
GROUND_SPACING = 0.05
"""Distance between two elevations of which the steepness of terrain is taken, over l [-]."""

Range = tuple[float, float]
Floats = NDArray[np.float64]


class Bound(Enum):
    """Which ends of a range count."""

    BOTH = auto()
    UPPER = auto()
    LOWER = auto()


@dataclass(frozen=True, kw_only=True)
class Body:
    """The units of a scene's released body."""

    length: float
    """l, the root of its volume [m]."""
    gravity: float
    """g [m/s^2], positive."""
    density: float
    """rho [kg/m^3]."""

    @staticmethod
    def from_scene(scene: Scene) -> "Body":
        """Those of `scene`, which has gravity."""
        return Body(
            length=released_volume(scene) ** (1.0 / scene.dimension),
            gravity=scene.gravity,
            density=scene.material_of(scene.masses[0]).density,
        )

    @property
    def speed(self) -> float:
        """sqrt(g l) [m/s]."""
        return math.sqrt(self.gravity * self.length)

    @property
    def time(self) -> float:
        """sqrt(l / g) [s]."""
        return math.sqrt(self.length / self.gravity)

    @property
    def stress(self) -> float:
        """rho g l [Pa]."""
        return self.density * self.gravity * self.length


Values = Callable[[Scene, Body], Sequence[float]]


@dataclass(frozen=True, kw_only=True)
class Quantity:
    """A quantity of a scene whose range bounds a surrogate's validity."""

    unit: str
    values: Values
    """Its values in a scene; none where the scene has no such thing."""
    bound: Bound = Bound.BOTH
    scale: Callable[[float], float] = float
    """Increasing function of a value, of which the width of its range is taken."""


def logarithm(value: float) -> float:
    """ln x, the scale of what varies by factors; that of `SMALLEST` for all that is smaller."""
    return math.log(max(value, SMALLEST))


def logarithm_of_tangent(degrees: float) -> float:
    """ln tan(phi): sand of 5 degrees is to that of 8 what a friction of 0.09 is to one of 0.14."""
    return logarithm(math.tan(math.radians(degrees)))


def material(number: Callable[[Material, Body], float | None]) -> Values:
    """A constant of the material of each mass; of those for which it is None there is none."""

    def values(scene: Scene, body: Body) -> list[float]:
        found = [number(scene.material_of(mass), body) for mass in scene.masses]
        return [value for value in found if value is not None]

    return values


def cohesions(scene: Scene, body: Body) -> list[float]:
    """Cohesion at the top and at the foot of each mass over rho g l."""
    return [
        scene.material_of(mass).cohesion_at(depth) / body.stress
        for mass in scene.masses
        for depth in (0.0, mass.size[1])
    ]


def box(scene: Scene, axis: int) -> Range:
    """Where the masses begin and end along an axis [m]."""
    return min(mass.lower[axis] for mass in scene.masses), max(
        mass.lower[axis] + mass.size[axis] for mass in scene.masses
    )


def extent(axis: int) -> Values:
    """Extent of all masses together along an axis over l."""

    def values(scene: Scene, body: Body) -> list[float]:
        if axis >= scene.dimension:
            return []
        low, high = box(scene, axis)
        return [(high - low) / body.length]

    return values


def aspect(scene: Scene, _: Body) -> list[float]:
    """Height over length of all masses together."""
    (left, right), (low, high) = box(scene, 0), box(scene, 1)
    return [(high - low) / (right - left)]


def room(axis: int) -> Values:
    """Distances of the sides of the box from the masses along an axis, both together, over l."""

    def values(scene: Scene, body: Body) -> list[float]:
        if axis >= scene.dimension:
            return []
        low, high = box(scene, axis)
        return [(scene.domain.size[axis] - (high - low)) / body.length]

    return values


def slope_length(scene: Scene, body: Body) -> list[float]:
    """Length of the box over l where the ground falls, and a farther side lets flows get faster."""
    return [scene.domain.size[0] / body.length] if scene.slope_deg != 0.0 or scene.solids else []


def velocities(mass: Mass) -> Sequence[Sequence[float]]:
    """Initial velocities in a mass [m/s]; none where it is at rest."""
    return mass.velocities or ((mass.velocity,) if mass.velocity else ())


def speeds(scene: Scene, body: Body) -> list[float]:
    """Largest initial speed of each mass over sqrt(g l)."""
    return [max((math.hypot(*each) for each in velocities(mass)), default=0.0) / body.speed for mass in scene.masses]


def climbs(scene: Scene, body: Body) -> list[float]:
    """Upward component of the initial velocities over sqrt(g l)."""
    return [each[1] / body.speed for mass in scene.masses for each in velocities(mass)]


def spins(scene: Scene, body: Body) -> list[float]:
    """Largest component of the initial velocity gradient of each mass times sqrt(l / g)."""
    return [float(abs(mass.spin).max()) * body.time for mass in scene.masses]


def stresses(scene: Scene, _: Body) -> list[float]:
    """Horizontal over vertical stress at the start where masses are given any; elastic: nu / (1 - nu)."""
    found = []
    for mass in scene.masses:
        if mass.k0 is not None:
            poisson = scene.material_of(mass).poisson
            found.append(poisson / (1.0 - poisson) if isinstance(mass.k0, str) else mass.k0)
    return found


def barriers(scene: Scene, _: Body) -> list[float]:
    """Number of masses that barriers hold at first, where there are any."""
    count = sum(mass.release is not None for mass in scene.masses)
    return [float(count)] if count else []


def corrections(scene: Scene, _: Body) -> list[float]:
    """Volume correction (0 or 1) where the scene asks for another than scenes have by themselves."""
    given = scene.volume_correction
    if given is None or given == remembers_gaps(dataclasses.replace(scene, volume_correction=None)):
        return []
    return [float(given)]


def relaxation(scene: Scene, _: Body) -> list[float]:
    """Relaxation time over sqrt(cell / g)."""
    return [scene.relaxation * math.sqrt(scene.gravity / scene.domain.cell)]


def baffle(number: Callable[[Baffle, Scene], float]) -> Values:
    """A length of each baffle [m] over l."""
    return lambda scene, body: [number(each, scene) / body.length for each in scene.baffles]


def distance(each: Baffle, scene: Scene) -> float:
    """Distance of a baffle from the masses along x [m], negative where it stands beside or beneath one."""
    left, right = box(scene, 0)
    return max(each.lower[0] - right, left - each.lower[0] - each.size[0])


def ground(number: Callable[[Floats, Floats, float], Sequence[float]]) -> Values:
    """Values of the elevation [m], the friction [-] and the distance of two elevations [m] where there is terrain."""

    def values(scene: Scene, body: Body) -> Sequence[float]:
        if not scene.solids:
            return []
        spacing = GROUND_SPACING * body.length
        elevation, friction = ground_raster(scene, spacing)
        return number(elevation / body.length, friction, spacing / body.length)

    return values


def steepest(elevation: Floats, _: Floats, spacing: float) -> list[float]:
    """Angle of the steepest ground along an axis [deg]."""
    rises = [np.abs(np.diff(elevation, axis=axis)).max() for axis in range(elevation.ndim)]
    return [math.degrees(math.atan(float(max(rises)) / spacing))]


QUANTITIES: dict[str, Quantity] = {
    "friction_deg": Quantity(
        unit="deg", values=material(lambda sand, _: sand.friction_deg), scale=logarithm_of_tangent
    ),
    "cohesion": Quantity(unit="rho g l", values=cohesions),
    "tension_cutoff": Quantity(
        unit="of the cohesion",
        values=material(lambda sand, _: sand.tension_limit / sand.cohesion if sand.cohesion > 0.0 else None),
    ),
    "young": Quantity(unit="rho g l", values=material(lambda sand, body: sand.young / body.stress), bound=Bound.LOWER),
    "poisson": Quantity(unit="", values=material(lambda sand, _: sand.poisson)),
    "dilation_deg": Quantity(unit="deg", values=material(lambda sand, _: sand.dilation_deg)),
    "softening_length": Quantity(
        unit="l",
        values=material(
            lambda sand, body: None if sand.softening_length is None else sand.softening_length / body.length
        ),
    ),
    "k0": Quantity(unit="", values=stresses),
    "barriers": Quantity(unit="", values=barriers),
    "volume_correction": Quantity(unit="", values=corrections),
    "relaxation_time": Quantity(unit="sqrt(cell / g)", values=relaxation),
    "floor_friction": Quantity(unit="", values=lambda scene, _: [scene.floor_friction]),
    "wall_friction": Quantity(unit="", values=lambda scene, _: [scene.wall_friction]),
    "baffle_friction": Quantity(
        unit="",
        values=lambda scene, _: [
            scene.baffle_friction if each.friction is None else each.friction for each in scene.baffles
        ],
    ),
    "ground_friction": Quantity(
        unit="", values=ground(lambda _, friction, __: [float(friction.min()), float(friction.max())])
    ),
    "ground_deg": Quantity(unit="deg", values=ground(steepest), bound=Bound.UPPER),
    "ground_relief": Quantity(
        unit="l", values=ground(lambda elevation, _, __: [float(np.ptp(elevation))]), bound=Bound.UPPER
    ),
    "damping": Quantity(unit="", values=lambda scene, _: [scene.damping]),
    "slope_deg": Quantity(unit="deg", values=lambda scene, _: [abs(scene.slope_deg)]),
    "slope_length": Quantity(unit="l", values=slope_length, bound=Bound.UPPER),
    "masses": Quantity(unit="", values=lambda scene, _: [float(len(scene.masses))]),
    "mass_aspect": Quantity(unit="", values=aspect, scale=logarithm),
    "mass_length": Quantity(unit="l", values=extent(0), scale=logarithm),
    "mass_height": Quantity(unit="l", values=extent(1), scale=logarithm),
    "mass_width": Quantity(unit="l", values=extent(2), scale=logarithm),
    "drop": Quantity(
        unit="l", values=lambda scene, body: [float(heights_above_ground(scene).max()) / body.length], bound=Bound.UPPER
    ),
    "room_along": Quantity(unit="l", values=room(0), bound=Bound.LOWER),
    "room_across": Quantity(unit="l", values=room(2), bound=Bound.LOWER),
    "speed": Quantity(unit="sqrt(g l)", values=speeds),
    "upward_speed": Quantity(unit="sqrt(g l)", values=climbs),
    "spin": Quantity(unit="sqrt(g / l)", values=spins),
    "baffles": Quantity(unit="", values=lambda scene, _: [float(len(scene.baffles))]),
    "baffle_length": Quantity(unit="l", values=baffle(lambda each, _: each.size[0])),
    "baffle_height": Quantity(unit="l", values=baffle(lambda each, _: each.size[1])),
    "baffle_foot": Quantity(unit="l", values=baffle(lambda each, _: each.lower[1])),
    "baffle_width": Quantity(
        unit="l",
        values=lambda scene, body: [each.size[2] / body.length for each in scene.baffles if len(each.size) > 2],
    ),
    "baffle_distance": Quantity(unit="l", values=baffle(distance)),
    "duration": Quantity(
        unit="sqrt(l / g)", values=lambda scene, body: [scene.duration / body.time], bound=Bound.UPPER
    ),
    "spacing": Quantity(unit="l", values=lambda scene, body: [scene.particle_spacing / body.length], bound=Bound.UPPER),
    "length": Quantity(unit="m", values=lambda _, body: [body.length]),
    "density": Quantity(unit="kg/m^3", values=lambda _, body: [body.density]),
    "gravity": Quantity(unit="m/s^2", values=lambda _, body: [body.gravity]),
}
ABSOLUTE = ("length", "density", "gravity")
"""What a model that scales its scenes does not see."""


def ranges_of(scenes: Iterable[Scene], settings: ModelSettings) -> dict[str, Range]:
    """Least and greatest value of each quantity over `scenes`; without those that they have none of.

    Particles may be as far apart as a cell of the model is long: it follows one of each cell.
    """
    found: dict[str, list[float]] = {}
    for scene in scenes:
        body = Body.from_scene(scene)
        for name, quantity in QUANTITIES.items():
            if name not in ABSOLUTE or settings.body_length is None:
                found.setdefault(name, []).extend(quantity.values(scene, body))
        if settings.body_length is None:
            found["spacing"].append(settings.cell / body.length)
    if settings.body_length is not None:
        found["spacing"].append(settings.cell / settings.body_length)
    return {name: (round(min(values), 9), round(max(values), 9)) for name, values in found.items() if values}


def admitted(low: float, high: float) -> Range:
    """A range with `MARGIN` of its width on either side, and rounding; all on the quantity's scale."""
    slack = MARGIN * (high - low) + 1.0e-6 * max(abs(low), abs(high))
    return low - slack, high + slack


def outside(scene: Scene, ranges: dict[str, Range]) -> list[str]:
    """The quantities of `scene` outside of `ranges`: each with its value, the range and by how much it is outside."""
    if scene.gravity <= 0.0:
        return ["gravity 0 (none in the training data)"]
    found, body = [], Body.from_scene(scene)
    scaled = not any(name in ranges for name in ABSOLUTE)
    for name, quantity in QUANTITIES.items():
        if scaled and name in ABSOLUTE:
            continue
        values, unit = quantity.values(scene, body), f" {quantity.unit}" if quantity.unit else ""
        if not values:
            continue
        if name not in ranges:
            found.append(f"{name} {values[0]:.3g}{unit} (none in the training data)")
            continue
        low, high = ranges[name]
        lowest, highest = admitted(quantity.scale(low), quantity.scale(high))
        below = quantity.bound is not Bound.UPPER and quantity.scale(min(values)) < lowest
        above = quantity.bound is not Bound.LOWER and quantity.scale(max(values)) > highest
        if not (below or above):
            continue
        trained = f"{low:.3g}" if low == high else f"{low:.3g} to {high:.3g}"
        worst = max(values) if above else min(values)
        by = f"{worst - high:.2g} above" if above else f"{low - worst:.2g} below"
        found.append(f"{name} {worst:.3g}{unit} (trained: {trained}, {by})")
    return found
