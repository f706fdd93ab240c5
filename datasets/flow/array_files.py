"""Arrays in files: NPZ whole or mapped, HDF5 frame by frame; sizes are checked before reading, nothing is executed."""

import math
import zipfile
from collections.abc import Collection, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import NDArray

from datasets import memory
from datasets.errors import require
from datasets.files import file_size, reading, replacing

if TYPE_CHECKING:  # most commands read NPZ alone
    import h5py

HDF5 = ".h5"
CHUNK = 2**16  # smallest size of an HDF5 chunk [bytes]
PIECE = 2**20  # bytes read at once for a checksum
HEADERS = 2**17  # largest size of the headers of an NPZ member [bytes]
DEFLATED: dict[str, Any] = {"compression": "gzip", "compression_opts": 4, "shuffle": True}
TEXTS = ("scene", "summary")
WHAT = "a trajectory"


class FrameWriter:
    """An HDF5 file that grows as frames are computed, with only appended ones in memory; it appears at the end."""

    def __init__(self, path: str | Path) -> None:
        self._path, self._stack = Path(path), ExitStack()

    def __enter__(self) -> "FrameWriter":
        import h5py

        part = self._stack.enter_context(replacing(self._path))
        self._file = self._stack.enter_context(h5py.File(part, "w"))
        return self

    def __exit__(self, *error: Any) -> None:
        self._stack.__exit__(*error)

    def put(self, **arrays: NDArray[Any] | str) -> None:
        """Write whole arrays and texts."""
        for key, value in arrays.items():
            array = np.frombuffer(value.encode(), np.uint8) if isinstance(value, str) else np.asarray(value)
            chunks = (frames_in_chunk(array), *array.shape[1:]) if array.nbytes > CHUNK else None
            self._file.create_dataset(key, data=array, chunks=chunks, **(DEFLATED if chunks else {}))

    def append(self, **frames: NDArray[Any]) -> None:
        """Append frames, shape [F, ...] each, to each key."""
        for key, values in frames.items():
            if key not in self._file:
                shape, chunks = values.shape[1:], (frames_in_chunk(values), *values.shape[1:])
                self._file.create_dataset(key, data=values, maxshape=(None, *shape), chunks=chunks, **DEFLATED)
            else:
                stored = self._file[key]
                stored.resize(len(stored) + len(values), axis=0)
                stored[-len(values) :] = values

    def frames(self, key: str) -> NDArray[Any]:
        """The appended frames, read from the file on use; `Frames`."""
        return cast(NDArray[Any], Frames(self._file[key]))


def frames_in_chunk(values: NDArray[Any]) -> int:
    """Number of rows of an array that fill a chunk."""
    return max(1, CHUNK // int(values[0].nbytes))


class Frames:
    """Frames in an HDF5 file, shape [T, ...]: an index reads one frame, a slice reads none until it is indexed."""

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
    """Arrays of an NPZ or HDF5 file: `names` and, if there, `optional`; or all. Runs no pickle. Raises InputError."""

    def chosen(there: Collection[str]) -> list[str]:
        return [*names, *(name for name in optional if name in there)] or list(there)

    if path.suffix == HDF5:
        import h5py

        file_size(path, what)
        with reading(path, what), h5py.File(path, "r", locking=False) as file:
            return {name: _whole(file, name, what) for name in chosen(file)}
    whole = f"a whole NPZ of plain arrays ({what})"
    with open_npz(path, whole) as archive:
        return {name: read_member(archive, name, whole) for name in chosen(keys(archive))}


def open_frames(path: Path, key: str, *, sound: bool = False) -> NDArray[Any]:
    """The frames `key` of an NPZ or HDF5 file, read on use; read-only. sound: first read an NPZ to verify its checksum.
    From an NPZ a memory map, or the whole array if it is compressed or not float32; from HDF5 `Frames`, whose file
    stays open. Raises InputError."""
    if path.suffix == HDF5:
        import h5py

        with reading(path, WHAT, key):
            stored = plain_array(h5py.File(path, "r", locking=False), key)
            chunk = math.prod(stored.chunks or ()) * stored.dtype.itemsize
            memory.require(chunk, "a chunk of an array", "it must fit into memory")
            return cast(NDArray[Any], Frames(stored))
    with open_npz(path, WHAT) as archive, reading(path, WHAT, key), path.open("rb") as file:
        place = member(archive, key)
        if place.compress_type == zipfile.ZIP_STORED:
            if sound:
                with archive.open(place) as stream:
                    while stream.read(PIECE):  # at its end the library compares the checksums
                        pass
            file.seek(place.header_offset)  # NumPy's own header stands behind that of the archive
            file.seek(place.header_offset + file.read(HEADERS).index(np.lib.format.MAGIC_PREFIX))
            shape, fortran, kind = read_header(file)
            if kind == np.float32:
                order: Any = "F" if fortran else "C"
                # A plain array: slices of a memmap are slow to make and say nothing more.
                return np.asarray(np.memmap(file, np.float32, "r", file.tell(), shape, order))
    return read_arrays(path, key)[key]


@contextmanager
def open_npz(path: Path, what: str) -> Iterator[zipfile.ZipFile]:
    """Open the NPZ at `path`; what: its contents, in words. Raises InputError."""
    file_size(path, what)
    with reading(path, what):
        archive = zipfile.ZipFile(path)
    with archive:
        yield archive


def keys(archive: zipfile.ZipFile) -> list[str]:
    """The names of the arrays of an open NPZ, in the order of the file."""
    return [name.removesuffix(".npy") for name in archive.namelist()]


def member(archive: zipfile.ZipFile, key: str) -> zipfile.ZipInfo:
    """The member of an array in an NPZ. Raises InputError if there is none."""
    require(key in keys(archive), key, "an array, the key is missing", where=str(archive.filename))
    return archive.getinfo(f"{key}.npy")


def read_member(archive: zipfile.ZipFile, key: str, what: str, unpickler: type[Any] | None = None) -> NDArray[Any]:
    """The array `key` of an open NPZ; unpickler: for an array of objects, if allowed. Raises InputError."""
    with reading(Path(str(archive.filename)), what, key), archive.open(member(archive, key)) as stream:
        shape, _, dtype = read_header(stream)
        size = max(member(archive, key).file_size, math.prod(shape) * dtype.itemsize)
        memory.require(size, "an array", "it must fit into memory")
        if dtype.hasobject and unpickler is not None:
            return np.asarray(unpickler(stream).load())
        stream.seek(0)
        return np.lib.format.read_array(stream, allow_pickle=False)


def read_header(stream: IO[bytes]) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    """Shape, order and dtype of a member, by NumPy, which evaluates only literals. Raises ValueError."""
    if np.lib.format.read_magic(stream) == (1, 0):
        return np.lib.format.read_array_header_1_0(stream)
    return np.lib.format.read_array_header_2_0(stream)


def plain_array(file: "h5py.File", key: str) -> "h5py.Dataset":
    """An array of numbers, unread. Raises InputError."""
    import h5py

    array = file.get(key)
    require(isinstance(array, h5py.Dataset) and array.dtype.kind in "biuf", key, "an array of numbers")
    return array


def _whole(file: "h5py.File", key: str, what: str) -> NDArray[Any]:
    """An array of an HDF5 file, texts as texts. Raises InputError."""
    with reading(Path(file.filename), what, key):
        stored = plain_array(file, key)
        memory.require(stored.nbytes, "an array", "it must fit into memory")
        array = np.asarray(stored[()])
        return np.array(bytes(array.astype(np.uint8, casting="safe")).decode()) if key in TEXTS else array
