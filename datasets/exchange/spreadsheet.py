"""Tables of numbers as spreadsheets write them: any separator, decimal commas, units in the header, empty rows.

    x [cm];height [mm]
    10,5;21,0

are the columns `x` and `height`, in metres 0.105 and 0.021. One line reports everything interpreted beyond a plain CSV.
"""

import csv
import math
import re
import warnings
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from datasets.errors import InputError, require
from datasets.files import GREATEST, LONGEST_LINE, read_text, reading

SEPARATORS = {",": "commas", ";": "semicolons", "\t": "tabs"}  # between the columns: those that a header may have
UNITS = {
    "length": {"m": 1.0, "cm": 0.01, "mm": 0.001, "km": 1000.0, "ft": 0.3048, "in": 0.0254},
    "time": {"s": 1.0, "ms": 0.001, "min": 60.0, "h": 3600.0},
    "impulse": {"N s": 1.0, "Ns": 1.0, "kN s": 1000.0, "kNs": 1000.0},
    "discharge": {"m3/s": 1.0, "m^3/s": 1.0, "m³/s": 1.0, "l/s": 0.001},
    "pressure": {"Pa": 1.0, "hPa": 100.0, "kPa": 1000.0, "MPa": 1.0e6, "bar": 1.0e5}
    | {f"kN/m{power}": 1000.0 for power in ("2", "^2", "²")},
    "speed": {"m/s": 1.0, "cm/s": 0.01, "km/h": 1.0 / 3.6},
    "friction": {"-": 1.0, "1": 1.0},
}
"""Quantity -> its units and their values in SI."""
PER_WIDTH = {
    "impulse": {f"{unit}/m": value for unit, value in UNITS["impulse"].items()},
    "discharge": {"m2/s": 1.0, "m^2/s": 1.0, "m²/s": 1.0, "l/s/m": 0.001},
}
"""The same in 2D, where these quantities are per metre of width."""
NAMED = re.compile(r"(?P<name>[^\[(]*?)\s*(?:\[(?P<square>[^\]]*)\]|\((?P<round>[^)]*)\))?\s*")
"""A column's header: its name, and optionally its unit in brackets."""
CONTROL = dict.fromkeys((*range(32), 127), "?")  # characters that a terminal does not show: of a file that is no text
DECIMAL_COMMA = re.compile(r"\s*[+-]?\d*,\d+(?:[eE][+-]?\d+)?\s*")


def read_columns(
    path: Path,
    needed: Sequence[str],
    optional: Sequence[str] = (),
    *,
    others: bool = False,
    metres: float = 1.0,
    blanks: bool = False,
    dimension: int = 3,
) -> dict[str, NDArray[np.float64]]:
    """Columns of a table with a header, each of shape [R]: `needed` ones, then `optional` ones that are there; lines
    that begin with # are comments. others: whether there may be more columns. metres: the length in which columns
    without a unit are, and in which those with one are returned; times are in seconds. blanks: whether empty rows and
    cells are NaN; else rows are left out, cells refused. dimension: of the scene, in 2D with units of `PER_WIDTH`.
    Raises InputError, which names the file."""
    text = read_text(path, "a CSV", windows=True)
    with reading(path, "a readable CSV"):
        lines = [(number, line) for number, line in enumerate(text.splitlines(), 1) if line[:1] != "#"]
        lines = [entry for entry in lines if blanks or entry[1].strip()]
        while lines and not lines[0][1].strip():
            lines = lines[1:]
        if lines and (stated := re.fullmatch(r"sep=(.)", lines[0][1].strip(), re.IGNORECASE)):
            lines, separator = lines[1:], stated[1]
        else:
            separator = max(SEPARATORS, key=lines[0][1].count) if lines else ","
        # Line by line and strictly: a quotation mark that nothing closes would swallow others.
        rows = [next(csv.reader([line], delimiter=separator, strict=True)) for _, line in lines]
        numbered = [(n, row) for (n, _), row in zip(lines, rows, strict=True) if blanks or any(map(str.strip, row))]
        header = [cell.strip() for cell in numbered[0][1]] if numbered else []
        while header and not header[-1]:
            header.pop()
        names, factors, units = described(header, metres, dimension)
        got = ", ".join(header)[:LONGEST_LINE].translate(CONTROL) or "an empty file"
        require(set(needed) <= set(names), "", f"a header with the columns `{'`, `'.join(needed)}`", got)
        known = [name for name in (*needed, *optional) for _ in range(names.count(name))]
        unknown = [name for name in names if name not in known]
        expected = "`, `".join((*needed, *optional))
        require(others or not unknown, "", f"no other columns than `{expected}`", f"`{', '.join(unknown)}`")
        require(len(set(known)) == len(known), "", "each column once", ", ".join(known))
        places = [names.index(name) for name in known]
        for place in places:
            known_units = ", ".join(units_of(names[place], dimension))
            expected = f"a unit of `{names[place]}`, one of {known_units}"
            if names[place] in PER_WIDTH:
                expected += ", per metre of width in 2D" if dimension == 2 else ", of the whole width in 3D"
            require(factors[place] is not None, "", expected, header[place])
        read = [numbers(number, row, len(header), places, separator, blanks) for number, row in numbered[1:]]
        require(len(read) > 0, "", f"rows of {len(known)} numbers", "none")
    said = [] if separator == "," else [f"{SEPARATORS.get(separator, repr(separator))} between columns"]
    said += ["decimal commas"] if any(commas for _, commas in read) else []
    said += [f"{names[place]} in {units[place]}" for place in places if units[place]]
    if said:
        warnings.warn(f"{path}: read with {', '.join(said)}", stacklevel=2)
    table = np.array([row for row, _ in read]) * np.array([factors[place] for place in places], dtype=float)
    return dict(zip(known, table.T.copy(), strict=True))


def described(header: Sequence[str], metres: float, dimension: int) -> tuple[list[str], list[float | None], list[str]]:
    """Names of columns, in lower case unless another column has the same name then, factors of their numbers (None for
    an unknown unit), and their units, empty if absent."""
    names, factors, units = [], list[float | None](), []
    parts = [(cell, NAMED.fullmatch(cell)) for cell in header]
    spelled = [cell if found is None else found["name"] for cell, found in parts]
    for name, (_, found) in zip(spelled, parts, strict=True):
        unit = "" if found is None else (found["square"] or found["round"] or "").strip()
        name = name if name.lower() in spelled else name.lower()
        factor = factor_of(units_of(name, dimension), unit) if unit else 1.0
        names.append(name)
        units.append(unit)
        factors.append(factor / metres if unit and factor is not None and name not in UNITS else factor)
    return names, factors, units


def units_of(name: str, dimension: int) -> dict[str, float]:
    """The units of the quantity in a column, by default a length, and their values in SI."""
    per_width = PER_WIDTH.get(name) if dimension == 2 else None
    return per_width or UNITS.get(name, UNITS["length"])


def factor_of(units: dict[str, float], unit: str) -> float | None:
    """The value of a unit in SI; None if it is unknown. Case is ignored (KPA), but a small m is not mega (mPa)."""
    same = [name for name in units if name.lower() == unit.lower() and (name[0], unit[0]) != ("M", "m")]
    exact = [name for name in same if name == unit] or same
    return units[exact[0]] if len(exact) == 1 else None


def numbers(
    line: int, row: Sequence[str], count: int, places: Sequence[int], separator: str, blanks: bool
) -> tuple[list[float], bool]:
    """The numbers in some columns of a row, NaN of empty `blanks`, and whether any has a comma. Raises InputError."""
    cells, commas = [cell.strip() for cell in row], False
    if blanks and not any(cells):
        return [math.nan] * len(places), False
    while len(cells) > count and not cells[-1]:
        cells.pop()
    if separator != ",":
        commas = any(DECIMAL_COMMA.fullmatch(cells[place]) for place in places if place < len(cells))
        cells = [cell.replace(",", ".") if DECIMAL_COMMA.fullmatch(cell) else cell for cell in cells]
    try:
        values = [float(cells[place] or ("nan" if blanks else "")) for place in places] if len(cells) == count else []
    except ValueError:
        values = []
    usable = all(abs(value) <= GREATEST or (blanks and math.isnan(value)) for value in values)
    if len(values) < len(places) or not usable:
        got = f"{separator.join(row).strip()[:40]!r}"
        raise InputError(f"expected {count} values in line {line}, all of them finite, got {got}")
    return values, commas
