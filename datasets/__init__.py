"""Scenes, materials and trajectories, and how they are read and written.

For example:

    from datasets import Domain, Mass, Material, Scene, read_trajectory, write_scene

    sand = Material(friction_deg=30.0)
    column = Mass(lower=(0.0, 0.0), size=(0.2, 0.4))
    scene = Scene(domain=Domain(size=(2.0, 0.5), cell=0.01), material=sand, masses=(column,), floor_friction=0.4)
    write_scene(scene, "column.toml")  # python -m mpm.run column.toml --out results
    print(read_trajectory("results").positions.shape)  # frames, particles, 2
"""

import warnings
from importlib.metadata import PackageNotFoundError, distribution
from importlib.util import find_spec
from pathlib import Path

from datasets.errors import InputError
from datasets.flow.trajectory import Trajectory, read_trajectory
from datasets.lazy import lazily as lazily
from datasets.scene import Baffle, Channel, Domain, Gate, Mass, Scene, Solid, Stage
from datasets.scene.library import read_scene, write_scene
from datasets.scene.material import Material

__version__ = "0.1.0"
__all__ = ["Baffle", "Channel", "Domain", "Gate", "InputError", "Mass", "Material", "Scene", "Solid", "Stage"]
__all__ += ["Trajectory", "read_scene", "read_trajectory", "write_scene"]


def __dir__() -> list[str]:
    return [*__all__, "__version__"]


def _warn_of_namesake() -> None:
    """Warn if Hugging Face's package `datasets` is installed: it has the same name, and Python imports only one."""
    try:
        other = distribution("datasets").version
    except PackageNotFoundError:
        return
    said = f"Hugging Face's datasets {other} is installed beside Talus, whose package `datasets` has the same name"
    warnings.warn(f"{said}: one of them will not work; install Talus in an environment of its own", stacklevel=3)


def _warn_of_shadowing() -> None:
    """Warn if a folder or file of the user, beside a script or in the working folder, hides a package of Talus."""
    for spec in filter(None, map(find_spec, ("mpm", "gns", "inverse", "validation"))):
        place = Path([*(spec.submodule_search_locations or ()), spec.origin or ""][0])
        if place.resolve() != Path(__file__).resolve().parents[1] / spec.name:
            warnings.warn(f"{place} hides Talus's package `{spec.name}` here: rename it", stacklevel=3)


_warn_of_namesake()
_warn_of_shadowing()
