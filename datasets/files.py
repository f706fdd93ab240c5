"""Files: written whole or not at all, each beside its place and then moved; read with errors in one line.

Only this module moves results. The bytes are on the disk before the name is (`fsync` of the file, `rename`, `fsync` of
the folder), so that a crash leaves either the old file or the new one. Files that are read may come from anybody: any
error before or while a library reads them becomes one InputError that names the file.
"""

import codecs
import csv
import errno
import json
import os
import stat
import tempfile
import tomllib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, cast

from datasets.errors import InputError, naming, require, shortened
from datasets.memory import spoken

PART = ".part-"  # prefix of files that are still being written
LONGEST_LINE = 200  # largest number of characters of a library's message that are passed on
MARKS = {codecs.BOM_UTF8: "utf-8-sig", codecs.BOM_UTF16_LE: "utf-16", codecs.BOM_UTF16_BE: "utf-16"}
"""Byte-order mark at the beginning of a text -> its encoding."""
NEW_LINE = b"\n"
LARGEST, LARGEST_TEXT = 2**30, 2**28  # bytes of a raster or a mesh, and of a file of text
GREATEST = 1.0e12
"""Largest number accepted as a length, time, velocity or volume of a flow; its square is finite."""


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yield a temporary path beside `path` to write to; it becomes `path` if the block succeeds, else it is removed. An
    OSError names `path`. Raises InputError if `path` is a folder, or if its folder is a file."""
    part = path
    require(not path.is_dir(), "", "the name of a file to write, got a folder", where=str(path))
    try:
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            # Keep the suffix: savez and savefig choose their format by it.
            handle, name = tempfile.mkstemp(dir=path.parent, prefix=f"{PART}{path.stem}-", suffix=path.suffix)
        except (FileExistsError, FileNotFoundError, NotADirectoryError) as error:
            raise InputError(f"expected a folder to write to, {error.strerror}", where=str(path.parent)) from None
        os.close(handle)
        part = Path(name)
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


def flush(path: Path) -> None:
    """Return once the contents of a file, or the names in a folder, are on the disk."""
    handle = os.open(path, os.O_RDONLY if path.is_dir() else os.O_RDWR)
    try:
        os.fsync(handle)
    except OSError as error:
        if error.errno != errno.EINVAL:  # some network file systems have no such call for folders
            raise
    finally:
        os.close(handle)


def remove_parts(folder: Path) -> None:
    """Remove partial files of killed processes, in `folder` and below."""
    for part in folder.rglob(f"{PART}*"):
        part.unlink(missing_ok=True)


def make_folder(path: Path) -> None:
    """Make the folder of a command's results before the work, which would otherwise be lost. Raises InputError."""
    try:
        path.mkdir(parents=True, exist_ok=True)
        if not os.access(path, os.W_OK | os.X_OK):
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
    except OSError as error:
        raise InputError(f"expected a folder to write to, {error.strerror}", where=str(path), key="--out") from None


def write_json(path: Path, value: Any) -> None:
    """Write `value` as indented JSON; NaN and infinities become null, which every JSON reader accepts."""
    write_text(path, json.dumps(finite(value), indent=2) + "\n")


def write_text(path: Path, text: str) -> None:
    """Write `text` in UTF-8."""
    with replacing(path) as part:
        part.write_text(text, encoding="utf-8")


def write_csv(path: Path, header: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    """Write a table; None becomes an empty cell."""
    with replacing(path) as part, part.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file, lineterminator="\n").writerows([header, *rows])


def finite(value: Any) -> Any:
    """`value` with null instead of NaN and infinities, at any depth."""
    if isinstance(value, Mapping):
        return {key: finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [finite(item) for item in value]
    if isinstance(value, float) and not (float("-inf") < value < float("inf")):
        return None
    return value


def file_size(path: Path, what: str, *, most: int | None = None) -> int:
    """The size of a file [bytes]; what: its description, such as `a trajectory (NPZ)`. Raises InputError for a missing
    file, for one larger than `most`, and for a device or a pipe, which would never end."""
    try:
        status = path.stat()
    except (FileNotFoundError, NotADirectoryError):
        raise InputError(f"expected {what}, there is no such file", where=str(path)) from None
    except (OSError, ValueError) as error:
        raise InputError(f"expected {what}, {line_of(error)}", where=str(path)) from None
    kind = "a folder" if stat.S_ISDIR(status.st_mode) else "a device or a pipe"
    require(stat.S_ISREG(status.st_mode), "", what, kind, where=str(path))
    few = most is None or status.st_size <= most
    require(few, "", f"{what} of at most {spoken(most or 0)}", spoken(status.st_size), where=str(path))
    return status.st_size


@contextmanager
def reading(path: Path, what: str, key: str = "") -> Iterator[None]:
    """Converts any error of a library on a broken or hostile file in the block into one InputError that names file and
    key. Limit the block to the library's own work, so that it hides no error of ours."""
    with naming(path, key):
        try:
            yield
        except InputError:
            raise
        except (Exception, SystemExit) as error:
            raise InputError(f"expected {what}, {line_of(error)}") from None


def line_of(error: BaseException) -> str:
    """The message of an error, in one short line."""
    text = " ".join(str(getattr(error, "strerror", None) or error).split()) or type(error).__name__
    return shortened(text, LONGEST_LINE)


def decoded(raw: bytes, errors: str = "strict") -> str:
    """Text in UTF-8, or in the encoding of its byte-order mark. Raises UnicodeDecodeError."""
    return raw.decode(next((name for mark, name in MARKS.items() if raw.startswith(mark)), "utf-8"), errors)


def read_text(path: Path, what: str, *, windows: bool = False) -> str:
    """The text of a file (`decoded`), with lines ended by a line feed. Raises InputError. windows: whether bytes that
    are no UTF-8 are read as Windows-1252, the encoding of Western European spreadsheets."""
    file_size(path, what, most=LARGEST_TEXT)
    with reading(path, f"{what} that can be read"):
        raw = path.read_bytes()
        try:
            text = decoded(raw)
        except UnicodeDecodeError as error:
            if not windows:
                place = f"line {raw.count(NEW_LINE, 0, error.start) + 1}"
                raise InputError(f"expected {what} in UTF-8, got other bytes in {place}") from None
            text = raw.decode("cp1252", errors="replace")
    return text.replace("\r\n", "\n").replace("\r", "\n")


def read_toml(path: Path) -> dict[str, Any]:
    """Parse a TOML file. Raises InputError, which names the file."""
    text = read_text(path, "a TOML file")
    with reading(path, "a readable TOML file"):
        return tomllib.loads(text)


def read_json(path: Path) -> dict[str, Any] | None:
    """Parse a file with a JSON object; None if there is no file. Raises InputError, which names the file."""
    if not path.exists():
        return None
    text = read_text(path, "a JSON file")
    with reading(path, "readable JSON"):
        return json_object(text)


def json_object(text: str, key: str = "") -> dict[str, Any]:
    """Parse the JSON object of `key`. Raises InputError."""
    try:
        content = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise InputError(f"expected readable JSON, {line_of(error)}", key=key) from None
    require(isinstance(content, dict), key, "a JSON object")
    return cast(dict[str, Any], content)
