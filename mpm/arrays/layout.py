"""Where the kernels find things: what a batch needs compiled, and the columns of the arrays that describe it.

Particles live in blocks of `lanes` particles, one vector register wide. A block holds one such vector per number of a
particle (its first coordinate, its second, ...), so a block is brought forward by vector instructions; the transfers to
and from the grid reach single lanes of the same memory through a second, scalar view of it.
"""

from dataclasses import dataclass
from enum import IntEnum, auto
from typing import ClassVar, Literal

Precision = Literal["f32", "f64"]

INDEX_LIMIT = 2**30
"""Numbers that an array of the particles may hold (`mpm.arrays.lanes.bounded`)."""
PADDING = 3
"""Cells of grid beyond every wall: a quadratic B-spline reaches one and a half."""
ALIGNMENT = 64
"""Bytes: vector loads of a whole register fail on less."""


class Column(IntEnum):
    """Counts from zero."""

    @staticmethod
    def _generate_next_value_(name: str, start: int, count: int, last_values: list[int]) -> int:
        return count


class Setting(Column):
    """Columns of `settings`, real, shape [scenes, len(Setting)]."""

    CELL = auto()  # [m]
    FRAME_DT = auto()  # [s]
    GRAVITY_X = auto()  # [m/s^2]
    GRAVITY_Y = auto()  # [m/s^2]
    FLOOR_FRICTION = auto()  # [-]
    WALL_FRICTION = auto()  # [-]
    CONTACT_WIDTH = auto()  # over which contact with a solid is spread [m]
    SEARCH = auto()  # distance from solids up to which it has to be known [m]
    REACH = auto()  # distance from solids beyond which cells have no faces [m]
    DAMPING = auto()  # [-]
    CORRECTED = auto()  # 1 where gaps are remembered, else 0
    GAP_RATE = auto()  # at which a gap follows the grid's density [1/s]
    WAVE_SPEED = auto()  # the fastest of the scene's materials [m/s]
    RELAXATION_RATE = auto()  # of the velocity that the grid cannot represent [1/s]
    WEIGHT = auto()  # of all particles [N, per metre of width in 2D]
    REST_ENERGY = auto()  # kinetic energy that counts as none [J, per metre of width in 2D]


class Property(Column):
    """Columns of `properties`, real, shape [scenes, len(Property)]; of each particle where scenes are heterogeneous."""

    VOLUME = auto()  # initial [m^D]
    DENSITY = auto()  # [kg/m^3]
    LAME = auto()  # [Pa]
    SHEAR = auto()  # [Pa]
    SIN_PHI = auto()  # [-]
    SIN_PSI = auto()  # [-]
    STRENGTH = auto()  # 2 c cos(phi) [Pa]
    LIMIT = auto()  # largest tensile stress [Pa]
    ELASTIC_DEVIATOR = auto()  # (1 + nu) / (2 E) [1/Pa]
    ELASTIC_TRACE = auto()  # nu / (2 E) [1/Pa]
    RESIDUAL_SIN_PHI = auto()  # [-]; from here on only where the material softens
    RESIDUAL_STRENGTH = auto()  # 2 c cos(phi) of the residual values [Pa]
    RESIDUAL_LIMIT = auto()  # [Pa]
    SOFTENING = auto()  # sqrt(3) / softening length [1/m], 0 where it does not soften


class Offset(Column):
    """Columns of `offsets`, integers, shape [scenes, len(Offset)]: where a scene lies in the flat arrays; counters."""

    BLOCK = auto()  # its first block of particles
    PARTICLES = auto()  # how many
    CELLS_X = auto()
    CELLS_Y = auto()
    CELLS_Z = auto()
    RECORD = auto()  # the first of its particles in `record`
    EVERY = auto()  # frames from one that is recorded to the next; 0 where the last is recorded alone
    LAST_FRAME = auto()  # the number of its last frame
    LAST_SLOT = auto()  # where that is recorded: how many recorded frames lie before it
    WINDOW = auto()  # frames over which a deposit must have been at rest
    ENERGY = auto()  # its first line in `energy`
    GEOMETRY = auto()  # its first entry in `cell_faces` and `held_nodes`
    OBSTACLES = auto()  # how many solids stand in the box: the baffles, then the others
    OPEN = auto()  # bit k: side k of the box, x-, x+, y-, ..., is open
    SOLIDS = auto()  # whose impulses are recorded: those and, where asked for, the box's 2 D sides and the gates
    IMPULSE = auto()  # its first line in `recorded_impulse`
    FRAMES = auto()  # how many, the initial one included
    SUBSTEPS = auto()  # per frame, by the scene's fraction of the stable step
    STEPS = auto()  # recorded_impulse so far
    REST = auto()  # the frame in which it was found at rest, 0 while it moves
    GATE = auto()  # its first line in `gates`
    GATES = auto()  # how many
    HELD = auto()  # its first line in `held` and `holding`
    HELDS = auto()  # how many


class Contact(Column):
    """Vectors of a block that describe the contact of its particles with solids (`mpm.physics.contact`)."""

    DELTA = auto()  # delta_h of the distance [1/m]
    DISTANCE = auto()  # from the nearest face [m]; beyond the search a lower bound of it
    ADHESION = auto()  # of that face [Pa]
    FRICTION = auto()  # its Coulomb coefficient at the foot [-]
    FACE = auto()  # the line of that face in `faces`
    IMPULSE = auto()  # one component of what a particle gives to its solid; before that its mass
    NORMAL = auto()  # D vectors: n, out of the solid [-]; behind them D of the shear traction [Pa]


class Worker(Column):
    """Columns of `workers`, integers, shape [workers, len(Worker)]: the part of a scene that one thread computes."""

    SCENE = auto()
    FIRST = auto()  # its blocks: [first, last)
    LAST = auto()
    NODE = auto()  # the first node of its grid
    SCRATCH = auto()  # its first vector of `scratch`
    IMPULSE = auto()  # its first vector of `impulse`
    LOW_X = auto()  # the nodes that its material reaches: [low, high)
    LOW_Y = auto()
    LOW_Z = auto()
    HIGH_X = auto()
    HIGH_Y = auto()
    HIGH_Z = auto()


class StepControl(Column):
    """Columns of `step_control`, real, shape [scenes, len(StepControl)]: the steps, where each is a launch."""

    DT = auto()  # of the next step [s]; 0 where the scene waits for others
    SPEED = auto()  # of its fastest particle [m/s]
    STEPS = auto()  # of its next frame; 0 where it has ended


class Energy(Column):
    """Columns of `energy`, real, shape [all frames, len(Energy)]: energies [J, per metre of width in 2D], a force."""

    KINETIC = auto()
    POTENTIAL = auto()
    ELASTIC = auto()
    UNBALANCED = auto()  # mean over a frame of sum m |a| over the weight [-], where `rests`; else 0


def component(i: int, j: int, dimension: int) -> int:
    """Where sigma_ij stands among the components xx, yy, zz, xy, yz, zx; no yz, zx in 2D."""
    return i if i == j else {(0, 1): 3, (1, 2): 4, (0, 2): 5}[min(i, j), max(i, j)]


@dataclass(frozen=True, kw_only=True)
class Features:
    """What the scenes of a batch need; the kernels are compiled for exactly this, and nothing else is in them."""

    dimension: int
    precision: Precision
    relaxed: bool = True
    """Velocity that the grid cannot represent decays in a relaxation time (AFLIP); else it is lost each step (APIC)."""
    damped: bool = False
    cohesive: bool = False
    """Strength without pressure: cohesion, and with it a tension cutoff."""
    dilates: bool = False
    softens: bool = False
    """Strength and dilation fall with plastic strain, which is then part of the state."""
    corrected: bool = False
    """A particle remembers the gap to its neighbours: volume correction."""
    heterogeneous: bool = False
    """A scene has several materials, or particles of several volumes."""
    contact: bool = False
    """Solids stand in the box: baffles, ground, obstacles."""
    open: bool = False
    """A side of the box lets particles out."""
    velocity_recorded: bool = False
    stress_recorded: bool = False
    pressure_recorded: bool = False
    """Recorded by itself, where the stress is not."""
    strain_recorded: bool = False
    """Plastic strain is summed up and recorded."""
    walls_recorded: bool = False
    """The momentum that floor and walls take is recorded."""
    shared: bool = False
    """One scene, on several threads."""
    gpu: bool = False
    """A thread per particle and atomic sums, for many threads; else a thread per scene or per part of it."""
    gated: bool = False
    """Masses stand behind gates until their release."""
    rests: bool = False
    """A scene ends when its deposit has come to rest."""

    _data_oriented: ClassVar[bool] = True
    """Tells Taichi that a kernel may hold it as a Python object of compile time."""

    @property
    def lanes(self) -> int:
        """Particles in a block: what a register of 64 bytes holds; one on a GPU."""
        if self.gpu:
            return 1
        return 16 if self.precision == "f32" else 8

    # The vectors of a block: position from 0, velocity, C row by row, stress, and what only some scenes need.

    @property
    def velocity(self) -> int:
        """First vector of a block that holds velocity."""
        return self.dimension

    @property
    def affine(self) -> int:
        """First of the D x D vectors of APIC's C, row by row."""
        return 2 * self.dimension

    @property
    def stress(self) -> int:
        """First vector of the stress: xx, yy, zz, xy and, in 3D, yz, zx."""
        return self.affine + self.dimension**2

    @property
    def stresses(self) -> int:
        """Components of the stress; 2D is plane strain."""
        return 4 if self.dimension == 2 else 6

    @property
    def plastic_strain(self) -> int:
        """Vector of the plastic strain, where `strained`."""
        return self.stress + self.stresses

    @property
    def strained(self) -> bool:
        """Plastic strain is accumulated."""
        return self.strain_recorded or self.softens

    @property
    def gap(self) -> int:
        """Vector of the mean stress that what opened would have made [Pa], where `corrected`."""
        return self.plastic_strain + int(self.strained)

    @property
    def properties(self) -> int:
        """First vector of the material properties, where `heterogeneous`."""
        return self.gap + int(self.corrected)

    @property
    def remainder(self) -> int:
        """First of the D vectors of what rounding has kept from the position [m], where `compensated`."""
        return self.properties + (self.columns if self.heterogeneous else 0)

    @property
    def before(self) -> int:
        """First of the D vectors of the velocity at the end of the frame before, where `rests`."""
        return self.remainder + (self.dimension if self.compensated else 0)

    @property
    def contacts(self) -> int:
        """First of the vectors that `Contact` lists, where `contact`."""
        return self.before + (self.dimension if self.rests else 0)

    @property
    def present(self) -> int:
        """Vector of ones, and of zeros in the lanes that only mirror a scene's last particle."""
        return self.contacts + (len(Contact) + 2 * self.dimension - 1 if self.contact else 0)

    @property
    def columns(self) -> int:
        """How many of the columns of `Property` a particle of its own material carries."""
        return len(Property) if self.softens else int(Property.RESIDUAL_SIN_PHI)

    @property
    def block(self) -> int:
        """Vectors in a block."""
        return self.present + 1

    @property
    def compensated(self) -> bool:
        """Positions are summed with compensation (Kahan 1965): in f32 slow particles far from the origin would rest."""
        return self.precision == "f32"

    @property
    def impulses(self) -> bool:
        """The momentum that solids take is recorded."""
        return self.contact or self.walls_recorded

    # What is recorded of a particle besides its position: velocity, stress or pressure, plastic strain.

    @property
    def recorded_stress(self) -> int:
        """Which of a particle's recorded numbers is the first of its stress, or its pressure."""
        return self.dimension if self.velocity_recorded else 0

    @property
    def recorded_strain(self) -> int:
        """Which of a particle's recorded numbers is its plastic strain."""
        return self.recorded_stress + (self.stresses if self.stress_recorded else int(self.pressure_recorded))

    @property
    def recorded(self) -> int:
        """Numbers that are recorded of a particle besides its position."""
        return self.recorded_strain + int(self.strain_recorded)

    # A face, a line of `faces`: its corners, its normal and those of its corners and, in 3D, edges; friction at each
    # corner, adhesion, number of its solid.

    @property
    def face_normal(self) -> int:
        """Column of a face's normal; those of its D corners and, in 3D, of its 3 edges follow."""
        return self.dimension**2

    @property
    def face_friction(self) -> int:
        """Column of the friction at a face's first corner [-]."""
        return self.face_normal + self.dimension * (1 + self.dimension + (3 if self.dimension == 3 else 0))

    @property
    def face_adhesion(self) -> int:
        """Column of a face's adhesion [Pa]."""
        return self.face_friction + self.dimension

    @property
    def face_solid(self) -> int:
        """Column of the number of a face's solid."""
        return self.face_adhesion + 1

    # A node: momentum, mass and, where forces stay apart, force.

    @property
    def forces(self) -> bool:
        """Nodes hold forces apart from momentum: local damping and AFLIP both need them."""
        return self.damped or self.relaxed

    @property
    def node(self) -> int:
        """Numbers in a node: a short vector, a power of two long."""
        return 8 if self.forces else 4

    @property
    def used(self) -> int:
        """Numbers of a node that mean something; the others stay zero."""
        return self.dimension + 1 + (self.dimension if self.forces else 0)

    @property
    def force(self) -> int:
        """First number of a node that holds force, where `forces`."""
        return self.dimension + 1

    @property
    def change(self) -> int:
        """First number of a node that holds its change of velocity, where `relaxed`; mass and force are done with."""
        return self.force

    # The scratch vectors of a worker: weights of the three nodes along each axis, these times their distances, what a
    # block gives to its nodes, its lowest nodes.

    @property
    def values(self) -> int:
        """First of the scratch vectors of what a block gives: a node's value at the lowest one, and D slopes of it."""
        return 6 * self.dimension

    @property
    def lowest(self) -> int:
        """First of the D scratch vectors that hold each particle's lowest node."""
        return self.values + self.node * (1 + self.dimension)

    @property
    def scratch(self) -> int:
        """Scratch vectors of a worker; after the lowest nodes, velocity of the grid and its change at each particle."""
        return self.push + (2 * self.dimension if self.contact else 0)

    @property
    def push(self) -> int:
        """First of the 2 D scratch vectors of the contact's force per volume and its arm, where `contact`."""
        return self.origin + (self.dimension if self.contact else 0)

    @property
    def origin(self) -> int:
        """First of the D scratch vectors of the positions before a step, where `contact`."""
        return self.density + (1 + self.dimension if self.corrected else 0)

    @property
    def density(self) -> int:
        """First of the 1 + D scratch vectors of the grid's mass at each particle and its slopes, where `corrected`."""
        return self.lowest + self.dimension * (3 if self.relaxed else 1)
