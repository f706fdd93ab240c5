"""The models that ship. Nothing here needs torch."""

from pathlib import Path

from datasets.errors import InputError
from datasets.scene.parts import SceneLayout

WEIGHTS = Path(__file__).parent / "weights"
ENDING = ".safetensors"  # suffix of a model's file
BEST = f"best{ENDING}"  # the model to use, in the folder of a training


def shipped(scene: SceneLayout) -> Path:
    """The default model for a scene: one in 2D, one in 3D, and one on terrain in 3D."""
    terrain = any(solid.kind == "terrain" for solid in scene.solids)
    name = "flow2d" if scene.dimension == 2 else "terrain3d" if terrain else "obstacle3d"
    return WEIGHTS / f"{name}{ENDING}"


def models() -> list[Path]:
    return sorted(WEIGHTS.glob(f"*{ENDING}"))


def model_path(model: str | Path) -> Path:
    """The file of a model: its path, the folder of its training, or the name of one that ships, such as flow2d.

    Raises InputError if there is none.
    """
    named, path = WEIGHTS / f"{model}{ENDING}", Path(model)
    if path.is_dir():
        return path / BEST
    names = ", ".join(file.stem for file in models())
    if not path.exists() and not named.is_file():
        raise InputError(f"expected a model, the folder of a training or one of {names}", where=str(model))
    return path if path.exists() else named
