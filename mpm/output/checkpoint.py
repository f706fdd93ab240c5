"""The state of a run that was interrupted, from which it goes on, the same to the bit."""

import dataclasses
import json
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from datasets.arrays import read_arrays, write_npz
from datasets.errors import InputError
from datasets.files import json_object
from datasets.records import from_mapping
from datasets.scene import Scene
from mpm.arrays.layout import Offset, Precision
from mpm.output.request import Recording

if TYPE_CHECKING:
    from mpm.arrays.batch import Batch

RUN = ("precision", "frame", "steps", "wall_s")
"""How far a run came, one text beside the scene and what is recorded."""


@dataclass(frozen=True, kw_only=True)
class Checkpoint:
    """A run of one scene up to a frame, in the precision of the solver, with all that it has recorded so far."""

    scene: Scene
    recording: Recording
    precision: Precision
    frame: int
    """The last frame that was computed."""
    steps: int
    """Steps so far."""
    wall_s: float
    """What all parts of the run have taken so far [s]."""
    arrays: dict[str, NDArray[Any]]
    """What `arrays_of` lists."""

    @staticmethod
    def from_batch(batch: "Batch", *, wall_s: float) -> "Checkpoint":
        """The state of a batch of one scene; views of its arrays."""
        return Checkpoint(
            scene=batch.scenes[0],
            recording=batch.recording,
            precision=batch.features.precision,
            frame=batch.computed,
            steps=int(batch.offsets[0, Offset.STEPS]),
            wall_s=wall_s,
            arrays=arrays_of(batch, batch.computed),
        )

    def difference(self, scene: Scene, recording: Recording, precision: Precision) -> str:
        """The key in which a run differs from one that can go on from here; empty where it does not."""
        key = difference(self.scene, scene) or difference(self.recording, recording)
        return key or ("" if self.precision == precision else "precision")

    def restore(self, batch: "Batch") -> None:
        """Bring a batch of one scene, as it is at its start, to where this run ended.

        Raises InputError, which names the key, where the run is one of another scene, recording or precision.
        """
        if key := self.difference(batch.scenes[0], batch.recording, batch.features.precision):
            raise InputError("expected the run of the checkpoint; it differs", key=key)
        for key, part in arrays_of(batch, self.frame).items():
            if key not in self.arrays:
                raise InputError("expected a checkpoint of this version of Talus, the key is missing", key=key)
            array = self.arrays[key]
            if array.shape != part.shape or array.dtype != part.dtype:
                got = f"{array.dtype} of shape {array.shape}"
                raise InputError(f"expected {part.dtype} of shape {part.shape}, got {got}", key=key)
            part[...] = array
        if batch.file is not None:
            # Where the first frame is kept, it is in the file already.
            kept = sum(number <= self.frame for number in batch.kept(0))
            for number in range(batch.recording.every > 0, kept):
                batch.file.append(positions=self.arrays["positions"][number][None])
        batch.offsets[0, Offset.STEPS], batch.computed = self.steps, self.frame

    def save(self, path: Path) -> None:
        """Write an NPZ of plain arrays and JSON strings."""
        recording = dataclasses.asdict(self.recording)
        run = {name: getattr(self, name) for name in RUN}
        texts = {"scene": self.scene.to_json(), "recording": json.dumps(recording), "run": json.dumps(run)}
        write_npz(path, {key: np.array(text) for key, text in texts.items()} | self.arrays)

    @staticmethod
    def load(path: Path) -> "Checkpoint":
        """Read what `save` wrote; never runs a pickle. Raises InputError, which names the file."""
        arrays: dict[str, Any] = read_arrays(path, what="a checkpoint")
        try:
            texts = {key: str(arrays.pop(key)) if key in arrays else "{}" for key in ("scene", "recording", "run")}
            run = json_object(texts["run"])
            if set(run) != set(RUN):
                raise InputError("expected a checkpoint of this version of Talus", key="run")
            return Checkpoint(
                scene=Scene.from_json(texts["scene"]),
                recording=from_mapping(Recording, json_object(texts["recording"])),
                arrays=arrays,
                **run,
            )
        except InputError as error:
            raise error.at(str(path)) from None


def arrays_of(batch: "Batch", frame: int) -> dict[str, NDArray[Any]]:
    """What a batch of one scene holds after `frame`; views.

    The particles in the order of memory, which particle lies in which lane, and what was recorded up to the frame;
    shapes as in `mpm.arrays.batch.Batch`.
    """
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
        # Those in a file stay there.
        **({name: each[:kept] for name, each in batch.record[0].items()} if batch.file is None else {}),
    }


def difference(one: Any, other: Any, key: str = "") -> str:
    """The first key, such as `masses[0].size`, in which two values differ; empty where they are equal."""
    if one == other:
        return ""
    parts: list[tuple[str, Any, Any]] = []
    if dataclasses.is_dataclass(one) and type(one) is type(other):
        names = [each.name for each in dataclasses.fields(one)]
        parts = [(f"{key}.{name}".lstrip("."), getattr(one, name), getattr(other, name)) for name in names]
    elif isinstance(one, tuple) and isinstance(other, tuple) and len(one) == len(other):
        pairs = zip(one, other, strict=True)
        parts = [(f"{key}[{n}]", *pair) for n, pair in enumerate(pairs) if dataclasses.is_dataclass(pair[0])]
    return next(filter(None, (difference(a, b, inner) for inner, a, b in parts)), key)
