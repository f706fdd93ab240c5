"""The state at the end of a run, from which a longer run of the same scene goes on, the same to the bit."""

import dataclasses
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from datasets.errors import InputError
from datasets.files import replacing
from datasets.frames import read_arrays
from datasets.reading import json_object
from datasets.records import Record, from_mapping
from datasets.scene import Scene
from mpm.arrays.batch import Batch
from mpm.arrays.features import Features
from mpm.arrays.layout import Contact, Energy, Offset, Retained
from mpm.output.request import Recording

LARGEST = 2**31 - 1
"""Of what 32 bits count."""
ARRAYS = ("state", "order", "energy", "impulse", "positions", "fields", "retained", "settling")


@dataclass(frozen=True, kw_only=True)
class Progress(Record):
    """How far a run came: what of `Checkpoint` stands as JSON under `run`."""

    frame: int
    rest: int
    steps: int
    clamped: int
    wall_s: float

    def __post_init__(self) -> None:
        if not (0 <= self.rest <= self.frame and min(self.steps, self.clamped, self.wall_s) >= 0):
            raise InputError("expected numbers of at least 0, and rest not after the frame", key="run")
        if max(self.steps, self.clamped) > LARGEST:
            raise InputError(f"expected numbers up to {LARGEST}", key="run")


@dataclass(frozen=True, kw_only=True)
class Checkpoint:
    """A run of one scene up to a frame, in the precision of the solver, with all that it has recorded so far."""

    scene: Scene
    features: Features
    """What the run was compiled for."""
    recording: Recording
    frame: int
    """The last frame that was computed."""
    rest: int
    """The frame in which the scene was found at rest, 0 while it moves."""
    steps: int
    """Steps so far."""
    clamped: int
    """How often a particle was put back into the box."""
    wall_s: float
    """What all parts of the run have taken so far [s]."""
    state: NDArray[Any]
    """The particles in the order of memory, shape [blocks, vectors, lanes]; see `mpm.arrays.layout.Features`."""
    order: NDArray[np.int32]
    """Which particle lies in which lane, shape [blocks lanes]."""
    energy: NDArray[np.float64]
    """Shape [frame + 1, len(Energy)]."""
    impulse: NDArray[np.float64]
    """Momentum that each solid took in each frame [N s, per metre of width in 2D], shape [frame + 1, solids, D]."""
    positions: NDArray[np.float32]
    """Of the kept frames up to `frame` [m], shape [T, N, D]."""
    fields: NDArray[np.float32]
    """As the particles carry them, shape [T, N, `Features.recorded`]."""
    retained: NDArray[np.int32]
    """Masses behind barriers, a line each (`mpm.arrays.layout.Retained`)."""
    settling: NDArray[np.float64]
    """What is known of how they settle, a line each (`mpm.arrays.layout.Settling`)."""

    @staticmethod
    def from_batch(batch: Batch, *, wall_s: float) -> "Checkpoint":
        """The state of a batch of one scene; a copy."""
        offset, first = batch.offsets[0], int(batch.offsets[0, Offset.IMPULSE])
        frame = int(offset[Offset.REST]) or batch.computed
        kept, solids = sum(number <= frame for number in batch.kept(0)), int(offset[Offset.SOLIDS])
        return Checkpoint(
            scene=batch.scenes[0],
            features=batch.features,
            recording=batch.recording,
            frame=frame,
            rest=int(offset[Offset.REST]),
            steps=int(offset[Offset.STEPS]),
            clamped=int(batch.clamped.sum()),
            wall_s=wall_s,
            state=batch.state_of(0).copy(),
            order=batch.order.copy(),
            energy=batch.energies(0)[: frame + 1].copy(),
            impulse=batch.recorded_impulse[first:][: (frame + 1) * solids]
            .reshape(frame + 1, solids, batch.features.dimension)
            .copy(),
            positions=batch.recorded(0)[:kept],
            fields=batch.recorded_fields(0)[:kept],
            retained=batch.retained.copy(),
            settling=batch.settling.copy(),
        )

    def restore(self, batch: Batch) -> None:
        """Bring a batch of one scene, as it is at its start, to where this run ended.

        Raises InputError, which names the key, where the run is one of another scene, recording or precision.
        """
        (scene,) = batch.scenes
        if key := difference(dataclasses.replace(self.scene, duration=scene.duration), scene):
            raise InputError("expected the scene of the checkpoint, for another duration at most", key=key)
        if scene.frames - 1 < self.frame:
            end = self.scene.frame_dt * self.frame
            raise InputError(
                f"expected at least the {end:g} s of the checkpoint, got {scene.duration:g}", key="duration"
            )
        if key := difference(self.recording, batch.recording):
            raise InputError("expected what the checkpoint was recorded with", key=key)
        if key := difference(dataclasses.replace(self.features, shared=batch.features.shared), batch.features):
            own, theirs = getattr(batch.features, key), getattr(self.features, key)
            raise InputError(f"expected {theirs} as in the checkpoint, got {own}", key=key)
        self.check_arrays(batch)
        kept, solids = sum(number <= self.frame for number in batch.kept(0)), self.impulse.shape[1]
        offset, first = batch.offsets[0], int(batch.offsets[0, Offset.IMPULSE])
        offset[Offset.REST], offset[Offset.STEPS], batch.clamped[0] = self.rest, self.steps, self.clamped
        batch.computed = self.frame
        batch.state_of(0)[:] = self.state
        batch.order[:] = self.order
        batch.retained[:], batch.settling[:] = self.retained, self.settling
        batch.energies(0)[: self.frame + 1] = self.energy
        batch.recorded_impulse[first:][: (self.frame + 1) * solids] = self.impulse.reshape(-1, self.impulse.shape[2])
        # The last frame of a shorter run may be none that a longer one keeps.
        batch.recorded(0)[:kept] = self.positions[:kept]
        batch.recorded_fields(0)[:kept] = self.fields[:kept]

    def check_arrays(self, batch: Batch) -> None:
        """Raise InputError for arrays that are none of a run of `batch`: the kernels believe what they hold."""
        features, state, count = batch.features, batch.state_of(0), len(batch.particles[0].positions)
        dimension, solids = features.dimension, int(batch.offsets[0, Offset.SOLIDS])
        # The last frame of a shorter run may be none that a longer one keeps.
        kept = [len(self.recording.kept(self.scene.frames)), sum(number <= self.frame for number in batch.kept(0))]
        frames = self.positions.shape[0] if self.positions.ndim else 0
        expected: dict[str, tuple[tuple[int, ...], Any]] = {
            "state": (state.shape, state.dtype),
            "order": (batch.order.shape, np.int32),
            "energy": ((self.frame + 1, len(Energy)), np.float64),
            "impulse": ((self.frame + 1, solids, dimension), np.float64),
            "positions": ((frames, count, dimension), np.float32),
            "fields": ((frames, count, features.recorded), np.float32),
            "retained": (batch.retained.shape, np.int32),
            "settling": (batch.settling.shape, np.float64),
        }
        for key, (shape, kind) in expected.items():
            array = getattr(self, key)
            if array.shape != shape or array.dtype != kind:
                got = f"{array.dtype} of shape {array.shape}"
                raise InputError(f"expected {np.dtype(kind)} of shape {shape}, got {got}", key=key)
            if array.dtype.kind == "f" and not np.isfinite(array).all():
                raise InputError("expected finite numbers", key=key)
        if not kept[1] <= frames <= max(kept):
            raise InputError(f"expected {kept[1]} frames, got {frames}", key="positions")
        whole = np.array_equal(np.sort(self.order[:count]), np.arange(count))
        if not whole or self.order.min() < 0 or self.order.max() >= count:
            raise InputError("expected each particle once", key="order")
        if not np.array_equal(self.retained[:, : Retained.RELEASE + 1], batch.retained[:, : Retained.RELEASE + 1]):
            raise InputError("expected the masses behind barriers of the scene", key="retained")
        numbers = np.moveaxis(self.state, 1, 0).reshape(features.block, -1)
        present = numbers[features.present]
        if not np.isin(present, (0.0, 1.0)).all():
            raise InputError("expected particles that are there or not", key="state")
        cell = self.scene.domain.cell
        upper = np.array(self.scene.domain.size)[:, None] + cell
        beyond = (numbers[:dimension] < -cell) | (numbers[:dimension] > upper)
        if (beyond & (present == 1.0)).any():
            raise InputError("expected particles inside the domain", key="state")
        if features.contact:
            face = numbers[features.contacts + Contact.FACE]
            if face.min() < 0.0 or face.max() >= len(batch.faces):
                raise InputError(f"expected the numbers of {len(batch.faces)} faces", key="state")

    def save(self, path: Path) -> None:
        """Write an NPZ of plain arrays and JSON strings."""
        recording = dataclasses.asdict(self.recording)
        with replacing(path) as part:
            np.savez(
                part,
                scene=np.array(self.scene.to_json()),
                features=np.array(json.dumps(dataclasses.asdict(self.features))),
                recording=np.array(json.dumps(recording | {"fields": sorted(recording["fields"])})),
                run=np.array(
                    json.dumps({each.name: getattr(self, each.name) for each in dataclasses.fields(Progress)})
                ),
                **{key: getattr(self, key) for key in ARRAYS},
            )

    @staticmethod
    def load(path: Path) -> "Checkpoint":
        """Read what `save` wrote; never runs a pickle. Raises InputError, which names the file."""
        arrays: dict[str, Any] = read_arrays(path, what="a checkpoint")
        try:
            for key in ("scene", "features", "recording", "run", *ARRAYS):
                if key not in arrays:
                    raise InputError("expected a checkpoint of this version of Talus, the key is missing", key=key)
            run = from_mapping(Progress, json_object(str(arrays["run"])))
            return Checkpoint(
                scene=Scene.from_json(str(arrays["scene"])),
                features=from_mapping(Features, json_object(str(arrays["features"]))),
                recording=from_mapping(Recording, json_object(str(arrays["recording"]))),
                **dataclasses.asdict(run),
                **{key: arrays[key] for key in ARRAYS},
            )
        except InputError as error:
            raise error.at(str(path)) from None


def difference(one: Any, other: Any, key: str = "") -> str:
    """The first key, such as `masses[0].size`, in which two values differ; empty where they are equal."""
    if one == other:
        return ""
    if dataclasses.is_dataclass(one) and type(one) is type(other):
        for each in dataclasses.fields(one):
            inner = difference(getattr(one, each.name), getattr(other, each.name), f"{key}.{each.name}".lstrip("."))
            if inner:
                return inner
    if isinstance(one, tuple) and isinstance(other, tuple) and len(one) == len(other):
        for index, (own, theirs) in enumerate(zip(one, other, strict=True)):
            if dataclasses.is_dataclass(own) and (inner := difference(own, theirs, f"{key}[{index}]")):
                return inner
    return key
