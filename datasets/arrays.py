"""Arrays of anybody's, in NPZ and in HDF5: sizes are looked up before anything is read, and nothing is executed."""

import io
import math
import pickle
import pickletools
import warnings
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from datasets import memory
from datasets.errors import InputError
from datasets.reading import file_size, reading

# Most commands read NPZ alone.
if TYPE_CHECKING:
    import h5py

WHOLE_HDF5 = "a whole HDF5 file"


class Npz:
    """The arrays of an open NPZ, by key, in the order of the file."""

    def __init__(self, path: Path, archive: zipfile.ZipFile, what: str) -> None:
        self.path, self._archive, self._what = path, archive, what
        self._members = {member.filename.removesuffix(".npy"): member for member in archive.infolist()}

    @property
    def keys(self) -> list[str]:
        """The names of the arrays."""
        return list(self._members)

    def member(self, key: str) -> zipfile.ZipInfo:
        """Where an array lies in the file. Raises InputError where there is none."""
        if key not in self._members:
            raise InputError("expected an array, the key is missing", where=str(self.path), key=key)
        return self._members[key]

    def shape(self, key: str) -> tuple[int, ...]:
        """The shape of an array, without reading it. Raises InputError."""
        with self._open(key) as stream:
            return read_header(stream)[0]

    def read(self, key: str, *, objects: bool = False) -> NDArray[Any]:
        """The array `key`; where `objects` may be, arrays and numbers in an array again. Raises InputError."""
        size = self.member(key).file_size
        memory.require(size, "an array", "it must fit into memory", key=key, where=str(self.path))
        with self._open(key) as stream:
            shape, _, dtype = read_header(stream)
            if dtype.hasobject and not objects:
                raise InputError(f"expected {self._what}, found an array of objects")
            if dtype.hasobject:
                value = np.asarray(unpickled(stream.read()))
            elif math.prod(shape) * dtype.itemsize != size - stream.tell():
                raise InputError("expected an array as large as its bytes in the file")
            else:
                stream.seek(0)
                with warnings.catch_warnings():
                    # That the header of Python 2 takes longer to parse.
                    warnings.simplefilter("ignore", UserWarning)
                    value = np.lib.format.read_array(stream, allow_pickle=False)
            # At the very end the archive compares the checksum.
            if stream.read(1) or value.shape != shape:
                raise InputError("expected one array of the shape that its header states")
            return value

    @contextmanager
    def _open(self, key: str) -> Iterator[IO[bytes]]:
        member = self.member(key)
        with reading(self.path, self._what, key), self._archive.open(member) as stream:
            yield stream


def read_header(stream: IO[bytes]) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    """Shape, order and dtype of a member, by numpy, which evaluates literals alone. Raises ValueError."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        if np.lib.format.read_magic(stream) == (1, 0):
            return np.lib.format.read_array_header_1_0(stream)
        return np.lib.format.read_array_header_2_0(stream)


@contextmanager
def open_npz(path: Path, what: str = "a whole NPZ") -> Iterator[Npz]:
    """Open the NPZ at `path`. Raises InputError."""
    file_size(path, what)
    with reading(path, what):
        archive = zipfile.ZipFile(path)
    with archive:
        yield Npz(path, archive, what)


def unpickled(content: bytes) -> Any:
    """What a pickle of arrays holds, without executing anything. Raises InputError and whatever `pickle` does."""
    for opcode, argument, _ in pickletools.genops(content):
        # The unpickler makes room for as many values as a number in the file says.
        if "PUT" in opcode.name and int(argument or 0) > len(content):
            raise InputError("expected arrays and nothing else, found more values than bytes")
    return plain(ArrayUnpickler(io.BytesIO(content)).load())


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


def plain(value: Any) -> Any:
    """The same tuples and object arrays with NumPy's own arrays in place of each `PickledArray`."""
    if isinstance(value, tuple | list):
        return tuple(map(plain, value))
    if not isinstance(value, np.ndarray):
        return value
    found = np.asarray(value)
    if found.dtype.hasobject:
        for index in np.ndindex(found.shape):
            found[index] = plain(found[index])
    return found


def plain_dtype(code: str, *_: Any) -> np.dtype[Any]:
    """A new dtype of numbers or of objects, whose byte order its state may set. Raises InputError."""
    dtype = np.dtype(code)
    if dtype.kind not in "biufO":
        raise InputError(f"expected arrays and nothing else, found the dtype {code!r}")
    return np.dtype(code, False, True)


@contextmanager
def open_hdf5(path: Path) -> Iterator["h5py.File"]:
    """Open an HDF5 file. Raises InputError, which names it."""
    import h5py

    file_size(path, "an HDF5 file")
    with reading(path, WHOLE_HDF5):
        file = h5py.File(path, "r", locking=False)
    with file:
        yield file


def read_array(file: "h5py.File", key: str) -> NDArray[Any]:
    """One array of numbers of the file itself. Raises InputError, which names the file."""
    array = plain_array(file, key)
    with reading(Path(file.filename), WHOLE_HDF5, key):
        memory.require(array.nbytes, "an array", "it must fit into memory", key=key)
        return np.asarray(array[()])


def plain_array(file: "h5py.File", key: str) -> "h5py.Dataset":
    """An array of numbers, unread, that does not point to another file. Raises InputError, which names the file."""
    import h5py

    with reading(Path(file.filename), WHOLE_HDF5, key):
        array = file.get(key)
        inside = isinstance(array, h5py.Dataset) and array.file.filename == file.filename
        if not inside or array.external or array.is_virtual or array.dtype.kind not in "biuf":
            raise InputError("expected an array of numbers in the file", key=key)
        return array
