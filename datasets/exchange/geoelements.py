"""The layout of geoelements/gns: NPZ of pickled object arrays, sand and obstacles in one cloud of particles, no scene.

A split is one file (`train.npz`, `valid.npz`, `test.npz`); each of its keys holds an object array `(positions
[T, N, D], types [N] or one, material [N] or one)`, the last of which may be missing. Older files hold all trajectories
in one array, `gns_data`; such a file cannot be read one trajectory at a time.
"""

import io
import math
import pickle
import pickletools
import zipfile
from collections.abc import Container, Iterable, Iterator
from dataclasses import dataclass
from enum import IntEnum
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from datasets.arrays import keys, member, open_npz, read_header, read_member
from datasets.errors import InputError
from datasets.files import reading, replacing
from datasets.scene import Baffle
from datasets.trajectory import Trajectory

ALL = "gns_data"
"""The key that holds all trajectories where it exists."""
WHAT = "positions, particle types and perhaps a material property"
FARTHEST = 1.0e6
"""Positions [m] beyond this mean a broken file; single precision would tell them no better than to 6 cm."""
STEEPEST = 1.0e3
"""A tan(phi) beyond this is none."""
EARLIEST = (1980, 1, 1, 0, 0, 0)
"""The date of every member: the same trajectories give the same bytes."""


class ParticleType(IntEnum):
    """Their numbers; those that are not here are other materials, such as water (5) or goop (7)."""

    STATIONARY = 3
    SAND = 6


@dataclass(frozen=True, kw_only=True)
class Cloud:
    """One trajectory as they store it."""

    name: str
    positions: NDArray[np.floating]
    """Positions [m], shape [T, N, D]."""
    stationary: NDArray[np.bool_]
    """Which particles are obstacles, shape [N]; the others are sand."""
    friction: NDArray[np.float32] | None
    """tan(phi) of each particle [-], shape [N], 0 for obstacles; None where the file does not say."""


def cloud_of(trajectory: Trajectory, name: str) -> Cloud:
    """Sand and, after it, the lattices of particles that stand for the baffles, at the spacing of the sand's."""
    scene, sand = trajectory.scene, np.asarray(trajectory.positions)
    lattices = [obstacle_particles(baffle, scene.particle_spacing) for baffle in scene.baffles]
    obstacles = np.concatenate([np.empty((0, scene.dimension)), *lattices]).astype(np.float32)
    return Cloud(
        name=name,
        positions=np.concatenate([sand, np.broadcast_to(obstacles, (len(sand), *obstacles.shape))], axis=1),
        stationary=np.repeat([False, True], [sand.shape[1], len(obstacles)]),
        friction=np.concatenate([trajectory.friction, np.zeros(len(obstacles), np.float32)]),
    )


def obstacle_particles(baffle: Baffle, spacing: float) -> NDArray[np.float64]:
    """A lattice that fills `baffle`, about `spacing` [m] apart and at least two along each axis: [m], shape [N, D].

    Each particle stands in the middle of its share of the box.
    """
    axes = []
    for low, size in zip(baffle.lower, baffle.size, strict=True):
        count = max(2, round(size / spacing))
        axes.append(low + (np.arange(count) + 0.5) * (size / count))
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(axes))


def write(path: Path, clouds: Iterable[Cloud]) -> None:
    """Write a split, one trajectory in memory at a time."""
    with replacing(path) as part, zipfile.ZipFile(part, "w") as archive:
        for cloud in clouds:
            types = np.where(cloud.stationary, ParticleType.STATIONARY, ParticleType.SAND).astype(np.int64)
            items = [each for each in (cloud.positions, types, cloud.friction) if each is not None]
            objects = np.empty(len(items), dtype=object)
            for index, item in enumerate(items):
                # A byte order of its own is what their tensors cannot take.
                objects[index] = np.ascontiguousarray(item, item.dtype.newbyteorder("="))
            with archive.open(zipfile.ZipInfo(f"{cloud.name}.npy", EARLIEST), "w", force_zip64=True) as stream:
                np.lib.format.write_array(stream, objects, allow_pickle=True)


def names(path: Path) -> list[str]:
    """The trajectories of a split, in order, without reading them. Raises InputError."""
    with open_npz(path, "a whole NPZ") as archive:
        if ALL not in keys(archive):
            return keys(archive)
        with reading(path, "an array of trajectories", ALL), archive.open(member(archive, ALL)) as stream:
            (count,), *_ = read_header(stream)
            return [f"{index:05d}" for index in range(count)]


def read(path: Path, requested: Container[str]) -> Iterator[Cloud]:
    """The trajectories of a split whose names are `requested`, one in memory at a time unless they are one array.

    Never executes a pickle. Raises InputError, which names the file and the trajectory.
    """
    with open_npz(path, "a whole NPZ") as archive:
        whole = read_member(archive, ALL, WHAT, unpickled) if ALL in keys(archive) else None
        for index, name in enumerate(names(path)):
            if name not in requested:
                continue
            parts = read_member(archive, name, WHAT, unpickled) if whole is None else whole[index]
            with reading(path, WHAT, name):
                positions, types, material = (*parts, None)[:3]
                cloud = checked(name, positions, types, material)
            yield cloud


def checked(name: str, positions: Any, types: Any, material: Any) -> Cloud:
    """A cloud from what a file holds.

    Raises InputError for anything else than positions [T, N, D], one type per particle or for all, and at most one
    material property, tan(phi), per particle, per particle of sand (their generator leaves the obstacles out), or for
    all.
    """

    def require(ok: bool, expected: str, got: object) -> None:
        if not ok:
            raise InputError(f"expected {expected}, got {got}")

    def numbers(value: Any, what: str, kinds: str) -> NDArray[Any]:
        array = np.asarray(value)
        require(array.dtype.kind in kinds, f"{what} as {'integers' if kinds == 'iu' else 'numbers'}", array.dtype)
        return array

    positions = numbers(positions, "positions", "f")
    expected = "positions of shape [T, N, 2 or 3] over two frames or more"
    known = positions.ndim == 3 and positions.shape[2] in (2, 3) and len(positions) > 1 and positions.shape[1] > 0
    require(known, expected, positions.shape)
    require(bool((abs(positions) < FARTHEST).all()), f"positions within {FARTHEST:g} m", "others, or nan")
    count = positions.shape[1]
    types = numbers(types, "types", "iu")
    require(types.shape in ((), (count,)), f"one type for all particles or for each of {count}", types.shape)
    found = sorted(set(types.ravel().tolist()))
    require(set(found) <= set(ParticleType), f"particle types of {sorted(map(int, ParticleType))}", found)
    still = np.broadcast_to(types == ParticleType.STATIONARY, (count,))
    require(not still.all(), "sand that moves", "obstacles alone")
    if material is None:
        return Cloud(name=name, positions=positions, stationary=still, friction=None)
    values = numbers(material, "material properties", "iuf")
    require(bool((abs(values) < STEEPEST).all()), "a material property that is a tan(phi)", "other numbers")
    if values.ndim == 2 and values.shape[1] == 1:
        values = values[:, 0]
    friction = np.zeros(count, np.float32)
    expected = f"one material property, tan(phi), for all particles or for each of {count}"
    require(values.shape in ((), (count,), (int((~still).sum()),)), expected, values.shape)
    friction[~still] = values[~still] if values.shape == still.shape else values
    return Cloud(name=name, positions=positions, stationary=still, friction=friction)


def unpickled(content: bytes) -> Any:
    """What a pickle of arrays holds, without executing anything. Raises InputError and whatever `pickle` does."""
    for opcode, argument, _ in pickletools.genops(content):
        # The unpickler makes room for as many values as a number in the file says.
        if "PUT" in opcode.name and int(argument or 0) > len(content):
            raise InputError("expected arrays and nothing else, found more values than bytes")
    return ArrayUnpickler(io.BytesIO(content)).load()


class ArrayUnpickler(pickle.Unpickler):
    """The object arrays of other codes: five names of NumPy's are looked up and no others, so no other is called.

    https://docs.python.org/3/library/pickle.html#restricting-globals
    """

    def find_class(self, module: str, name: str) -> Any:
        """What a name stands for here. Raises InputError."""
        match module, name:
            case "numpy", "dtype":
                return plain_dtype
            case "numpy", "ndarray":
                return PickledArray
            case "_codecs", "encode":
                return super().find_class(module, name)
            case "numpy.core.multiarray" | "numpy._core.multiarray", "_reconstruct":
                # Its shape is that of its state, which is held against what is there.
                return lambda *_: np.ndarray.__new__(PickledArray, (0,))
            case "numpy.core.multiarray" | "numpy._core.multiarray", "scalar":
                return super().find_class("numpy._core.multiarray", name)
        raise InputError(f"expected arrays and nothing else, found the name {f'{module}.{name}'[:80]!r}")


class PickledArray(np.ndarray[Any, Any]):
    """An array that takes the state of no more elements than its pickle brings."""

    def __setstate__(self, state: Any) -> None:
        _, shape, dtype, _, content = state
        if math.prod(shape) * (1 if dtype.hasobject else dtype.itemsize) != len(content):
            raise InputError("expected arrays and nothing else, found one whose shape does not match its content")
        super().__setstate__(state)


def plain_dtype(code: str, *_: Any) -> np.dtype[Any]:
    """A new dtype of numbers or of objects, whose byte order its state may set. Raises InputError."""
    dtype = np.dtype(code)
    if dtype.kind not in "biufO":
        raise InputError(f"expected arrays and nothing else, found the dtype {code!r}")
    return np.dtype(code, False, True)
