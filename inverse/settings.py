"""What stands in a problem's file: its sections as they are read from TOML, strictly."""

import math
from dataclasses import dataclass, field
from enum import StrEnum

from datasets.errors import InputError
from datasets.records import Record, fraction


class LengthUnit(StrEnum):
    """In what a length was measured."""

    METRE = "m"
    CENTIMETRE = "cm"
    MILLIMETRE = "mm"
    FOOT = "ft"

    @property
    def metres(self) -> float:
        """Its length [m]."""
        return {"m": 1.0, "cm": 0.01, "mm": 0.001, "ft": 0.3048}[self.value]


class Heights(StrEnum):
    """What the heights of a measured profile are."""

    EQUIVALENT = "equivalent"
    """Of the released volume at its initial density, over the length and the width."""
    SURFACE = "surface"
    """Of the deposit's surface above the ground, which may be looser than what was released."""
    ELEVATION = "elevation"
    """Of the deposit's surface above the datum, over terrain: the ground beneath it is taken off (2D)."""


class ForwardModel(StrEnum):
    """What predicts the observation."""

    GNS = "gns"
    """The surrogate, with its gradient."""
    MPM = "mpm"
    """The MPM; gradients are those of an emulator of its runs."""
    ADJOINT = "adjoint"
    """The MPM with the gradient of its adjoint."""


class Surrogate(StrEnum):
    """Which surrogate, if any, is asked besides the MPM."""

    AUTO = "auto"
    """Where the flow, the unknowns and the observations are what it has learned, and it saves more than it costs."""
    GNS = "gns"
    """Always: an error where it cannot."""
    COARSE = "coarse"
    """The MPM on cells twice as large, at a sixteenth of the price in 3D: where a run takes minutes."""
    NONE = "none"
    """Never: the loop runs on the MPM alone."""


@dataclass(frozen=True, kw_only=True)
class ObservationSettings(Record):
    """What is measured, where and when, how well, and what came out unless a twin or a trajectory says that."""

    kind: str
    """A key of `inverse.observations.KINDS`."""
    name: str | None = None
    """As it is called in reports; its kind where absent."""
    value: float | None = None
    """The one number, in the unit of its kind: m, N s (in 2D per metre of width), a share -."""
    values: tuple[float, ...] | None = None
    """The numbers: of a toe its coordinates, of others one for each of `x` or `times`."""
    csv: str | None = None
    """A table: x, height of a profile or gauges, there maybe time; time, front; time, impulse; x, z of an outline."""
    noise: float | str = 0.0
    """Standard deviation of each number, of a profile of each height: in their unit, or a percentage such as "3%"."""
    unit: LengthUnit = LengthUnit.METRE
    """Of the lengths in a `csv`."""
    datum: float = 0.0
    """Height of the floor in a `csv` of heights [`unit`]."""
    heights: Heights = Heights.EQUIVALENT
    """What the heights of a profile are."""
    spacing: float = 0.02
    """Distance between the stations of a profile [m]; half width over which a gauge takes the mean height."""
    line: float | None = None
    """The x beyond which a particle has passed [m]."""
    width: float | None = None
    """Length over which the share that passed is smoothed for gradients [m]; a cell of the scene where absent."""
    x: tuple[float, ...] | None = None
    """Of gauges [m], where they are not in a `csv`."""
    z: float | None = None
    """Of gauges in 3D [m]; where absent they take the mean across the flow."""
    times: tuple[float, ...] | None = None
    """When [s] after the start, where that is not in a `csv`; where absent, in the end."""
    solid: int | str = 0
    """Which solid an impulse is on, by its name or its number: the baffles, from 0, then the other solids."""
    axis: int = 0
    """Along which axis of the scene: 0 for x, 1 for y, 2 for z."""
    directions_deg: tuple[float, ...] | None = None
    """Of an outline, from +x towards +z; every 22.5 degrees where absent."""


@dataclass(frozen=True, kw_only=True)
class TargetSettings(Record):
    """Where the observed numbers come from: the observations themselves unless this says otherwise."""

    twin: bool = False
    """A twin experiment: the MPM makes the numbers, with stated noise drawn on them; nothing else is given."""
    seed: int = 1
    """Seed of the jitter and the noise of the twin; another one than any of the inversion's."""
    truth: dict[str, float] = field(default_factory=dict)
    """Number -> its value in the twin; the scene's own where absent."""
    cell: float | None = None
    """Cells of the twin [m], the scene's unless given: with others the answer has the error of the scene's cells."""
    trajectory: str | None = None
    """A trajectory (NPZ) that was observed."""

    @property
    def measured(self) -> bool:
        """Whether the observations bring their own numbers."""
        return not self.twin and self.trajectory is None


def noise_of(noise: float | str) -> tuple[float, float]:
    """A stated noise as (share of each number [-], standard deviation in their unit). Raises InputError."""
    if isinstance(noise, str):
        text = noise.strip()
        share = fraction(text) if text.endswith("%") else math.nan
        if not 0.0 < share < 1.0:
            raise InputError(f"expected a number or a percentage such as 3%, got {text!r}", key="noise")
        return share, 0.0
    if noise < 0.0:
        raise InputError(f"expected a standard deviation of at least 0, got {noise:g}", key="noise")
    return 0.0, noise


@dataclass(frozen=True, kw_only=True)
class OptimiserSettings(Record):
    """How the minimum of the misfit is looked for."""

    seed: int = 0
    """Of random numbers."""
    max_iterations: int = 8
    """Of fields: Gauss-Newton steps, at most."""
    seeds: int = 4
    """Of fields: jitter seeds over which predictions and their derivatives are averaged."""
    ensemble: int = 24
    """Of fields: runs that measure the scatter from jitter seed to jitter seed, and as many draws of the prior."""


@dataclass(frozen=True, kw_only=True)
class LoopSettings(Record):
    """What the MPM may spend (`validation.loop`)."""

    mpm_runs: int | None = None
    """Most MPM runs that the loop may spend on the problem's cells; 40 and 12 for each unknown where absent.

    Besides come four on other cells where the target is no flow on the same, and those of a coarse surrogate.
    """

    def budget(self, unknowns: int) -> int:
        """Most MPM runs for so many unknowns."""
        return 40 + 12 * unknowns if self.mpm_runs is None else self.mpm_runs
