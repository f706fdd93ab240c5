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
from datasets.scene import Scene
from datasets.trajectory import read_arrays
from mpm.arrays.batch import Batch
from mpm.arrays.features import Features
from mpm.arrays.layout import Offset
from mpm.output.request import Recording

ARRAYS = ("state", "order", "energy", "impulse", "positions", "fields", "retained", "settling")
PLAIN = ("frame", "rest", "steps", "clamped", "wall_s")


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
            positions=batch.recorded(0)[:kept].copy(),
            fields=batch.recorded_fields(0)[:kept].copy(),
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
        if self.state.shape != batch.state_of(0).shape or self.retained.shape != batch.retained.shape:
            raise InputError("expected a checkpoint of this version of Talus, it holds another state", key="state")
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

    def save(self, path: Path) -> None:
        """Write an NPZ of plain arrays and JSON strings."""
        recording = dataclasses.asdict(self.recording)
        with replacing(path) as part:
            np.savez(
                part,
                scene=np.array(self.scene.to_json()),
                features=np.array(json.dumps(dataclasses.asdict(self.features))),
                recording=np.array(json.dumps(recording | {"fields": sorted(recording["fields"])})),
                run=np.array(json.dumps({key: getattr(self, key) for key in PLAIN})),
                **{key: getattr(self, key) for key in ARRAYS},
            )

    @staticmethod
    def load(path: Path) -> "Checkpoint":
        """Read what `save` wrote; never runs a pickle. Raises InputError, which names the file."""
        arrays: dict[str, Any] = read_arrays(path, what="a checkpoint")
        try:
            return Checkpoint(
                scene=Scene.from_json(str(arrays["scene"])),
                features=Features(**json.loads(str(arrays["features"]))),
                recording=Recording(**json.loads(str(arrays["recording"]))),
                **json.loads(str(arrays["run"])),
                **{key: arrays[key] for key in ARRAYS},
            )
        except InputError as error:
            raise error.at(str(path)) from None
        except (KeyError, TypeError, ValueError) as error:
            raise InputError(f"expected a checkpoint of this version of Talus, {error}", where=str(path)) from None


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
