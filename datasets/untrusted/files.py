"""A file before and while a library reads it: what it may be, how large, and what the library's errors mean."""

import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from datasets.errors import InputError
from datasets.memory import spoken

LONGEST_LINE = 200
"""Characters of a library's message that are passed on."""


def file_size(path: Path, what: str, *, most: int | None = None) -> int:
    """The size of a file [bytes]. Raises InputError where there is none, or something else, or one beyond `most`.

    what: such as `a trajectory (NPZ)`. A device or a pipe would never end.
    """
    try:
        found = path.stat()
    except (FileNotFoundError, NotADirectoryError):
        raise InputError(f"expected {what}, there is none", where=str(path)) from None
    except (OSError, ValueError) as error:
        raise InputError(f"expected {what}, {line_of(error)}", where=str(path)) from None
    if not stat.S_ISREG(found.st_mode):
        kind = "a folder" if stat.S_ISDIR(found.st_mode) else "a device or a pipe"
        raise InputError(f"expected {what}, got {kind}", where=str(path))
    if most is not None and found.st_size > most:
        raise InputError(f"expected {what} of at most {spoken(most)}, got {spoken(found.st_size)}", where=str(path))
    return found.st_size


@contextmanager
def reading(path: Path, what: str, key: str = "") -> Iterator[None]:
    """Whatever a library makes of a broken or hostile file in the block, as one InputError that names file and key.

    Their readers fail in many ways on a file that is none of theirs; to the user all of them mean the same. Keep the
    block to the library's own work, so that no mistake of ours hides in it.
    """
    try:
        yield
    except InputError as error:
        raise error if error.where else InputError(error.message, where=str(path), key=error.key or key) from None
    except (Exception, SystemExit) as error:
        raise InputError(f"expected {what}, {line_of(error)}", where=str(path), key=key) from None


def line_of(error: BaseException) -> str:
    """What an error says, in one short line."""
    text = " ".join(str(getattr(error, "strerror", None) or error).split()) or type(error).__name__
    return text if len(text) <= LONGEST_LINE else f"{text[:LONGEST_LINE]}..."
