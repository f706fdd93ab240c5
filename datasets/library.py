"""Scene files: read from a path or, by name, from those that ship in `datasets/scenes`."""

import difflib
from pathlib import Path
from typing import Any

from datasets.errors import InputError
from datasets.records import from_mapping, read_toml
from datasets.scene import Scene

SCENES = Path(__file__).parent / "scenes"


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


def read_scene(name: str) -> Scene:
    """Read the scene at a path or of a shipped name, with the files that it names beside it.

    Raises InputError, which names the file and the key.
    """
    path = find(name, SCENES, "scene")
    try:
        data = read_toml(path)
        if any(names_file(entry) for group in ("solids", "masses") for entry in entries(data, group)):
            from datasets.geometry.files import with_files

            data = with_files(data, path.parent)
        return from_mapping(Scene, data)
    except InputError as error:
        raise error if error.where else error.at(str(path)) from None


def entries(data: dict[str, Any], group: str) -> list[dict[str, Any]]:
    """The tables of a group, such as `masses`, as far as there are any."""
    found = data.get(group)
    return [entry for entry in found if isinstance(entry, dict)] if isinstance(found, list) else []


def names_file(entry: dict[str, Any]) -> bool:
    """Whether a solid or a mass has more to it than numbers: a file, or another kind than a box."""
    return "file" in entry or entry.get("kind", "box") != "box" or isinstance(entry.get("friction"), str)
