"""The layout of geoelements/gns: NPZ of pickled object arrays, sand and obstacles in one cloud of particles, no scene.

What stands in their files: docs/exchange.md. Older ones, all of one array `gns_data`, are read as a whole.
"""

import pickle
import zipfile
from collections.abc import Iterable, Iterator
from enum import IntEnum
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from datasets.errors import InputError, require
from datasets.files import reading, replacing
from datasets.flow.array_files import keys, open_npz, read_member
from datasets.flow.trajectory import Trajectory
from datasets.geometry.bodies import lattice_in
from datasets.geometry.ground import elevation, plan_axes
from datasets.geometry.shells import manifold, sliced
from datasets.geometry.surface import closed_body, solids_of
from datasets.scene import Scene

ALL = "gns_data"  # the key that holds all trajectories where it exists
WHAT = "positions, particle types and perhaps a material property"
STEEPEST = 5.0  # largest valid tan(phi), 79 degrees
Sand = tuple[NDArray[np.floating], NDArray[Any] | None]
"""Positions [m], shape [T, N, D], and tan(phi), shape [N], or None if the file has none."""
ARRAYS = "numpy._core.multiarray"
NAMES = {"numpy.dtype", "numpy.ndarray", f"{ARRAYS}._reconstruct", f"{ARRAYS}.scalar", "_codecs.encode"}
"""Names that pickled arrays of numbers, and object arrays of such arrays, call."""
EARLIEST = (1980, 1, 1, 0, 0, 0)  # the date of every member: the same trajectories give the same bytes


class ParticleType(IntEnum):
    """Their numbers; those that are not here are other materials, such as water (5) or goop (7)."""

    STATIONARY = 3
    SAND = 6


def obstacle_particles(scene: Scene) -> NDArray[np.float64]:
    """Particles that represent the solids of `scene`, about as far apart as the sand's [m], shape [N, D]: a lattice in
    each baffle and solid, finer in thin ones; two layers along the terrain, from below."""
    spacing, size, planar = scene.particle_spacing, np.array(scene.domain.size), scene.dimension == 2
    parts = [np.empty((0, scene.dimension))]
    for solid, key in zip(*solids_of(scene), strict=True):
        if solid.kind == "terrain":
            continue
        body = closed_body(solid, key, scene.domain)
        vertices, faces = body.vertices, body.faces
        shape = shapely.Polygon(vertices) if planar else manifold(vertices, faces)
        thickness = 2.0 * (shape.area / shape.length if planar else shape.volume() / shape.surface_area())
        lattice, _ = lattice_in(vertices.min(axis=0), vertices.max(axis=0), min(spacing, thickness))
        parts.append(lattice[shapely.contains_xy(shape, lattice) if planar else sliced(vertices, faces, lattice)])
    if any(solid.kind == "terrain" for solid in scene.solids):
        lengths = size[plan_axes(scene.dimension)]
        plan, _ = lattice_in(np.zeros(len(lengths)), lengths, spacing)
        top = elevation(scene.solids, scene.domain, plan)
        parts += [np.insert(plan, 1, top - share * spacing, axis=1) for share in (0.5, 1.5)]
    points = np.concatenate(parts)
    return np.asarray(points[((points >= 0.0) & (points <= size)).all(axis=1)])


def write(path: Path, flows: Iterable[tuple[str, Trajectory]]) -> None:
    """Write a split: for each trajectory the sand and, after it, the particles that represent baffles and solids."""
    with replacing(path) as part, zipfile.ZipFile(part, "w") as archive:
        for name, flow in flows:
            sand, obstacles = np.asarray(flow.positions), obstacle_particles(flow.scene).astype(np.float32)
            objects = np.empty(3, dtype=object)
            objects[0] = np.concatenate([sand, np.broadcast_to(obstacles, (len(sand), *obstacles.shape))], axis=1)
            counts = sand.shape[1], len(obstacles)
            objects[1] = np.repeat(np.array([ParticleType.SAND, ParticleType.STATIONARY], np.int64), counts)
            objects[2] = np.concatenate([flow.friction, np.zeros(len(obstacles), np.float32)])
            with archive.open(zipfile.ZipInfo(f"{name}.npy", EARLIEST), "w", force_zip64=True) as stream:
                np.lib.format.write_array(stream, objects, allow_pickle=True)


def read(path: Path) -> Iterator[tuple[str, Sand]]:
    """The sand of the trajectories of a split by name; never executes a pickle. One is in memory at a time unless they
    are one array. Raises InputError, which names the file and the trajectory."""
    with open_npz(path, "a whole NPZ") as archive:
        whole = np.atleast_1d(read_member(archive, ALL, WHAT, ArrayUnpickler)) if ALL in keys(archive) else None
        names = keys(archive) if whole is None else [f"{index:05d}" for index in range(len(whole))]
        require(len({*names}) == len(names), "", "each key once", where=str(path))
        for index, name in enumerate(names):
            parts = read_member(archive, name, WHAT, ArrayUnpickler) if whole is None else whole[index]
            with reading(path, WHAT, name):
                positions, types, material = (*parts, None)[:3]
                sand = checked(positions, types, material)
            yield name, sand


def checked(positions: Any, types: Any, material: Any) -> Sand:
    """The sand in what a file holds of a trajectory. Raises InputError. A material property, tan(phi), may be one for
    all, for each particle, or for each of sand: their generator leaves the obstacles out."""

    def numbers(value: Any, what: str, kinds: str) -> NDArray[Any]:
        array = np.asarray(value)
        require(array.dtype.kind in kinds, "", f"{what} as {'integers' if kinds == 'iu' else 'numbers'}", array.dtype)
        return array

    positions = numbers(positions, "positions", "f")
    expected = "positions of shape [T, N, 2 or 3] over two frames or more"
    fits = positions.ndim == 3 and positions.shape[2] in (2, 3) and len(positions) > 1 and positions.shape[1] > 0
    require(fits, "", expected, positions.shape)
    count = positions.shape[1]
    types = numbers(types, "types", "iu")
    require(types.shape in ((), (count,)), "", f"one type for all particles or for each of {count}", types.shape)
    present = sorted(set(types.ravel().tolist()))
    require(set(present) <= set(ParticleType), "", f"particle types of {sorted(map(int, ParticleType))}", present)
    sand = np.broadcast_to(types == ParticleType.SAND, (count,))
    require(bool(sand.any()), "", "sand that moves", "obstacles alone")
    if material is None:
        return positions[:, sand], None
    values = numbers(material, "material properties", "iuf")
    if values.ndim == 2 and values.shape[1] == 1:
        values = values[:, 0]
    moving = int(sand.sum())
    expected = f"one material property, tan(phi), for all particles or for each of {count}"
    require(values.shape in ((), (count,), (moving,)), "", expected, values.shape)
    values = np.broadcast_to(values[sand] if values.shape == sand.shape else values, moving)
    wrong = values[~((values >= 0.0) & (values <= STEEPEST))]
    require(len(wrong) == 0, "", f"a material property that is a tan(phi), 0 to {STEEPEST:g}", *wrong[:1].tolist())
    return positions[:, sand], values


class ArrayUnpickler(pickle.Unpickler):
    """Reads the object arrays of other codes: only five names of NumPy are looked up, so that no other is called.
    https://docs.python.org/3/library/pickle.html#restricting-globals"""

    def find_class(self, module: str, name: str) -> Any:
        """The object of an allowed name. Raises InputError."""
        module = module.replace("numpy.core.", "numpy._core.")
        if f"{module}.{name}" not in NAMES:
            raise InputError(f"expected arrays and nothing else, found the name {f'{module}.{name}'[:80]!r}")
        return super().find_class(module, name)
