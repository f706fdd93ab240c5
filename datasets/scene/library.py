"""Scene files: read from a path or, by name, from those that ship in `datasets/scenes`; written from Python."""

import difflib
from pathlib import Path
from typing import Any

import tomli_w

from datasets.errors import InputError, OutOfRange, naming
from datasets.exchange.map_coordinates import PLACES, moved, origin_of
from datasets.exchange.scene_files import with_files
from datasets.files import read_toml, write_text
from datasets.scene import Scene
from datasets.schema import changed, from_mapping

SCENES = Path(__file__).parents[1] / "scenes"


def find(name: str, shelf: Path, what: str) -> Path:
    """The TOML file meant by `name`: a path, or the name of one on `shelf`. Raises InputError."""
    if name.endswith(".toml") or "/" in name:
        return Path(name)
    shipped = sorted(path.stem for path in shelf.glob("*.toml"))
    if name not in shipped:
        near = difflib.get_close_matches(name, shipped, n=1)
        hint = f"did you mean {near[0]!r}?" if near else f"one of {', '.join(shipped)}"
        raise InputError(f"expected the path of a {what} in TOML or a shipped name: {hint}", where=name)
    return shelf / f"{name}.toml"


def read_scene(name: str | Path) -> Scene:
    """Read the scene at a path, or of a shipped name such as `column-short-21`, with the files that it names beside it.

    Raises InputError, which names the file and the key.
    """
    path = find(str(name), SCENES, "scene")
    with naming(path):
        data = read_toml(path)
        if "unknowns" in data:
            takes = "python -m inverse and python -m validation.loop take it"
            raise InputError(f"expected a scene, got a problem: {takes}", key="unknowns")
        return scene_from(data, path.parent)


def scene_from(data: dict[str, Any], folder: Path) -> Scene:
    """The scene of the tables of a TOML file in `folder`, to which the paths in it are relative. Raises InputError.

    Its lengths count from the lower corner of the box, those of the file from the map's origin where the box has one.
    """
    data, origin = with_files(data, folder), origin_of(data)
    if origin is None:
        return from_mapping(Scene, data)
    try:
        return from_mapping(Scene, moved(data, -origin))
    except OutOfRange as error:
        if not error.key.startswith(tuple(PLACES)):
            raise
        raise InputError(f"{error.message}; lengths count from domain.origin here", key=error.key) from None


def write_scene(scene: Scene, path: str | Path) -> None:
    """Write `scene` as TOML, the keys that differ from their defaults; `read_scene` gives an equal one.

    In map coordinates where its box has an origin; then places are equal to a tenth of a micrometre.
    """
    table = changed(scene)
    for mass in table["masses"]:
        if mass.get("kind", "box") != "box":
            # A scene works out the box around it.
            del mass["lower"], mass["size"]
    if scene.domain.origin is not None:
        table = moved(table, scene.domain.corner)
    write_text(Path(path), tomli_w.dumps(table))
