"""Trajectories in HDF5, at a quarter of their size: positions as whole numbers of a quantum, differenced in time.

    x_t = q (k_s + sum of k over s < u <= t),    q = 2^floor(log2(dx / 10^4)),    s: the first frame of the group of t

so that a position is within dx / 20,000 (dx: the scene's cell) of what it was. Groups of frames can be read on their
own; deposits at rest take next to nothing. Everything else is stored as it is, all of it deflated with its bytes
shuffled. Texts are arrays of bytes.
"""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from datasets.arrays import open_hdf5, read_array
from datasets.errors import InputError
from datasets.reading import reading

SUFFIX = ".h5"
FINENESS = 1.0e4
"""Quanta in a cell, at least."""
GROUP = 32
"""Frames of a group: the first holds positions, the others differences from the frame before."""
PARTICLES = 1024
"""Particles of a chunk."""
LEVEL = 4
"""Of deflate: higher ones take longer and save little."""
MOST_QUANTA = 2**30
"""Positions beyond so many quanta are stored as they are."""
TEXTS = ("scene", "summary")


def write_compressed(path: Path, arrays: Mapping[str, NDArray[Any]], cell: float) -> None:
    """Write the arrays of a trajectory, `positions` [T, N, D] among them, of a scene with the cell `cell` [m]."""
    with h5py.File(path, "w") as file:
        for key, array in arrays.items():
            if key == "positions":
                write_positions(file, array, 2.0 ** math.floor(math.log2(cell / FINENESS)))
            elif array.dtype.kind == "U":
                file.create_dataset(key, data=np.frombuffer(str(array).encode(), np.uint8))
            else:
                file.create_dataset(key, data=array, **how(array.shape))


def how(shape: tuple[int, ...]) -> dict[str, Any]:
    """How an array is stored: in chunks, deflated, where it is more than a few numbers."""
    if math.prod(shape) < PARTICLES:
        return {}
    largest = (GROUP, PARTICLES, *shape[2:]) if len(shape) > 1 else (PARTICLES,)
    chunks = tuple(map(min, largest, shape))
    return {"chunks": chunks, "compression": "gzip", "compression_opts": LEVEL, "shuffle": True}


def write_positions(file: h5py.File, positions: NDArray[np.float32], quantum: float) -> None:
    """Write positions [T, N, D] a group of frames at a time: they may be more than fit into memory."""
    groups = [slice(first, first + GROUP) for first in range(0, len(positions), GROUP)]
    if not all(np.abs(positions[group]).max() < MOST_QUANTA * quantum for group in groups):
        file.create_dataset("positions", data=positions, **how(positions.shape))
        return
    stored = file.create_dataset("positions", positions.shape, np.int32, **how(positions.shape))
    stored.attrs["quantum"], stored.attrs["group"] = quantum, GROUP
    for group in groups:
        quanta = np.rint(positions[group] / np.float64(quantum)).astype(np.int32)
        quanta[1:] -= quanta[:-1].copy()
        stored[group] = quanta


def read_compressed(path: Path, *names: str, optional: tuple[str, ...] = ()) -> dict[str, NDArray[Any]]:
    """The arrays `names` that `write_compressed` wrote and, where they are there, `optional`; all where none is named.

    Raises InputError.
    """
    with open_hdf5(path) as file, reading(path, "a trajectory in HDF5"):
        there = [name for name in optional if name in file]
        return {name: decoded(file, name) for name in (*names, *there) or list(file)}


def decoded(file: h5py.File, key: str) -> NDArray[Any]:
    """The array `key` as it was given. Raises InputError."""
    if key not in file:
        raise InputError("expected an array, the key is missing", where=file.filename, key=key)
    array = read_array(file, key)
    if key in TEXTS:
        if array.dtype != np.uint8:
            raise InputError("expected text, as bytes", where=file.filename, key=key)
        return np.array(array.tobytes().decode())
    if key != "positions" or array.dtype != np.int32 or array.ndim != 3:
        return array
    quantum, group = float(file[key].attrs.get("quantum", math.nan)), int(file[key].attrs.get("group", 0))
    if not (0.0 < quantum < math.inf and group >= 1):
        raise InputError("expected the attributes quantum and group, both positive", where=file.filename, key=key)
    positions = np.empty(array.shape, np.float32)
    for first in range(0, len(array), group):
        positions[first : first + group] = np.cumsum(array[first : first + group], axis=0, dtype=np.int64) * quantum
    return positions
