"""Scenes in map coordinates: in a file lengths count from the map's origin, in a `Scene` from the box's lower corner.

    x_scene = x_file - origin        [domain] origin = [easting, elevation, northing], in 2D [x, elevation]

x runs to the east, y up, z to the north. The difference is taken here alone, when a file is read, in double precision:
single precision has steps of 0.25 m at 2,600,000 m, but of 0.25 mm at 4,096 m from the corner. It is rounded to
`DIGITS`, so that 2600000.1 - 2600000 is 0.1: the scene is that of a file in coordinates of its own, to the bit.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

Entry = dict[str, Any]
WHOLE, PLAN, UP = slice(None), slice(None, None, 2), slice(1, 2)
"""Of the components of an origin: all; those in plan, x and z; y."""
PLACES: dict[str, dict[str, slice]] = {
    "masses": {"lower": WHOLE, "vertices": WHOLE, "origin": PLAN, "outline": PLAN},
    "baffles": {"lower": WHOLE},
    "solids": {"lower": WHOLE, "vertices": WHOLE, "points": WHOLE, "origin": PLAN, "heights": UP},
    "fields": {"origin": WHOLE},
    "stages": {"lower": WHOLE, "outline": PLAN},
}
"""The keys of a scene that say where something is, and which components of an origin they count from."""
DIGITS = 7
"""Decimals of a metre: more than the rounding of map coordinates in double precision up to 100,000 km."""


def origin_of(data: Entry) -> NDArray[np.float64] | None:
    """The origin [m] that the tables of a scene give, shape [D]; None where they give none that could be one."""
    domain = data.get("domain")
    origin = numbers(domain.get("origin"), 1) if isinstance(domain, dict) else None
    # What is no origin the scene's own checks refuse.
    usable = origin is not None and origin.shape in ((2,), (3,)) and bool(np.isfinite(origin).all())
    return origin if usable else None


def numbers(value: Any, axes: int) -> NDArray[np.float64] | None:
    """A number, a list or lists of numbers as an array of at least so many axes; None of anything else."""
    try:
        array = np.asarray(value)
    except ValueError:  # rows of different lengths
        return None
    return array.astype(np.float64) if array.dtype.kind in "if" and array.ndim >= axes else None


def moved(data: Entry, by: NDArray[np.float64]) -> Entry:
    """The tables of a scene with every place moved by so much [m], shape [D]; what is no place as it is."""
    new = dict(data)
    for group, keys in PLACES.items():
        if isinstance(data.get(group), list | tuple):
            new[group] = [moved_entry(entry, keys, by) for entry in data[group]]
    return new


def moved_entry(entry: Any, keys: dict[str, slice], by: NDArray[np.float64]) -> Any:
    """A mass, a solid or another table with the places under `keys` moved by `by` [D]; what is none as it is."""
    if not isinstance(entry, dict):
        return entry
    entry = dict(entry)
    for key, axes in keys.items():
        places, step = numbers(entry.get(key), 1), by[axes]
        if places is not None and (axes == UP or places.shape[-1] == len(step)):
            entry[key] = np.round(places + step, DIGITS).tolist()
    return entry
