"""What datasets consist of: families of kinds of scenes in Python, distributions in TOML; by name or from a file."""

from importlib import import_module
from pathlib import Path

from datasets.definitions.definition import Definition
from datasets.errors import InputError

MODULES = {"flow2d": "flow2d", "columns2d": "paper_families", "obstacle3d": "obstacle3d", "baffles3d": "paper_families"}
"""Those that define the families, by their names."""
FILES = {path.stem: path for path in sorted(Path(__file__).parent.glob("*.toml"))}
NAMES = (*MODULES, *FILES)
"""Of the definitions that ship."""


def read_definition(name: str) -> Definition:
    """The definition of a shipped name, or in the TOML file at a path. Raises InputError."""
    from datasets.definitions.distributions import definition_from_file

    if name in MODULES:
        found: Definition = getattr(import_module(f"datasets.definitions.{MODULES[name]}"), name.upper())
        return found
    if name in FILES:
        return definition_from_file(FILES[name])
    if name.endswith(".toml") or "/" in name:
        return definition_from_file(Path(name))
    raise InputError(f"expected one of {', '.join(NAMES)}, or a TOML file, got {name!r}", key="definition")
