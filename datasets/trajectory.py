"""Trajectory: the motion of all particles of one scene, in memory and as a plain NPZ file."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from datasets.arrays import open_hdf5, open_npz, plain_array
from datasets.compressed import SUFFIX, read_compressed, write_compressed
from datasets.errors import InputError
from datasets.files import replacing
from datasets.particles import initial_volumes, particle_count
from datasets.reading import json_object
from datasets.scene import Scene

Floats = NDArray[np.float32]

SUFFIXES = (".npz", SUFFIX)
"""Of the files of trajectories."""
FARTHEST = 1.0e12
"""Positions [m] and velocities [m/s] beyond this are none: their squares would not fit into single precision."""
FIELDS = {
    "volume": np.float32,
    "velocities": np.float32,
    "stress": np.float32,
    "pressure": np.float32,
    "density": np.float32,
    "plastic_strain": np.float32,
    "solid_impulse": np.float64,
}
"""What a simulation may have recorded besides the positions, and as what it is stored."""


@dataclass(frozen=True, kw_only=True)
class Trajectory:
    """The motion of the particles of a scene, frame by frame; from the MPM or from the GNS alike.

    For example:

        flow = mpm.simulate(scene)
        flow.save(Path("flow.npz"))
        flow = read_trajectory("flow.npz")
        x = flow.positions[-1, :, 0]  # of every particle of the deposit [m]
    """

    positions: Floats
    """Positions [m], shape [T, N, D]; T counts the frames that were kept, which need not begin at the start."""
    time: NDArray[np.float64]
    """Time of each of these frames [s], shape [T]."""
    velocity0: Floats
    """Initial velocity of each particle [m/s], shape [N, D]."""
    friction: Floats
    """tan(phi) of each particle [-], shape [N]."""
    scene: Scene
    """The scene it came from; its `frame_dt` is that of `time`, unless not all frames were kept."""
    summary: dict[str, Any] = field(default_factory=dict)
    """What it cost and came to: steps, wall seconds, energies, runout; see `mpm.output.outcome`."""
    volume: Floats | None = None
    """Initial volume of each particle [m^D], shape [N]; absent where it is that of the scene's own particles.

    A learned simulator follows some of them, each with the volume of those that it stands for.
    """
    mass: NDArray[np.int32] | None = None
    """Index of the scene's mass of each particle, shape [N]; absent where the particles are the scene's."""
    velocities: Floats | None = None
    """Velocities [m/s], shape [T, N, D]."""
    stress: Floats | None = None
    """Cauchy stress [Pa], tension positive, shape [T, N, S]: xx, yy, zz, xy and, in 3D, yz, zx; S is 4 or 6."""
    pressure: Floats | None = None
    """Mean compressive stress -tr(sigma)/3 [Pa], compression positive, shape [T, N]."""
    density: Floats | None = None
    """Density of the deposit around each particle [kg/m^3], shape [T, N]."""
    plastic_strain: Floats | None = None
    """Accumulated equivalent deviatoric plastic strain [-], shape [T, N]."""
    solid_impulse: NDArray[np.float64] | None = None
    """Momentum given to each solid since the start [N s, in 2D per metre of width], shape [T, B, D].

    The solids are those of `solid_names`, in that order. The derivative is the force on them (`datasets.forces`).
    """

    @property
    def volumes(self) -> NDArray[np.float64]:
        """Initial volume of each particle [m^D], shape [N]: as given, else that of the scene's own particles.

        Of other particles than these (another code's) only the mean is known: the scene's volume over their number.
        """
        count = self.positions.shape[1]
        if self.volume is not None:
            return self.volume.astype(np.float64)
        if particle_count(self.scene) == count:
            return initial_volumes(self.scene)
        return np.full(count, initial_volumes(self.scene).sum() / count)

    @property
    def frame_dt(self) -> float:
        """Time between two frames that were kept [s], the scene's where there is one frame alone.

        Raises InputError where the frames are not evenly spaced in time.
        """
        if len(self.time) == 1:
            return self.scene.frame_dt
        steps = np.diff(self.time)
        if np.ptp(steps) > 1.0e-6 * steps[0]:
            raise InputError("expected frames evenly spaced in time, they are not", key="time")
        return float((self.time[-1] - self.time[0]) / len(steps))

    @property
    def baffle_impulse(self) -> NDArray[np.float64] | None:
        """Of `solid_impulse` that of the baffles, which come first, shape [T, B, D]."""
        return None if self.solid_impulse is None else self.solid_impulse[:, : len(self.scene.baffles)]

    def save(self, path: Path) -> None:
        """Write an NPZ of plain arrays; `scene` and `summary` as JSON strings; of the fields those that there are.

        The same in HDF5, compressed (`datasets.compressed`), for a name in `.h5`: positions to a part of a cell.
        """
        names = {key: key for key in FIELDS} | {"solid_impulse": impulse_key(self.scene)}
        fields: dict[str, tuple[NDArray[Any] | None, type]] = {"mass": (self.mass, np.int32)}
        fields |= {names[key]: (getattr(self, key), kind) for key, kind in FIELDS.items()}
        recorded: dict[str, Any] = {
            key: array.astype(kind, copy=False) for key, (array, kind) in fields.items() if array is not None
        }
        arrays: dict[str, Any] = {
            "positions": self.positions.astype(np.float32, copy=False),
            "time": self.time.astype(np.float64, copy=False),
            "velocity0": self.velocity0.astype(np.float32, copy=False),
            "friction": self.friction.astype(np.float32, copy=False),
            "scene": np.array(self.scene.to_json()),
            "summary": np.array(json.dumps(self.summary)),
            **recorded,
        }
        with replacing(path) as part:
            if path.suffix == SUFFIX:
                write_compressed(part, arrays, self.scene.domain.cell)
            else:
                np.savez(part, **arrays)

    @staticmethod
    def load(path: Path) -> "Trajectory":
        """Read what `save` wrote; never runs a pickle. Raises InputError, which names the file and the key."""
        arrays = read_arrays(path)
        for key in ("positions", "time", "velocity0", "friction", "scene"):
            if key not in arrays:
                raise InputError("expected an array, the key is missing", where=str(path), key=key)
        positions = arrays["positions"]
        if positions.ndim != 3 or positions.shape[2] not in (2, 3) or positions.size == 0:
            expected = "shape [T, N, 2 or 3], at least one frame of one particle"
            raise InputError(f"expected {expected}, got {positions.shape}", where=str(path), key="positions")
        frames, particles, dimension = positions.shape
        scene = scene_in(arrays["scene"], path)
        shapes: dict[str, tuple[int, ...]] = {
            "positions": positions.shape,
            "time": (frames,),
            "velocity0": (particles, dimension),
            "friction": (particles,),
            "volume": (particles,),
            "velocities": positions.shape,
            "stress": (frames, particles, 4 if dimension == 2 else 6),
            "pressure": (frames, particles),
            "density": (frames, particles),
            "plastic_strain": (frames, particles),
            impulse_key(scene): (frames, len(solid_names(scene)), dimension),
        }
        for key, shape in shapes.items():
            if key not in arrays:
                continue
            if arrays[key].shape != shape:
                raise InputError(f"expected shape {shape}, got {arrays[key].shape}", where=str(path), key=key)
            if not np.issubdtype(arrays[key].dtype, np.floating):
                raise InputError(f"expected floating-point numbers, got {arrays[key].dtype}", where=str(path), key=key)
        if scene.dimension != dimension:
            raise InputError(
                f"expected {scene.dimension}D positions as in the scene, got {dimension}D",
                where=str(path),
                key="positions",
            )
        check_numbers(arrays, path)
        mass = checked_mass(arrays.get("mass"), particles, scene, path)
        try:
            summary = json_object(str(arrays["summary"])) if "summary" in arrays else {}
        except InputError as error:
            raise InputError(error.message, where=str(path), key="summary") from None
        return Trajectory(
            positions=positions.astype(np.float32, copy=False),
            time=arrays["time"].astype(np.float64, copy=False),
            velocity0=arrays["velocity0"].astype(np.float32, copy=False),
            friction=arrays["friction"].astype(np.float32, copy=False),
            scene=scene,
            summary=summary,
            mass=mass,
            **{
                key: arrays[name].astype(kind, copy=False)
                for key, kind in FIELDS.items()
                if (name := impulse_key(scene) if key == "solid_impulse" else key) in arrays
            },
        )


def check_numbers(arrays: Mapping[str, NDArray[Any]], path: Path) -> None:
    """Raise InputError for numbers of the NPZ at `path`, those that are there, that are none of any motion."""

    def require(ok: bool, key: str, expected: str) -> None:
        if not ok:
            raise InputError(f"expected {expected}, got others", where=str(path), key=key)

    for key in ("positions", "velocity0"):
        if key in arrays:
            require(bool((np.abs(arrays[key]) < FARTHEST).all()), key, "finite numbers")
    time, friction = arrays["time"], arrays["friction"]
    ascending = np.isfinite(time).all() and time[0] >= 0.0 and (np.diff(time) > 0.0).all()
    require(bool(ascending), "time", "ascending times of at least 0 s")
    require(bool((np.isfinite(friction) & (friction >= 0.0)).all()), "friction", "tan(phi) of at least 0")
    if (volume := arrays.get("volume")) is not None:
        require(bool((np.isfinite(volume) & (volume > 0.0)).all()), "volume", "positive volumes")


def checked_mass(array: NDArray[Any] | None, particles: int, scene: Scene, path: Path) -> NDArray[np.int32] | None:
    """The index of the mass of each particle, as the NPZ at `path` has it. Raises InputError."""
    if array is None:
        return None
    whole = np.issubdtype(array.dtype, np.integer) and array.shape == (particles,)
    if not whole or array.min() < 0 or array.max() >= len(scene.masses):
        expected = f"the index of one of {len(scene.masses)} masses for each of {particles} particles"
        raise InputError(f"expected {expected}", where=str(path), key="mass")
    return array.astype(np.int32, copy=False)


def solid_names(scene: Scene) -> tuple[str, ...]:
    """The names of what stands fixed in a scene's flow, in the order in which impulses are recorded."""
    baffles = (f"baffles[{index}]" for index in range(len(scene.baffles)))
    return (*baffles, *(solid.name or f"solids[{index}]" for index, solid in enumerate(scene.solids)))


def impulse_key(scene: Scene) -> str:
    """The key in an NPZ of `Trajectory.solid_impulse`: that of older files where there are no solids but baffles."""
    return "solid_impulse" if scene.solids else "baffle_impulse"


def read_trajectory(path: str | Path) -> Trajectory:
    """Read the trajectory at a path, or in the folder of a run.

    For example:

        flow = read_trajectory("results")  # results/trajectory.npz

    Raises InputError, which names the file and the key.
    """
    return Trajectory.load(trajectory_file(path))


def trajectory_file(path: str | Path) -> Path:
    """The file of a trajectory: at a path, or in the folder of a run."""
    path = Path(path)
    if not path.is_dir():
        return path
    found = path / f"trajectory{SUFFIX}"
    return found if found.exists() else path / "trajectory.npz"


def trajectory_files(folder: Path) -> list[Path]:
    """The trajectories in a folder by name; parts of files that a killed process left begin with a dot."""
    return sorted(path for suffix in SUFFIXES for path in folder.glob(f"[!.]*{suffix}"))


def stored_scene(path: Path) -> Scene:
    """The scene of a saved trajectory, without reading its positions. Raises InputError."""
    return scene_in(read_arrays(path, "scene")["scene"], path)


def stored_shape(path: Path, key: str) -> tuple[int, ...]:
    """The shape of an array of a saved trajectory, without reading it. Raises InputError."""
    if path.suffix == SUFFIX:
        with open_hdf5(path) as file:
            return tuple(plain_array(file, key).shape)
    with open_npz(path) as archive:
        return archive.shape(key)


def read_arrays(
    path: Path, *names: str, optional: tuple[str, ...] = (), what: str = "a trajectory"
) -> dict[str, NDArray[Any]]:
    """The arrays `names` of an NPZ, or of a compressed trajectory, and, where they are there, `optional`; all where

    none is named. Never runs a pickle. Raises InputError.
    """
    if path.suffix == SUFFIX:
        return read_compressed(path, *names, optional=optional)
    with open_npz(path, f"a whole NPZ of plain arrays ({what})") as file:
        there = [name for name in optional if name in file.keys]
        return {name: file.read(name) for name in (*names, *there) or file.keys}


def scene_in(array: NDArray[Any], path: Path) -> Scene:
    """The scene in the array `scene` of the NPZ at `path`. Raises InputError."""
    try:
        return Scene.from_json(str(array))
    except InputError as error:
        raise error.at(str(path)) from None
