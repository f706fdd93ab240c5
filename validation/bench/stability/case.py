"""A row of the table: a scene file and what has to hold in it."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from datasets.library import read_scene
from datasets.scene import Scene
from datasets.trajectory import Trajectory
from validation.bench.stability.finding import Finding

SCENES = Path(__file__).parent / "hard_cases"

Check = Callable[[Trajectory], Finding | None]
Comparison = Callable[[Trajectory, Trajectory], Finding]


@dataclass(frozen=True, kw_only=True)
class Case:
    """One row; what every flow keeps is checked without being named here."""

    name: str
    """Of the scene file."""
    what: str
    """What happens."""
    rests: bool = False
    """It ends as a deposit of cohesionless sand at rest: checked for that, for its slope and for its volume."""
    rings: bool = False
    """An elastic wave in free space: its decrement is checked in place of its energy, because velocity and stress are
    recorded half a step apart, so that the sum of their energies swings by omega dt."""
    spalls: bool = False
    """A slice of a cell may fall off its face, as rounding decides: fronts in f32 and f64 are not compared."""
    sprays: bool = False
    """Particles fly apart and land: rounding grows as large as another jitter, and fronts agree as those of two do."""
    until_rest: bool = False
    """Run until the solver says that it rests, which is then checked."""
    checks: tuple[Check, ...] = ()
    """Its own."""
    precisions: tuple[Comparison, ...] = ()
    """Of the flow in f32 with that in f64, besides their fronts."""
    beside: str = ""
    """Another row ..."""
    comparisons: tuple[Comparison, ...] = ()
    """... and what is checked of the two together."""
    remark: str = ""
    """What the numbers do not say by themselves."""
    cause: str = ""
    """Why the row is red, where it is."""

    @property
    def scene(self) -> Scene:
        """The scene, read from its file."""
        return read_scene(str(SCENES / f"{self.name}.toml"))
