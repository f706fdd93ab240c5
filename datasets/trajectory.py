"""Trajectory: the motion of all points of one scene, in memory and as a plain NPZ file."""

import json
import zipfile
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from datasets.errors import InputError
from datasets.files import replacing
from datasets.scene import Scene

Floats = NDArray[np.float32]


@dataclass(frozen=True, kw_only=True)
class Trajectory:
    """What a simulation saw, frame by frame; from the MPM or from the GNS alike."""

    positions: Floats
    """Positions [m], shape [T, N, D]."""
    time: NDArray[np.float64]
    """Time of each frame [s], shape [T]."""
    velocity0: Floats
    """Initial velocity of each point [m/s], shape [N, D]."""
    friction: Floats
    """tan(phi) of each point [-], shape [N]."""
    scene: Scene
    """The scene it came from."""
    summary: dict[str, Any] = field(default_factory=dict)
    """What it cost and came to: steps, wall seconds, energies, runout; see `mpm.summary`."""

    def save(self, path: Path) -> None:
        """Write an NPZ of plain arrays; `scene` and `summary` as JSON strings."""
        with replacing(path) as part:
            np.savez(
                part,
                positions=self.positions.astype(np.float32, copy=False),
                time=self.time.astype(np.float64, copy=False),
                velocity0=self.velocity0.astype(np.float32, copy=False),
                friction=self.friction.astype(np.float32, copy=False),
                scene=np.array(self.scene.to_json()),
                summary=np.array(json.dumps(self.summary)),
            )

    @staticmethod
    def load(path: Path) -> "Trajectory":
        """Read what `save` wrote; never runs a pickle. Raises InputError, which names the file and the key."""
        arrays = read_arrays(path)
        for key in ("positions", "time", "velocity0", "friction", "scene"):
            if key not in arrays:
                raise InputError("expected an array, the key is missing", where=str(path), key=key)
        positions = arrays["positions"]
        if positions.ndim != 3 or positions.shape[2] not in (2, 3):
            raise InputError(f"expected shape [T, N, 2 or 3], got {positions.shape}", where=str(path), key="positions")
        frames, points, dimension = positions.shape
        for key, shape in (("time", (frames,)), ("velocity0", (points, dimension)), ("friction", (points,))):
            if arrays[key].shape != shape:
                raise InputError(f"expected shape {shape}, got {arrays[key].shape}", where=str(path), key=key)
        for key in ("positions", "time", "velocity0", "friction"):
            if not np.issubdtype(arrays[key].dtype, np.floating):
                raise InputError(f"expected floating-point numbers, got {arrays[key].dtype}", where=str(path), key=key)
        scene = scene_in(arrays["scene"], path)
        if scene.dimension != dimension:
            raise InputError(
                f"expected {scene.dimension}D positions as in the scene, got {dimension}D",
                where=str(path),
                key="positions",
            )
        try:
            summary = json.loads(str(arrays["summary"])) if "summary" in arrays else {}
        except json.JSONDecodeError as error:
            raise InputError(f"expected JSON, {error}", where=str(path), key="summary") from None
        return Trajectory(
            positions=positions.astype(np.float32, copy=False),
            time=arrays["time"].astype(np.float64, copy=False),
            velocity0=arrays["velocity0"].astype(np.float32, copy=False),
            friction=arrays["friction"].astype(np.float32, copy=False),
            scene=scene,
            summary=summary,
        )


def stored_scene(path: Path) -> Scene:
    """The scene of a saved trajectory, without reading its positions. Raises InputError."""
    return scene_in(read_arrays(path, "scene")["scene"], path)


def read_arrays(path: Path, *names: str) -> dict[str, NDArray[Any]]:
    """The arrays `names` of an NPZ, all of them where none is named; never runs a pickle. Raises InputError."""
    try:
        # Opened here, because numpy leaves its own handle open where the archive is broken.
        with path.open("rb") as raw:
            file = np.load(raw, allow_pickle=False)
            if not isinstance(file, np.lib.npyio.NpzFile):
                raise ValueError("found a single array")
            return {name: file[name] for name in names or file.files}
    except FileNotFoundError:
        raise InputError("expected a trajectory (NPZ), there is none", where=str(path)) from None
    except (OSError, ValueError, EOFError, zipfile.BadZipFile, KeyError) as error:
        raise InputError(f"expected a whole NPZ of plain arrays, {error}", where=str(path)) from None


def scene_in(array: NDArray[Any], path: Path) -> Scene:
    """The scene in the array `scene` of the NPZ at `path`. Raises InputError."""
    try:
        return Scene.from_json(str(array))
    except InputError as error:
        raise error.at(str(path)) from None
