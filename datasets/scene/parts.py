"""The parts of a scene, and the scene that they form; the types hold the bounds of numbers."""

import math
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from datasets.errors import require
from datasets.scene.grid_field import Field
from datasets.scene.material import Material
from datasets.schema import FARTHEST, Bounds, Record

Vector = tuple[float, ...]
Rows = tuple[Vector, ...]
Triangles = tuple[tuple[int, int, int], ...]

TOLERANCE = 1.0e-9
"""Slack [m] in comparisons of lengths that a user wrote in decimals."""
DOMAIN_SIDES = ("x-", "x+", "y-", "y+", "z-", "z+")
"""The sides of the box; y- is the floor."""
RELAXATION = 0.5
"""Default relaxation time over sqrt(cell / gravity): fronts depend least on stiffness and step (docs/stability.md)."""
ROUGH = "rough"
"""Friction of a surface as rough as the grains: nothing slides on it, the material shears above it."""
INFLOW = "inflow"
"""Kind of a mass that enters over time."""
NO_SLIP = 1.0e9
"""Coulomb coefficient that represents no slip; without pressure it gives no friction."""
Time = Annotated[float, Bounds(f"a positive time in s, up to {FARTHEST:g}", gt=0.0)]
Length = Annotated[float, Bounds(f"a positive length in m, up to {FARTHEST:g}", gt=0.0)]
Coefficient = Annotated[float | str, Bounds(f"a coefficient of at least 0 or '{ROUGH}'", ge=0.0, words=(ROUGH,))]
Turbulence = Annotated[float | None, Bounds(f"a positive coefficient in m/s^2, up to {FARTHEST:g}", gt=0.0)]
Size = Annotated[Vector, Bounds(f"positive lengths in m, above {TOLERANCE:g}", gt=TOLERANCE)]
K0 = Annotated[float | str, Bounds("a ratio of stresses of at least 0 or 'elastic'", ge=0.0, words=("elastic",))]
Share = Annotated[float | None, Bounds("a ratio in [0, 1]", ge=0.0, le=1.0)]
Moment = Annotated[float | str, Bounds("a time in s or 'settled'", words=("settled",))]


def coefficient(friction: float | str, rough: float = NO_SLIP) -> float:
    """Coulomb coefficient [-] of a surface: the given number, or `rough` if it is as rough as the grains."""
    return rough if isinstance(friction, str) else friction


@dataclass(frozen=True, kw_only=True)
class Domain(Record):
    """The rigid box [0, size] and the background grid in it; y, the second axis, points up.

    All lengths of a `Scene` count from the box's lower corner. If the box has an `origin`, the scene's file and the
    results of its flow are in map coordinates (`datasets.scene.library`).
    """

    size: Vector
    """Extent in x, y and, in 3D, z [m]; a whole number of cells."""
    cell: Length
    """Edge of a grid cell [m]."""
    origin: Vector | None = None
    """Map coordinates of its lower corner [m]: easting, elevation, northing, in 2D x, elevation; default: none."""
    crs: str | None = None
    """Reference system of these, as an authority's code or in WKT."""

    def __post_init__(self) -> None:
        super().__post_init__()
        count, origin = len(self.size), self.origin
        require(count in (2, 3), "size", "2 or 3 lengths in m", list(self.size))
        placed = origin is None or (len(origin) == count and all(abs(length) <= FARTHEST for length in origin))
        require(placed, "origin", f"{count} lengths in m within {FARTHEST:g}", list(origin or ()))
        require(self.crs is None or self.origin is not None, "crs", "an origin beside it", "none")

    @property
    def dimension(self) -> int:
        """2 or 3."""
        return len(self.size)

    @property
    def corner(self) -> NDArray[np.float64]:
        """The origin [m], 0 without one, shape [D]: adding it to box coordinates gives map coordinates."""
        return np.zeros(len(self.size)) if self.origin is None else np.array(self.origin)


@dataclass(frozen=True, kw_only=True)
class Gate(Record):
    """A gate: the barriers of a mass rise from its release on, with the speed v (1 - exp(-t / tau)) after time t."""

    speed: Annotated[float, Bounds("a positive speed in m/s", gt=0.0)]
    """Final speed v [m/s]."""
    time_constant: Annotated[float, Bounds("a time of at least 0 s", ge=0.0)] = 0.0
    """Time constant tau [s]; 0: v from the start."""


@dataclass(frozen=True, kw_only=True)
class Mass(Record):
    """A body of material at the start; its kind determines the keys of its shape (`datasets.geometry.shapes`).

    For example:

        Mass(lower=(0.0, 0.0), size=(0.2, 0.4), velocity=(1.0, 0.0))
        Mass(kind="polygon", vertices=((0.0, 0.0), (0.3, 0.0), (0.0, 0.3)))
    """

    kind: str = "box"
    """`box`, `polygon` (2D), `mesh` (3D), `layer` (on the ground: terrain, else the floor) or `inflow`, which enters
    over time (`datasets.geometry.inflow`)."""
    lower: Vector = ()
    """Lower corner of the box [m]; for other kinds, of the box around the body, which a scene computes."""
    size: Size = ()
    """Extent of that box [m]."""
    vertices: Rows | None = None
    """Corners of a simple polygon in either orientation, or of the triangles of a mesh [m], shape [V, D]."""
    triangles: Triangles | None = None
    """The three vertices of each triangle of a mesh, counted from 0; closed, in either orientation."""
    thickness: float | Rows | None = None
    """Vertical thickness of a layer [m]: a number, or in 3D rows along x of columns along z."""
    origin: Vector | None = None
    """x and z of the first thickness in 3D [m]."""
    spacing: Size | None = None
    """Distance between thicknesses along x and z [m]."""
    outline: Rows | None = None
    """Outline of a layer in plan: corners x, z of a polygon, in 2D two x [m]; default: everywhere."""
    section: Rows | None = None
    """Section through which an inflow enters [m]: in 2D its foot, x; in 3D both ends of its foot, x and z, on the
    ground; or with the elevation y of the foot."""
    direction: Vector | None = None
    """Direction of the inflow's velocity, at right angles to the section; default: downslope along the ground."""
    hydrograph: Rows | None = None
    """Times [s], discharges [m^3/s, in 2D m^2/s] and speeds [m/s] of an inflow, linear in between, shape [R, 3]."""
    discharge_factor: Annotated[float | None, Bounds("a positive factor", gt=0.0)] = None
    """Factor of all discharges [-]; default: 1."""
    velocity: Vector | None = None
    """Initial velocity [m/s]; default: at rest."""
    angular_velocity: float | Vector | None = None
    """Initial angular velocity about the centre of the box [rad/s]: a number about z, positive from x to y, or in 3D a
    vector; the velocity at x is then velocity + angular_velocity x (x - centre)."""
    material: Material | None = None
    """Material of this mass; default: the scene's."""
    k0: K0 | None = None
    """Initial stress: K0 [-], horizontal over vertical stress under its weight; or "elastic". Default: no stress, or
    for a flat mass on inclined ground the stress of an infinite slope (`mpm.initial.slope`)."""
    release: Moment | None = None
    """Time [s] until which smooth vertical barriers hold its sides, or "settled"; default: free from the start."""
    gate: Gate | None = None
    """How these barriers then rise; default: they vanish at once."""
    initial_pore_pressure_ratio: Share = None
    """Initial pore pressure of a saturated mass over the total stress normal to its ground [-]; default: hydrostatic
    below the water table."""

    @property
    def spin(self) -> NDArray[np.float64]:
        """Initial velocity gradient W [1/s], shape [D, D]: W r = omega x r."""
        given = self.angular_velocity or 0.0
        x, y, z = (0.0, 0.0, given) if isinstance(given, float | int) else given
        return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])[: len(self.size), : len(self.size)]


@dataclass(frozen=True, kw_only=True)
class Baffle(Record):
    """A fixed rigid box in the way of the flow."""

    lower: Vector
    """Lower corner [m]."""
    size: Size
    """Extent [m]."""
    turned_deg: float = 0.0
    """Rotation about its centre [deg]: in 2D from x to y, in 3D about the vertical, from x to z."""
    friction: Coefficient | None = None
    """Coulomb coefficient of its faces [-], or "rough"; default: the scene's `baffle_friction`."""
    turbulence: Turbulence = None
    """Voellmy's turbulent coefficient xi of its faces [m/s^2] (`mpm.physics.contact`); default: no such term."""


@dataclass(frozen=True, kw_only=True)
class Channel(Record):
    """Two vertical walls along x that bound the flow of a 2D scene; their friction acts on its whole depth. Per volume
    of the material it is -2 tan(friction) (-sigma_zz) v / (width |v|), with the stress across the plane."""

    width: Length
    """Distance between the walls [m]."""
    friction_deg: Annotated[float, Bounds("an angle in [0, 90) degrees", ge=0.0, lt=90.0)]
    """Friction angle of the walls [deg], in [0, 90); its tangent is the Coulomb coefficient."""

    @property
    def grip(self) -> float:
        """Friction per volume over the pressure on the walls [1/m]."""
        return 2.0 * math.tan(math.radians(self.friction_deg)) / self.width


@dataclass(frozen=True, kw_only=True)
class Water(Record):
    """The initial groundwater of a scene with saturated material (`mpm.initial.water`)."""

    level: Annotated[float | None, Bounds("an elevation in m", ge=-FARTHEST)] = None
    """Elevation of a level water table [m]; default without a `table`: the `pool`, else the top of the masses."""
    table: Rows | None = None
    """A water table that varies [m]: in 2D points x, y from small to large x, in 3D rows along x of columns along z."""
    origin: Vector | None = None
    """x and z of the first elevation of a table in 3D [m]."""
    spacing: Size | None = None
    """Distance between its elevations along x and z [m]."""
    pool: Annotated[float | None, Bounds("an elevation in m", ge=-FARTHEST)] = None
    """Elevation of standing water [m], which presses on the ground below it; only for a slope at rest (`fixed`)."""
    drained: bool = False
    """Whether the floor and the solids let water out; default: impermeable."""
    fixed: bool = False
    """Whether each particle keeps its initial pore pressure: for a slope at rest, as in a factor of safety."""


@dataclass(frozen=True, kw_only=True)
class Solid(Record):
    """A fixed rigid body; its kind determines the keys of its shape (`datasets.geometry.shapes`).

    For example:

        Solid(kind="polygon", vertices=((0.5, 0.0), (0.9, 0.0), (0.7, 0.2)), friction=0.4)
        Solid(kind="terrain", points=((0.0, 0.5), (1.0, 0.0), (2.0, 0.0)))  # solid below this line
    """

    name: str | None = None
    """Name in results; default: `solids[I]`."""
    kind: str = "box"
    """`box`, `polygon` (2D), `terrain` (solid below a line or a surface) or `mesh` (3D)."""
    lower: Vector | None = None
    """Lower corner of a box before it is turned [m]."""
    size: Size | None = None
    """Extent of a box [m]."""
    turned_deg: float = 0.0
    """Rotation of a box about its centre [deg]: in 2D from x to y, in 3D about the vertical, from x to z."""
    vertices: Rows | None = None
    """Corners of a simple polygon in either orientation, or of the triangles of a mesh [m], shape [V, D]."""
    triangles: Triangles | None = None
    """The three vertices of each triangle of a mesh, counted from 0; closed, in either orientation."""
    points: Rows | None = None
    """Ground line of a terrain in 2D from small to large x [m], shape [P, 2]."""
    origin: Vector | None = None
    """x and z of the first height of a terrain in 3D [m]."""
    spacing: Size | None = None
    """Distance between its heights along x and z [m]."""
    heights: Rows | None = None
    """Elevation y of a terrain in 3D [m], linear on triangles: rows along x of columns along z, shape [X, Z]."""
    corner: Vector | None = None
    """Easting and northing of x = 0, z = 0 in the coordinates of the raster that a terrain in 3D came from [m]."""
    crs: str | None = None
    """Reference system of these coordinates, as an authority's code or in WKT, if the raster names one."""
    friction: Annotated[float | Vector | Rows, Bounds("coefficients of at least 0", ge=0.0)] = 0.0
    """Coulomb coefficient [-]: a number, or one per vertex, point or height, linear between them."""
    contact: Annotated[str, Bounds("'coulomb' or 'no-slip'", words=("coulomb", "no-slip"))] = "coulomb"
    """`coulomb` or `no-slip`."""
    turbulence: Annotated[float | Rows | None, Bounds("positive coefficients in m/s^2", gt=0.0)] = None
    """Voellmy's turbulent coefficient xi [m/s^2] (`mpm.physics.contact`): a number, or one per height
    of a terrain in 3D, 1 / xi linear along x and z between them; default: no such term."""

    def __hash__(self) -> int:
        """A hash that uses only the first row of a raster: hashing millions of heights takes longer than it saves."""
        tables = self.heights, self.friction, self.triangles
        rows = [table[:1] if isinstance(table, tuple) else table for table in tables]
        shape = self.kind, self.lower, self.size, self.turned_deg, self.vertices, self.points
        return hash((*shape, self.origin, self.spacing, *rows))


@dataclass(frozen=True, kw_only=True)
class Stage(Record):
    """A change of the material of some particles at a time: for example, a slope stands first and then loses strength.

    For example:

        Stage(time="settled", cohesion=0.0)
        Stage(time=2.0, mass=1, outline=((4.0,), (6.0,)), friction_deg=18.0)  # 2D: from x = 4 to 6 m
    """

    time: Moment
    """Start of the stage [s], or "settled": once nothing moves any more after the stage before."""
    mass: int | None = None
    """Index of the mass whose particles change; default: all masses."""
    lower: Vector | None = None
    """Lower corner of a box [m]: only particles that started in it change."""
    size: Vector | None = None
    """Extent of this box [m]."""
    outline: Rows | None = None
    """The same region in plan: corners x, z of a polygon, in 2D two x [m]."""
    friction_deg: float | None = None
    """The material's new value; unchanged by default, as are the following constants."""
    dilation_deg: float | None = None
    cohesion: float | None = None
    strength_gradient: float | None = None
    tension_cutoff: float | None = None

    @property
    def values(self) -> dict[str, Any]:
        """The constants that the stage changes."""
        names = ("friction_deg", "dilation_deg", "cohesion", "strength_gradient", "tension_cutoff")
        return {name: value for name in names if (value := getattr(self, name)) is not None}


@dataclass(frozen=True, kw_only=True)
class SceneLayout(Record):
    """The parts of a scene, each number within its bounds; a `Scene` is a layout whose parts fit together."""

    domain: Domain
    material: Material
    """The material of every mass without its own."""
    masses: tuple[Mass, ...]
    fields: tuple[Field, ...] = ()
    """Fields that vary over the particles at the start: friction, velocities (`datasets.scene.grid_field`)."""
    stages: tuple[Stage, ...] = ()
    """Changes of the material, in order of time."""
    baffles: tuple[Baffle, ...] = ()
    solids: tuple[Solid, ...] = ()
    """Other fixed rigid bodies: boxes, polygons, terrain, meshes."""
    channel: Channel | None = None
    """Side walls of a 2D scene; default: none."""
    water: Water | None = None
    """Groundwater in saturated material; default: up to the top of each mass."""
    open_sides: tuple[str, ...] = ()
    """Sides of the box that let material out: any of "x-", "x+", "y-", "y+", "z-" and "z+"."""
    duration: Time = 1.0
    """Simulated time [s], a whole number of frames."""
    frame_dt: Time = 0.0025
    """Time between two frames [s]."""
    gravity: Annotated[float, Bounds("an acceleration of at least 0 m/s^2", ge=0.0)] = 9.81
    """Gravitational acceleration [m/s^2]."""
    slope_deg: Annotated[float, Bounds("an angle in (-90, 90) degrees", gt=-90.0, lt=90.0)] = 0.0
    """Inclination of the floor [deg], in (-90, 90): downhill is +x; the box is drawn level, gravity tilts instead."""
    floor_friction: Coefficient = 0.0
    """Coulomb coefficient of the floor y = 0 [-], or "rough": as rough as the grains, which do not slide on it."""
    wall_friction: Coefficient = 0.0
    """Coulomb coefficient of every other wall of the box [-], or "rough"."""
    baffle_friction: Coefficient = 0.0
    """Coulomb coefficient of the faces of every baffle without its own [-], or "rough"."""
    damping: Annotated[float, Bounds("a fraction in [0, 1)", ge=0.0, lt=1.0)] = 0.0
    """Local (Cundall) damping [-], in [0, 1): the part of a node's force that always opposes its motion; 0 is off."""
    relaxation_time: Annotated[float | None, Bounds("a time of at least 0 s", ge=0.0)] = None
    """Time [s] in which the part of a particle's velocity that the grid cannot represent decays.

    Default: half of sqrt(cell / gravity), so that flows of any size decay alike; 0 removes it in every step (APIC).
    """
    volume_correction: bool | None = None
    """Whether material that has come apart closes its gaps before it carries stress again.

    Default: wherever material may fall or splash: beside solids, where a mass has a velocity, and where a body is a
    cell or more above whatever is beneath it.
    """
    step_fraction: Annotated[float, Bounds("a fraction in (0, 1]", gt=0.0, le=1.0)] = 0.4
    """Time step as a fraction of cell / (pressure-wave speed), in (0, 1]."""
    particles_per_axis: Annotated[int, Bounds("an integer from 1 to 1000", ge=1, le=1000)] = 2
    """Particles per cell along one axis: 2 gives 4 particles per cell in 2D, 8 in 3D."""
    jitter: Annotated[float, Bounds("a fraction in [0, 1]", ge=0.0, le=1.0)] = 0.8
    """Random displacement of a particle at the start, as a fraction of its share of the cell, in [0, 1]."""
    seed: Annotated[int, Bounds("an integer of at least 0", ge=0, le=math.inf)] = 0
    """Seed of that displacement."""

    @property
    def dimension(self) -> int:
        """2 or 3."""
        return len(self.domain.size)

    @property
    def relaxation(self) -> float:
        """The relaxation time [s]: as given, or proportional to the fall time through a cell; inf without gravity."""
        if self.relaxation_time is not None:
            return self.relaxation_time
        return RELAXATION * math.sqrt(self.domain.cell / self.gravity) if self.gravity > 0.0 else math.inf

    @property
    def frames(self) -> int:
        """Number of frames, the initial state included."""
        return round(self.duration / self.frame_dt) + 1

    @property
    def particle_spacing(self) -> float:
        """Nominal distance between neighbouring particles at the start [m]."""
        return self.domain.cell / self.particles_per_axis

    @property
    def particle_volume(self) -> float:
        """Nominal volume of a particle [m^D] in a lattice that fits; of each mass: `datasets.scene.particles`."""
        return self.particle_spacing**self.dimension

    @property
    def gravity_vector(self) -> Vector:
        """Gravitational acceleration in the axes of the box [m/s^2]."""
        slope = math.radians(self.slope_deg)
        along, down = self.gravity * math.sin(slope), -self.gravity * math.cos(slope)
        return (along, down) if self.dimension == 2 else (along, down, 0.0)

    def material_of(self, mass: Mass) -> Material:
        """The material that `mass` is made of."""
        return mass.material or self.material

    def friction_of(self, baffle: Baffle) -> float | str:
        """Friction of the faces of `baffle`: its own, else the scene's `baffle_friction`."""
        return self.baffle_friction if baffle.friction is None else baffle.friction


def keyed(scene: SceneLayout, *groups: str) -> dict[str, Any]:
    """The members of groups such as `masses` by their keys in the scene, such as `masses[0]`."""
    return {f"{group}[{index}]": member for group in groups for index, member in enumerate(getattr(scene, group))}
