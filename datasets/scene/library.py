"""Scene files: read from a path or by the name of a shipped scene in `datasets/scenes`; written from Python.

If the box has an origin, lengths in a file are map coordinates; in a `Scene` they count from the box's lower corner:

    x_scene = x_file - origin        [domain] origin = [easting, elevation, northing], in 2D [x, elevation]

x runs to the east, y up, z to the north. Only this module takes the difference, when it reads a file, in double
precision: single precision has steps of 0.25 m at 2,600,000 m, but of 0.25 mm at 4,096 m from the corner. It is rounded
to `DIGITS`, so that 2600000.1 - 2600000 is 0.1: the scene equals that of a file in box coordinates to the bit.
"""

from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w
from numpy.typing import NDArray

from datasets.errors import InputError, OutOfRange, naming, require, suggestion
from datasets.exchange.scene_files import file_of, with_files
from datasets.files import read_toml, write_text
from datasets.scene import Scene
from datasets.schema import changed, from_mapping

SCENES = Path(__file__).parents[1] / "scenes"
WHOLE, PLAN, UP = slice(None), slice(None, None, 2), slice(1, 2)
"""Components of an origin: all; x and z, in plan; y."""
PLACES: dict[str, dict[str, slice]] = {
    "masses": {"lower": WHOLE, "vertices": WHOLE, "origin": PLAN, "outline": PLAN, "section": PLAN},
    "baffles": {"lower": WHOLE},
    "solids": {"lower": WHOLE, "vertices": WHOLE, "points": WHOLE, "origin": PLAN, "heights": UP},
    "fields": {"origin": WHOLE},
    "stages": {"lower": WHOLE, "outline": PLAN},
    "water": {"level": UP, "pool": UP, "table": WHOLE, "origin": PLAN},
}
"""The keys of a scene that hold coordinates, and the components of the origin that they count from."""
DIGITS = 7
"""Decimals of a metre: more than the rounding of map coordinates in double precision up to 100,000 km."""


def find(name: str | Path, shelf: Path, what: str) -> Path:
    """The TOML file that `name` refers to: a path, or a name in the folder `shelf`. Raises InputError."""
    name = str(name)
    if name.endswith(".toml") or "/" in name:
        return Path(name)
    shipped = sorted(path.stem for path in shelf.glob("*.toml"))
    expected = f"the path of a {what} in TOML or a shipped name: {suggestion(name, shipped)}"
    require(name in shipped, "", expected, where=name)
    return shelf / f"{name}.toml"


def read_scene(name: str | Path) -> Scene:
    """Read a scene from a path or by a shipped name such as `column-short-21`, with the files that it refers to. Raises
    InputError, which names the file and the key."""
    path = find(name, SCENES, "scene")
    with naming(path):
        data = read_toml(path)
        takes = "python -m inverse and python -m validation.loop take it"
        require("unknowns" not in data, "unknowns", "a scene", f"a problem: {takes}")
        return scene_from(data, path.parent)


def scene_from(data: dict[str, Any], folder: Path) -> Scene:
    """The scene of a TOML file's tables; paths in them are relative to `folder`. Raises InputError."""
    whole = with_files(data, folder)
    origin = whole["domain"].get("origin") if isinstance(whole.get("domain"), dict) else None
    try:
        return from_mapping(Scene, whole if origin is None else moved(whole, -np.array(origin, np.float64)))
    except OutOfRange as error:
        placed, file = origin is not None and error.key.startswith(tuple(PLACES)), file_of(data, error.key)
        message = f"{error.message}; lengths count from domain.origin here" if placed else error.message
        kind = InputError if placed else OutOfRange
        raise kind(message, key=error.key, where=str(folder / file) if file else error.where) from None


def moved(data: dict[str, Any], by: NDArray[np.float64]) -> dict[str, Any]:
    """The tables of a scene with all coordinates moved by `by` [m], shape [D]; other values are unchanged."""
    new = dict(data)
    for group, keys in PLACES.items():
        if isinstance(data.get(group), list | tuple):
            new[group] = [moved_entry(entry, keys, by) for entry in data[group]]
        elif isinstance(data.get(group), dict):
            new[group] = moved_entry(data[group], keys | ({"table": UP} if len(by) == 3 else {}), by)
    return new


def moved_entry(entry: Any, keys: dict[str, slice], by: NDArray[np.float64]) -> Any:
    """A mass, a solid or another table with the coordinates under `keys` moved by `by` [D]."""
    if not isinstance(entry, dict):
        return entry
    entry = dict(entry)
    for key, axes in keys.items():
        with suppress(ValueError):  # from rows of different lengths
            places = np.asarray(entry.get(key))
            # The foot of a section may have an elevation.
            step = by if axes == PLAN and places.shape[-1:] == by.shape else by[axes]
            # A field of thickness lies in plan.
            step = by[PLAN] if axes == WHOLE and places.shape[-1:] == by[PLAN].shape else step
            is_place = places.dtype.kind in "if" and (places.ndim > 0 or key in ("level", "pool"))
            if is_place and (axes == UP or places.shape[-1] == len(step)):
                entry[key] = np.round(places + (step if places.ndim else step[0]), DIGITS).tolist()
    return entry


def write_scene(scene: Scene, path: str | Path) -> None:
    """Write the keys of `scene` that differ from their defaults as TOML; `read_scene` gives an equal scene. If its box
    has an origin, the file is in map coordinates, and coordinates are equal to a tenth of a micrometre."""
    table = changed(scene)
    for mass in table["masses"]:
        if mass.get("kind", "box") != "box":
            del mass["lower"], mass["size"]  # a scene computes the box around it
    if scene.domain.origin is not None:
        table = moved(table, scene.domain.corner)
    write_text(Path(path), tomli_w.dumps(table))
