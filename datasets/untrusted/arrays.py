"""NPZ of anybody's: arrays of numbers and of text, object arrays only where they are asked for, by `pickles`."""

import math
import warnings
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from datasets import memory
from datasets.errors import InputError
from datasets.untrusted.archives import open_archive
from datasets.untrusted.files import reading
from datasets.untrusted.pickles import NUMBERS, Refused, checked_count, read_pickle

PIECE = 2**24
"""Bytes that are read at a time: what is copied on the way stays small."""


class UntrustedNpz:
    """The arrays of an open NPZ, by key, in the order of the file."""

    def __init__(self, path: Path, archive: zipfile.ZipFile, what: str) -> None:
        self.path, self._archive, self._what = path, archive, what
        self._members: dict[str, zipfile.ZipInfo] = {}
        for member in archive.infolist():
            key = member.filename.removesuffix(".npy")
            if key == member.filename:
                expected = "expected an NPZ of arrays, each of its own name in .npy"
                raise InputError(expected, where=str(path), key=member.filename)
            self._members[key] = member

    @property
    def keys(self) -> list[str]:
        """The names of the arrays."""
        return list(self._members)

    @property
    def checksums(self) -> list[tuple[str, int, int]]:
        """Name, checksum and size of every member, as the archive states them."""
        return [(key, member.CRC, member.file_size) for key, member in self._members.items()]

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
            shape, fortran, dtype = read_header(stream)
            size -= stream.tell()
            if dtype.hasobject:
                if not objects:
                    raise InputError(f"expected {self._what}, found an array of objects")
                value: NDArray[Any] = read_pickle(stream, size)
                if not isinstance(value, np.ndarray) or value.shape != shape:
                    raise Refused("expected the array of objects that the header announces")
            else:
                if checked_count(shape) * dtype.itemsize != size:
                    raise Refused("found an array whose shape does not match its bytes")
                value = filled(stream, math.prod(shape), dtype)
                value = value.reshape(shape, order="F" if fortran else "C")
            # At the very end the archive compares the checksum.
            if stream.read(1):
                raise Refused("expected the end of the array, found more")
            return value

    @contextmanager
    def _open(self, key: str) -> Iterator[IO[bytes]]:
        member = self.member(key)
        with reading(self.path, self._what, key):
            try:
                with self._archive.open(member) as stream:
                    yield stream
            except Refused as refused:
                raise InputError(f"expected arrays and nothing else: {refused}") from None


def filled(stream: IO[bytes], count: int, dtype: np.dtype[Any]) -> NDArray[Any]:
    """The next `count` numbers of a stream. Raises ValueError where it ends before."""
    value = np.empty(count, dtype)
    content = value.view(np.uint8)
    for first in range(0, len(content), PIECE):
        piece = stream.read(min(PIECE, len(content) - first))
        if not piece:
            raise ValueError("found fewer bytes than it states")
        content[first : first + len(piece)] = np.frombuffer(piece, np.uint8)
    return value


def read_header(stream: IO[bytes]) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    """Shape, order and dtype of a member, by numpy, which evaluates literals alone. Raises Refused, ValueError."""
    version = np.lib.format.read_magic(stream)
    readers = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
    if version not in readers:
        raise Refused(f"expected an array in numpy's format 1.0 or 2.0, found {version}")
    with warnings.catch_warnings():
        # That the header of Python 2 takes longer to parse.
        warnings.simplefilter("ignore")
        shape, fortran, dtype = readers[version](stream)
    text = dtype.kind == "U" and dtype.itemsize > 0
    if dtype.kind != "O" and dtype.str[1:] not in NUMBERS and not text:
        raise Refused("expected an array of numbers, of text or of arrays")
    return shape, fortran, dtype


@contextmanager
def open_untrusted_npz(path: Path, what: str = "a whole NPZ") -> Iterator[UntrustedNpz]:
    """Open the NPZ at `path`. Raises InputError."""
    with open_archive(path, what) as archive:
        yield UntrustedNpz(path, archive, what)
