"""A measured experiment as data: `NAME/experiment.toml` and the scenes beside it.

Every number was read in a source, or worked out from such numbers; `status` says which. What the authors do not state
is listed with the choice made for it.
"""

import dataclasses
import itertools
import math
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

from datasets.errors import InputError
from datasets.library import read_scene
from datasets.records import Record, from_mapping, read_toml
from datasets.scene import Domain, Scene

FOLDER = Path(__file__).parent


REPOSE = "repose"
"""Name of the angle at which a flow stops: mu_s of mu(I)."""


class Status(StrEnum):
    """Where a number comes from; one from memory alone is not used."""

    READ = "read"
    WORKED_OUT = "worked out"


class Quantity(StrEnum):
    """What was measured on a deposit."""

    FRONT = "front"
    RADIUS = "radius"
    HEIGHT = "height"
    PROFILE = "profile"
    RADII = "radii"


@dataclass(frozen=True, kw_only=True)
class Angle(Record):
    """An angle of friction of the material that was measured by itself, not on the flow."""

    name: str
    """Such as avalanche or repose."""
    angle: str = "slope"
    """How it is read: as `datasets.material.Material.angle`."""
    lower_deg: float
    """Smallest value in the sources [deg]."""
    upper_deg: float
    """Largest one [deg]."""
    status: Status
    source: str

    def __post_init__(self) -> None:
        if not 0.0 < self.lower_deg <= self.upper_deg < 90.0:
            raise InputError(
                f"expected 0 < lower_deg <= upper_deg < 90, got {self.lower_deg:g} and {self.upper_deg:g}",
                key="lower_deg",
            )

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
    """How friction grows with the inertial number (`mpm.physics.inertial`)."""

    friction_growth: float
    """mu_2 - mu_s [-]."""
    inertial_number: float
    """I_0 [-]."""
    grain_diameter: float
    """[m]."""
    grain_density: float
    """[kg/m^3]."""
    source: str


@dataclass(frozen=True)
class Reading:
    """What a scene is computed with."""

    deg: float
    """Angle of friction [deg]."""
    angle: str = "slope"
    """How it is read."""
    rate: bool = False
    """Whether friction grows with the inertial number."""


@dataclass(frozen=True, kw_only=True)
class Measured(Record):
    """A measured number, or a measured profile."""

    quantity: Quantity
    """front: x [m] that 99.5 % of the particles are behind, or where the deposit first gets thinner than
    `thicker_than`; radius: the same share by distance from the vertical axis; height: of the surface [m] next to the
    wall x = 0; profile: root mean square difference of the heights [m], of which the measured value is 0; radii: that
    of the radius over time."""
    value: float = 0.0
    """[m], from the wall x = 0."""
    spread: float
    """One unit of its uncertainty [m]; where sources disagree, half of the band between them, `value` its middle."""
    spread_from: str = ""
    """Where the spread comes from."""
    status: Status
    source: str
    explanation: str = ""
    """Why the computation may differ: printed where it does, by more than twice the spread."""
    thicker_than: float | None = None
    """Thickness [m] by which the measurement defines a front."""
    beside_walls: float | None = None
    """In 3D, width [m] of the strips along both side walls over which a front by thickness is measured, as by a camera
    that looks through a wall. The whole width where absent."""
    within: float | None = None
    """Strip [m] next to the wall over which a height is measured."""
    x: tuple[float, ...] = ()
    """Where the heights of a profile were measured [m], ascending."""
    heights: tuple[float, ...] = ()
    """Of the surface at `x` [m]."""
    times: tuple[float, ...] = ()
    """When radii were measured [s]."""
    radii: tuple[float, ...] = ()
    """At `times` [m]."""

    @property
    def single(self) -> bool:
        """Whether it is one number, not a difference from many."""
        return self.quantity not in (Quantity.PROFILE, Quantity.RADII)

    def __post_init__(self) -> None:
        if self.spread <= 0.0:
            raise InputError(f"expected a positive length in m, got {self.spread:g}", key="spread")
        if self.quantity is Quantity.HEIGHT and self.within is None:
            raise InputError("expected a value, a height needs one", key="within")
        if self.quantity is Quantity.PROFILE and not len(self.x) == len(self.heights) > 1:
            raise InputError(f"expected as many heights as x, {len(self.x)}, and two or more", key="heights")
        if self.quantity is Quantity.RADII and not len(self.times) == len(self.radii) > 1:
            raise InputError(f"expected as many radii as times, {len(self.times)}, and two or more", key="radii")
        if any(later <= earlier for earlier, later in itertools.pairwise(self.x)):
            raise InputError("expected lengths that ascend", key="x")
        if self.single and self.value <= 0.0:
            raise InputError(f"expected a positive length in m, got {self.value:g}", key="value")


@dataclass(frozen=True, kw_only=True)
class MeasuredScene(Record):
    """A scene and what was measured in it."""

    name: str
    scene: str
    """File of the scene, beside the experiment."""
    cells: tuple[float, float] | None = None
    """Its own grid cells [m]; the experiment's where absent."""
    measured: tuple[Measured, ...]
    """The first one is a front or a radius: an angle is inferred from it."""

    def __post_init__(self) -> None:
        if not self.measured or self.measured[0].quantity not in (Quantity.FRONT, Quantity.RADIUS):
            raise InputError("expected a front or a radius first", key="measured")

    @property
    def extent(self) -> Measured:
        """The measured number that an angle is inferred from."""
        return self.measured[0]


@dataclass(frozen=True, kw_only=True)
class Assumption(Record):
    """The choice for something that the authors do not state."""

    what: str
    choice: str
    reason: str


@dataclass(frozen=True, kw_only=True)
class Experiment(Record):
    """The contents of an `experiment.toml`."""

    title: str
    what: str
    source: str
    licence: str
    angles: tuple[Angle, ...] = ()
    """The material's own; the first is the one to compute with. None: an angle is inferred, nothing is predicted."""
    grains: Grains | None = None
    """How their friction grows with the rate; nothing is known of it where absent."""
    cells: tuple[float, float]
    """Grid cells, the coarse and the fine one [m]."""
    cases: tuple[MeasuredScene, ...]
    assumptions: tuple[Assumption, ...] = ()

    @property
    def readings(self) -> tuple[Reading, ...]:
        """What its angles are computed with, by one rule.

        At the repose angle a flow stops: it is mu_s, and friction grows with the rate where that is known. At any other
        one, an avalanche's, grains begin to flow: it is the friction of all of the flow.
        """
        return tuple(
            Reading(each.deg, each.angle, each.name == REPOSE and self.grains is not None) for each in self.angles
        )


@dataclass(frozen=True, kw_only=True)
class Shipped:
    """An experiment and the folder it was read from."""

    name: str
    folder: Path
    experiment: Experiment

    def cells(self, case: MeasuredScene) -> tuple[float, float]:
        """Grid cells of a case, the coarse and the fine one [m]."""
        return case.cells or self.experiment.cells

    def scene(self, file: str, cell: float, reading: Reading) -> Scene:
        """The scene of `file` on another cell [m], of grains of the friction of `reading`."""
        scene = read_scene(str(self.folder / file))
        material = dataclasses.replace(scene.material, friction_deg=reading.deg, angle=reading.angle)
        if reading.rate and (grains := self.experiment.grains) is not None:
            limit = math.tan(math.radians(reading.deg)) + grains.friction_growth
            material = dataclasses.replace(
                material,
                friction_limit_deg=math.degrees(math.atan(limit)),
                inertial_number=grains.inertial_number,
                grain_diameter=grains.grain_diameter,
                grain_density=grains.grain_density,
            )
        return dataclasses.replace(scene, domain=Domain(size=scene.domain.size, cell=cell), material=material)


def read_experiment(folder: Path) -> Shipped:
    """Read `folder`/experiment.toml. Raises InputError, which names the file and the key."""
    path = folder / "experiment.toml"
    try:
        return Shipped(name=folder.name, folder=folder, experiment=from_mapping(Experiment, read_toml(path)))
    except InputError as error:
        raise error if error.where else error.at(str(path)) from None


def read_experiments(folder: Path = FOLDER) -> list[Shipped]:
    """Every experiment in `folder`, by name. Raises InputError."""
    return [read_experiment(path.parent) for path in sorted(folder.glob("*/experiment.toml"))]
