"""The ground truth: explicit MLS-MPM of Mohr-Coulomb sand, in Taichi.

from datasets import read_scene
from mpm import LAST, simulate, simulate_many

trajectory = simulate(read_scene("column-tall-42"))
deposit = simulate(read_scene("baffles-2"), record=LAST).positions[-1]
runs = simulate_many([scene.with_friction_deg(angle) for angle in (20.0, 30.0, 40.0)], record=LAST)
"""

import os
from typing import TYPE_CHECKING

# Talus's commands print their results, not the versions of libraries.
os.environ.setdefault("ENABLE_TAICHI_HEADER_PRINT", "0")

try:
    from datasets import lazily
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

__getattr__, __dir__ = lazily(
    "mpm",
    {
        **dict.fromkeys(("ALL", "AT_REST", "LAST", "WITH_FIELDS", "Recording"), "mpm.output.recording"),
        **dict.fromkeys(("ScenesFailed", "simulate", "simulate_each", "simulate_many"), "mpm.simulation"),
        "safety_factor": "mpm.safety",
    },
)
