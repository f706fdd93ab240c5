"""A dataset in a peer's layout as one of Talus: its scenes reconstructed, one trajectory in memory at a time."""

import re
from dataclasses import dataclass, replace
from functools import reduce
from operator import add
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from datasets.definitions.definition import Definition, Entry, Split
from datasets.errors import InputError
from datasets.exchange.common import Particles, PeerMetadata, known_keys, read_json
from datasets.exchange.layouts import Layout, begin, digest
from datasets.exchange.reconstruction import Known, reconstruct
from datasets.files import write_json
from datasets.scene import Scene
from datasets.training.metadata import metadata
from datasets.training.statistics import MotionStatistics, motion_statistics
from datasets.trajectory import Trajectory, stored_scene

SAFE_NAME = re.compile(r"\w[\w.-]{0,99}", re.ASCII)


@dataclass(frozen=True, kw_only=True)
class Part:
    """One split of a peer's dataset."""

    split: Split
    path: Path
    metadata: PeerMetadata
    names: dict[str, str]
    """Trajectory in the peer's file -> file name in ours, without its ending."""

    def place(self, name: str, out: Path) -> Path:
        """The file of a trajectory in the dataset folder `out`."""
        return out / self.split.value / f"{self.names[name]}.npz"


def import_dataset(
    source: Path, layout: Layout, out: Path, *, friction_deg: float | None, spacing: float | None, up: str
) -> None:
    """Write the peer's dataset in `source` to the folder `out`; what an earlier, interrupted call finished is kept.

    `friction_deg` [deg] for sets that do not say, `spacing` [m] of the points where it is known better than from them,
    `up` the axis, `y` or `z`, that points up. Raises InputError, also where `out` holds anything else.
    """
    parts = parts_of(source, layout)
    record = {
        "from": layout.name,
        "source": digest([*(part.path for part in parts), source / "metadata.json"], source),
        "friction_deg": friction_deg,
        "spacing": spacing,
        "up": up,
    }
    begin(out, record)
    refuse_strangers(parts, out)
    estimate = None
    for part in parts:
        known = Known(
            bounds=turned_bounds(part) if up == "z" else part.metadata.bounds,
            frame_dt=part.metadata.frame_dt,
            spacing=spacing or part.metadata.dx or estimate,
            spacing_from="--spacing" if spacing else "dx" if part.metadata.dx else "estimate",
            friction_deg=friction_deg,
        )
        estimate = convert(part, layout, out, known, up)
    write_json(out / "metadata.json", described(parts, out, layout, record))


def convert(part: Part, layout: Layout, out: Path, known: Known, up: str) -> float | None:
    """Write what is missing of a split. Returns the spacing of its points [m]: all trajectories share the first's."""
    missing = {name for name in part.names if not part.place(name, out).exists()}
    if known.spacing is None and missing != part.names.keys():
        first = next(name for name in part.names if name not in missing)
        known = replace(known, spacing=spacing_in(stored_scene(part.place(first, out))))
    bar = tqdm(total=len(part.names), desc=part.split.value, unit="trajectory", dynamic_ncols=True)
    with bar:
        bar.update(len(part.names) - len(missing))
        for particles in layout.read(part.path, missing) if missing else ():
            try:
                trajectory = reconstruct(turned(particles) if up == "z" else particles, known)
            except InputError as error:
                raise error.at(str(part.path)) from None
            known = replace(known, spacing=spacing_in(trajectory.scene))
            trajectory.save(part.place(particles.name, out))
            bar.update()
    return known.spacing


def spacing_in(scene: Scene) -> float:
    """How far apart the points of a scene start [m]."""
    return scene.particle_spacing


def parts_of(source: Path, layout: Layout) -> list[Part]:
    """The splits that a peer's dataset has. Raises InputError."""
    place = source / "metadata.json"
    content = read_json(place)
    parts = []
    for split in Split:
        path = source / f"{split.value}{layout.suffix}"
        if not path.exists():
            continue
        # geoelements may describe a larger box for rollouts than for training.
        purpose = content.get("rollout" if split is Split.TEST else "train", content)
        names = layout.names(path)
        safe = all(map(SAFE_NAME.fullmatch, names)) and len({name.casefold() for name in names}) == len(names)
        parts.append(
            Part(
                split=split,
                path=path,
                metadata=known_keys(PeerMetadata, purpose if isinstance(purpose, dict) else {}, place),
                names={name: name if safe else f"{index:05d}" for index, name in enumerate(names)},
            )
        )
    if not any(part.names for part in parts):
        raise InputError(f"expected trajectories in train, valid or test{layout.suffix}", where=str(source))
    return parts


def refuse_strangers(parts: list[Part], out: Path) -> None:
    """Raise InputError where `out` holds a trajectory that is not of these."""
    wanted = {part.place(name, out) for part in parts for name in part.names}
    for split in Split:
        for path in sorted((out / split.value).glob("[!.]*.npz")):
            if path not in wanted:
                raise InputError("expected no trajectory but those of this dataset", where=str(path))


def turned(particles: Particles) -> Particles:
    """The same with z up made y up: the second and the third axis change places."""
    return replace(particles, positions=np.ascontiguousarray(particles.positions[..., [0, 2, 1]]))


def turned_bounds(part: Part) -> tuple[tuple[float, float], ...]:
    """The bounds with z up made y up. Raises InputError in 2D."""
    if part.metadata.dim != 3:
        raise InputError("expected a set in 3D for --up z", where=str(part.path))
    x, y, z = part.metadata.bounds
    return x, z, y


def described(parts: list[Part], out: Path, layout: Layout, record: dict[str, Any]) -> dict[str, Any]:
    """The contents of `metadata.json`, statistics of the first split among them."""
    entries = [
        Entry(split=part.split, name=part.names[name], scene=stored_scene(part.place(name, out)))
        for part in parts
        for name in part.names
    ]
    first = next(part for part in parts if part.names)
    definition = Definition(
        name=layout.name,
        size=len(entries),
        connectivity_radius=first.metadata.default_connectivity_radius,
        split=lambda index: entries[index].split,
        draw=lambda _, index: entries[index].scene,
    )
    places = [first.place(name, out) for name in first.names]
    bar = tqdm(places, desc="statistics", unit="trajectory", dynamic_ncols=True)
    statistics: MotionStatistics = reduce(add, map(statistics_of, bar))
    content = metadata(definition, entries, seed=0, statistics=statistics)
    content["statistics"]["split"] = first.split.value
    # Nothing was drawn at random.
    del content["seed"]
    return {**content, "reconstructed": record}


def statistics_of(path: Path) -> MotionStatistics:
    """The statistics of the trajectory at `path`."""
    trajectory = Trajectory.load(path)
    return motion_statistics(trajectory.positions, trajectory.scene.frame_dt)
