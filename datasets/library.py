"""Scene files: read from a path or, by name, from those that ship in `datasets/scenes`."""

import difflib
from pathlib import Path

from datasets.errors import InputError
from datasets.scene import Scene
from datasets.strict import from_mapping, read_toml

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
    """Read the scene at a path or of a shipped name. Raises InputError, which names the file and the key."""
    path = find(name, SCENES, "scene")
    try:
        return from_mapping(Scene, read_toml(path))
    except InputError as error:
        raise error if error.where else error.at(str(path)) from None
