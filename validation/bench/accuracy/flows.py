"""Scenes of every kind, from dimensionless numbers (`flows.toml`), on which `--tolerance` is measured or tried.

Lengths are in S, the smallest side of the mass; a mass of length (in x) and height (in y) stands at the left wall
or `gap` S away from it. Times are in sqrt(H / g), speeds in sqrt(g H), with H the height; stiffness and cohesion in
rho g H. The box is a whole number of S along each axis, so that cells of S / n fit it for every whole n.
"""

import math
from dataclasses import dataclass
from pathlib import Path

from datasets.files import read_toml
from datasets.scene import Baffle, Domain, Mass, Scene
from datasets.scene.material import Material
from datasets.schema import Record, from_mapping

GRAVITY = 9.81
FRAMES = 20  # frames of a run, of which only the last is used
OWN_CELLS = 20  # cells across S of a scene; a resolution replaces them
OWN_STEP = 0.9
ROOM = 1.2  # least height of the box over that of the mass


@dataclass(frozen=True, kw_only=True)
class MeasuredFlow(Record):
    """A mass that is released or thrown, in dimensionless numbers."""

    name: str = ""
    unseen: bool = False  # whether `--tolerance` is tried on it, not measured
    aspect: float  # height over length
    friction_deg: float
    floor: float = 0.385  # Coulomb coefficient of the floor, and of the baffles
    wall: float = 0.0  # Coulomb coefficient of all other walls; a smooth left wall is a plane of symmetry
    cohesion: float = 0.0  # in rho g H; half of it is the tension cutoff
    damping: float = 0.0
    velocity: float = 0.0  # along x, in sqrt(g H)
    gap: float = 0.0  # from the left wall to the mass, in S
    depth: float = 0.0  # along z, in S; 0 in 2D
    walls_apart: float = 0.0  # along z, in S; 0: as far as along x
    box: float = 10.0  # length of the box, in S
    baffles: tuple[tuple[float, float, float, float], ...] = ()
    """x of the face, length, height and, in 3D, z of the near face of baffles [S]; as wide as long."""
    duration: float = 6.0  # in sqrt(H / g)
    smallest: float = 0.1  # S [m]
    density: float = 1800.0  # [kg/m^3]
    stiffness: float = 150.0  # Young's modulus in rho g H: the foot of a column gives by half a per cent

    @property
    def dimension(self) -> int:
        return 3 if self.depth else 2

    def scene(self) -> Scene:
        """The scene in SI units, on a grid of `OWN_CELLS`."""
        unit = self.smallest
        length, height = (1.0, self.aspect) if self.aspect >= 1.0 else (1.0 / self.aspect, 1.0)
        weight = self.density * GRAVITY * height * unit
        time = math.sqrt(height * unit / GRAVITY)
        box = [math.ceil(extent) for extent in (self.box, ROOM * height, self.walls_apart or self.box)]
        along = max(0.0, 0.5 * (box[2] - self.depth)) if self.walls_apart else 0.0
        speed = (self.velocity * math.sqrt(GRAVITY * height * unit), 0.0, 0.0)[: self.dimension]

        def metres(*lengths: float) -> tuple[float, ...]:
            return tuple(extent * unit for extent in lengths[: self.dimension])

        lower, size = metres(self.gap, 0.0, along), metres(length, height, self.depth)
        mass = Mass(lower=lower, size=size, velocity=speed if self.velocity else None)
        return Scene(
            domain=Domain(size=metres(*box), cell=unit / OWN_CELLS),
            material=Material(
                friction_deg=self.friction_deg,
                density=self.density,
                young=self.stiffness * weight,
                poisson=0.3,
                cohesion=self.cohesion * weight,
                tension_cutoff=0.5 * self.cohesion * weight,
            ),
            masses=(mass,),
            baffles=tuple(Baffle(lower=metres(x, 0.0, z), size=metres(w, h, w)) for x, w, h, z in self.baffles),
            duration=self.duration * time,
            frame_dt=self.duration * time / FRAMES,
            gravity=GRAVITY,
            floor_friction=self.floor,
            wall_friction=self.wall,
            baffle_friction=self.floor if self.baffles else 0.0,
            damping=self.damping,
            step_fraction=OWN_STEP,
        )


def read_flows(dimension: int, *, unseen: bool) -> dict[str, Scene]:
    """Name -> scene of a dimension, of those on which `--tolerance` is measured or, if `unseen`, tried."""
    flows = [from_mapping(MeasuredFlow, table) for table in read_toml(Path(__file__).with_suffix(".toml"))["flows"]]
    return {flow.name: flow.scene() for flow in flows if (flow.dimension, flow.unseen) == (dimension, unseen)}
