"""An NPZ that somebody else wrote, object arrays included, without ever executing a pickle.

`numpy.load` reads object arrays only by unpickling, which runs whatever the file says. This reads the zip archive, the
header of each member and, of object arrays, the pickle through `datasets.exchange.pickle_reading`; anything but arrays of plain
numbers, and object arrays of them, is an InputError that names the file and the key.
"""

import ast
import re
import struct
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from datasets.errors import InputError
from datasets.exchange.pickle_reading import NUMBERS, OBJECTS, Refused, checked_count, numbers, read_pickle

LARGEST = 8 * 2**30
"""Bytes of one member, uncompressed: beyond what a trajectory needs, and the most that a small file may swell to."""

MAGIC = b"\x93NUMPY"
LONGEST_HEADER = 10_000
HEADER = re.compile(
    r"\{'descr': '(?P<order>[<>|=]?)(?P<code>[a-zA-Z]\d*)', 'fortran_order': (?P<fortran>True|False), "
    r"'shape': (?P<shape>\((?:\d{1,18},|\d{1,18}(?:, \d{1,18})+)?\)), \}\s*"
)
"""The header that numpy writes for an array whose dtype has no fields."""


@dataclass(frozen=True, kw_only=True)
class Header:
    """What a member says of its array."""

    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    fortran: bool


class ForeignNpz:
    """The arrays of an open NPZ, by key, in the order of the file."""

    def __init__(self, path: Path, archive: zipfile.ZipFile) -> None:
        self.path, self._archive = path, archive
        self._members: dict[str, zipfile.ZipInfo] = {}
        for member in archive.infolist():
            key = member.filename.removesuffix(".npy")
            if key == member.filename or key in self._members:
                raise InputError(
                    "expected an NPZ of arrays, each of its own name in .npy", where=str(path), key=member.filename
                )
            self._members[key] = member

    @property
    def keys(self) -> list[str]:
        """The names of the arrays."""
        return list(self._members)

    @property
    def checksums(self) -> list[tuple[str, int, int]]:
        """Name, checksum and size of every member, as the archive states them."""
        return [(key, member.CRC, member.file_size) for key, member in self._members.items()]

    def shape(self, key: str) -> tuple[int, ...]:
        """The shape of an array, without reading it."""
        with self._open(key) as stream:
            return read_header(stream)[0].shape

    def read(self, key: str) -> NDArray[Any]:
        """The array `key`: numbers, or objects that are arrays and numbers again. Raises InputError."""
        with self._open(key) as stream:
            header, start = read_header(stream)
            size = self._members[key].file_size - start
            if header.dtype.hasobject:
                content = read_pickle(stream, size)
                if not isinstance(content, np.ndarray) or content.shape != header.shape:
                    raise Refused("expected the array of objects that the header announces")
                value: NDArray[Any] = content
            else:
                if checked_count(header.shape) * header.dtype.itemsize != size:
                    raise Refused("found an array whose shape does not match its bytes")
                value = numbers(stream.read(size), header.shape, header.dtype, "F" if header.fortran else "C")
            # At the very end the archive compares the checksum.
            if stream.read(1):
                raise Refused("expected the end of the array, found more")
            return value

    @contextmanager
    def _open(self, key: str) -> Iterator[IO[bytes]]:
        member = self._members[key]
        with as_input_error(self.path, key):
            if member.file_size > LARGEST:
                raise Refused(f"expected at most {LARGEST / 2**30:g} GiB, found {member.file_size / 2**30:.1f}")
            if member.flag_bits & 1 or member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
                raise Refused("expected a member that is stored or deflated, and not encrypted")
            with self._archive.open(member) as stream:
                yield stream


@contextmanager
def open_foreign_npz(path: Path) -> Iterator[ForeignNpz]:
    """Open the NPZ at `path`. Raises InputError."""
    with as_input_error(path):
        raw = path.open("rb")
    with raw:
        with as_input_error(path):
            archive = zipfile.ZipFile(raw)
        with archive:
            yield ForeignNpz(path, archive)


def read_header(stream: IO[bytes]) -> tuple[Header, int]:
    """The header of a member and its length in bytes. Raises Refused."""
    start = stream.read(8)
    if start[:6] != MAGIC or start[6:] not in (b"\x01\x00", b"\x02\x00", b"\x03\x00"):
        raise Refused("expected an array in numpy's format")
    layout = "<H" if start[6] == 1 else "<I"
    (length,) = struct.unpack(layout, stream.read(struct.calcsize(layout)))
    if length > LONGEST_HEADER:
        raise Refused(f"expected a header of at most {LONGEST_HEADER} bytes")
    text = HEADER.fullmatch(stream.read(length).decode("latin-1"))
    if text is None or text["code"] not in NUMBERS | OBJECTS:
        raise Refused("expected an array of numbers or of arrays")
    return (
        Header(
            shape=ast.literal_eval(text["shape"]),
            dtype=np.dtype(text["order"].replace("|", "") + text["code"]),
            fortran=text["fortran"] == "True",
        ),
        8 + struct.calcsize(layout) + length,
    )


@contextmanager
def as_input_error(path: Path, key: str = "") -> Iterator[None]:
    """Whatever a broken or a hostile archive makes of the block, as one InputError that names file and key."""
    try:
        yield
    except InputError:
        raise
    except FileNotFoundError:
        raise InputError("expected an NPZ, there is none", where=str(path)) from None
    except Refused as refused:
        raise InputError(f"expected arrays and nothing else: {refused}", where=str(path), key=key) from None
    except (
        OSError,
        ValueError,
        EOFError,
        MemoryError,
        OverflowError,
        NotImplementedError,
        RuntimeError,
        struct.error,
        zipfile.BadZipFile,
        zlib.error,
    ) as error:
        raise InputError(f"expected a whole NPZ, {error}", where=str(path), key=key) from None
