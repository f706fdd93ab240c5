"""Files appear whole or not at all: each is written beside its place, made to last, and moved into it.

This is the one place that moves results. The bytes are on the disk before the name is (`fsync` of the file, `rename`,
`fsync` of the folder), so that a machine that dies in between leaves the old file or the new one.
"""

import errno
import json
import os
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from datasets.errors import InputError

PART = ".part-"
"""What the names of files begin with that are still being written."""
_being_written: set[Path] = set()
"""Such files of this process."""


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yield a temporary path beside `path` to write to; it becomes `path` if the block succeeds, else it goes.

    An OSError, such as that of a full disk, names `path`.
    """
    part = path
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        # The suffix stays: savez and savefig choose their format by it.
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=f"{PART}{path.stem}-", suffix=path.suffix)
        os.close(handle)
        part = Path(name)
        _being_written.add(part)
        yield part
        part.chmod(0o644)
        flush(part)
        part.replace(path)
        flush(path.parent)
    except OSError as error:
        if error.filename is None or Path(error.filename).name.startswith(PART):
            error.filename = str(path)
        raise
    finally:
        if part != path:
            part.unlink(missing_ok=True)
            _being_written.discard(part)


def remove_own_parts() -> None:
    """Remove what this process has not finished writing, before it ends by a signal."""
    for part in tuple(_being_written):
        part.unlink(missing_ok=True)


def flush(path: Path) -> None:
    """Return once the contents of a file, or the names in a folder, are on the disk."""
    if path.is_dir() and os.name != "posix":
        return
    handle = os.open(path, os.O_RDONLY if path.is_dir() else os.O_RDWR)
    try:
        os.fsync(handle)
    except OSError as error:
        # Some file systems of a network have no such call for folders.
        if error.errno != errno.EINVAL:
            raise
    finally:
        os.close(handle)


def remove_parts(folder: Path) -> None:
    """Remove what killed processes left of files that they were writing, in `folder` and below."""
    for part in folder.rglob(f"{PART}*"):
        part.unlink(missing_ok=True)


def make_folder(path: Path) -> None:
    """Make the folder `path`, in which a command leaves its results. Raises InputError."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"expected a folder to write to, {error.strerror}", where=str(path), key="--out") from None


def write_json(path: Path, value: Any) -> None:
    """Write `value` as indented JSON; NaN and infinities become null, which every JSON reader takes."""
    with replacing(path) as part:
        part.write_text(json.dumps(finite(value), indent=2) + "\n")


def write_text(path: Path, text: str) -> None:
    """Write `text` in UTF-8."""
    with replacing(path) as part:
        part.write_text(text, encoding="utf-8")


def finite(value: Any) -> Any:
    """`value` with null in place of NaN and infinities, at any depth."""
    if isinstance(value, Mapping):
        return {key: finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [finite(item) for item in value]
    if isinstance(value, float) and not (float("-inf") < value < float("inf")):
        return None
    return value
