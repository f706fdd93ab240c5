"""The sections of a problem's file, read strictly from TOML."""

from dataclasses import dataclass, field
from enum import StrEnum
from typing import Annotated

from datasets.errors import InputError, require
from datasets.scene import Scene
from datasets.schema import Bounds, Record

MOST = 1_000_000  # largest number of runs, draws or iterations: more would take years, and too much memory


def counted(least: int, most: int = MOST) -> Bounds:
    """The bounds of a whole number."""
    return Bounds(f"an integer from {least} to {most}", ge=least, le=most)


class ForwardModel(StrEnum):
    """The forward model, which predicts the observation."""

    GNS = "gns"
    """The surrogate, with its gradient."""
    MPM = "mpm"
    """The MPM, with the gradient of an emulator of its runs."""
    ADJOINT = "adjoint"
    """The MPM with the gradient of its adjoint."""


class Derivatives(StrEnum):
    """The method for derivatives of the MPM with respect to unknown fields."""

    ADJOINT = "adjoint"
    """The MPM's adjoint: exact, with one reverse pass for each relevant combination of the numbers. In long 3D flows a
    few particles make it noisy; more `seeds` average the noise."""
    DIFFERENCES = "differences"
    """Runs that each move along all principal directions of the prior, for each seed a few more runs than directions:
    less noise in a chaotic flow, but derivatives in these directions only."""


class Surrogate(StrEnum):
    """The surrogate that is used in addition to the MPM."""

    AUTO = "auto"
    """The learned one, if it covers the flow, the unknowns and the observations, and saves more than it costs."""
    GNS = "gns"
    """Always the learned one; an error if it does not apply."""
    COARSE = "coarse"
    """The MPM on cells twice as large, at a sixteenth of the cost in 3D: for runs that take minutes. Derivatives use
    twice as many `seeds`."""
    NONE = "none"
    """None: the loop uses the MPM alone."""


@dataclass(frozen=True, kw_only=True)
class TargetSettings(Record):
    """The source of the observed numbers; by default the observations themselves."""

    twin: bool = False
    """A twin experiment: the MPM makes the numbers, to which drawn noise is added; no measurement is given."""
    seed: int = 1
    """Seed of the jitter and the noise of the twin, different from any seed of the inversion."""
    truth: dict[str, float] = field(default_factory=dict)
    """Number -> its value in the twin; default: the scene's value."""
    cell: float | None = None
    """Cell size of the twin [m], by default the scene's; with another size, the answer has the error of the cells."""
    trajectory: str | None = None
    """An observed trajectory (NPZ)."""

    def __post_init__(self) -> None:
        super().__post_init__()
        both = self.twin and self.trajectory is not None
        require(not both, "", "one of twin = true and trajectory", "twin and trajectory")
        require(self.twin or not self.truth, "truth", "twin = true beside a truth", "none")
        require(self.twin or self.cell is None, "cell", "twin = true beside cells of the twin", "none")

    @property
    def measured(self) -> bool:
        """Whether the observations contain their own numbers."""
        return not self.twin and self.trajectory is None

    def check(self, scene: Scene) -> None:
        """Raise InputError for a twin with a jitter seed of the inversion, or on cells that do not fit."""
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
    """Settings of the search for the minimum of the misfit."""

    seed: Annotated[int, counted(0, 2**62)] = 0
    """Seed of the random numbers."""
    max_iterations: Annotated[int, counted(1)] = 8
    """For fields: largest number of Gauss-Newton steps."""
    derivatives: Derivatives = Derivatives.ADJOINT
    """For fields: method for the derivatives of the MPM."""
    seeds: Annotated[int, counted(1)] = 4
    """For fields: number of jitter seeds over which predictions and their derivatives are averaged."""
    ensemble: Annotated[int, counted(4)] = 24
    """For fields: number of runs that measure the scatter between jitter seeds, and of draws from the prior."""


@dataclass(frozen=True, kw_only=True)
class LoopSettings(Record):
    """The budget of MPM runs (`validation.loop`)."""

    mpm_runs: Annotated[int | None, counted(1)] = None
    """Largest number of MPM runs on the problem's cells, by default 40 plus 12 for each unknown. Runs on other
    cells (unless the target is a flow on the same cells) and the runs of a coarse surrogate do not count."""

    def budget(self, unknowns: int) -> int:
        """Largest number of MPM runs for so many unknowns."""
        return 40 + 12 * unknowns if self.mpm_runs is None else self.mpm_runs
