"""Definitions of datasets in TOML: families of kinds of scenes, or one scene of distributions; by name or path."""

from pathlib import Path

from datasets.definitions.definition import Definition
from datasets.definitions.distributions import definition_from_file
from datasets.errors import InputError

FAMILIES = ("flow2d", "columns2d", "obstacle3d", "baffles3d", "terrain3d", "cohesive3d")
NAMES = (*FAMILIES, "paper2d", "paper3d")  # of the shipped definitions


def read_definition(name: str | Path) -> Definition:
    """The definition of a shipped name, or in the TOML file at a path. Raises InputError."""
    name = str(name)
    shipped = Path(__file__).parent / f"{name}.toml"
    if name in FAMILIES:
        # Imported here, with the geometry libraries that check similarity to held-out scenes.
        from datasets.definitions.families import family

        return family(shipped)
    if name in NAMES:
        return definition_from_file(shipped)
    if name.endswith(".toml") or "/" in name:
        return definition_from_file(Path(name))
    raise InputError(f"expected one of {', '.join(NAMES)}, or a TOML file, got {name!r}", key="definition")
