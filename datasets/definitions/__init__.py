"""What datasets consist of: families of kinds of scenes in Python, distributions in TOML; by name or from a file."""

from pathlib import Path

from datasets.definitions.definition import Definition
from datasets.definitions.distributions import definition_from_file
from datasets.definitions.flow2d import FLOW2D
from datasets.definitions.obstacle3d import OBSTACLE3D
from datasets.definitions.paper_families import BAFFLES3D, COLUMNS2D
from datasets.errors import InputError

DEFINITIONS = {each.name: each for each in (FLOW2D, COLUMNS2D, OBSTACLE3D, BAFFLES3D)} | {
    path.stem: definition_from_file(path) for path in sorted(Path(__file__).parent.glob("*.toml"))
}
"""Those that ship."""


def read_definition(name: str) -> Definition:
    """The definition of a shipped name, or in the TOML file at a path. Raises InputError."""
    if name in DEFINITIONS:
        return DEFINITIONS[name]
    if name.endswith(".toml") or "/" in name:
        return definition_from_file(Path(name))
    raise InputError(f"expected one of {', '.join(DEFINITIONS)}, or a TOML file, got {name!r}", key="definition")
