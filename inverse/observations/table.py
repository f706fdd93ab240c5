"""A CSV of measured numbers: columns by their header, in the units of the problem."""

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from datasets import files
from datasets.errors import InputError
from datasets.scene import Scene
from datasets.trajectory import Trajectory
from inverse.settings import ObservationSettings

Values = NDArray[np.float64]

LENGTHS = ("x", "z", "front", "height")
"""Columns that are lengths."""


@dataclass(frozen=True, kw_only=True)
class Context:
    """What the numbers of a measurement are read and checked with."""

    scene: Scene
    folder: Path
    """Relative paths start here."""
    released: float | None
    """Volume of the masses over the width [m^2]; None where that is itself a parameter."""
    run: Trajectory | None = None
    """The flow that was observed, where it is known."""


def tabulated(
    settings: ObservationSettings, context: Context, columns: Mapping[str, str], optional: Sequence[str]
) -> ObservationSettings:
    """`settings` with the numbers of their `csv` [m, s] under the keys that its columns stand for."""
    required, given = [name for name in columns if name not in optional], dict[str, Any]()
    for name, column in read_columns(context.folder / str(settings.csv), required, optional).items():
        datum = settings.datum if name == "height" else 0.0
        metres = settings.unit.metres if name in LENGTHS else 1.0
        given[columns[name]] = tuple(((column - datum) * metres).tolist())
    return dataclasses.replace(settings, csv=None, **given)


def read_columns(path: Path, names: Sequence[str], optional: Sequence[str] = ()) -> dict[str, Values]:
    """The columns `names` as they stand in a CSV, and those of `optional` that it has, each of shape [R].

    Raises InputError, which names the file.
    """
    found = files.read_columns(path, tuple(names), tuple(optional), others=True)
    if len(found[names[0]]) < 2:
        raise InputError(f"expected the columns {' and '.join(names)} and at least two rows", where=str(path))
    return {name: found[name] for name in (*names, *optional) if name in found}


def require_inside(x: Values, length: float) -> Values:
    """`x` [m], if they lie in the box of `length` [m]. Raises InputError."""
    slack = 1e-9 * length
    outside = x[(x < -slack) | (x > length + slack)]
    if len(outside):
        got = f"got {outside[-1]:g} m; unit says in what unit the file is"
        raise InputError(f"expected x between the walls, 0 and {length:g} m, {got}")
    return x
