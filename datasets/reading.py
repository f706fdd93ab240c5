"""Files of anybody's, before and while a library reads them: whatever is wrong is one line that names the file."""

import csv
import json
import stat
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from datasets.errors import InputError
from datasets.memory import spoken

LONGEST_LINE = 200
"""Characters of a library's message that are passed on."""
LARGEST_TEXT = 2**28
"""Bytes of a file of text."""
FARTHEST = 1.0e12
"""Numbers beyond this are no length, time, velocity or volume of anything that flows; their squares are finite."""


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


def read_text(path: Path, what: str) -> str:
    """The text of a file in UTF-8, a mark of the byte order left out. Raises InputError."""
    file_size(path, what, most=LARGEST_TEXT)
    with reading(path, f"{what} that can be read"):
        return path.read_text(encoding="utf-8-sig")


def read_toml(path: Path) -> dict[str, Any]:
    """Parse a TOML file. Raises InputError, which names the file."""
    text = read_text(path, "a TOML file")
    with reading(path, "a readable TOML file"):
        return tomllib.loads(text)


def read_json(path: Path) -> dict[str, Any] | None:
    """Parse a file with a JSON object; None where there is no file. Raises InputError, which names the file."""
    if not path.exists():
        return None
    text = read_text(path, "a JSON file")
    with reading(path, "readable JSON"):
        return json_object(text)


def json_object(text: str) -> dict[str, Any]:
    """Parse a JSON object. Raises InputError."""
    try:
        found = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise InputError(f"expected readable JSON, {line_of(error)}") from None
    if not isinstance(found, dict):
        raise InputError("expected a JSON object")
    return found


def read_columns(
    path: Path, needed: tuple[str, ...], optional: tuple[str, ...] = (), *, others: bool = False
) -> dict[str, NDArray[np.float64]]:
    """Columns of a CSV with a header, each of shape [R]: `needed` ones and the `optional` ones that are there.

    others: whether the file may have more columns, of anything. Lines that begin with # are comments. Raises
    InputError, which names the file.
    """
    text = read_text(path, "a CSV")
    with reading(path, "a readable CSV"):
        lines = [(number, line) for number, line in enumerate(text.splitlines(), 1) if line.strip() and line[0] != "#"]
        header = [name.strip() for name in values_in(lines[0][1])] if lines else []
        if not set(needed) <= set(header):
            got = ", ".join(header)[:LONGEST_LINE] or "an empty file"
            raise InputError(f"expected a header with the columns `{'`, `'.join(needed)}`, got {got}")
        known = [name for name in header if name in (*needed, *optional)]
        unknown = [name for name in header if name not in known]
        if unknown and not others:
            expected = "`, `".join((*needed, *optional))
            raise InputError(f"expected no other columns than `{expected}`, got `{unknown[0]}`")
        if len(set(known)) < len(known):
            raise InputError("expected each column once")
        rows = [numbers_in(line, number, header, known) for number, line in lines[1:]]
        if not rows:
            raise InputError(f"expected rows of {len(known)} numbers, got none")
    return dict(zip(known, np.array(rows).T.copy(), strict=True))


def numbers_in(line: str, number: int, header: list[str], known: list[str]) -> list[float]:
    """The numbers of the columns `known` in a line of a CSV. Raises InputError."""
    values = values_in(line)
    if len(values) != len(header):
        raise InputError(f"expected {len(header)} numbers in line {number}, got {len(values)}")
    try:
        row = [float(values[header.index(name)]) for name in known]
    except ValueError:
        raise InputError(f"expected numbers in line {number}, got {line.strip()[:40]!r}") from None
    if not all(abs(value) <= FARTHEST for value in row):
        raise InputError(f"expected finite numbers in line {number}, got {line.strip()[:40]!r}")
    return row


def values_in(line: str) -> list[str]:
    """The values in a line. Raises csv.Error for a quotation mark that nothing closes, which would swallow others."""
    return next(csv.reader([line], strict=True))
