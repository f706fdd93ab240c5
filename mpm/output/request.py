"""What a simulation is asked to record, and in which frames."""

from dataclasses import dataclass, replace
from typing import Literal

from datasets.errors import InputError

FieldName = Literal["velocity", "stress", "pressure", "density", "plastic_strain"]

FIELDS: tuple[FieldName, ...] = ("velocity", "stress", "pressure", "density", "plastic_strain")
"""All that can be recorded of a particle besides its position."""
USUAL: frozenset[FieldName] = frozenset({"velocity", "pressure", "plastic_strain"})
"""What `fields=True` stands for, with the forces on the walls."""


@dataclass(frozen=True, kw_only=True)
class Recording:
    """A request: memory is allocated, and code compiled, for this alone.

    The series of the summary (energies, impulse on the walls) have a value at every `frame_dt` of the scene, whichever
    frames keep their positions. Raises InputError for what cannot be recorded.
    """

    frames: Literal["all", "last"] | int = "all"
    """Which frames keep positions and fields: all, the last alone, or every k-th from the first on and the last."""
    fields: frozenset[FieldName] = frozenset()
    """What is recorded of every particle besides its position."""
    baffle_forces: bool = True
    """Whether the momentum that each baffle has taken is recorded, where there are any."""
    wall_forces: bool = False
    """Whether the momentum that floor and walls have taken together is recorded."""
    raw: bool = False
    """Stress and pressure as the particles carry them, not smoothed through the grid (`mpm.physics.smoothing`)."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "fields", frozenset(self.fields))
        if isinstance(self.frames, str):
            if self.frames not in ("all", "last"):
                raise InputError(f"expected all, last or every how many, got {self.frames!r}", key="frames")
        elif self.frames < 1:
            raise InputError(f"expected every first frame or more seldom, got every {self.frames}th", key="frames")
        if unknown := self.fields - set(FIELDS):
            raise InputError(f"expected any of {', '.join(FIELDS)}, got {', '.join(sorted(unknown))}", key="fields")

    @property
    def every(self) -> int:
        """Frames from one that is kept to the next; 0 where the last is kept alone."""
        if isinstance(self.frames, str):
            return 1 if self.frames == "all" else 0
        return self.frames

    def kept(self, frames: int) -> list[int]:
        """The numbers of the frames that are kept of `frames`, ascending."""
        if self.every == 0:
            return [frames - 1]
        return [*range(0, frames - 1, self.every), frames - 1]


ALL = Recording()
"""All positions."""
LAST = Recording(frames="last")
"""The deposit alone."""


def with_usual_fields(record: Recording) -> Recording:
    """`record` and the usual fields: `USUAL`, and the forces on the walls."""
    return replace(record, fields=record.fields | USUAL, wall_forces=True)
