"""python -m datasets.exchange DATASET --to geoelements, or --from geoelements: datasets in the layout of that code.

One trajectory is in memory at a time. The other code's files contain no scene: all its trajectories get the scene that
the user gives, with box, obstacles and material; each has the angle of its particles and the box in which they start.
"""

import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from cyclopts import Parameter
from scipy.spatial import cKDTree
from tqdm import tqdm

from datasets.command_line import run
from datasets.definitions.definition import Entry, Split
from datasets.definitions.training import MotionStatistics, metadata, motion_statistics
from datasets.errors import InputError, naming, require
from datasets.exchange import geoelements
from datasets.exchange.geoelements import Sand
from datasets.files import read_json, write_json
from datasets.flow.measures import extents
from datasets.flow.trajectory import Trajectory, open_trajectory, trajectory_files
from datasets.scene import Mass, Scene
from datasets.scene.grid_field import Floats
from datasets.scene.library import read_scene
from datasets.schema import Record, from_mapping

STATISTICS = ("default_connectivity_radius", "vel_mean", "vel_std", "acc_mean", "acc_std")
"""Keys that both versions of `metadata.json` share."""
CLOSE = 1.0e-6  # relative difference of two boxes within rounding


@dataclass(frozen=True, kw_only=True)
class ForeignMetadata(Record):
    """The keys of the other code's `metadata.json` that Talus uses."""

    bounds: tuple[tuple[float, float], ...]  # lower and upper end of the box per axis [m]
    dt: float  # time between frames [s]
    dx: float | None = None  # spacing of the particles [m], which Talus writes


def export(dataset: Path, out: Path) -> None:
    """Write a dataset to the folder `out` in the other layout. Raises InputError for trajectories that do not share
    box, frames and spacing, and if `out` is not empty."""
    files = {split: trajectory_files(dataset / split.value) for split in Split}
    described = described_as_theirs(dataset, files)
    check_empty(out)
    for split, paths in files.items():
        if paths:
            bar = tqdm(paths, desc=split.value, unit="trajectory", dynamic_ncols=True)
            geoelements.write(out / f"{split.value}.npz", ((path.stem, Trajectory.load(path)) for path in bar))
    write_json(out / "metadata.json", described)


def described_as_theirs(dataset: Path, files: Mapping[Split, Sequence[Path]]) -> dict[str, Any]:
    """The contents of the other code's `metadata.json`, from scenes and shapes only. Raises InputError."""
    content = read_metadata(dataset / "metadata.json")
    for key in STATISTICS:
        require(key in content, key, "a value, the key is missing", where=str(dataset / "metadata.json"))
    shared, paths = None, [path for split in Split for path in files[split]]
    for path in paths:
        flow = open_trajectory(path)
        scene = flow.scene
        require(not scene.open_sides, "scene", "a closed box, their format knows no other", where=str(path))
        this = (scene.domain.size, scene.frame_dt, len(flow.positions), scene.particle_spacing)
        expected = f"the box, time between frames, number of frames and spacing {shared} of {paths[0]}"
        require(shared is None or this == shared, "", expected, this, where=str(path))
        shared = this
    if shared is None:
        raise InputError("expected trajectories in train, valid or test, there are none", where=str(dataset))
    size, frame_dt, frames, spacing = shared
    return {
        "bounds": [[0.0, length] for length in size],
        "dim": len(size),
        "dt": frame_dt,
        "dx": spacing,
        **{key: content[key] for key in STATISTICS},
        "sequence_length": frames,
        "material_feature_len": 1,
        # Five velocities and two walls per axis, an embedding of the type, and the material.
        "nnode_in": 5 * len(size) + 2 * len(size) + 16 + 1,
        "nedge_in": len(size) + 1,
        "nmessage_passing_steps": 10,
    }


def import_dataset(source: Path, out: Path, *, scene: Scene, up: str) -> None:
    """Convert a dataset in the other layout into the folder `out`; scene: of all trajectories; up: the axis that points
    up. Raises InputError for another kind of dataset, and if `out` is not empty."""
    content = read_metadata(source / "metadata.json")
    check_empty(out)
    entries: list[Entry] = []
    statistics = MotionStatistics.from_samples(*np.empty((2, 0, scene.dimension)))
    for split in Split:
        path = source / f"{split.value}.npz"
        if not path.exists():
            continue
        # The file may describe a larger box for rollouts than for training.
        purpose = content.get("rollout" if split is Split.TEST else "train", content)
        values = {key: purpose[key] for key in ForeignMetadata.__dataclass_fields__ if key in purpose}
        with naming(source / "metadata.json"):
            foreign = from_mapping(ForeignMetadata, values)
        for name, sand in tqdm(geoelements.read(path), desc=split.value, unit="trajectory", dynamic_ncols=True):
            with naming(path, name):
                fits = Path(name).name == name and name[:1] not in ("", ".")
                require(fits, "", "a name that a file can have", repr(name))
                flow = trajectory_of(sand, scene, foreign, up)
            flow.save(out / split.value / f"{name}.npz")
            entries.append(Entry(split=split, name=name, scene=flow.scene))
            if split is entries[0].split:
                statistics += motion_statistics(flow.positions, flow.frame_dt)
    require(len(entries) > 0, "", "trajectories in train, valid or test.npz", where=str(source))
    content = metadata("geoelements", entries, seed=None, statistics=statistics)
    write_json(out / "metadata.json", {**content, "exchange": {"from": "geoelements", "source": str(source), "up": up}})


def trajectory_of(sand: Sand, scene: Scene, foreign: ForeignMetadata, up: str) -> Trajectory:
    """The trajectory of the imported sand, in `scene`; a particle has the volume of a lattice cell of the dataset's
    spacing, else of that in the first frame. Raises InputError if the scene has another box."""
    (positions, friction), bounds = sand, np.array(foreign.bounds)
    if up == "z":
        require(positions.shape[2] == 3, "", "a set in 3D for --up z")
        positions, bounds = positions[..., [0, 2, 1]], bounds[[0, 2, 1]]
    size = bounds[:, 1] - bounds[:, 0]
    same = len(size) == scene.dimension and np.allclose(size, scene.domain.size, rtol=CLOSE)
    require(same, "", f"a scene in the box of the set, {size.tolist()} m", f"{list(scene.domain.size)} m")
    positions = np.ascontiguousarray(positions - bounds[:, 0], dtype=np.float32)
    spacing = foreign.dx or float(np.median(cKDTree(positions[0]).query(positions[0], k=2)[0][:, 1]))
    require(0.0 < spacing < np.inf, "", "particles that are apart in the first frame", f"a spacing of {spacing:g} m")
    volume = np.full(positions.shape[1], spacing**scene.dimension, np.float32)
    velocity0 = ((positions[1] - positions[0]) / foreign.dt).astype(np.float32)
    scene = own_scene(scene, positions[0], velocity0, friction, spacing)
    friction = np.full(len(volume), scene.material.friction) if friction is None else friction
    return Trajectory(
        positions=positions,
        time=np.arange(len(positions), dtype=np.float64) * foreign.dt,
        velocity0=velocity0,
        friction=friction.astype(np.float32),
        volume=volume,
        scene=replace(scene, duration=(len(positions) - 1) * foreign.dt, frame_dt=foreign.dt),
        summary=extents(scene, positions[-1], volume),
    )


def own_scene(scene: Scene, places: Floats, velocities: Floats, friction: Floats | None, spacing: float) -> Scene:
    """The scene with the angle of the particles, if given, and a mass that fills the box of their first `places` [m],
    if they fill one: the ranges and units of a model follow from these."""
    if friction is not None and np.ptp(friction) <= CLOSE * abs(float(friction[0])):
        angle = float(np.degrees(np.arctan(friction[0])))
        scene = replace(scene, material=replace(scene.material, friction_deg=angle, angle="triaxial"))
    counts = np.maximum(np.round(np.ptp(places, axis=0) / spacing + 1.0), 1.0)
    if counts.prod() != len(places):
        return scene
    size = np.minimum(counts * spacing, scene.domain.size)
    lower = np.clip(places.mean(axis=0) - 0.5 * size, 0.0, np.array(scene.domain.size) - size)
    body = Mass(
        lower=tuple(lower.tolist()), size=tuple(size.tolist()), velocity=tuple(velocities.mean(axis=0).tolist())
    )
    try:
        return replace(scene, masses=(body,), fields=(), stages=())
    except InputError:
        # Rounding has put the mass into an obstacle.
        return scene


def read_metadata(path: Path) -> dict[str, Any]:
    """Read a `metadata.json`. Raises InputError, also if there is none."""
    data = read_json(path)
    if data is None:
        raise InputError("expected a JSON file, there is none", where=str(path))
    return data


def check_empty(out: Path) -> None:
    """Raise InputError if `out` is no folder or is not empty, so that nothing is overwritten."""
    empty = not out.exists() or (out.is_dir() and all(path.name[0] == "." for path in out.iterdir()))
    require(empty, "", "an empty folder", where=str(out))


def command(
    dataset: Path,
    /,
    *,
    out: Path,
    to: Literal["geoelements"] | None = None,
    from_: Annotated[Literal["geoelements"] | None, Parameter(name="--from")] = None,
    scene: str | None = None,
    up: Literal["y", "z"] = "y",
) -> None:
    """Convert a dataset of Talus into the layout of geoelements/gns, or a geoelements dataset into one of Talus.

    One trajectory is in memory at a time. Foreign files are read without executing their contents.

    Args:
        dataset: With --to, a folder from python -m mpm.generate; with --from, a geoelements folder with train, valid,
            test in .npz and metadata.json.
        out: Folder of the result, which has to be empty.
        to: Layout to write.
        from_: Layout to read.
        scene: With --from, the scene of all trajectories, a path or a shipped name: it gives box and obstacles, and the
            friction angle if the dataset has no tan(phi).
        up: With --from, the axis that points up, y or z.
    """
    require((to is None) != (from_ is None), "", "one of --to and --from")
    if (scene is None) != (from_ is None) or (to is not None and up != "y"):
        raise InputError("--from needs --scene; --scene and --up go with --from only")
    require(dataset.is_dir(), "", "the folder of a dataset, there is none", where=str(dataset))
    if scene is None:
        export(dataset, out)
    else:
        import_dataset(dataset, out, scene=read_scene(scene), up=up)


if __name__ == "__main__":
    sys.exit(run(command, "python -m datasets.exchange"))
