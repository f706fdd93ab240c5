"""The state of an interrupted run, from which it continues with the same result to the bit."""

import dataclasses
import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from datasets.errors import InputError, require
from datasets.files import reading
from datasets.flow.array_files import read_arrays, write_npz
from datasets.scene import Scene
from mpm.arrays.layout import Offset, Precision
from mpm.output.recording import Recording

if TYPE_CHECKING:
    from mpm.arrays.batch import Batch

WHAT = "a checkpoint of this version of Talus; delete the file to begin anew"
SCALARS: dict[str, Callable[[Any], Any]] = {"run": str, "frame": int, "steps": int, "wall_s": float}
"""Content of a checkpoint besides arrays, with its types."""


@dataclass(frozen=True, kw_only=True)
class Checkpoint:
    """A run of one scene up to a frame, in the precision of the solver, with all records so far."""

    run: str  # scene, recording and precision: `described`
    frame: int  # the last frame that was computed
    steps: int  # steps so far
    wall_s: float  # time of all parts of the run so far [s]
    arrays: dict[str, NDArray[Any]]  # those of `arrays_of`

    @staticmethod
    def from_batch(batch: "Batch", *, wall_s: float) -> "Checkpoint":
        """The state of a batch of one scene; views of its arrays."""
        run, frame = described(batch.scenes[0], batch.recording, batch.features.precision), batch.computed
        steps, arrays = int(batch.offsets[0, Offset.STEPS]), arrays_of(batch, frame)
        return Checkpoint(run=run, frame=frame, steps=steps, wall_s=wall_s, arrays=arrays)

    def restore(self, batch: "Batch") -> None:
        """Bring a batch of one scene from its start to the end of this run.

        Raises InputError if the run belongs to another scene, recording or precision."""
        if self.run != described(batch.scenes[0], batch.recording, batch.features.precision):
            raise InputError("expected the run of the checkpoint, got another scene, recording or precision")
        for key, part in arrays_of(batch, self.frame).items():
            array = self.arrays.get(key)
            if array is None or (array.shape, array.dtype) != (part.shape, part.dtype):
                raise InputError(f"expected {WHAT}", key=key)
            part[...] = array
        if batch.file is not None:
            # If the first frame is kept, it is already in the file.
            kept = sum(number <= self.frame for number in batch.kept(0))
            for number in range(batch.recording.every > 0, kept):
                batch.file.append(positions=self.arrays["positions"][number][None])
        batch.offsets[0, Offset.STEPS], batch.computed = self.steps, self.frame

    def save(self, path: Path) -> None:
        """Write an NPZ of plain arrays."""
        write_npz(path, {name: np.array(getattr(self, name)) for name in SCALARS} | self.arrays)

    @staticmethod
    def load(path: Path) -> "Checkpoint":
        """Read what `save` wrote; never runs a pickle. Raises InputError, which names the file."""
        arrays = read_arrays(path, what=WHAT)
        require(SCALARS.keys() <= arrays.keys(), "", WHAT, where=str(path))
        with reading(path, WHAT):
            scalars: dict[str, Any] = {name: kind(arrays.pop(name)) for name, kind in SCALARS.items()}
        return Checkpoint(arrays=arrays, **scalars)


def described(scene: Scene, recording: Recording, precision: Precision) -> str:
    """All that determines the result of a run, as JSON."""
    return json.dumps([scene.to_json(), dataclasses.asdict(recording), precision])


def arrays_of(batch: "Batch", frame: int) -> dict[str, NDArray[Any]]:
    """The content of a batch of one scene after `frame`; views.

    These are the particles in the order of memory, the particle in each lane, and the records up to the frame; shapes
    as in `mpm.arrays.batch.Batch`."""
    solids, first = int(batch.offsets[0, Offset.SOLIDS]), int(batch.offsets[0, Offset.IMPULSE])
    kept, impulse = sum(number <= frame for number in batch.kept(0)), batch.recorded_impulse[first:]
    return {
        "state": batch.state_of(0),
        "order": batch.order,
        "energy": batch.energies(0)[: frame + 1],
        "impulse": impulse[: (frame + 1) * solids].reshape(frame + 1, solids, impulse.shape[1]),
        "retained": batch.retained,
        "settling": batch.settling,
        **({"staged": batch.staged} if batch.scenes[0].stages else {}),
        **({"inflows": batch.inflows} if batch.features.inflow else {}),
        # Records in a file stay there.
        **({name: series[:kept] for name, series in batch.record[0].items()} if batch.file is None else {}),
    }
