"""Trajectory: the motion of all particles of one scene, in memory and as a plain NPZ or HDF5 file."""

import json
import webbrowser
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

import numpy as np
from numpy.typing import NDArray

from datasets.errors import naming, require
from datasets.files import GREATEST, json_object
from datasets.flow.array_files import HDF5, FrameWriter, open_frames, read_arrays, write_npz
from datasets.scene import Scene, keyed
from datasets.scene.particles import particle_volumes

Floats = NDArray[np.float32]

SUFFIXES = (".npz", HDF5)  # of the files of trajectories
STORED: dict[str, tuple[type, str]] = {
    "time": (np.float64, "T"),
    "velocity0": (np.float32, "ND"),
    "friction": (np.float32, "N"),
    "mass": (np.int32, "N"),
    "volume": (np.float32, "N"),
    "entry_time": (np.float64, "N"),
    "velocities": (np.float32, "TND"),
    "stress": (np.float32, "TNS"),
    "pressure": (np.float32, "TN"),
    "plastic_strain": (np.float32, "TN"),
    "pore_pressure": (np.float32, "TN"),
    "solid_impulse": (np.float64, "TBD"),
}
"""Array (except positions) -> stored type and axes: T frames, N particles, D dimensions, S stresses, B solids."""
REQUIRED = ("positions", "time", "velocity0", "friction", "scene")


@dataclass(frozen=True, kw_only=True)
class Trajectory:
    """The motion of the particles of a scene, frame by frame, from the MPM or the GNS.

    For example:

        flow = mpm.simulate(scene)
        flow.save("flow.npz")
        flow = read_trajectory("flow.npz")
        x = flow.positions[-1, :, 0]  # of every particle of the deposit [m]
    """

    positions: Floats
    """Positions [m], shape [T, N, D]; T is the number of kept frames, which need not include the start."""
    time: NDArray[np.float64]
    """Time of each of these frames [s], shape [T]."""
    velocity0: Floats
    """Initial velocity of each particle [m/s], shape [N, D]."""
    friction: Floats
    """tan(phi) of each particle [-], shape [N]."""
    scene: Scene
    """The scene of the flow; its `frame_dt` is that of `time`, unless not all frames were kept."""
    summary: dict[str, Any] = field(default_factory=dict)
    """Cost and results: steps, wall seconds, energies, runout; see `mpm.output.outcome`."""
    volume: Floats | None = None
    """Initial volume of each particle [m^D], shape [N]; None if it is that of the scene's own particles."""
    mass: NDArray[np.int32] | None = None
    """Index of the scene's mass of each particle, shape [N]; None if the particles are the scene's own."""
    entry_time: NDArray[np.float64] | None = None
    """Time at which each particle enters [s], shape [N]: until then it waits at its place of entry, outside the flow;
    its initial velocity is that at entry. None if all are present from the start."""
    velocities: Floats | None = None
    """Velocities [m/s], shape [T, N, D]."""
    stress: Floats | None = None
    """Cauchy stress [Pa], tension positive, shape [T, N, S]: xx, yy, zz, xy and, in 3D, yz, zx; S is 4 or 6."""
    pressure: Floats | None = None
    """Mean compressive stress -tr(sigma)/3 [Pa], compression positive, shape [T, N]."""
    plastic_strain: Floats | None = None
    """Accumulated equivalent deviatoric plastic strain [-], shape [T, N]."""
    pore_pressure: Floats | None = None
    """Pressure of the water in the pores [Pa], shape [T, N]; `stress` and `pressure` are then those of the grains."""
    solid_impulse: NDArray[np.float64] | None = None
    """Momentum given to each solid since the start [N s, in 2D per metre of width], shape [T, B, D].

    The solids are those of `solid_names`, in that order. The derivative is the force on them (`datasets.forces`).
    """

    @property
    def volumes(self) -> NDArray[np.float64]:
        """Initial volume of each particle [m^D], shape [N]: as given, else `particle_volumes` of the scene."""
        if self.volume is not None:
            return self.volume.astype(np.float64)
        return particle_volumes(self.scene, self.positions.shape[1])

    def entered(self, time: float) -> NDArray[np.bool_]:
        """Which particles are part of the flow at a time [s], shape [N]."""
        count = self.positions.shape[1]
        return np.full(count, True) if self.entry_time is None else np.asarray(self.entry_time <= time)

    def ending(self, summary: dict[str, Any]) -> "Trajectory":
        """Only the last frame, with an extended summary and only the arrays over time of a run without fields."""
        over_time = ("positions", "time", "solid_impulse")
        last = {name: values[-1:] for name in over_time if (values := getattr(self, name)) is not None}
        return replace(self, **last, summary=self.summary | summary)

    @property
    def frame_dt(self) -> float:
        """Time between two kept frames [s], or the scene's if there is only one frame. Raises InputError if the frames
        are not evenly spaced in time."""
        if len(self.time) == 1:
            return self.scene.frame_dt
        steps = np.diff(self.time)
        require(bool(np.ptp(steps) <= 1.0e-6 * steps[0]), "time", "frames evenly spaced in time, they are not")
        return float((self.time[-1] - self.time[0]) / len(steps))

    def arrays(self) -> dict[str, NDArray[Any] | str]:
        """The contents of a file without the positions: all present fields; `scene` and `summary` as JSON."""
        values = {key: getattr(self, key) for key in STORED}
        stored = {key: array.astype(STORED[key][0], copy=False) for key, array in values.items() if array is not None}
        return {**stored, "scene": self.scene.to_json(), "summary": json.dumps(self.summary)}

    def save(self, path: str | Path) -> None:
        """Write an NPZ of plain arrays, or chunked HDF5 if the name ends in `.h5` (`datasets.flow.array_files`)."""
        path, arrays = Path(path), self.arrays()
        if path.suffix != HDF5:
            positions = np.asarray(self.positions, np.float32)
            write_npz(path, {"positions": positions, **{key: np.asarray(array) for key, array in arrays.items()}})
            return
        with FrameWriter(path) as file:
            for frame in range(len(self.time)):
                file.append(positions=np.asarray(self.positions[frame : frame + 1], np.float32))
            file.put(**arrays)

    def view(self, path: str | Path | None = None, *, other: "Trajectory | None" = None) -> Path:
        """Write one HTML page that any browser opens from disk; without a path, into a temporary folder, and open it.

            flow.view()
            flow.view("flow.html", other=gns.simulate("column-tall-42"))

        other: a flow to draw over this one. Returns the page's path. Raises InputError.
        """
        page = Path(mkdtemp(prefix="talus-")) / "flow.html" if path is None else Path(path)
        # The only late import of a higher module: the drawing module imports this one.
        from datasets.exchange.page import write_view

        write_view(page, self, other)
        if path is None:
            webbrowser.open(page.as_uri())
        return page

    @staticmethod
    def load(path: str | Path) -> "Trajectory":
        """Read a file of `save`; never executes a pickle. Raises InputError, which names the file and the key."""
        with naming(Path(path)):
            return _checked(read_arrays(Path(path)))


def open_trajectory(path: str | Path, *fields: str, sound: bool = False) -> Trajectory:
    """The trajectory at `path`, with positions read on use, and without the summary and recorded fields other than
    `fields`. Only the first and the last frame of the positions are checked; sound: all are, by the checksum of an NPZ.
    Raises InputError, which names the file and the key."""
    path = Path(path)
    needed = [key for key in REQUIRED if key != "positions"]
    arrays = read_arrays(path, *needed, optional=("volume", "mass", "entry_time", *fields))
    with naming(path):
        return _checked({**arrays, "positions": open_frames(path, "positions", sound=sound)}, lazily=True)


def _checked(arrays: Mapping[str, NDArray[Any]], *, lazily: bool = False) -> Trajectory:
    """The trajectory of these arrays. Raises InputError, which names the key."""
    for key in REQUIRED:
        require(key in arrays, key, "an array", "none: the key is missing")
    positions, scene = arrays["positions"], Scene.from_json(str(arrays["scene"]))
    fits = positions.ndim == 3 and positions.shape[2] in (2, 3) and positions.size > 0
    require(fits, "positions", "shape [T, N, 2 or 3], at least one frame of one particle", positions.shape)
    frames, particles, dimension = positions.shape
    sizes = {"T": frames, "N": particles, "D": dimension, "S": 2 * dimension, "B": len(solid_names(scene))}
    for key, (kind, axes) in {"positions": (np.float32, "TND"), **STORED}.items():
        if key in arrays:
            shape, array = tuple(sizes[axis] for axis in axes), arrays[key]
            require(array.shape == shape, key, f"shape {shape}", array.shape)
            expected, parent = ("integers", np.integer) if kind is np.int32 else ("floating-point numbers", np.floating)
            require(np.issubdtype(array.dtype, parent), key, expected, array.dtype)
    require(scene.dimension == dimension, "positions", f"{scene.dimension}D positions as in the scene", f"{dimension}D")
    frames_read = (positions[0], positions[-1]) if lazily else (positions,)
    for key, array in (("velocity0", arrays["velocity0"]), *(("positions", part) for part in frames_read)):
        require(bool((np.abs(array) < GREATEST).all()), key, "finite numbers", "others")
    time = arrays["time"]
    ascending = np.isfinite(time).all() and time[0] >= 0.0 and (np.diff(time) > 0.0).all()
    require(bool(ascending), "time", "ascending times of at least 0 s", "others")
    of_masses = f"the index of one of {len(scene.masses)} masses for each of {particles} particles"
    for key, holds, expected in (
        ("friction", lambda array: np.isfinite(array) & (array >= 0.0), "tan(phi) of at least 0"),
        ("volume", lambda array: np.isfinite(array) & (array > 0.0), "positive volumes"),
        ("entry_time", np.isfinite, "finite times"),
        ("mass", lambda array: (array >= 0) & (array < len(scene.masses)), of_masses),
    ):
        require(key not in arrays or bool(holds(arrays[key]).all()), key, expected, "others")
    return Trajectory(
        positions=positions if lazily and positions.dtype == np.float32 else np.asarray(positions, np.float32),
        scene=scene,
        summary=json_object(str(arrays.get("summary", "{}")), "summary"),
        **{key: arrays[key].astype(kind, copy=False) for key, (kind, _) in STORED.items() if key in arrays},
    )


def brackets(time: NDArray[np.float64], times: NDArray[np.float64]) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """For each of `times`, the frame before it and its fraction of the interval to the next one, both of shape [M]."""
    times = np.clip(times, time[0], time[-1])
    before = np.clip(np.searchsorted(time, times, side="right") - 1, 0, max(0, len(time) - 2))
    if len(time) == 1:
        return before, np.zeros(len(times))
    return before, (times - time[before]) / (time[before + 1] - time[before])


def solid_names(scene: Scene) -> tuple[str, ...]:
    """The names of a scene's baffles and solids, in the order of the recorded impulses."""
    return tuple(getattr(solid, "name", None) or key for key, solid in keyed(scene, "baffles", "solids").items())


def read_trajectory(path: str | Path) -> Trajectory:
    """Read the trajectory at a path, or in the folder of a run. Raises InputError, which names file and key."""
    return Trajectory.load(trajectory_file(path))


def trajectory_file(path: str | Path) -> Path:
    """The file of a trajectory at a path, or in the folder of a run."""
    path = Path(path)
    if not path.is_dir():
        return path
    candidate = path / f"trajectory{HDF5}"
    return candidate if candidate.exists() else path / "trajectory.npz"


def trajectory_files(folder: Path) -> list[Path]:
    """The trajectories in a folder, sorted by name; partial files of killed processes start with a dot."""
    return sorted(path for suffix in SUFFIXES for path in folder.glob(f"[!.]*{suffix}"))


def stored_scene(path: Path) -> Scene:
    """The scene of a saved trajectory, without reading its positions. Raises InputError."""
    with naming(path):
        return Scene.from_json(str(read_arrays(path, "scene")["scene"]))
