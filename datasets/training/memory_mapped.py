"""Trajectories of any size without reading them: the positions of an NPZ as a memory map of the file itself.

`numpy.savez` stores its arrays in the archive as they are. Where the bytes of one begin is known from the archive's
directory, so the operating system can bring in the pages that are asked for and no others.
"""

import struct
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from datasets.arrays import open_npz, read_header
from datasets.compressed import SUFFIX
from datasets.errors import InputError
from datasets.reading import reading
from datasets.trajectory import Trajectory, check_numbers, checked_mass, read_arrays, scene_in

LIMIT = 2**30
"""Largest array [bytes] that is read into memory because it cannot be mapped: compressed, or not float32."""
WHAT = "a whole NPZ of plain arrays (a trajectory)"
LOCAL_HEADER = struct.Struct("<4s22xHH")
"""What stands before a member of a zip archive: signature, then the lengths of its name and of its extra field."""


def open_trajectory(path: Path) -> Trajectory:
    """The trajectory at `path`, its positions mapped and read-only, without the recorded fields and the summary.

    Checks what there is to check without reading the positions. Raises InputError, which names the file and the key.
    The file stays open for as long as the positions are in use.
    """
    arrays = read_arrays(path, "velocity0", "friction", "time", "scene", optional=("volume", "mass"))
    scene = scene_in(arrays["scene"], path)
    positions = mapped(path, "positions")
    if positions.ndim != 3 or positions.shape[2] not in (2, 3) or positions.size == 0:
        expected = "shape [T, N, 2 or 3], at least one frame of one particle"
        raise InputError(f"expected {expected}, got {positions.shape}", where=str(path), key="positions")
    frames, particles, dimension = positions.shape
    shapes = {"time": (frames,), "velocity0": (particles, dimension), "friction": (particles,), "volume": (particles,)}
    for key, shape in shapes.items():
        if key in arrays and arrays[key].shape != shape:
            raise InputError(f"expected shape {shape}, got {arrays[key].shape}", where=str(path), key=key)
    if scene.dimension != dimension:
        expected = f"{scene.dimension}D positions as in the scene"
        raise InputError(f"expected {expected}, got {dimension}D", where=str(path), key="positions")
    check_numbers(arrays, path)
    return Trajectory(
        positions=positions,
        time=arrays["time"].astype(np.float64, copy=False),
        velocity0=arrays["velocity0"].astype(np.float32, copy=False),
        friction=arrays["friction"].astype(np.float32, copy=False),
        scene=scene,
        volume=arrays["volume"].astype(np.float32, copy=False) if "volume" in arrays else None,
        mass=checked_mass(arrays.get("mass"), particles, scene, path),
    )


def mapped(path: Path, key: str, *, limit: int = LIMIT) -> NDArray[np.float32]:
    """The array `key` of the NPZ at `path` as float32: a read-only map of the file where it is stored so.

    One that is compressed or of another type is read whole, from an NPZ if it has at most `limit` bytes. Raises
    InputError.
    """
    if path.suffix == SUFFIX:
        return read_arrays(path, key)[key]
    with open_npz(path, WHAT) as file:
        member = file.member(key)
    if member.compress_type == zipfile.ZIP_STORED:
        with reading(path, WHAT, key):
            offset, shape, fortran, kind = _stored(path, member)
            if kind == np.float32 and kind.isnative:
                order: Any = "F" if fortran else "C"
                whole = np.memmap(path, dtype=np.float32, mode="r", offset=offset, shape=shape, order=order)
                # A plain array: slices of a memmap are slow to make and say nothing more.
                return np.asarray(whole)
    if member.file_size > limit:
        expected = f"float32 numbers that are stored uncompressed (numpy.savez), or at most {limit / 2**20:g} MiB"
        raise InputError(f"expected {expected}, got {member.file_size / 2**20:.0f} MiB", where=str(path), key=key)
    array = read_arrays(path, key)[key]
    if not np.issubdtype(array.dtype, np.floating):
        raise InputError(f"expected floating-point numbers, got {array.dtype}", where=str(path), key=key)
    return array.astype(np.float32, copy=False)


def _stored(path: Path, member: zipfile.ZipInfo) -> tuple[int, tuple[int, ...], bool, np.dtype[Any]]:
    """Where the bytes of an uncompressed array begin in the file; its shape, Fortran order, type."""
    with path.open("rb") as file:
        file.seek(member.header_offset)
        signature, name, extra = LOCAL_HEADER.unpack(file.read(LOCAL_HEADER.size))
        if signature != b"PK\x03\x04":
            raise ValueError(f"no member begins at byte {member.header_offset}")
        file.seek(name + extra, 1)
        shape, fortran, kind = read_header(file)
        return file.tell(), shape, fortran, kind
