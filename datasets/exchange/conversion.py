"""A dataset of Talus in another code's layout and back: one trajectory in memory at a time, interruptions finished."""

import hashlib
import json
import re
from collections.abc import Container, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from operator import add
from pathlib import Path
from typing import Any, Protocol, cast

import numpy as np
from tqdm import tqdm

from datasets.arrays import open_npz
from datasets.definitions.definition import Definition, Entry, Split
from datasets.errors import InputError
from datasets.exchange import geoelements, lagrangebench
from datasets.exchange.baffle_particles import obstacle_particles
from datasets.exchange.cloud import Cloud, Described, ForeignMetadata, Statistics, cloud_of, known_keys, read_metadata
from datasets.exchange.reconstruction import Known, reconstruct
from datasets.files import write_json
from datasets.geometry.plain import check_plain
from datasets.training.metadata import metadata
from datasets.training.statistics import motion_statistics
from datasets.trajectory import Trajectory, open_trajectory, stored_scene, trajectory_files

RECORD = "exchange.json"
"""What a conversion is from, and with which options; written first, so that the same command can finish it."""
SAFE_NAME = re.compile(r"\w[\w.-]{0,99}", re.ASCII)


class Layout(Protocol):
    """How another code lays out a dataset, a file per split and `metadata.json`: what each layout's module has."""

    SUFFIX: str

    def write(self, path: Path, clouds: Iterable[Cloud]) -> None: ...
    def names(self, path: Path) -> list[str]: ...
    def read(self, path: Path, requested: Container[str]) -> Iterator[Cloud]: ...
    def metadata(self, described: Described) -> dict[str, Any]: ...


LAYOUTS = {"geoelements": cast(Layout, geoelements), "lagrangebench": cast(Layout, lagrangebench)}


def export(dataset: Path, to: str, out: Path) -> None:
    """Write the dataset folder `dataset` to `out` in the layout `to`; what an earlier, interrupted call wrote is kept.

    Raises InputError for trajectories that do not share box, frames and spacing, and where `out` holds anything else.
    """
    layout = LAYOUTS[to]
    files = {split: trajectory_files(dataset / split.value) for split in Split}
    described = survey(dataset, files)
    begin(
        out,
        {
            "to": to,
            "source": digest(
                [*(path for paths in files.values() for path in paths), dataset / "metadata.json"], dataset
            ),
        },
    )
    for split, paths in files.items():
        path = out / f"{split.value}{layout.SUFFIX}"
        if paths and not path.exists():
            bar = tqdm(paths, desc=split.value, unit="trajectory", dynamic_ncols=True)
            layout.write(path, (cloud_of(Trajectory.load(each), each.stem) for each in bar))
    write_json(out / "metadata.json", layout.metadata(described))


def survey(dataset: Path, files: Mapping[Split, Sequence[Path]]) -> Described:
    """What a dataset's trajectories have in common, from their scenes and shapes alone. Raises InputError."""
    described = dataset / "metadata.json"
    statistics = known_keys(Statistics, read_metadata(described), described)
    paths = [path for split in Split for path in files[split]]
    if not paths:
        raise InputError("expected trajectories in train, valid or test, there are none", where=str(dataset))
    shared, largest = None, 0
    for path in paths:
        scene = stored_scene(path)
        check_plain(scene, "the other code's format", str(path))
        shape = open_trajectory(path).positions.shape
        if len(shape) != 3:
            raise InputError("expected positions of shape [T, N, D]", where=str(path), key="positions")
        frames, particles, _ = shape
        spacing = scene.particle_spacing
        this = (scene.domain.size, scene.frame_dt, frames, spacing)
        if shared is not None and this != shared:
            expected = f"expected the box, time between frames, number of frames and spacing {shared} of {paths[0]}"
            raise InputError(f"{expected}, got {this}", where=str(path))
        shared = this
        largest = max(largest, particles + sum(len(obstacle_particles(each, spacing)) for each in scene.baffles))
    assert shared is not None
    return Described(
        size=shared[0],
        frame_dt=shared[1],
        frames=shared[2],
        spacing=shared[3],
        particles=largest,
        trajectories={split.value: len(files[split]) for split in Split},
        statistics=statistics,
    )


@dataclass(frozen=True, kw_only=True)
class Part:
    """One split of another code's dataset."""

    split: Split
    path: Path
    metadata: ForeignMetadata
    files: dict[str, Path]
    """Trajectory in their file -> its file in our folder."""


def import_dataset(
    source: Path, layout: str, out: Path, *, friction_deg: float | None, spacing: float | None, up: str
) -> None:
    """Write the dataset in `source`, in the layout of another code, to `out`; what an earlier call wrote is kept.

    `friction_deg` [deg] for sets that do not say, `spacing` [m] of the particles where it is known better than from
    them, `up` the axis, `y` or `z`, that points up. Raises InputError, also where `out` holds anything else.
    """
    parts = parts_of(source, LAYOUTS[layout], out)
    record = {
        "from": layout,
        "source": digest([*(part.path for part in parts), source / "metadata.json"], source),
        "friction_deg": friction_deg,
        "spacing": spacing,
        "up": up,
    }
    begin(out, record)
    ours = {path for part in parts for path in part.files.values()}
    for path in (path for split in Split for path in trajectory_files(out / split.value)):
        if path not in ours:
            raise InputError("expected no trajectory but those of this dataset", where=str(path))
    estimate = None
    for part in parts:
        dx, bounds = part.metadata.dx, part.metadata.bounds
        if up == "z":
            if part.metadata.dim != 3:
                raise InputError("expected a set in 3D for --up z", where=str(part.path))
            bounds = (bounds[0], bounds[2], bounds[1])
        known = Known(
            bounds=bounds,
            frame_dt=part.metadata.frame_dt,
            spacing=spacing or dx or estimate,
            spacing_from="--spacing" if spacing else "dx" if dx else "estimate",
            friction_deg=friction_deg,
        )
        estimate = convert(part, LAYOUTS[layout], known, up)
    write_json(out / "metadata.json", described_as_ours(parts, layout, record))


def parts_of(source: Path, layout: Layout, out: Path) -> list[Part]:
    """The splits that another code's dataset has. Raises InputError."""
    described = source / "metadata.json"
    content = read_metadata(described)
    parts = []
    for split in Split:
        path = source / f"{split.value}{layout.SUFFIX}"
        if not path.exists():
            continue
        # geoelements may describe a larger box for rollouts than for training.
        purpose = content.get("rollout" if split is Split.TEST else "train", content)
        names = layout.names(path)
        safe = all(map(SAFE_NAME.fullmatch, names)) and len({name.casefold() for name in names}) == len(names)
        stems = names if safe else [f"{index:05d}" for index in range(len(names))]
        parts.append(
            Part(
                split=split,
                path=path,
                metadata=known_keys(ForeignMetadata, purpose if isinstance(purpose, dict) else {}, described),
                files={name: out / split.value / f"{stem}.npz" for name, stem in zip(names, stems, strict=True)},
            )
        )
    if not any(part.files for part in parts):
        raise InputError(f"expected trajectories in train, valid or test{layout.SUFFIX}", where=str(source))
    return parts


def convert(part: Part, layout: Layout, known: Known, up: str) -> float | None:
    """Write what is missing of a split. Returns the spacing of its particles [m]: all share the first's."""
    missing = {name for name, path in part.files.items() if not path.exists()}
    done = [path for path in part.files.values() if path.exists()]
    if known.spacing is None and done:
        known = replace(known, spacing=stored_scene(done[0]).particle_spacing)
    bar = tqdm(total=len(part.files), desc=part.split.value, unit="trajectory", dynamic_ncols=True)
    with bar:
        bar.update(len(done))
        for cloud in layout.read(part.path, missing) if missing else ():
            if up == "z":
                cloud = replace(cloud, positions=np.ascontiguousarray(cloud.positions[..., [0, 2, 1]]))
            try:
                trajectory = reconstruct(cloud, known)
            except InputError as error:
                raise error.at(str(part.path)) from None
            known = replace(known, spacing=trajectory.scene.particle_spacing)
            trajectory.save(part.files[cloud.name])
            bar.update()
    return known.spacing


def described_as_ours(parts: list[Part], layout: str, record: dict[str, Any]) -> dict[str, Any]:
    """The contents of `metadata.json`, statistics of the first split among them."""
    entries = [
        Entry(split=part.split, name=path.stem, scene=stored_scene(path))
        for part in parts
        for path in part.files.values()
    ]
    first = next(part for part in parts if part.files)
    definition = Definition(
        name=layout,
        size=len(entries),
        connectivity_radius=first.metadata.default_connectivity_radius,
        split=lambda index: entries[index].split,
        draw=lambda _, index: entries[index].scene,
    )
    bar = tqdm(first.files.values(), desc="statistics", unit="trajectory", dynamic_ncols=True)
    flows = (Trajectory.load(path) for path in bar)
    statistics = reduce(add, (motion_statistics(flow.positions, flow.frame_dt) for flow in flows))
    content = metadata(definition, entries, seed=0, statistics=statistics)
    content["statistics"]["split"] = first.split.value
    # Nothing was drawn at random.
    del content["seed"]
    return {**content, "reconstructed": record}


def begin(out: Path, record: dict[str, Any]) -> None:
    """Claim the folder `out` for the conversion that `record` describes.

    Raises InputError where it holds something else: nothing is overwritten.
    """
    path = out / RECORD
    if path.exists():
        if read_metadata(path) != json.loads(json.dumps(record)):
            raise InputError("expected the conversion that this folder was begun with, found another", where=str(path))
    elif out.exists() and (not out.is_dir() or any(each.name[0] != "." for each in out.iterdir())):
        raise InputError("expected an empty folder, or one that this conversion has begun", where=str(out))
    else:
        write_json(path, record)


def digest(paths: Sequence[Path], folder: Path) -> str:
    """A fingerprint of files in `folder`: of an NPZ from the checksums it states, of any other from all its bytes."""
    total = hashlib.sha256()
    for path in paths:
        if path.suffix == ".npz":
            with open_npz(path) as file:
                content = json.dumps(file.checksums)
        else:
            with path.open("rb") as raw:
                content = hashlib.file_digest(raw, "sha256").hexdigest()
        total.update(f"{path.relative_to(folder).as_posix()} {content}\n".encode())
    return total.hexdigest()
