"""The layout of geoelements/gns: NPZ of pickled object arrays, one per trajectory.

A split is one file (`train.npz`, `valid.npz`, `test.npz`); each of its keys holds an object array `(positions
[T, N, D], types [N] or one, material [N] or one)`, the last of which may be missing. Older files hold all trajectories
in one array, `gns_data`; such a file cannot be read one trajectory at a time.
"""

import zipfile
from collections.abc import Container, Iterable, Iterator
from enum import IntEnum
from pathlib import Path
from typing import Any

import numpy as np

from datasets.arrays import open_npz
from datasets.errors import InputError
from datasets.exchange.cloud import Cloud, checked_cloud
from datasets.files import replacing

SUFFIX = ".npz"
ALL = "gns_data"
"""The key that holds all trajectories where it exists."""


class ParticleType(IntEnum):
    """Their numbers; those that are not here are other materials, such as water (5) or goop (7)."""

    STATIONARY = 3
    SAND = 6


STATIONARY = {int(kind): kind is ParticleType.STATIONARY for kind in ParticleType}

EARLIEST = (1980, 1, 1, 0, 0, 0)
"""The date of every member: the same trajectories give the same bytes."""


def write(path: Path, clouds: Iterable[Cloud]) -> None:
    """Write a split, one trajectory in memory at a time."""
    with replacing(path) as part, zipfile.ZipFile(part, "w") as archive:
        for cloud in clouds:
            if cloud.name == ALL:
                raise InputError(f"expected a trajectory of another name than {ALL}", where=str(path))
            types = np.where(cloud.stationary, ParticleType.STATIONARY, ParticleType.SAND).astype(np.int64)
            items = [each for each in (cloud.positions, types, cloud.friction) if each is not None]
            objects = np.empty(len(items), dtype=object)
            for index, item in enumerate(items):
                # A byte order of its own is what their tensors cannot take.
                objects[index] = np.ascontiguousarray(item, item.dtype.newbyteorder("="))
            with archive.open(zipfile.ZipInfo(f"{cloud.name}.npy", EARLIEST), "w", force_zip64=True) as stream:
                np.lib.format.write_array(stream, objects, allow_pickle=True)


def metadata(shared: dict[str, Any], *, frames: int, **_: Any) -> dict[str, Any]:
    """What `metadata.json` says; the counts of features are those of their network with one material property.

    shared: the keys that all layouts have; frames: of a trajectory, the start included.
    """
    axes = shared["dim"]
    velocities, walls, embedding, material = 5 * axes, 2 * axes, 16, 1
    return {
        **shared,
        "sequence_length": frames,
        "material_feature_len": material,
        "nnode_in": velocities + walls + embedding + material,
        "nedge_in": axes + 1,
        "nmessage_passing_steps": 10,
    }


def names(path: Path) -> list[str]:
    """The trajectories of a split, in order, without reading them. Raises InputError."""
    with open_npz(path) as file:
        if ALL not in file.keys:
            return file.keys
        shape = file.shape(ALL)
        if len(shape) == 0:
            raise InputError("expected an array of trajectories", where=str(path), key=ALL)
        return [f"{index:05d}" for index in range(shape[0])]


def read(path: Path, requested: Container[str]) -> Iterator[Cloud]:
    """The trajectories of a split whose names are `requested`, one in memory at a time unless they are one array.

    Never executes a pickle. Raises InputError, which names the file and the trajectory.
    """
    with open_npz(path) as file:
        whole = file.read(ALL, objects=True) if ALL in file.keys else None
        for index, name in enumerate(names(path)):
            if name not in requested:
                continue
            parts = file.read(name, objects=True) if whole is None else whole[index]
            if isinstance(parts, np.ndarray) and parts.ndim == 0 and parts.dtype.hasobject:
                parts = parts.item()
            try:
                if not isinstance(parts, tuple | list | np.ndarray) or len(parts) not in (2, 3):
                    message = "expected positions, particle types and perhaps a material property"
                    raise InputError(message, key=name)
                positions, types, material = (*parts, None)[:3]
                yield checked_cloud(name, positions, types, material, stationary=STATIONARY)
            except InputError as error:
                raise error.at(str(path)) from None
