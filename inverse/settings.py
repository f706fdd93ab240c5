"""What stands in a problem's file: its sections as they are read from TOML, strictly."""

from dataclasses import dataclass, field
from enum import StrEnum
from typing import Annotated

from datasets.errors import InputError, require
from datasets.scene import Scene
from datasets.schema import Bounds, Record

MOST = 1_000_000  # of runs, draws and iterations: more would take years, and memory that no machine has


def counted(least: int, most: int = MOST) -> Bounds:
    """The bounds of a whole number."""
    return Bounds(f"an integer from {least} to {most}", ge=least, le=most)


class ForwardModel(StrEnum):
    """What predicts the observation."""

    GNS = "gns"
    """The surrogate, with its gradient."""
    MPM = "mpm"
    """The MPM; gradients are those of an emulator of its runs."""
    ADJOINT = "adjoint"
    """The MPM with the gradient of its adjoint."""


class Derivatives(StrEnum):
    """What gives the derivatives of the MPM with respect to unknown fields."""

    ADJOINT = "adjoint"
    """Its adjoint: exact, at one reverse pass for each combination of the numbers that matters. In long flows in 3D a
    few particles make it noisy; more `seeds` average it."""
    DIFFERENCES = "differences"
    """Runs that each move along all principal directions of the prior, for each seed a few more than there are such
    directions: little noise of a chaotic flow, and no more than these directions."""


class Surrogate(StrEnum):
    """Which surrogate, if any, is asked besides the MPM."""

    AUTO = "auto"
    """Where the flow, the unknowns and the observations are what it has learned, and it saves more than it costs."""
    GNS = "gns"
    """Always: an error where it cannot."""
    COARSE = "coarse"
    """The MPM on cells twice as large, at a sixteenth of the price in 3D: where a run takes minutes. Derivatives take
    twice as many `seeds`."""
    NONE = "none"
    """Never: the loop runs on the MPM alone."""


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

    def __post_init__(self) -> None:
        super().__post_init__()
        both = self.twin and self.trajectory is not None
        require(not both, "", "one of twin = true and trajectory", "twin and trajectory")
        require(self.twin or not self.truth, "truth", "twin = true beside a truth", "none")
        require(self.twin or self.cell is None, "cell", "twin = true beside cells of the twin", "none")

    @property
    def measured(self) -> bool:
        """Whether the observations bring their own numbers."""
        return not self.twin and self.trajectory is None

    def check(self, scene: Scene) -> None:
        """Raise InputError for a twin that is a flow of the inversion's own, or on cells that do not fit."""
        if not self.twin:
            return
        other = self.seed >= 0 and self.seed != scene.seed
        require(other, "seed", f"a seed of at least 0 and other than the scene's {scene.seed}", self.seed)
        if self.cell is not None:
            try:
                scene.with_cell(self.cell)
            except InputError as error:
                message = f"expected cells of which the box is a whole number, but {error}"
                raise InputError(message, key="cell") from None


@dataclass(frozen=True, kw_only=True)
class OptimiserSettings(Record):
    """How the minimum of the misfit is looked for."""

    seed: Annotated[int, counted(0, 2**62)] = 0
    """Of random numbers."""
    max_iterations: Annotated[int, counted(1)] = 8
    """Of fields: Gauss-Newton steps, at most."""
    derivatives: Derivatives = Derivatives.ADJOINT
    """Of fields, by the MPM."""
    seeds: Annotated[int, counted(1)] = 4
    """Of fields: jitter seeds over which predictions and their derivatives are averaged."""
    ensemble: Annotated[int, counted(4)] = 24
    """Of fields: runs that measure the scatter from jitter seed to jitter seed, and as many draws of the prior."""


@dataclass(frozen=True, kw_only=True)
class LoopSettings(Record):
    """What the MPM may spend (`validation.loop`)."""

    mpm_runs: Annotated[int | None, counted(1)] = None
    """Most MPM runs that the loop may spend on the problem's cells, 40 and 12 for each unknown where absent; besides
    come four on other cells where the target is no flow on the same, and those of a coarse surrogate."""

    def budget(self, unknowns: int) -> int:
        """Most MPM runs for so many unknowns."""
        return 40 + 12 * unknowns if self.mpm_runs is None else self.mpm_runs
