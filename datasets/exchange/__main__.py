"""python -m datasets.exchange DATASET --to geoelements, or --from geoelements: datasets in the layout of that code.

One trajectory is in memory at a time. The other code's files contain no scene: all its trajectories get the scene that
the user gives, with box, obstacles and materials; each has the angle of its particles and the box in which they start.
"""

import itertools
import math
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
from datasets.errors import InputError, keyed, naming, require
from datasets.exchange import geoelements
from datasets.exchange.geoelements import Sand
from datasets.files import read_json, write_json
from datasets.flow.measures import extents
from datasets.flow.trajectory import Trajectory, open_trajectory, trajectory_files
from datasets.scene import Mass, Scene
from datasets.scene.grid_field import FRICTION, Floats
from datasets.scene.library import read_scene
from datasets.scene.material import Material
from datasets.schema import Bounds, Record, from_mapping

STATISTICS = ("default_connectivity_radius", "vel_mean", "vel_std", "acc_mean", "acc_std")
"""Keys that both versions of `metadata.json` share."""
CLOSE = 1.0e-6  # relative difference of two boxes within rounding
Counts = tuple[float, ...]
FARTHEST_APART = 3.0  # largest distance to the nearest particle, over the spacing of the lattice
LONGEST_NAME = 200  # bytes of a key that names a file
KEPT = ("material", "k0", "release", "gate", "initial_pore_pressure_ratio")
"""What the box of the first particles keeps of the scene's masses, where they have it in common."""


@dataclass(frozen=True, kw_only=True)
class ForeignMetadata(Record):
    """The keys of the other code's `metadata.json` that Talus uses."""

    bounds: tuple[tuple[float, float], ...]  # lower and upper end of the box per axis [m]
    dt: Annotated[float, Bounds("a time in s, 1e-9 to 1e9", ge=1.0e-9)]  # between frames
    dx: Annotated[float | None, Bounds("a length in m, 1e-9 to 1e9", ge=1.0e-9)] = None
    """Spacing of the particles, which Talus writes."""

    def __post_init__(self) -> None:
        super().__post_init__()
        ascending = len(self.bounds) in (2, 3) and all(lower < upper for lower, upper in self.bounds)
        require(ascending, "bounds", "a lower and an upper end for each of 2 or 3 axes", list(self.bounds))


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
    boxless: list[str] = []
    statistics = MotionStatistics.from_samples(*np.empty((2, 0, scene.dimension)))
    for split in Split:
        path = source / f"{split.value}.npz"
        if not path.exists():
            continue
        # The file may describe a larger box for rollouts than for training.
        purpose = "rollout" if split is Split.TEST and "rollout" in content else "train"
        described = content.get(purpose, content)
        with naming(source / "metadata.json"):
            require(isinstance(described, dict), purpose, "a JSON object")
            values = {key: described[key] for key in ForeignMetadata.__dataclass_fields__ if key in described}
            foreign = from_mapping(ForeignMetadata, values)
        for name, sand in tqdm(geoelements.read(path), desc=split.value, unit="trajectory", dynamic_ncols=True):
            with naming(path), keyed(name):
                fits = Path(name).name == name and name[:1] not in ("", ".") and len(name.encode()) <= LONGEST_NAME
                require(fits, "", f"a name that a file can have, of at most {LONGEST_NAME} bytes", repr(name))
                flow, boxed = trajectory_of(sand, scene, foreign, up)
            flow.save(out / split.value / f"{name}.npz")
            entries.append(Entry(split=split, name=name, scene=flow.scene))
            boxless += [f"{split.value} {name}"] * (not boxed)
            if split is entries[0].split:
                statistics += motion_statistics(flow.positions, flow.frame_dt)
    require(len(entries) > 0, "", "trajectories in train, valid or test.npz", where=str(source))
    content = metadata("geoelements", entries, seed=None, statistics=statistics)
    write_json(out / "metadata.json", {**content, "exchange": {"from": "geoelements", "source": str(source), "up": up}})
    if boxless:
        which = ", ".join(boxless[:3]) + (", ..." if len(boxless) > 3 else "")
        said = "have the masses of the scene, their particles begin in no box of one material"
        print(f"{len(boxless)} of {len(entries)} trajectories {said}: {which}")


def trajectory_of(sand: Sand, scene: Scene, foreign: ForeignMetadata, up: str) -> tuple[Trajectory, bool]:
    """The trajectory of the imported sand, in `scene`, and whether its particles start in a box, which its scene then
    has; a particle has the volume of a lattice cell. Raises InputError if the scene has another box."""
    (positions, friction), bounds = sand, np.array(foreign.bounds)
    count, dimension = positions.shape[1:]
    require(dimension == len(bounds), "", f"positions in {len(bounds)}D, as bounds in metadata.json", f"{dimension}D")
    covered, slack = np.stack([positions.min(axis=(0, 1)), positions.max(axis=(0, 1))], axis=1), scene.domain.cell
    inside = bool(((covered[:, 0] >= bounds[:, 0] - slack) & (covered[:, 1] <= bounds[:, 1] + slack)).all())
    expected = f"positions within bounds in metadata.json, {bounds.tolist()} m, up to a cell of the scene"
    require(inside, "", expected, covered.astype(float).round(4).tolist())
    require(up == "y" or dimension == 3, "", "a set in 3D for --up z")
    if up == "z":
        positions, bounds = positions[..., [0, 2, 1]], bounds[[0, 2, 1]]
    size = bounds[:, 1] - bounds[:, 0]
    same = dimension == scene.dimension and np.allclose(size, scene.domain.size, rtol=CLOSE)
    require(same, "", f"a scene in the box of the set, {size.tolist()} m", f"{list(scene.domain.size)} m")
    positions = np.ascontiguousarray(positions - bounds[:, 0], dtype=np.float32)
    spacing, rows = lattice_spacing(positions[0], foreign.dx)
    volume = np.full(count, spacing**dimension, np.float32)
    fits = 0.0 < volume[0] <= 2.0 * size.prod() / count
    require(fits, "", "particles that are apart in the first frame and fit the box", f"a spacing of {spacing:g} m")
    velocity0 = ((positions[1] - positions[0]) / foreign.dt).astype(np.float32)
    sloped = with_tangent(replace(scene, duration=(len(positions) - 1) * foreign.dt, frame_dt=foreign.dt), friction)
    boxed = with_body(sloped, positions[0], velocity0, spacing, rows)
    scene = boxed or sloped
    flow = Trajectory(
        positions=positions,
        time=np.arange(len(positions), dtype=np.float64) * foreign.dt,
        velocity0=velocity0,
        friction=np.full(count, scene.material.friction if friction is None else friction, np.float32),
        volume=volume,
        scene=scene,
        summary=extents(scene, positions[-1], volume),
    )
    return flow, boxed is not None


def lattice_spacing(places: Floats, given: float | None) -> tuple[float, Counts | None]:
    """Spacing s [m] of the lattice of particles that begin at `places` [m], shape [N, D], and, where it fills a box,
    its rows along each axis. given: s, where the set has it. Raises InputError where that is far too small.

    c rows, fitted to a box within half a row and moved at random by at most s / 2, extend over (c - 1.5) s to
    (c + 0.5) s, and sqrt(12) std(x) = c s, to less than a row. Where s is not given, it is the median distance to the
    nearest neighbour, exact for a regular lattice; if the rows of that fill no box, (prod(sqrt(12) std(x)) / N)^(1/D),
    exact for a uniform box, is tried.
    """
    count, dimension = places.shape
    width = np.sqrt(12.0) * places.std(axis=0, dtype=np.float64)
    nearest = float(np.median(cKDTree(places).query(places, k=2)[0][:, 1]))
    apart = given is None or count == 1 or nearest <= FARTHEST_APART * given
    require(apart, "", f"particles about dx in metadata.json apart, {given} m", f"{nearest:g} m")
    spacings = [nearest, float(width.prod() / count) ** (1.0 / dimension)] if given is None else [given]
    for spacing in spacings:
        if 0.0 < spacing < np.inf:
            extent = np.ptp(places, axis=0) / spacing + 1.0
            choices = itertools.product(*((rows - 1.0, rows) for rows in np.round(extent).tolist()))
            boxes = [rows for rows in choices if math.prod(rows) == count and (abs(width / spacing - rows) <= 1).all()]
            if boxes:
                return spacing, min(boxes, key=lambda rows: float(((rows - extent) ** 2).sum()))
    return spacings[0], None


def with_tangent(scene: Scene, friction: Floats | None) -> Scene:
    """The scene with the tan(phi) of its particles, shape [N], where they share one; the scene's material is that of
    its first mass. Raises InputError where nothing says which of several materials a particle has."""
    sands = [scene.material_of(mass) for mass in scene.masses]
    alike = len({*sands}) == 1 and all(field.quantity != FRICTION for field in scene.fields)
    require(friction is not None or alike, "", "tan(phi) of the particles, or a scene of one material", "neither")
    if friction is not None and np.ptp(friction) <= CLOSE * abs(float(friction[0])):
        sands = [at_tangent(sand, float(friction[0])) for sand in sands]
    others = [None if sand == sands[0] else sand for sand in sands]
    masses = tuple(replace(mass, material=sand) for mass, sand in zip(scene.masses, others, strict=True))
    return replace(scene, material=sands[0], masses=masses)


def at_tangent(sand: Material, tangent: float) -> Material:
    """The same material at another tan(phi); how its angles were measured stays, for it may have more of them."""
    phi_deg = math.degrees(math.atan(tangent))
    if sand.angle == "triaxial":
        return replace(sand, friction_deg=phi_deg)
    others: dict[str, Any] = dict.fromkeys(("friction_limit_deg", "residual_friction_deg"))
    return replace(sand, friction_deg=replace(sand, angle="triaxial", friction_deg=phi_deg, **others).slope_deg)


def with_body(scene: Scene, places: Floats, velocities: Floats, spacing: float, rows: Counts | None) -> Scene | None:
    """The scene with the box of the first `places` [m], shape [N, D], as its mass; None where there is no box (`rows`),
    or masses of several materials. Ranges and units of a model follow from it."""
    kept = {tuple(getattr(mass, key) for key in KEPT) for mass in scene.masses}
    if rows is None or len(kept) > 1:
        return None
    size = np.minimum(np.array(rows) * spacing, scene.domain.size)
    lower = np.clip(places.mean(axis=0) - 0.5 * size, 0.0, np.array(scene.domain.size) - size)
    velocity, same = tuple(velocities.mean(axis=0).tolist()), dict(zip(KEPT, kept.pop(), strict=True))
    body = Mass(lower=tuple(lower.tolist()), size=tuple(size.tolist()), velocity=velocity, **same)
    try:
        return replace(scene, masses=(body,), fields=())
    except InputError:
        return None  # rounding has put the mass into an obstacle


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
        scene: With --from, the scene of all trajectories, a path or a shipped name: it gives box, obstacles and
            material, with its friction angle if the dataset has no tan(phi).
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
