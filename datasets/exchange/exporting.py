"""A dataset of Talus in a peer's layout: one trajectory in memory at a time."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from tqdm import tqdm

from datasets.definitions.definition import Split
from datasets.errors import InputError
from datasets.exchange.baffle_particles import obstacle_points
from datasets.exchange.common import Described, Particles, Statistics, known_keys, particles_of, read_json
from datasets.exchange.foreign_npz import open_foreign_npz
from datasets.exchange.layouts import Layout, begin, digest
from datasets.files import write_json
from datasets.geometry.plain import check_plain
from datasets.trajectory import Trajectory, stored_scene


def export(dataset: Path, layout: Layout, out: Path) -> None:
    """Write the dataset folder `dataset` to `out`; what an earlier, interrupted call finished is kept.

    Raises InputError for trajectories that do not share box, frames and spacing, and where `out` holds anything else.
    """
    files = {split: sorted((dataset / split.value).glob("[!.]*.npz")) for split in Split}
    described = survey(dataset, files)
    sources = [path for paths in files.values() for path in paths] + [dataset / "metadata.json"]
    begin(out, {"to": layout.name, "source": digest(sources, dataset)})
    for split, paths in files.items():
        place = out / f"{split.value}{layout.suffix}"
        if paths and not place.exists():
            layout.write(place, converted(paths, split))
    write_json(out / "metadata.json", layout.metadata(described))


def converted(paths: Sequence[Path], split: Split) -> Iterator[Particles]:
    """The trajectories of a split as the peers see them, one after the other."""
    for path in tqdm(paths, desc=split.value, unit="trajectory", dynamic_ncols=True):
        yield particles_of(Trajectory.load(path), path.stem)


def survey(dataset: Path, files: Mapping[Split, Sequence[Path]]) -> Described:
    """What a dataset's trajectories have in common, from their scenes and shapes alone. Raises InputError."""
    place = dataset / "metadata.json"
    statistics = known_keys(Statistics, read_json(place), place)
    paths = [path for split in Split for path in files[split]]
    if not paths:
        raise InputError("expected trajectories in train, valid or test, there are none", where=str(dataset))
    shared, largest = None, 0
    for path in paths:
        scene = stored_scene(path)
        check_plain(scene, "the peers' format", str(path))
        with open_foreign_npz(path) as file:
            if "positions" not in file.keys or len(file.shape("positions")) != 3:
                raise InputError("expected positions of shape [T, N, D]", where=str(path), key="positions")
            frames, points, _ = file.shape("positions")
        spacing = scene.particle_spacing
        this = (scene.domain.size, scene.frame_dt, frames, spacing)
        if shared is not None and this != shared:
            raise InputError(
                f"expected the box, time between frames, number of frames and spacing {shared} of {paths[0]}, "
                f"got {this}",
                where=str(path),
            )
        shared = this
        largest = max(largest, points + sum(len(obstacle_points(baffle, spacing)) for baffle in scene.baffles))
    assert shared is not None
    size, frame_dt, frames, spacing = shared
    return Described(
        size=size,
        frame_dt=frame_dt,
        frames=frames,
        spacing=spacing,
        particles=largest,
        trajectories={split.value: len(files[split]) for split in Split},
        statistics=statistics,
    )
