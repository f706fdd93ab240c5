"""Where the kernel finds things: columns of the plain arrays that describe a batch of scenes."""

from enum import IntEnum, auto

PADDING = 3
"""Cells of grid beyond every wall: a quadratic B-spline reaches one and a half."""


class Column(IntEnum):
    """Counts from zero."""

    @staticmethod
    def _generate_next_value_(name: str, start: int, count: int, last_values: list[int]) -> int:
        return count


class Setting(Column):
    """Columns of `settings`, real, shape [scenes, len(Setting)]."""

    CELL = auto()  # [m]
    FRAME_DT = auto()  # [s]
    VOLUME = auto()  # of a point [m^D]
    GRAVITY_X = auto()  # [m/s^2]
    GRAVITY_Y = auto()  # [m/s^2]
    FLOOR_FRICTION = auto()  # [-]
    WALL_FRICTION = auto()  # [-]
    DAMPING = auto()  # [-]
    WAVE_SPEED = auto()  # the fastest of the scene's materials [m/s]


class Property(Column):
    """Columns of `properties`, real, shape [materials, len(Property)]."""

    DENSITY = auto()  # [kg/m^3]
    LAME = auto()  # [Pa]
    SHEAR = auto()  # [Pa]
    SIN_PHI = auto()  # [-]
    SIN_PSI = auto()  # [-]
    STRENGTH = auto()  # 2 c cos(phi) [Pa]
    LIMIT = auto()  # largest tensile stress [Pa]
    ELASTIC_DEVIATOR = auto()  # (1 + nu) / (2 E) [1/Pa]
    ELASTIC_TRACE = auto()  # nu / (2 E) [1/Pa]


class Place(Column):
    """Columns of `places`, integers, shape [scenes, len(Place)]: where a scene lies in the flat arrays; counters."""

    POINT = auto()  # its first point
    POINTS = auto()  # how many
    NODE = auto()  # its first grid node
    CELLS_X = auto()
    CELLS_Y = auto()
    RECORD = auto()  # its first number in `record`
    ENERGY = auto()  # its first line in `energy`
    MATERIAL = auto()  # its (first) material
    FRAMES = auto()  # how many, the initial one included
    SUBSTEPS = auto()  # per frame, by the scene's fraction of the stable step
    BOX_LEFT = auto()  # the nodes that hold material: columns [left, right), rows [bottom, top)
    BOX_RIGHT = auto()
    BOX_BOTTOM = auto()
    BOX_TOP = auto()
    STEPS = auto()  # taken so far
    CLAMPED = auto()  # how often a point had to be put back into the box


class Energy(Column):
    """Columns of `energy`, real [J per metre of width], shape [all frames, len(Energy)]."""

    KINETIC = auto()
    POTENTIAL = auto()
    ELASTIC = auto()
