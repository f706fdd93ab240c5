"""A dataset of Talus in another code's layout and back: one trajectory in memory at a time, interruptions finished.

Their files know no scene. What `export` writes keeps the scenes beside them (`scenes.json`); of any other set all
trajectories get the scene that the user gives, which says box, obstacles and material.
"""

import json
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import reduce
from operator import add
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from tqdm import tqdm

from datasets.checks import check_plain
from datasets.definitions.definition import Definition, Entry, Split
from datasets.errors import InputError
from datasets.exchange import geoelements, lagrangebench
from datasets.exchange.cloud import Cloud, cloud_of, obstacle_particles
from datasets.files import write_json
from datasets.measures import front, runout, toe
from datasets.reading import read_json
from datasets.records import Record, from_mapping
from datasets.scene import Scene
from datasets.training.metadata import metadata
from datasets.training.statistics import motion_statistics
from datasets.trajectory import Trajectory, open_trajectory, stored_scene, trajectory_files

LAYOUTS: dict[str, ModuleType] = {"geoelements": geoelements, "lagrangebench": lagrangebench}
"""Of other codes: how each lays out a dataset, a file per split and `metadata.json`."""
RECORD, SCENES = "exchange.json", "scenes.json"
"""What a conversion is from, written first, so that the same command can finish it; the scenes of what was exported."""
STATISTICS = ("default_connectivity_radius", "vel_mean", "vel_std", "acc_mean", "acc_std")
"""Keys of `metadata.json` that all layouts share with ours."""
SAFE_NAME = re.compile(r"\w[\w.-]{0,99}", re.ASCII)
CLOSE = 1.0e-6
"""Relative difference of two boxes that is rounding."""


@dataclass(frozen=True, kw_only=True)
class ForeignMetadata(Record):
    """What Talus uses of another code's `metadata.json`."""

    bounds: tuple[tuple[float, float], ...]
    """Lower and upper end of the box per axis [m]."""
    dt: float
    """Time between frames [s]; in LagrangeBench of the solver, whose every `write_every`-th step is a frame."""
    default_connectivity_radius: float
    """Radius of their neighbour search [m]."""
    write_every: int = 1
    periodic_boundary_conditions: tuple[bool, ...] = field(default=())

    def __post_init__(self) -> None:
        for key, ok, expected in (
            ("bounds", len(self.bounds) in (2, 3) and all(a < b for a, b in self.bounds), "two ends for 2 or 3 axes"),
            ("dt", self.dt > 0.0, "a positive time in s"),
            ("write_every", self.write_every > 0, "a positive number of steps"),
            ("periodic_boundary_conditions", not any(self.periodic_boundary_conditions), "walls on all sides"),
        ):
            if not ok:
                raise InputError(f"expected {expected}, got {getattr(self, key)}", key=key)


def export(dataset: Path, to: str, out: Path) -> None:
    """Write the dataset folder `dataset` to `out` in the layout `to`; what an earlier, interrupted call wrote is kept.

    Raises InputError for trajectories that do not share box, frames and spacing, and where `out` holds anything else.
    """
    layout = LAYOUTS[to]
    files = {split: trajectory_files(dataset / split.value) for split in Split}
    described = survey(dataset, files)
    begin(out, {"to": to, "source": str(dataset)})
    for split, paths in files.items():
        path = out / f"{split.value}{layout.SUFFIX}"
        if paths and not path.exists():
            bar = tqdm(paths, desc=split.value, unit="trajectory", dynamic_ncols=True)
            layout.write(path, (cloud_of(Trajectory.load(each), each.stem) for each in bar))
    scenes = {
        split.value: {each.stem: json.loads(stored_scene(each).to_json()) for each in paths}
        for split, paths in files.items()
    }
    write_json(out / SCENES, scenes)
    write_json(out / "metadata.json", layout.metadata(**described))


def survey(dataset: Path, files: Mapping[Split, Sequence[Path]]) -> dict[str, Any]:
    """What a dataset's trajectories have in common, from their scenes and shapes alone. Raises InputError."""
    content = read_metadata(dataset / "metadata.json")
    missing = [key for key in STATISTICS if key not in content]
    if missing:
        raise InputError("expected a value, the key is missing", where=str(dataset / "metadata.json"), key=missing[0])
    shared, largest = None, 0
    paths = [path for split in Split for path in files[split]]
    for path in paths:
        flow = open_trajectory(path)
        scene, (frames, particles, _) = flow.scene, flow.positions.shape
        check_plain(scene, "the other code's format", str(path))
        this = (scene.domain.size, scene.frame_dt, frames, scene.particle_spacing)
        if shared is not None and this != shared:
            expected = f"expected the box, time between frames, number of frames and spacing {shared} of {paths[0]}"
            raise InputError(f"{expected}, got {this}", where=str(path))
        shared, obstacles = this, [obstacle_particles(each, this[3]) for each in scene.baffles]
        largest = max(largest, particles + sum(map(len, obstacles)))
    if shared is None:
        raise InputError("expected trajectories in train, valid or test, there are none", where=str(dataset))
    size, frame_dt, frames, spacing = shared
    keys = {"bounds": [[0.0, length] for length in size], "dim": len(size), "dt": frame_dt, "dx": spacing}
    return {
        "shared": keys | {key: content[key] for key in STATISTICS},
        "frames": frames,
        "particles": largest,
        "trajectories": {split.value: len(paths) for split, paths in files.items()},
    }


def import_dataset(source: Path, layout: str, out: Path, *, scene: Scene | None, up: str) -> None:
    """Write the dataset in `source`, in the layout of another code, to `out`; what an earlier call wrote is kept.

    scene: of all trajectories, where `source` does not hold their scenes; up: the axis, `y` or `z`, that points up.
    Raises InputError, also where `out` holds anything else.
    """
    code, described = LAYOUTS[layout], source / "metadata.json"
    content, known = read_metadata(described), read_json(source / SCENES) or {}
    record = {"from": layout, "source": str(source), "scene": None if scene is None else scene.to_json(), "up": up}
    entries: list[Entry] = []
    radius = None
    for split in Split:
        path = source / f"{split.value}{code.SUFFIX}"
        if not path.exists():
            continue
        # geoelements may describe a larger box for rollouts than for training.
        purpose = content.get("rollout" if split is Split.TEST else "train", content)
        keys = [key for key in ForeignMetadata.__dataclass_fields__ if key in purpose]
        try:
            foreign = from_mapping(ForeignMetadata, {key: purpose[key] for key in keys})
        except InputError as error:
            raise error.at(str(described)) from None
        radius = foreign.default_connectivity_radius if radius is None else radius
        names, ours = code.names(path), known.get(split.value, {})
        safe = all(map(SAFE_NAME.fullmatch, names)) and len({name.casefold() for name in names}) == len(names)
        stems = list(ours) or (names if safe else [f"{index:05d}" for index in range(len(names))])
        scenes: list[Scene | None] = [from_mapping(Scene, each) for each in ours.values()] or [scene] * len(names)
        if None in scenes or len(scenes) != len(names):
            raise InputError(f"expected --scene, for there is no {SCENES} of these trajectories", where=str(source))
        begin(out, record)
        files = {name: out / split.value / f"{stem}.npz" for name, stem in zip(names, stems, strict=True)}
        strangers = set(trajectory_files(out / split.value)) - set(files.values())
        if strangers:
            raise InputError("expected no trajectory but those of this dataset", where=str(min(strangers)))
        missing = {name for name, file in files.items() if not file.exists()}
        of_name = dict(zip(names, scenes, strict=True))
        clouds = code.read(path, missing) if missing else ()
        for cloud in tqdm(clouds, desc=split.value, total=len(missing), unit="trajectory", dynamic_ncols=True):
            try:
                trajectory_of(cloud, of_name[cloud.name], foreign, up).save(files[cloud.name])
            except InputError as error:
                raise InputError(error.message, where=str(path), key=cloud.name) from None
        entries += [Entry(split=split, name=file.stem, scene=stored_scene(file)) for file in files.values()]
    if radius is None or not entries:
        raise InputError(f"expected trajectories in train, valid or test{code.SUFFIX}", where=str(source))
    write_json(out / "metadata.json", described_as_ours(entries, out, radius, layout, record))


def trajectory_of(cloud: Cloud, scene: Scene, foreign: ForeignMetadata, up: str) -> Trajectory:
    """The trajectory of the sand of a cloud, in `scene`. Raises InputError where the scene's box is another one."""
    frame_dt, positions, bounds = foreign.dt * foreign.write_every, cloud.positions, np.array(foreign.bounds)
    if up == "z":
        if positions.shape[2] != 3:
            raise InputError("expected a set in 3D for --up z")
        positions, bounds = positions[..., [0, 2, 1]], bounds[[0, 2, 1]]
    size = bounds[:, 1] - bounds[:, 0]
    if len(size) != scene.dimension or not np.allclose(size, scene.domain.size, rtol=CLOSE):
        raise InputError(f"expected a scene in the box of the set, {size.tolist()} m, got {list(scene.domain.size)} m")
    sand = np.ascontiguousarray((positions - bounds[:, 0])[:, ~cloud.stationary], dtype=np.float32)
    tangent = math.tan(math.radians(scene.material.friction_deg))
    friction = np.full(sand.shape[1], tangent) if cloud.friction is None else cloud.friction[~cloud.stationary]
    return Trajectory(
        positions=sand,
        time=np.arange(len(sand), dtype=np.float64) * frame_dt,
        velocity0=((sand[1] - sand[0]) / frame_dt).astype(np.float32),
        friction=friction.astype(np.float32),
        scene=replace(scene, duration=(len(sand) - 1) * frame_dt, frame_dt=frame_dt),
        summary={"runout": runout(sand[-1]), "front": front(sand[-1]), "toe": list(toe(sand[-1]))},
    )


def described_as_ours(
    entries: list[Entry], out: Path, radius: float, layout: str, record: dict[str, Any]
) -> dict[str, Any]:
    """The contents of `metadata.json`, statistics of the first split among them."""
    definition = Definition(
        name=layout,
        size=len(entries),
        connectivity_radius=radius,
        split=lambda index: entries[index].split,
        draw=lambda _, index: entries[index].scene,
    )
    first = entries[0].split
    paths = [out / first.value / f"{entry.name}.npz" for entry in entries if entry.split is first]
    bar = tqdm(paths, desc="statistics", unit="trajectory", dynamic_ncols=True)
    flows = (Trajectory.load(path) for path in bar)
    statistics = reduce(add, (motion_statistics(flow.positions, flow.frame_dt) for flow in flows))
    content = metadata(definition, entries, seed=0, statistics=statistics)
    content["statistics"]["split"] = first.value
    # Nothing was drawn at random.
    del content["seed"]
    return {**content, "exchange": record}


def read_metadata(path: Path) -> dict[str, Any]:
    """Read a `metadata.json`. Raises InputError, also where there is none."""
    data = read_json(path)
    if data is None:
        raise InputError("expected a JSON file, there is none", where=str(path))
    return data


def begin(out: Path, record: dict[str, Any]) -> None:
    """Claim the folder `out` for the conversion that `record` describes.

    Raises InputError where it holds something else: nothing is overwritten.
    """
    path = out / RECORD
    if path.exists():
        if read_metadata(path) != record:
            raise InputError("expected the conversion that this folder was begun with, found another", where=str(path))
    elif out.exists() and (not out.is_dir() or any(each.name[0] != "." for each in out.iterdir())):
        raise InputError("expected an empty folder, or one that this conversion has begun", where=str(out))
    else:
        write_json(path, record)
