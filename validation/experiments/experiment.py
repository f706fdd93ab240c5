"""A measured experiment as data: `NAME/experiment.toml` and the scenes beside it; and its measurements of a deposit.

Every number was read in a source or derived from such numbers; `status` says which. Values that the authors do not
state are listed with the choice made for them.
"""

import itertools
import math
from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray

from datasets.errors import naming, require
from datasets.files import read_toml
from datasets.flow.measures import Positions, front, height_profile, profile_stations
from datasets.flow.trajectory import Trajectory
from datasets.scene import Domain, Scene
from datasets.scene.library import read_scene
from datasets.scene.particles import particle_volumes
from datasets.schema import Bounds, Record, from_mapping

FOLDER = Path(__file__).parent
Floats = NDArray[np.float64]

STATION = 2.0  # distance of a profile's stations in cells
SURFACE_QUANTILE = 0.99  # of the particles' heights in a strip: the surface, robust against single particles
REPOSE = "repose"  # name of the angle at which a flow stops: mu_s of mu(I)


class Quantity(StrEnum):
    """The quantity measured on a deposit."""

    FRONT = "front"  # x [m] that 99.5 % of the volume is behind; with `thicker_than`, the end of the deposit
    RADIUS = "radius"  # radius that contains the same share, from the vertical axis
    HEIGHT = "height"  # of the surface [m] next to the wall x = 0
    PROFILE = "profile"  # root mean square difference of the heights [m]; the measured value is 0
    RADII = "radii"  # root mean square difference of the radius over time


@dataclass(frozen=True, kw_only=True)
class Angle(Record):
    """A friction angle of the material that was measured independently, not on the flow."""

    name: str  # such as avalanche or repose
    angle: str = "slope"  # its kind, as `datasets.scene.material.Material.angle`
    lower_deg: float  # smallest value in the sources [deg]
    upper_deg: float  # largest one [deg]
    status: Literal["read", "worked out"]
    source: str

    def __post_init__(self) -> None:
        super().__post_init__()
        ordered, got = 0.0 < self.lower_deg <= self.upper_deg < 90.0, f"{self.lower_deg:g} and {self.upper_deg:g}"
        require(ordered, "lower_deg", "0 < lower_deg <= upper_deg < 90", got)

    @property
    def deg(self) -> float:
        """Middle of the range [deg]."""
        return 0.5 * (self.lower_deg + self.upper_deg)

    @property
    def half_width_deg(self) -> float:
        """Half of the range [deg]."""
        return 0.5 * (self.upper_deg - self.lower_deg)


@dataclass(frozen=True, kw_only=True)
class Grains(Record):
    """Constants of the growth of friction with the inertial number (`mpm.physics.inertial`)."""

    friction_growth: float  # mu_2 - mu_s [-]
    inertial_number: float  # I_0 [-]
    grain_diameter: float  # [m]
    grain_density: float  # [kg/m^3]
    source: str


@dataclass(frozen=True, kw_only=True)
class Reading:
    """A friction angle as used in the computation of a scene."""

    name: str
    deg: float
    angle: str = "slope"  # how it is read
    rate: bool = False  # whether friction grows with the inertial number

    def __str__(self) -> str:
        read = [self.name, *(["μ(I)"] if self.rate else []), *({self.angle} - {"slope"})]
        return f"{self.deg:.1f}° ({', '.join(read)})"


@dataclass(frozen=True, kw_only=True)
class Measured(Record):
    """A measured number, or a measured profile."""

    quantity: Quantity
    value: float = 0.0  # [m], from the wall x = 0
    spread: Annotated[float, Bounds("a positive length in m", gt=0.0)]
    """One unit of its uncertainty [m]; if sources disagree, half of the band between them, with `value` its middle."""
    spread_from: str = ""  # origin of the spread
    status: Literal["read", "worked out"]
    source: str
    explanation: str = ""  # why the computation may differ; printed if it does by more than twice the spread
    thicker_than: float | None = None  # thickness [m] that defines a measured front: where it first falls below this
    beside_walls: float | None = None
    """In 3D, width [m] of the strips along both side walls in which a front by thickness is measured, as by a camera
    that looks through a wall. Default: the whole width."""
    within: float | None = None  # strip [m] next to the wall over which a height is measured
    x: tuple[float, ...] = ()  # places of the measured heights of a profile [m], ascending
    heights: tuple[float, ...] = ()  # of the surface at `x` [m]
    times: tuple[float, ...] = ()  # times of the measured radii [s]
    radii: tuple[float, ...] = ()  # at `times` [m]

    @property
    def single(self) -> bool:
        """Whether it is a single number, not a difference from many."""
        return self.quantity not in (Quantity.PROFILE, Quantity.RADII)

    def __post_init__(self) -> None:
        super().__post_init__()
        missing = self.quantity is Quantity.HEIGHT and self.within is None
        require(not missing, "within", "a value, a height needs one", "none")
        for kind, at, values in ((Quantity.PROFILE, "x", "heights"), (Quantity.RADII, "times", "radii")):
            count, size = len(getattr(self, at)), len(getattr(self, values))
            ok = self.quantity is not kind or count == size > 1
            require(ok, values, f"as many {values} as {at}, {count}, and two or more", size)
        ascending = all(earlier < later for earlier, later in itertools.pairwise(self.x))
        require(ascending, "x", "lengths that ascend", list(self.x))
        require(not self.single or self.value > 0.0, "value", "a positive length in m", f"{self.value:g}")


@dataclass(frozen=True, kw_only=True)
class Case(Record):
    """A scene and its measurements."""

    name: str
    scene: str  # file of the scene, beside the experiment
    cells: tuple[float, float] | None = None  # its own grid cells [m]; default: the experiment's
    measured: tuple[Measured, ...]  # the first is a front or a radius, from which an angle is inferred

    def __post_init__(self) -> None:
        super().__post_init__()
        extent = bool(self.measured) and self.extent.quantity in (Quantity.FRONT, Quantity.RADIUS)
        require(extent, "measured", "a front or a radius first", "another")

    @property
    def extent(self) -> Measured:
        """The measured number from which an angle is inferred."""
        return self.measured[0]


@dataclass(frozen=True, kw_only=True)
class Variant(Record):
    """A variant of a prediction's constants, if sources differ."""

    name: str
    consolidation: Annotated[float, Bounds("a positive coefficient in m^2/s", gt=0.0)]  # c_v [m^2/s]
    source: str


@dataclass(frozen=True, kw_only=True)
class Prediction(Record):
    """A scene without measured numbers: times of arrival at gauges, and the thickness there."""

    name: str
    scene: str  # file of the scene, beside the experiment
    start: float  # the x of the scene from which distances count [m]
    gauges: tuple[float, ...]  # their distances [m]
    spacing: Annotated[float, Bounds("a positive length in m", gt=0.0)]
    """Half width over which they take the mean thickness [m]."""
    variants: tuple[Variant, ...]


@dataclass(frozen=True, kw_only=True)
class Experiment(Record):
    """The contents of an `experiment.toml`."""

    title: str
    what: str
    source: str
    licence: str
    angles: tuple[Angle, ...] = ()
    """The material's angles; computations use the first. Without any, an angle is inferred and nothing predicted."""
    grains: Grains | None = None  # growth of friction with the rate, if known
    cells: tuple[float, float]  # grid cells, the coarse and the fine one [m]
    cases: tuple[Case, ...] = ()
    predictions: tuple[Prediction, ...] = ()
    assumptions: tuple[dict[Literal["what", "choice", "reason"], str], ...] = ()
    """The choices for values that the authors do not state."""
    folder: Path = FOLDER  # folder of its file and its scenes

    @property
    def name(self) -> str:
        return self.folder.name

    @property
    def readings(self) -> tuple[Reading, ...]:
        """The readings of its angles, by one rule. At the repose angle a flow stops: the angle is mu_s, and friction
        grows with the rate if that is known. At any other angle, such as an avalanche's, grains start to flow: it is
        the friction of the whole flow."""
        known = self.grains is not None
        return tuple(
            Reading(name=angle.name, deg=angle.deg, angle=angle.angle, rate=known and angle.name == REPOSE)
            for angle in self.angles
        )

    def scene(self, case: Case, number: int, reading: Reading) -> Scene:
        """The scene of a case on its coarse (0) or fine (1) cells, with the friction of `reading`."""
        scene = read_scene(str(self.folder / case.scene))
        material = replace(scene.material, friction_deg=reading.deg, angle=reading.angle)
        if reading.rate and (grains := self.grains) is not None:
            limit = math.tan(math.radians(reading.deg)) + grains.friction_growth
            constants = ("inertial_number", "grain_diameter", "grain_density")
            known: dict[str, Any] = {name: getattr(grains, name) for name in constants}
            material = replace(material, friction_limit_deg=math.degrees(math.atan(limit)), **known)
        cell = (case.cells or self.cells)[number]
        return replace(scene, domain=Domain(size=scene.domain.size, cell=cell), material=material)

    def predicted(self, prediction: Prediction, number: int, variant: Variant) -> Scene:
        """The scene of a prediction on the coarse (0) or fine (1) cells."""
        scene = read_scene(str(self.folder / prediction.scene)).with_cell(self.cells[number])
        return replace(scene, material=replace(scene.material, consolidation=variant.consolidation))


def read_experiments(folder: Path = FOLDER) -> list[Experiment]:
    """Every experiment `folder`/NAME/experiment.toml, by name. Raises InputError, which names the file and the key."""
    experiments = []
    for path in sorted(folder.glob("*/experiment.toml")):
        with naming(path):
            experiments.append(replace(from_mapping(Experiment, read_toml(path)), folder=path.parent))
    return experiments


def quantity(measured: Measured, flow: Trajectory) -> float:
    """The quantity of `measured` [m] in the last frame of a flow; for radii, in all frames."""
    scene, positions = flow.scene, flow.positions[-1]
    if measured.quantity is Quantity.RADIUS:
        return radius(positions, flow.volumes)
    if measured.quantity is Quantity.RADII:
        computed = np.interp(measured.times, flow.time, [radius(frame, flow.volumes) for frame in flow.positions])
        return float(np.sqrt(np.mean((computed - measured.radii) ** 2)))
    if measured.quantity is Quantity.HEIGHT:
        strip = positions[positions[:, 0] < measured.within, 1].astype(np.float64)
        return float(np.quantile(strip, SURFACE_QUANTILE)) + 0.5 * scene.particle_spacing
    stations = profile_stations(scene, STATION * scene.domain.cell)
    if measured.quantity is Quantity.PROFILE:
        computed = np.interp(measured.x, stations, mean_profile(scene, positions, stations))
        return float(np.sqrt(np.mean((computed - measured.heights) ** 2)))
    if measured.thicker_than is None:
        return front(positions, flow.volumes)
    return edge(stations, mean_profile(scene, positions, stations, measured.beside_walls), measured.thicker_than)


def radius(positions: Positions, volume: Floats) -> float:
    """Radius around the vertical axis [m] that contains 99.5 % of the volume; positions: [N, D], volume: [N]."""
    return front(np.hypot(positions[:, [0]], positions[:, [-1]]), volume)


def mean_profile(scene: Scene, positions: Positions, stations: Floats, beside_walls: float | None = None) -> Floats:
    """Height of the deposit at its initial density [m] at `stations` [m], shape [S]; in 3D the mean over z.

    beside_walls: width [m] of the strips along the walls z = 0 and z = width in which the mean is taken; None: all.
    """
    volumes = particle_volumes(scene, len(positions))
    if scene.dimension == 2:
        return height_profile(positions, volumes, stations)
    width = scene.domain.size[2]
    strip = 0.5 * width if beside_walls is None else beside_walls
    z = positions[:, 2]
    beside = (z <= strip) | (z >= width - strip)
    return height_profile(positions[beside], volumes[beside] / (2.0 * strip), stations)


def edge(stations: Floats, heights: Floats, thickness: float) -> float:
    """The x [m] beyond the highest station where a profile first falls below `thickness` [m], linear in between.
    stations, heights: [m], shape [S] each. The last station if it never does."""
    top = int(np.argmax(heights))
    below = top + np.flatnonzero(heights[top:] < thickness)
    if len(below) == 0:
        return float(stations[-1])
    around = [below[0], max(below[0] - 1, top)]
    return float(np.interp(thickness, heights[around], stations[around]))
