"""Files appear whole or not at all: each is written beside its place and moved into it."""

import json
import os
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from datasets.errors import InputError


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yield a temporary path beside `path` to write to; it becomes `path` if the block succeeds, else it goes."""
    path.parent.mkdir(parents=True, exist_ok=True)
    # The suffix stays: savez and savefig choose their format by it.
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.stem}-", suffix=path.suffix)
    os.close(handle)
    part = Path(name)
    try:
        yield part
        part.chmod(0o644)
        part.replace(path)
    finally:
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
