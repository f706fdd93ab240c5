"""What stands in a problem's file: its sections as they are read from TOML, strictly."""

import math
from dataclasses import dataclass, field
from enum import StrEnum
from functools import cached_property

from datasets.errors import InputError
from datasets.records import Record, fraction
from inverse.parameters import Kind, kind


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


class Method(StrEnum):
    """How the loss is minimised."""

    GRADIENT_DESCENT = "gradient-descent"
    """The paper's for the angle of friction: a fixed learning rate on the loss in m^2 with the angle in degrees."""
    ADAM = "adam"
    """The paper's for velocities and baffles (torch.optim.Adam), projected onto the bounds."""
    LBFGSB = "lbfgs-b"
    """Bounded quasi-Newton (SciPy)."""
    GAUSS_NEWTON = "gauss-newton"
    """Bounded least squares by the Jacobian (SciPy's trust region), for observations of few numbers."""
    SECANTS = "secants"
    """The same without derivatives, from a sample of the box (`inverse.secants`): for observations of many numbers."""


class Sampler(StrEnum):
    """Where a search without gradients looks next (Optuna)."""

    TPE = "tpe"
    """Tree-structured Parzen estimator."""
    CMA_ES = "cma-es"
    """Covariance matrix adaptation; wants the package cmaes."""


@dataclass(frozen=True, kw_only=True)
class Parameter(Record):
    """An unknown number with its prior bounds, in the units of its name: one of `[[unknowns]]`."""

    name: str
    """See `inverse.parameters`."""
    initial: float
    """Where the search starts."""
    lower: float
    """Smallest value allowed."""
    upper: float
    """Largest value allowed."""
    step: float | None = None
    """Step of a finite difference; that of its kind where absent."""
    learning_rate: float | None = None
    """Of this parameter in gradient descent and Adam; the optimiser's where absent."""

    @cached_property
    def kind(self) -> Kind:
        """What the name stands for. Raises InputError."""
        return kind(self.name)

    @property
    def range(self) -> float:
        """Width of the prior bounds."""
        return self.upper - self.lower


@dataclass(frozen=True, kw_only=True)
class ObservationSettings(Record):
    """An observation: what is measured, where and when, what came out, and how well it is known.

    What came out is a `value`, `values` or a `csv`; none of them where a twin or a trajectory makes the numbers, nor in
    `[observation]`, whose numbers stand in `[target]`.
    """

    kind: str
    """A key of `inverse.observations.KINDS`."""
    name: str | None = None
    """As it is called in reports; its kind where absent."""
    value: float | None = None
    """The one number, in the unit of its kind: m, N s or N (in 2D per metre of width), a share -."""
    values: tuple[float, ...] | None = None
    """The numbers: of a toe its coordinates, of others one for each of `x` or `times`."""
    csv: str | None = None
    """A table, by its header: x, height of a profile; time, front; x, height and maybe time of gauges; time, impulse;
    x, z of an outline."""
    noise: float | str = 0.0
    """Standard deviation of each number: a number in the unit of the kind, or a percentage of each such as "3%"."""
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
    window: float = 0.02
    """Time over which a force is a mean [s]: of the gauge, or long enough that single particles do not matter."""
    directions_deg: tuple[float, ...] | None = None
    """Of an outline, from +x towards +z; every 22.5 degrees where absent."""


MEASURED = ("value", "values", "csv", "noise", "unit", "datum", "heights")
"""Keys of an observation that stand in `[target]` where there is one observation alone."""


@dataclass(frozen=True, kw_only=True)
class TargetSettings(Record):
    """What was observed: exactly one of `value`, `values`, `trajectory`, `csv`, `twin` and `minimise`.

    Beside `[[observations]]`, which bring their own numbers, a `twin` or a `trajectory` alone.
    """

    value: float | None = None
    """The observed number, for a front or a runout [m] or a share that passed [-]."""
    values: tuple[float, ...] | None = None
    """The observed coordinates of a toe [m]."""
    trajectory: str | None = None
    """A trajectory (NPZ) whose last frame is the observed deposit."""
    csv: str | None = None
    """A measured profile: columns `x` and `height`, one header line."""
    unit: LengthUnit = LengthUnit.METRE
    """Of both columns."""
    datum: float = 0.0
    """Height of the floor in the file [`unit`]."""
    heights: Heights = Heights.EQUIVALENT
    """What the heights are: by how much their area may differ from the released one
    (`inverse.observations.measured_profile`)."""
    twin: bool = False
    """A twin experiment: the MPM makes the target, the inversion is given the observation alone."""
    minimise: bool = False
    """A design: nothing was observed, the one number is to be as small as possible."""
    seed: int = 1
    """Seed of the initial jitter of the twin's scene; another one than the inversion's."""
    truth: dict[str, float] = field(default_factory=dict)
    """Parameter -> its value in the twin; the scene's own where absent."""
    noise: float | str = 0.0
    """Standard deviation of each measured number [m; of a share -], besides the flow's own scatter; or a percentage of
    a `value` and of each height of a `csv`, such as "3%"."""

    @property
    def measured(self) -> bool:
        """Whether the numbers were measured; else a simulated flow makes them, or there are none."""
        return not (self.twin or self.minimise or self.trajectory is not None)


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
    """How the surrogate is inverted."""

    method: Method = Method.LBFGSB
    max_iterations: int = 20
    """Most evaluations of the loss and its gradient; the sample of the secants is not counted."""
    stop_below: float = 1.0e-7
    """Loss [m^2] at which the surrogate has done its part: (0.3 mm)^2; the paper stops at 5e-4, (22 mm)^2."""
    learning_rate: float | None = None
    """Of gradient descent [unit^2/m^2] or Adam [unit of the unknown], in which a first step is just as long.

    Where absent, the paper's 500 deg^2/m^2 for gradient descent, for Adam a fiftieth of each unknown's range.
    """
    sampler: Sampler = Sampler.TPE
    """Of a search without gradients (`--gradient none`)."""
    max_trials: int = 100
    """Most predictions of such a search."""
    seed: int = 0
    """Of its random numbers."""


class Surrogate(StrEnum):
    """Whether a learned surrogate is asked besides the MPM."""

    AUTO = "auto"
    """Where the flow, the unknowns and the observations are what it has learned, and it saves more than it costs."""
    GNS = "gns"
    """Always: an error where it cannot."""
    NONE = "none"
    """Never: the loop runs on the MPM alone."""


@dataclass(frozen=True, kw_only=True)
class LoopSettings(Record):
    """How the MPM confirms or corrects (`validation.loop`)."""

    confirm_within: float = 0.003
    """Relative error of the front within which the MPM confirms."""
    runout_within: float = 0.01
    """Relative error of the runout within which one is confirmed: it is that of a single particle."""
    profile_within: float = 0.01
    """Mean distance between equal shares of two profiles, over the target's mean, within which one is confirmed."""
    toe_within: float = 0.32
    """Distance between two toes within which one is confirmed, in cells: 1e-4 m^2 squared in a cell of 31 mm."""
    deposit_within: float = 1.0
    """Root mean square distance of the particles within which a deposit is confirmed, in cells."""
    passed_within: float = 0.01
    """Difference between two shares that passed within which one is confirmed."""
    joint_within: float | None = None
    """Root mean square misfit of multiple observations, in standard deviations, within which they are confirmed; what
    chance exceeds once in twenty times where absent."""
    mpm_runs: int | None = None
    """Most MPM runs that the loop may spend; 40 and 12 for each unknown where absent."""
    mpm_seconds: float | None = None
    """Seconds that they may take in all, but for those that fill the box and check an answer; no bound where absent."""

    def budget(self, unknowns: int) -> int:
        """Most MPM runs for so many unknowns."""
        return 40 + 12 * unknowns if self.mpm_runs is None else self.mpm_runs
