"""The memory layout for the kernels: the columns of the arrays that describe a batch.

Particles are stored in blocks of `lanes` particles, two vector registers wide. A block holds one such vector per number
of a particle (its first coordinate, its second, ...), so that vector instructions update it. The transfers to and from
the grid address single lanes of the same memory through a second, scalar view.
"""

import math
from enum import IntEnum, auto
from typing import Literal

from datasets.scene import Domain

Precision = Literal["f32", "f64"]

INDEX_LIMIT = 2**30  # numbers that an array of the particles may hold (`mpm.arrays.access.no_overflow`)
PADDING = 3  # cells of grid beyond every wall: the support of a quadratic B-spline is one and a half to either side
NODES_PER_PARTICLE, FEWEST_NODES = 2, 1024  # initially, of a worker; flows of two cells and more need fewer
CACHE_LINE = 64  # bytes
ALIGNMENT = 128  # bytes: loads of a whole vector of lanes fail on less
GROWTH = 1.5  # new number of nodes of a worker that has too few, over those it needs


class Setting(IntEnum):
    """Columns of `settings`, real, shape [scenes, len(Setting)]."""

    CELL = 0  # [m]
    FRAME_DT = auto()  # [s]
    GRAVITY_X, GRAVITY_Y = auto(), auto()  # [m/s^2]
    FLOOR_FRICTION, WALL_FRICTION = auto(), auto()  # [-]
    CONTACT_WIDTH = auto()  # width over which contact with a solid is spread [m]
    SEARCH_DISTANCE = auto()  # up to which the distance from solids must be known [m]
    DAMPING = auto()  # [-]
    GRIP = auto()  # friction of the side walls per volume over the pressure on them, 2 mu / W [1/m]
    CORRECTED = auto()  # 1 where gaps are remembered, else 0
    GAP_RATE = auto()  # rate at which a gap follows the grid's density [1/s]
    LEAST_TENSION = auto()  # T_0, up to which open material counts as loose [Pa]
    SLOW_AFFINE = auto()  # C_s^2 of particles without stress (`mpm.physics.transfer`) [1/s^2]
    WAVE_SPEED = auto()  # the fastest of the scene's materials [m/s]
    RELAXATION_RATE = auto()  # of the velocity that the grid cannot represent [1/s]
    MASS, WEIGHT = auto(), auto()  # of all particles [kg and N, per metre of width in 2D]
    REST_ENERGY = auto()  # kinetic energy that counts as none [J, per metre of width in 2D]
    WATER_MODULUS = auto()  # Q (`mpm.physics.water`) [Pa]
    WATER_DIFFUSION = auto()  # Q kappa [m^2/s]
    WATER_WAVE = auto()  # Q over the density of the mixture [m^2/s^2]
    SEEPAGE = auto()  # c_v times the duration over a cell squared [-], at most 1
    DRAINED = auto()  # 1 where floor and solids let water out, else 0


class Property(IntEnum):
    """First columns of `properties`, real, shape [scenes, columns]; of each particle where scenes are heterogeneous.

    The columns of the material's law follow (`mpm.laws`)."""

    VOLUME = 0  # initial [m^D]
    DENSITY = auto()  # [kg/m^3]
    LAME = auto()  # [Pa]
    SHEAR = auto()  # [Pa]
    ELASTIC_DEVIATOR = auto()  # (1 + nu) / (2 E) [1/Pa]
    ELASTIC_TRACE = auto()  # nu / (2 E) [1/Pa]


FRAMES_PER_CALL = 20  # most frames in a call of the kernel; after a call the progress bar moves and a run can stop


class Offset(IntEnum):
    """Columns of `offsets`, integers, shape [scenes, len(Offset)]: where a scene lies in the flat arrays; counters."""

    BLOCK, PARTICLES = 0, auto()  # its first block of particles, and how many these are
    CELLS_X, CELLS_Y, CELLS_Z = auto(), auto(), auto()
    RECORD = auto()  # the first of its particles in `positions`, -1 if the kernel records none
    WINDOW = auto()  # frames over which a deposit must have been at rest
    ENERGY = auto()  # its first line in `energy`
    GEOMETRY = auto()  # the first entry of its window in `cell_faces`, `node_holds`, ...
    WINDOW_LOW_X, WINDOW_LOW_Y, WINDOW_LOW_Z = auto(), auto(), auto()  # the lowest node of this window
    WINDOW_X, WINDOW_Y, WINDOW_Z = auto(), auto(), auto()  # and how many it has along each axis
    TERRAIN = auto()  # the first number of its terrain in `terrain`; 0 without one
    TERRAIN_FACE = auto()  # its number as a face, beyond all listed ones
    TERRAIN_SOLID = auto()  # the number of its solid
    TERRAIN_FRICTION = auto()  # 1 where its friction varies, else 0
    COLUMNS = auto()  # its first column of nodes in `column_heights`
    OBSTACLES = auto()  # how many solids are in the box: the baffles, then the others
    OPEN = auto()  # bit k: side k of the box, x-, x+, y-, ..., is open
    SOLIDS = auto()  # solids with recorded impulse: those and, if asked for, the box's 2 D sides and the barriers
    IMPULSE = auto()  # its first line in `recorded_impulse`
    FRAMES = auto()  # how many, the initial one included
    SUBSTEPS = auto()  # steps per frame, by the scene's fraction of the stable step
    STEPS = auto()  # so far
    NEXT = auto()  # the next frame to compute
    DONE = auto()  # completed steps of that frame: 0 unless it waits for room in the grid
    FRAME_STEPS = auto()  # how many that frame then has
    REST = auto()  # the frame in which it was found at rest, 0 while it moves
    BARRIER, BARRIERS = auto(), auto()  # its first line in `barriers`, and how many
    RETAINED, RETAINED_COUNT = auto(), auto()  # its first line in `retained` and `settling`, and how many
    INFLOW, INFLOWS = auto(), auto()  # its first line in `inflows`, and how many
    ENTERED = auto()  # the frame by which all of its particles have entered; 0 without inflow


class Contact(IntEnum):
    """Vectors of a block that describe the contact of its particles with solids (`mpm.physics.contact`)."""

    DELTA = 0  # delta_h of the distance [1/m]
    DISTANCE = auto()  # from the nearest face [m]; beyond the search a lower bound of it
    FRICTION = auto()  # its Coulomb coefficient at the foot [-]
    FACE = auto()  # the number of that face, less FIRST_FACE
    # How far a particle may move before another face or an edge (on terrain: any face) may be nearest [m]; negative at
    # an edge, where it is the distance before another part of the faces may be nearest.
    FREE = auto()
    NORMAL = auto()  # D vectors: n, out of the solid [-]; behind them D of the shear traction [Pa]


FIRST_FACE = 2**24
"""Subtracted from face numbers that are stored as reals: single precision holds whole numbers up to it on either side
of zero."""


BED_PER_CELL = 2  # nodes of the lattice of a terrain in 3D per cell of the grid (`mpm.solids.bed`)
BED_FIRST = BED_PER_CELL * PADDING + 1  # the number of its node at the corner of the box: one lies beyond the padding


class TerrainNumber(IntEnum):
    """The first numbers of a terrain in `terrain`; its elevations follow, and its frictions where they vary."""

    NEARNESS = 0  # the least part of the height above it that is the distance from it [-]
    FRICTION = auto()  # if it is the same everywhere [-]


class BedUnder(IntEnum):
    """The bed of a terrain under a column, common to its nodes."""

    REFERENCE = 0  # an elevation near its own [m]
    ABOVE = auto()  # height of the reference above the bed [m]: single precision keeps more digits of differences
    NORMAL_X, NORMAL_Y, NORMAL_Z = auto(), auto(), auto()
    FRICTION = auto()


class Worker(IntEnum):
    """Columns of `workers`, integers, shape [workers, len(Worker)]: the part of a scene that one thread computes."""

    SCENE = 0
    FIRST, LAST = auto(), auto()  # its blocks: [first, last)
    NODE, ROOM = auto(), auto()  # the first node of its part of `grid`, and how many nodes that part has
    USED = auto()  # how many its columns need; if those are more, the run waits for room
    COLUMN = auto()  # its first column in `bases` and `spans`
    ACTIVE, LOWEST, HIGHEST = auto(), auto(), auto()  # how many columns are in use, the lowest and the highest number
    SCRATCH, IMPULSE = auto(), auto()  # its first vector of `scratch` and of `impulse`
    EVEN, ODD = auto(), auto()  # number of its even cells with water, and of its odd ones


class Address(IntEnum):
    """Entries of `addresses`: where arrays lie in memory, for functions of `mpm.arrays.bitcode`."""

    GRID, SCRATCH, STATE = 0, auto(), auto()


class Span(IntEnum):
    """Columns of `spans`, integers, shape [columns of nodes of all workers, len(Span)]: see `mpm.physics.columns`."""

    LOW, HIGH = 0, auto()  # the nodes of a column that are in use, [low, high); high is 0 where it is not
    CELL_LOW, CELL_HIGH = auto(), auto()  # cells above it that hold particles, while columns are made
    ACTIVE = auto()  # line n: the n-th column in use
    OCCUPIED = auto()  # line n: the n-th column of cells that holds particles
    HELD = auto()  # 1 where listed faces hold a node of a column
    ALONE = CELL_LOW  # after columns are made, with water: 1 if no other worker of a shared scene has the column


class StepControl(IntEnum):
    """Columns of `step_control`, real, shape [scenes, len(StepControl)]: the steps of a GPU, each a launch."""

    DT = 0  # of the next step [s]; 0 where the scene waits for others
    SPEED = auto()  # of its fastest particle [m/s]
    STEPS = auto()  # of its next frame; 0 where it has ended


class Energy(IntEnum):
    """Columns of `energy`, real, shape [all frames, len(Energy)]: energies [J, per metre of width in 2D], shares."""

    KINETIC = 0
    POTENTIAL = auto()
    ELASTIC = auto()
    UNBALANCED = auto()  # mean over a frame of sum m |a| over the weight [-], where runs end at rest; else 0
    ABSENT = auto()  # share of the mass that has left the box or not entered it yet [-]


class Pore(IntEnum):
    """Numbers of a cell in `cells`, as long as two nodes: sums from its particles, then the results for their water."""

    VOLUME = 0  # of saturated particles [m^D]; from here on means over it
    STRAIN = auto()  # volume strain of a step [-]
    PRESSURE = auto()  # [Pa]
    CLOSED = auto()  # bit f: a solid is beyond face f, x-, x+, y-, ...
    CENTRE_X, CENTRE_Y, CENTRE_Z = auto(), auto(), auto()  # from the middle of the cell [cells]
    SUCTION = 7  # suction that water bears [Pa], if material dilates
    CHANGE = 8  # change of the pressure in a step [Pa]
    SOURCE = 9  # of that change, explicit in time [Pa]
    SHARE = 10  # filled share of the cell [-]
    PER_DIAGONAL = 11  # 1 over the diagonal of the system [-]
    SLOPE_X, SLOPE_Y, SLOPE_Z = 12, 13, 14  # of the pressure [Pa per cell]
    FELT = 15  # change of the acting pressure, which is at least minus the suction [Pa]


class Beside(IntEnum):
    """Columns of `beside`, integers, a line for each cell: what lies around it; and a list of the cells in use."""

    BELOW_X, ABOVE_X, BELOW_Y, ABOVE_Y, BELOW_Z, ABOVE_Z = range(6)  # the cell with water beyond a face, or the dry one
    COLUMN = 6  # its own, of the box
    LISTED = 7  # line n: the n-th even cell with water; from the end on the odd ones


class Face(IntEnum):
    """What lies beyond a face of a cell with saturated material."""

    TIGHT = 0
    CELL = auto()  # another cell with water
    SURFACE = auto()
    DRAIN = auto()  # a solid that lets water out
    GAP = auto()  # a cell without water, and another one behind it


class Barrier(IntEnum):
    """Columns of `barriers`, integers, shape [barriers, len(Barrier)]: a range of nodes that is held, [low, high)."""

    RETAINED = 0  # line of its mass in `retained`
    AXIS = auto()  # axis across which nodes are held; len(Barrier): they are damped
    LOW_X, LOW_Y, LOW_Z = auto(), auto(), auto()
    HIGH_X, HIGH_Y, HIGH_Z = auto(), auto(), auto()


class Retained(IntEnum):
    """Columns of `retained`, integers, shape [retained masses, len(Retained)]."""

    FIRST, LAST = 0, auto()  # its particles: [first, last) of the scene's
    RELEASE = auto()  # the frame in which its barriers open; 0: when it has settled
    SETTLED_FRAMES = auto()  # frames in a row in which it was settled
    OPENED = auto()  # the frame in which its barriers opened; 0 while they are closed
    FOOT = auto()  # the lowest row of nodes that opened barriers still hold, at the foot of a gate
    TOP = auto()  # the row beyond their highest one


class Settling(IntEnum):
    """Columns of `settling`, real, shape [retained masses, len(Settling)]."""

    RATE = 0  # rate of damping [1/s]
    PARTICLE = auto()  # mass of a particle [kg, per metre of width in 2D]
    MOST_KINETIC = auto()  # largest of a settled mass [J, per metre of width in 2D]
    MOST_IMPULSE = auto()  # change of its momentum in a frame [N s]
    KINETIC = auto()  # in the frame that is recorded
    MOMENTUM_X, MOMENTUM_Y, MOMENTUM_Z = auto(), auto(), auto()
    EARLIER_X, EARLIER_Y, EARLIER_Z = auto(), auto(), auto()  # momentum in the frame before
    GATE_SPEED = auto()  # [m/s]; 0: the barriers are gone at once
    GATE_TIME = auto()  # its time constant [s]
    GATE_FOOT = auto()  # its initial height [m]


class Inflow(IntEnum):
    """First columns of `inflows`, real, shape [inflows, columns]; its speed in each frame [m/s] follows."""

    SPEED = 0  # in the next frame [m/s]; negative if the inflow has not begun, or has ended
    FOOT_X, FOOT_Y, FOOT_Z = auto(), auto(), auto()  # the middle of the lowest line of its section [cells]
    FLOW_X, FLOW_Y, FLOW_Z = auto(), auto(), auto()  # unit vectors: of its velocity,
    ALONG_X, ALONG_Y, ALONG_Z = auto(), auto(), auto()  # along its foot, in 2D z,
    UP_X, UP_Y, UP_Z = auto(), auto(), auto()  # and across both
    HALF_WIDTH = auto()  # of its foot [cells]


def node_shape(domain: Domain) -> tuple[int, ...]:
    """Nodes of the background grid along each axis, PADDING cells beyond every wall."""
    return tuple(round(length / domain.cell) + 2 * PADDING + 1 for length in domain.size)


def node_room(domain: Domain, particles: int) -> int:
    """Initial number of nodes of the grid of so many particles."""
    return min(math.prod(node_shape(domain)), max(FEWEST_NODES, NODES_PER_PARTICLE * particles))


def column_count(domain: Domain) -> int:
    """Vertical columns of nodes in the box."""
    nodes = node_shape(domain)
    return math.prod(nodes) // nodes[1]


def component(i: int, j: int) -> int:
    """Index of sigma_ij among the components xx, yy, zz, xy, yz, zx; no yz, zx in 2D."""
    return i if i == j else {(0, 1): 3, (1, 2): 4, (0, 2): 5}[min(i, j), max(i, j)]
