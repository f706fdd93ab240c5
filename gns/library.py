"""The models that ship. Nothing here needs torch."""

from pathlib import Path

WEIGHTS = Path(__file__).parent / "weights"
ENDING = ".safetensors"
"""Of the file of a model."""
BEST = f"best{ENDING}"
"""What a training leaves in its folder: the model to use."""


def shipped(dimension: int) -> Path:
    """The model that is used in 2D or 3D where none is named."""
    return WEIGHTS / f"{'flow2d' if dimension == 2 else 'obstacle3d'}{ENDING}"


def models() -> list[Path]:
    return sorted(WEIGHTS.glob(f"*{ENDING}"))


def model_path(model: str | Path) -> Path:
    """The file of a model: its path, the folder of its training, or the name of one that ships (flow2d, obstacle3d)."""
    named, path = WEIGHTS / f"{model}{ENDING}", Path(model)
    if path.is_dir():
        return path / BEST
    return named if named.is_file() and not path.exists() else path
