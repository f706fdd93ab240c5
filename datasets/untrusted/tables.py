"""CSV of anybody's: columns of finite numbers under a header."""

import csv
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from datasets.errors import InputError
from datasets.untrusted.files import reading
from datasets.untrusted.text import read_text

LARGEST = 2**28
"""Bytes."""
LONGEST_LINE = 10_000
"""Characters."""
FARTHEST = 1.0e12
"""Numbers beyond this are no length, time, velocity or volume of anything that flows; their squares are finite."""


def read_columns(
    path: Path, needed: tuple[str, ...], optional: tuple[str, ...] = (), *, others: bool = False
) -> dict[str, NDArray[np.float64]]:
    """Columns of a CSV with a header, each of shape [R]: `needed` ones and the `optional` ones that are there.

    others: whether the file may have more columns, of anything. Lines that begin with # are comments. Raises
    InputError, which names the file.
    """
    with reading(path, "a readable CSV"):
        return columns_of(read_text(path, "a CSV", most=LARGEST), needed, optional, others)


def columns_of(
    text: str, needed: tuple[str, ...], optional: tuple[str, ...], others: bool
) -> dict[str, NDArray[np.float64]]:
    """As `read_columns`, of the text of a CSV. Raises InputError, which does not name the file."""
    lines = [(number, line) for number, line in enumerate(text.splitlines(), 1) if line.strip() and line[0] != "#"]
    if any(len(line) > LONGEST_LINE for _, line in lines):
        raise InputError(f"expected lines of at most {LONGEST_LINE} characters")
    header = [name.strip() for name in parts_of(lines[0][1])] if lines else []
    if not set(needed) <= set(header):
        got = ", ".join(header)[: LONGEST_LINE // 100] or "an empty file"
        raise InputError(f"expected a header with the columns `{'`, `'.join(needed)}`, got {got}")
    asked = [name for name in header if name in (*needed, *optional)]
    unknown = [name for name in header if name not in asked]
    if unknown and not others:
        known = "`, `".join((*needed, *optional))
        raise InputError(f"expected no other columns than `{known}`, got `{unknown[0]}`")
    if len(set(asked)) < len(asked):
        raise InputError("expected each column once")
    columns = [header.index(name) for name in asked]
    rows = []
    for number, line in lines[1:]:
        parts = parts_of(line)
        if len(parts) != len(header):
            raise InputError(f"expected {len(header)} numbers in line {number}, got {len(parts)}")
        try:
            row = [float(parts[column]) for column in columns]
        except ValueError:
            raise InputError(f"expected numbers in line {number}, got {line.strip()[:40]!r}") from None
        if not all(abs(value) <= FARTHEST for value in row):
            raise InputError(f"expected finite numbers in line {number}, got {line.strip()[:40]!r}")
        rows.append(row)
    if not rows:
        raise InputError(f"expected rows of {len(asked)} numbers, got none")
    table = np.array(rows)
    return {name: table[:, index] for index, name in enumerate(asked)}


def parts_of(line: str) -> list[str]:
    """The values in a line. Raises InputError for a quotation mark that nothing closes, which would swallow others."""
    try:
        return next(csv.reader([line], strict=True))
    except (csv.Error, StopIteration) as error:
        raise InputError(f"expected values separated by commas, got {line.strip()[:40]!r}: {error}") from None
