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

from datasets.errors import InputError
from datasets.exchange.common import Described, Particles, checked_particles
from datasets.exchange.foreign_npz import ForeignNpz, open_foreign_npz
from datasets.exchange.pickle_writing import object_array_pickle
from datasets.files import replacing

SUFFIX = ".npz"
ALL = "gns_data"
"""The key that holds all trajectories where it exists."""


class ParticleType(IntEnum):
    """The peers' numbers; those that are not here are other materials, such as water (5) or goop (7)."""

    STATIONARY = 3
    SAND = 6


STATIONARY = {int(kind): kind is ParticleType.STATIONARY for kind in ParticleType}

EARLIEST = (1980, 1, 1, 0, 0, 0)
"""The date of every member: the same trajectories give the same bytes."""


def write(path: Path, trajectories: Iterable[Particles]) -> None:
    """Write a split, one trajectory in memory at a time; numpy 1 and 2 read it alike."""
    with replacing(path) as part, zipfile.ZipFile(part, "w") as archive:
        for particles in trajectories:
            if particles.name == ALL:
                raise InputError(f"expected a trajectory of another name than {ALL}", where=str(path))
            items = [
                particles.positions,
                np.where(particles.stationary, ParticleType.STATIONARY, ParticleType.SAND).astype(np.int64),
            ]
            if particles.friction is not None:
                items.append(particles.friction)
            member = zipfile.ZipInfo(f"{particles.name}.npy", EARLIEST)
            with archive.open(member, "w", force_zip64=True) as stream:
                header = {"descr": "|O", "fortran_order": False, "shape": (len(items),)}
                np.lib.format.write_array_header_1_0(stream, header)
                for piece in object_array_pickle(items):
                    stream.write(piece)


def metadata(described: Described) -> dict[str, Any]:
    """What `metadata.json` says; the counts of features are those of the peers' network with one material property."""
    axes = len(described.size)
    velocities, walls, embedding, material = 5 * axes, 2 * axes, 16, 1
    return {
        **described.shared_keys(),
        "sequence_length": described.frames,
        "material_feature_len": material,
        "nnode_in": velocities + walls + embedding + material,
        "nedge_in": axes + 1,
        "nmessage_passing_steps": 10,
    }


def names(path: Path) -> list[str]:
    """The trajectories of a split, in order, without reading them. Raises InputError."""
    with open_foreign_npz(path) as file:
        if ALL not in file.keys:
            return file.keys
        shape = file.shape(ALL)
        if len(shape) == 0:
            raise InputError("expected an array of trajectories", where=str(path), key=ALL)
        return [f"{index:05d}" for index in range(shape[0])]


def read(path: Path, wanted: Container[str]) -> Iterator[Particles]:
    """The trajectories of a split whose names are `wanted`, one in memory at a time unless they are one array.

    Never executes a pickle. Raises InputError, which names the file and the trajectory.
    """
    with open_foreign_npz(path) as file:
        for name, parts in _entries(file, wanted):
            try:
                yield _particles(name, parts)
            except InputError as error:
                raise error.at(str(path)) from None


def _entries(file: ForeignNpz, wanted: Container[str]) -> Iterator[tuple[str, Any]]:
    if ALL in file.keys:
        for index, parts in enumerate(file.read(ALL)):
            if f"{index:05d}" in wanted:
                yield f"{index:05d}", parts
    else:
        yield from ((name, file.read(name)) for name in file.keys if name in wanted)


def _particles(name: str, parts: Any) -> Particles:
    if isinstance(parts, np.ndarray) and parts.ndim == 0 and parts.dtype.hasobject:
        parts = parts.item()
    if not isinstance(parts, tuple | list | np.ndarray) or len(parts) not in (2, 3):
        raise InputError("expected positions, particle types and perhaps a material property", key=name)
    positions, types, material = (*parts, None)[:3]
    return checked_particles(name, positions, types, material, stationary=STATIONARY)
