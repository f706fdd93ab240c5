"""What a simulation is asked to record, in which frames, and until when it runs."""

from dataclasses import dataclass
from typing import Literal

from datasets.errors import InputError
from datasets.records import Record

FieldName = Literal["velocity", "stress", "pressure", "density", "plastic_strain"]

FIELDS: tuple[FieldName, ...] = ("velocity", "stress", "pressure", "density", "plastic_strain")
"""All that can be recorded of a particle besides its position."""


@dataclass(frozen=True, kw_only=True)
class Recording(Record):
    """A request: memory is allocated, and code compiled, for this alone.

        simulate(scene, record=Recording(frames=10, fields=frozenset({"velocity", "stress"}), wall_forces=True))

    The series of the summary (energies, impulse on the walls) have a value at every `frame_dt` of the scene, whichever
    frames keep their positions; the impulse on solids is recorded in the frames that are kept wherever there are
    solids. Raises InputError for what cannot be recorded.
    """

    frames: Literal["all", "last"] | int = "all"
    """Which frames keep positions and fields: all, the last alone, or every k-th from the first on and the last."""
    fields: frozenset[FieldName] = frozenset()
    """What is recorded of every particle besides its position."""
    wall_forces: bool = False
    """Whether the momentum that each side of the box has taken is recorded."""
    raw: bool = False
    """Stress and pressure as the particles carry them, not smoothed through the grid (`mpm.output.smoothing`)."""
    until_rest: bool = False
    """End a scene when its deposit has come to rest (`mpm.output.rest`), and fill the frames that are left with the
    last one; the summary says when it came to rest, `rest_time` [s], and until when it was computed, `end_time` [s]."""

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
"""The positions in all frames."""
LAST = Recording(frames="last")
"""The deposit alone."""
AT_REST = Recording(frames="last", until_rest=True)
"""The deposit alone, of a run that ends when it rests."""
WITH_FIELDS = Recording(fields=frozenset({"velocity", "pressure", "plastic_strain"}), wall_forces=True)
"""All frames with velocity, pressure and plastic strain, and the forces on the walls."""
