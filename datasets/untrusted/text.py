"""TOML and JSON of anybody's: of limited size and depth."""

import json
import tomllib
from pathlib import Path
from typing import Any

from datasets.errors import InputError
from datasets.untrusted.files import file_size, line_of, reading

DEEPEST = 32
"""Tables and lists in one another: a scene has six."""
LARGEST_TOML = 16 * 2**20
"""Bytes; its parser reads a few MB a second."""
LARGEST_JSON = 2**28
"""Bytes."""
MOST_PARTS = 32
"""Parts of a dotted key, in which the time of the parser is quadratic."""


def read_toml(path: Path) -> dict[str, Any]:
    """Parse a TOML file. Raises InputError, which names the file."""
    text = read_text(path, "a TOML file", most=LARGEST_TOML)
    for number, line in enumerate(text.splitlines(), 1):
        head = line.lstrip()
        key = head.partition("]")[0] if head.startswith("[") else head.partition("=")[0] if "=" in head else ""
        if key.count(".") > MOST_PARTS and "," not in key and not head.startswith("#"):
            message = f"expected keys of at most {MOST_PARTS} parts, line {number} has {key.count('.') + 1}"
            raise InputError(message, where=str(path))
    with reading(path, "a readable TOML file"):
        return shallow(tomllib.loads(text))


def read_json(path: Path) -> dict[str, Any] | None:
    """Parse a file with a JSON object; None where there is no file. Raises InputError, which names the file."""
    if not path.exists():
        return None
    text = read_text(path, "a JSON file", most=LARGEST_JSON)
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
    return shallow(found)


def read_text(path: Path, what: str, *, most: int) -> str:
    """The text of a file in UTF-8 of at most `most` bytes, a mark of the byte order left out. Raises InputError."""
    file_size(path, what, most=most)
    with reading(path, f"{what} that can be read"):
        return path.read_text(encoding="utf-8-sig")


def shallow(data: dict[str, Any]) -> dict[str, Any]:
    """`data`. Raises InputError where it is nested more than `DEEPEST` times, or has an integer beyond 64 bits."""
    level: list[Any] = [data]
    for _ in range(DEEPEST):
        inner = [value for each in level for value in (each.values() if isinstance(each, dict) else each)]
        if any(isinstance(value, int) and not -(2**63) <= value < 2**63 for value in inner):
            raise InputError("expected integers of 64 bits, got a larger one")
        level = [value for value in inner if isinstance(value, dict | list)]
        if not level:
            return data
    raise InputError(f"expected tables and lists at most {DEEPEST} deep, got more")
