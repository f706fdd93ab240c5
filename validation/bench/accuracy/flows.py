"""Scenes of every kind, from numbers without units: those that `--tolerance` is measured on, and others.

Lengths are in S, the smallest side of the mass; a mass of length (in x) and height (in y) stands at the left wall
or `gap` S away from it. Times are in sqrt(H / g), speeds in sqrt(g H), with H the height; stiffness and cohesion in
rho g H. The box is a whole number of S along each axis, so that cells of S / n fit it for every whole n.
"""

import dataclasses
import math
from dataclasses import dataclass

from datasets.material import Material
from datasets.scene import Baffle, Domain, Mass, Scene

GRAVITY = 9.81
FRAMES = 20
"""Of a run: only the last one is used."""
OWN_CELLS = 20
"""Cells across S of a scene; a resolution replaces them."""
OWN_STEP = 0.9
ROOM = 1.2
"""Least height of the box over that of the mass."""


@dataclass(frozen=True, kw_only=True)
class Flow:
    """A mass that is released or thrown, in numbers without units."""

    aspect: float
    """Height over length."""
    friction_deg: float
    """Of the grains [deg]."""
    floor: float = 0.385
    """Coulomb coefficient of the floor, and of the baffles."""
    wall: float = 0.0
    """Of all other walls; the left one is a plane of symmetry where it is smooth."""
    cohesion: float = 0.0
    """In rho g H; half of it is the tension cutoff."""
    damping: float = 0.0
    velocity: float = 0.0
    """Along x, in sqrt(g H)."""
    gap: float = 0.0
    """From the left wall to the mass, in S."""
    depth: float = 0.0
    """Along z, in S; 0 in 2D."""
    walls_apart: float = 0.0
    """Along z, in S; as far as along x where 0."""
    box: float = 10.0
    """Length of the box, in S."""
    baffles: tuple[tuple[float, float, float, float], ...] = ()
    """x of the face, length, height and, in 3D, z of the near face of baffles [S]; as wide as long."""
    duration: float = 6.0
    """In sqrt(H / g)."""
    smallest: float = 0.1
    """S [m]."""
    density: float = 1800.0
    """[kg/m^3]."""
    stiffness: float = 150.0
    """Young's modulus in rho g H: the foot of a column gives by half a per cent."""

    def scene(self) -> Scene:
        """The scene in SI units, on a grid of `OWN_CELLS`."""
        unit = self.smallest
        length, height = (1.0, self.aspect) if self.aspect >= 1.0 else (1.0 / self.aspect, 1.0)
        weight = self.density * GRAVITY * height * unit
        time = math.sqrt(height * unit / GRAVITY)
        size: tuple[float, ...] = (length, height)
        box: tuple[float, ...] = (math.ceil(self.box), math.ceil(ROOM * height))
        if self.depth:
            size, box = (*size, self.depth), (*box, math.ceil(self.walls_apart or self.box))
        along = max(0.0, 0.5 * (box[2] - self.depth)) if self.walls_apart else 0.0
        lower = (self.gap, 0.0, along)[: len(size)]
        speed = (self.velocity * math.sqrt(GRAVITY * height * unit), 0.0, 0.0)[: len(size)]
        return Scene(
            domain=Domain(size=scaled(box, unit), cell=unit / OWN_CELLS),
            material=Material(
                friction_deg=self.friction_deg,
                density=self.density,
                young=self.stiffness * weight,
                poisson=0.3,
                cohesion=self.cohesion * weight,
                tension_cutoff=0.5 * self.cohesion * weight,
            ),
            masses=(
                Mass(lower=scaled(lower, unit), size=scaled(size, unit), velocity=speed if self.velocity else None),
            ),
            baffles=tuple(
                Baffle(lower=scaled((x, 0.0, z)[: len(size)], unit), size=scaled((long, high, long)[: len(size)], unit))
                for x, long, high, z in self.baffles
            ),
            duration=self.duration * time,
            frame_dt=self.duration * time / FRAMES,
            gravity=GRAVITY,
            floor_friction=self.floor,
            wall_friction=self.wall,
            baffle_friction=self.floor if self.baffles else 0.0,
            damping=self.damping,
            step_fraction=OWN_STEP,
        )


def scaled(lengths: tuple[float, ...], unit: float) -> tuple[float, ...]:
    """Lengths in S as lengths in metres."""
    return tuple(length * unit for length in lengths)


MEASURED = {
    2: {
        "low, 30°": Flow(aspect=0.5, friction_deg=30.0, box=9.0, duration=6.0),
        "low, cohesive, damped": Flow(
            aspect=0.5, friction_deg=42.0, cohesion=0.03, damping=0.12, box=9.0, duration=5.0
        ),
        "square, 20°": Flow(aspect=1.0, friction_deg=20.0, box=10.0),
        "square, 45°, rough": Flow(aspect=1.0, friction_deg=45.0, floor=0.8, box=6.0, duration=5.0),
        "square, 25°, damped": Flow(aspect=1.0, friction_deg=25.0, damping=0.05, box=8.0),
        "high, 30°": Flow(aspect=2.0, friction_deg=30.0, box=12.0),
        "high, cohesive": Flow(aspect=2.0, friction_deg=35.0, cohesion=0.02, box=10.0, duration=5.0),
        "high, 21°, damped": Flow(aspect=2.0, friction_deg=21.0, damping=0.12, box=12.0, duration=5.0),
        "tower, 35°": Flow(aspect=4.0, friction_deg=35.0, box=17.0, duration=4.5),
        "thrown, 28°": Flow(aspect=0.5, friction_deg=28.0, velocity=1.5, gap=1.0, box=14.0, duration=6.0),
    },
    3: {
        "low box, 30°": Flow(aspect=0.5, friction_deg=30.0, depth=1.0, walls_apart=1.0, box=8.0, duration=5.0),
        "cube, 25°": Flow(aspect=1.0, friction_deg=25.0, depth=1.0, box=7.0, duration=5.0),
        "high box, 35°, damped": Flow(aspect=2.0, friction_deg=35.0, damping=0.05, depth=1.0, box=7.0, duration=4.0),
        "thrown at a baffle": Flow(
            aspect=0.8,
            friction_deg=33.0,
            floor=0.43,
            wall=0.43,
            velocity=1.4,
            gap=0.5,
            depth=1.5,
            walls_apart=3.0,
            box=10.0,
            baffles=((3.0, 0.75, 1.0, 0.5), (3.0, 0.75, 1.0, 1.75)),
            duration=6.0,
        ),
    },
}
"""The scenes that `--tolerance` is measured on, by dimension."""

UNSEEN = {
    2: {
        "low, 25°": Flow(aspect=0.7, friction_deg=25.0, box=9.0),
        "low, 38°, rough": Flow(aspect=0.6, friction_deg=38.0, floor=0.7, box=7.0, duration=5.0),
        "low, 33°, ten times the size": Flow(aspect=0.5, friction_deg=33.0, smallest=1.0, density=1500.0, box=9.0),
        "square, 30°, damped": Flow(aspect=1.0, friction_deg=30.0, damping=0.08, box=7.0, duration=5.0),
        "square, 36°, cohesive": Flow(aspect=1.2, friction_deg=36.0, cohesion=0.04, box=7.0, duration=5.0),
        "1.5 times as high, 27°": Flow(aspect=1.5, friction_deg=27.0, box=11.0, duration=5.0),
        "1.5 times as high, 40°": Flow(aspect=1.5, friction_deg=40.0, floor=0.5, box=8.0, duration=5.0),
        "high, 24°, ten times the size": Flow(aspect=2.0, friction_deg=24.0, smallest=1.0, density=2200.0, box=14.0),
        "high, cohesive, damped": Flow(
            aspect=2.0, friction_deg=30.0, cohesion=0.01, damping=0.12, box=9.0, duration=5.0
        ),
        "tower, 28°": Flow(aspect=3.0, friction_deg=28.0, box=18.0, duration=4.5),
        "stiff, 32°": Flow(aspect=1.0, friction_deg=32.0, stiffness=600.0, box=7.0),
        "thrown, 35°": Flow(aspect=0.8, friction_deg=35.0, velocity=1.0, gap=0.5, box=11.0),
        "thrown against a baffle": Flow(
            aspect=1.0, friction_deg=30.0, velocity=1.2, gap=0.5, box=9.0, baffles=((3.0, 0.5, 0.5, 0.0),)
        ),
        "between rough walls": Flow(aspect=1.0, friction_deg=26.0, wall=0.4, gap=1.5, box=4.0, duration=5.0),
    },
    3: {
        "low box, 37°": Flow(aspect=0.7, friction_deg=37.0, depth=1.0, box=5.0, duration=5.0),
        "cube, 30°, ten times the size": Flow(
            aspect=1.0, friction_deg=30.0, smallest=1.0, density=1600.0, depth=1.0, box=6.0, duration=5.0
        ),
        "cube, cohesive, damped": Flow(
            aspect=1.0, friction_deg=32.0, cohesion=0.03, damping=0.1, depth=1.0, box=5.0, duration=4.0
        ),
        "high box, 28°": Flow(aspect=1.5, friction_deg=28.0, depth=1.0, box=8.0, duration=4.5),
        "between walls, 24°": Flow(aspect=1.0, friction_deg=24.0, wall=0.2, depth=1.0, walls_apart=1.0, box=8.0),
        "thrown at a baffle, 38°": Flow(
            aspect=1.0,
            friction_deg=38.0,
            floor=0.5,
            velocity=1.0,
            gap=0.5,
            depth=1.0,
            walls_apart=2.0,
            box=7.0,
            baffles=((2.5, 0.5, 0.8, 0.75),),
            duration=5.0,
        ),
    },
}
"""Others: other angles, shapes, sizes, densities, damping, cohesion, throws, walls and baffles."""


def shortened(flow: Flow, share: float) -> Flow:
    """The same flow, cut off at a share of its duration."""
    return dataclasses.replace(flow, duration=share * flow.duration)
