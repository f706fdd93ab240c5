"""Arrays of frames in files: NPZ whole or mapped, HDF5 written and read frame by frame.

`numpy.savez` stores its arrays as they are, so the positions of an NPZ are a memory map of the file itself. An array of
frames in HDF5 grows along its first axis, single precision as it is, in chunks of a frame (of small frames as many as
fill `CHUNK`) that are deflated with their bytes shuffled; a text is an array of its bytes.
"""

import math
import struct
import zipfile
from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import NDArray

from datasets.arrays import open_hdf5, open_npz, plain_array, read_array, read_header
from datasets.errors import InputError
from datasets.files import replacing
from datasets.reading import reading

# Most commands read NPZ alone.
if TYPE_CHECKING:
    import h5py

HDF5 = ".h5"
CHUNK = 2**16
"""Bytes that a chunk of HDF5 holds at least."""
LARGEST_CHUNK = 2**30
"""Bytes of a chunk that is read."""
DEFLATED: dict[str, Any] = {"compression": "gzip", "compression_opts": 4, "shuffle": True}
TEXTS = ("scene", "summary")
WHAT = "a trajectory"
LOCAL_HEADER = struct.Struct("<4s22xHH")
"""What stands before a member of a zip archive: signature, then the lengths of its name and of its extra field."""


class FrameWriter:
    """An HDF5 file that grows as frames are computed: memory holds no more of them than one call appends.

    The file takes its place when the block ends. For example:

        with FrameWriter("flow.h5") as file:
            for positions in run:  # [F, N, D]
                file.append(positions=positions)
            flow = Trajectory(positions=file.frames("positions"), ...)  # which are read from the file
            file.put(**flow.arrays())
    """

    def __init__(self, path: str | Path) -> None:
        self._path, self._stack = Path(path), ExitStack()

    def __enter__(self) -> "FrameWriter":
        import h5py

        part = self._stack.enter_context(replacing(self._path))
        self._file = self._stack.enter_context(h5py.File(part, "w"))
        return self

    def __exit__(self, *error: Any) -> None:
        kind, value, trace = cast(tuple[type[BaseException] | None, BaseException | None, TracebackType | None], error)
        self._stack.__exit__(kind, value, trace)

    def put(self, **arrays: NDArray[Any] | str) -> None:
        """Write whole arrays, and texts."""
        for key, value in arrays.items():
            array = np.frombuffer(value.encode(), np.uint8) if isinstance(value, str) else np.asarray(value)
            chunks = (frames_in_chunk(array), *array.shape[1:]) if array.nbytes > CHUNK else None
            self._file.create_dataset(key, data=array, chunks=chunks, **(DEFLATED if chunks else {}))

    def append(self, **frames: NDArray[Any]) -> None:
        """Add frames, shape [F, ...] each, to what there is of every key."""
        for key, values in frames.items():
            if key not in self._file:
                shape, chunks = values.shape[1:], (frames_in_chunk(values), *values.shape[1:])
                self._file.create_dataset(key, data=values, maxshape=(None, *shape), chunks=chunks, **DEFLATED)
            else:
                stored = self._file[key]
                stored.resize(len(stored) + len(values), axis=0)
                stored[-len(values) :] = values

    def frames(self, key: str) -> NDArray[Any]:
        """What was appended, to be read from the file; `Frames`."""
        return cast(NDArray[Any], Frames(self._file[key]))


def frames_in_chunk(values: NDArray[Any]) -> int:
    """How many rows of an array fill a chunk."""
    return max(1, CHUNK // int(values[0].nbytes))


class Frames:
    """Frames in an HDF5 file, shape [T, ...]: a number reads one of them, a slice reads none until it is indexed.

    Stands where an array of numpy does that is indexed by frame: `frames[-1]`, `frames[::2][3:5, particles]`.
    """

    def __init__(self, stored: "h5py.Dataset", chosen: range | None = None) -> None:
        self._stored = stored
        self._chosen = range(len(stored)) if chosen is None else chosen
        self.shape: tuple[int, ...] = (len(self._chosen), *stored.shape[1:])
        self.dtype: np.dtype[Any] = stored.dtype
        self.ndim, self.size = len(self.shape), math.prod(self.shape)
        self.nbytes = self.size * self.dtype.itemsize

    def __len__(self) -> int:
        return len(self._chosen)

    def __getitem__(self, key: Any) -> Any:
        first, *others = key if isinstance(key, tuple) else (key,)
        if isinstance(first, slice):
            part = Frames(self._stored, self._chosen[first])
            return np.asarray(part)[:, *others] if others else part
        if isinstance(first, int | np.integer):
            one = self._chosen[int(first)]
            return self._read(slice(one, one + 1))[0, *others]
        return np.asarray(self)[key]

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        chosen = self._chosen
        return self._read(slice(chosen.start, chosen.stop, chosen.step)).astype(dtype or self.dtype, copy=False)

    def _read(self, frames: slice) -> NDArray[Any]:
        with reading(Path(self._stored.file.filename), WHAT, self._stored.name.lstrip("/")):
            return np.asarray(self._stored[frames])


def write_npz(path: Path, arrays: Mapping[str, NDArray[Any]]) -> None:
    """Write an NPZ of plain arrays."""
    with replacing(path) as part:
        np.savez(part, **cast(Any, arrays))


def read_arrays(path: Path, *names: str, optional: tuple[str, ...] = (), what: str = WHAT) -> dict[str, NDArray[Any]]:
    """The arrays `names` of an NPZ or HDF5 file and, where they are there, `optional`; all where none is named.

    Never runs a pickle. Raises InputError.
    """
    if path.suffix == HDF5:
        with open_hdf5(path) as file, reading(path, what):
            there = [name for name in optional if name in file]
            return {name: _decoded(file, name) for name in (*names, *there) or list(file)}
    with open_npz(path, f"a whole NPZ of plain arrays ({what})") as archive:
        there = [name for name in optional if name in archive.keys]
        return {name: archive.read(name) for name in (*names, *there) or archive.keys}


def open_frames(path: Path, key: str) -> NDArray[Any]:
    """The frames `key` of an NPZ or HDF5 file, read when they are used and no sooner; read-only.

    From an NPZ a memory map, or the whole array where it is compressed or not float32; from HDF5 `Frames`. The file
    stays open for as long as they are in use. Raises InputError.
    """
    if path.suffix == HDF5:
        import h5py

        with reading(path, WHAT, key):
            stored = plain_array(h5py.File(path, "r", locking=False), key)
            if stored.chunks and math.prod(stored.chunks) * stored.dtype.itemsize > LARGEST_CHUNK:
                raise InputError(f"expected chunks of at most {LARGEST_CHUNK} bytes")
            return cast(NDArray[Any], Frames(stored))
    with open_npz(path, WHAT) as file:
        member = file.member(key)
    if member.compress_type == zipfile.ZIP_STORED:
        with reading(path, WHAT, key):
            offset, shape, fortran, kind = _place(path, member)
            if kind == np.float32 and kind.isnative:
                order: Any = "F" if fortran else "C"
                # A plain array: slices of a memmap are slow to make and say nothing more.
                return np.asarray(np.memmap(path, np.float32, "r", offset, shape, order))
    return read_arrays(path, key)[key]


def _decoded(file: "h5py.File", key: str) -> NDArray[Any]:
    """An array of an HDF5 file, texts as texts. Raises InputError."""
    if key not in file:
        raise InputError("expected an array, the key is missing", where=file.filename, key=key)
    array = read_array(file, key)
    if key not in TEXTS:
        return array
    with reading(Path(file.filename), "text, as bytes", key):
        return np.array(bytes(array.astype(np.uint8, casting="safe")).decode())


def _place(path: Path, member: zipfile.ZipInfo) -> tuple[int, tuple[int, ...], bool, np.dtype[Any]]:
    """Where the bytes of an uncompressed array begin in the file; its shape, Fortran order, type."""
    with path.open("rb") as file:
        file.seek(member.header_offset)
        signature, name, extra = LOCAL_HEADER.unpack(file.read(LOCAL_HEADER.size))
        if signature != b"PK\x03\x04":
            raise ValueError(f"no member begins at byte {member.header_offset}")
        file.seek(name + extra, 1)
        shape, fortran, kind = read_header(file)
        return file.tell(), shape, fortran, kind
