"""Zip archives of anybody's (NPZ is one): how many members, how large, how far compressed, before any is read.

A directory entry may state any size. Of a stored member both sizes are that of its bytes; deflate reaches a ratio of
1032 at most; and members may overlap, so that a file of some KB holds petabytes. So all sizes together are held against
that of the file, and against the memory that is free.
"""

import struct
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from datasets import memory
from datasets.errors import InputError
from datasets.untrusted.files import file_size, reading

MOST_MEMBERS = 200_000
LARGEST = 64 * 2**30
"""Bytes of one member, uncompressed."""
SMALL = 128 * 2**20
"""Bytes that all members together may swell to, however small the file."""
MOST_RATIO = 100
"""Beyond that, uncompressed over compressed bytes: positions compress twofold, zeros a thousandfold."""
END, END_64 = struct.Struct("<4s4H2LH"), struct.Struct("<4sQ2H2L4Q")
"""The record at the end of an archive, and that of a large one."""
ENTRY = 46
"""Bytes of the shortest entry of the directory."""


@contextmanager
def open_archive(path: Path, what: str) -> Iterator[zipfile.ZipFile]:
    """Open a zip archive whose members are few, small and different. Raises InputError, which names the file."""
    size = file_size(path, what)
    with reading(path, what):
        raw = path.open("rb")
    with raw:
        with reading(path, what):
            entries = directory_size(raw, size) // ENTRY
            if entries > MOST_MEMBERS:
                raise InputError(f"expected {what} of at most {MOST_MEMBERS} members, got up to {entries}")
            archive = zipfile.ZipFile(raw)
            check_members(archive.infolist(), size)
        with archive:
            yield archive


def check_members(members: list[zipfile.ZipInfo], size: int) -> None:
    """Raise InputError for members that cannot be those of an honest archive of `size` bytes."""
    names: set[str] = set()
    for member in members:
        key = member.filename
        if key in names:
            raise InputError("expected each member once", key=key)
        names.add(key)
        if member.flag_bits & 1 or member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            raise InputError("expected a member that is stored or deflated, and not encrypted", key=key)
        stored = member.compress_type == zipfile.ZIP_STORED
        if member.compress_size > size or (stored and member.file_size != member.compress_size):
            raise InputError("expected a member as large as its bytes in the file", key=key)
        if member.file_size > LARGEST:
            got = f"at most {memory.spoken(LARGEST)}, got {memory.spoken(member.file_size)}"
            raise InputError(f"expected {got}", key=key)
    whole = sum(member.file_size for member in members)
    if whole > max(SMALL, MOST_RATIO * size):
        expected = f"at most {MOST_RATIO} times the {memory.spoken(size)} of the file"
        raise InputError(f"expected arrays of {expected}, got {memory.spoken(whole)}")


def directory_size(raw: IO[bytes], size: int) -> int:
    """Bytes of an archive's directory by the record at its end, which `zipfile` parses as a whole."""
    tail_size = min(size, 2**16 + END.size)
    raw.seek(size - tail_size)
    tail = raw.read()
    raw.seek(0)
    # As `zipfile` looks for it: without a comment, else wherever it is last.
    last = tail[-END.size :]
    start = len(tail) - END.size if last[:4] == b"PK\5\6" and last[-2:] == b"\0\0" else tail.rfind(b"PK\5\6")
    if start < 0 or len(tail) - start < END.size:
        return 0
    stated = int(END.unpack_from(tail, start)[5])
    before = start - 20 - END_64.size  # the locator of the larger record is between them
    if before >= 0 and tail[before : before + 4] == b"PK\6\6":
        stated = max(stated if stated < 2**32 - 1 else 0, int(END_64.unpack_from(tail, before)[8]))
    return min(stated, size)
