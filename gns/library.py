"""The models that ship, and where the members of an ensemble lie. Nothing here needs torch."""

import itertools
import re
from pathlib import Path

WEIGHTS = Path(__file__).parent / "weights"
"""The models that ship."""
ENDING = ".safetensors"
"""Of the file of a model."""
BEST = f"best{ENDING}"
"""What a training leaves in its folder: the model to use."""
MEMBER = re.compile(r".*-\d+")
"""How a member of the ensemble of a model is called: its name and a number."""


def shipped(dimension: int) -> Path:
    """The model that is used in 2D or 3D where none is named."""
    return WEIGHTS / f"{'flow2d' if dimension == 2 else 'obstacle3d'}{ENDING}"


def models(folder: Path = WEIGHTS) -> list[Path]:
    """The models in a folder, by name; without the members of ensembles."""
    found = [path for path in folder.glob(f"*{ENDING}") if not MEMBER.fullmatch(path.stem)]
    return sorted(found, key=lambda path: path.stem)


def members(model: Path) -> list[Path]:
    """The members of the ensemble of a model, NAME-1, NAME-2 and so on beside it."""
    return list(itertools.takewhile(Path.exists, (member_path(model, number) for number in itertools.count(1))))


def member_path(model: Path, number: int) -> Path:
    """The file of a member of the ensemble of a model, counted from 1."""
    return model.with_name(f"{model.stem}-{number}{ENDING}")


def model_path(model: str | Path) -> Path:
    """The file of a model: its path, the folder of its training, or the name of one that ships (flow2d, obstacle3d)."""
    named, path = WEIGHTS / f"{model}{ENDING}", Path(model)
    if path.is_dir():
        return path / BEST
    return named if named.is_file() and not path.exists() else path
