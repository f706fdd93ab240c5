"""The ground truth: explicit MLS-MPM of Mohr-Coulomb sand, in Taichi.

from datasets import read_scene
from mpm import LAST, simulate, simulate_many

trajectory = simulate(read_scene("column-tall-42"))
deposit = simulate(read_scene("baffles-2"), record=LAST).positions[-1]
runs = simulate_many([scene.with_friction_deg(angle) for angle in (20.0, 30.0, 40.0)], record=LAST)
"""

import os
from importlib import import_module
from typing import TYPE_CHECKING, Any

# Commands of Talus print what they found, not which libraries they found it with.
os.environ.setdefault("ENABLE_TAICHI_HEADER_PRINT", "0")

try:
    from datasets import Scene as _Scene  # noqa: F401
except ImportError as error:
    raise ImportError(
        f"expected Talus's package datasets ({error}); Hugging Face's has the same name: install Talus in an "
        "environment of its own"
    ) from None

if TYPE_CHECKING:
    from mpm.output.recording import ALL, AT_REST, LAST, WITH_FIELDS, Recording
    from mpm.safety import safety_factor
    from mpm.simulation import ScenesFailed, simulate, simulate_each, simulate_many

__all__ = ["ALL", "AT_REST", "LAST", "WITH_FIELDS", "Recording", "ScenesFailed"]
__all__ += ["safety_factor", "simulate", "simulate_each", "simulate_many"]


def __getattr__(name: str) -> Any:
    """Import on first use: processes that only read scenes or resolutions need no Taichi."""
    if name not in __all__:
        raise AttributeError(f"module 'mpm' has no attribute {name!r}")
    solves = name.startswith(("simulate", "Scenes"))
    home = "simulation" if solves else "safety" if name == "safety_factor" else "output.recording"
    return getattr(import_module(f"mpm.{home}"), name)


def __dir__() -> list[str]:
    return [*globals(), *__all__]
