"""A tiny experiment whose front has a formula, and deposits by that formula."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from datasets.scene import Scene

EXPERIMENT = """
title = "A wedge"
what = "Its front falls by 10 mm a degree."
source = "this test"
licence = "MIT"
floor = "material"
cells = [0.02, 0.01]

[[angles]]
name = "avalanche"
lower_deg = 24.5
upper_deg = 25.5
status = "read"
source = "this test"

[[angles]]
name = "repose"
lower_deg = 20.0
upper_deg = 20.0
status = "worked out"
source = "this test"

[[cases]]
name = "wedge"
scene = "wedge.toml"

[[cases.measured]]
quantity = "front"
value = 0.52
spread = 0.005
spread_from = "this test"
status = "read"
source = "this test"
explanation = "The wedge is imaginary."

[[assumptions]]
what = "everything"
choice = "nothing"
reason = "a test"
"""

SCENE = """
duration = 0.1
frame_dt = 0.01

[domain]
size = [1.0, 0.2]
cell = 0.02

[material]
friction_deg = 30.0

[[masses]]
lower = [0.0, 0.0]
size = [0.2, 0.1]
"""

PARTICLES = 2001


def front_of(friction_deg: float) -> float:
    """Front of the wedge [m]: 0.5 m at 25 degrees, 10 mm less a degree."""
    return 0.5 - 0.01 * (friction_deg - 25.0)


def deposits(scenes: Sequence[Scene]) -> list[NDArray[np.float32]]:
    """Wedges whose 99.5 % quantile of x is `front_of` their angle; on cells of 20 mm 2 % less."""
    found = []
    for scene in scenes:
        factor = 0.98 if scene.domain.cell > 0.015 else 1.0
        # Evenly spaced from 0: the quantile at a share q is at q times the largest.
        x = np.linspace(0.0, factor * front_of(scene.material.friction_deg) / 0.995, PARTICLES)
        found.append(np.stack([x, 0.05 * np.ones(PARTICLES)], axis=1).astype(np.float32))
    return found


@pytest.fixture
def shelf(tmp_path: Path) -> Path:
    """A folder with the one experiment `wedge`."""
    folder = tmp_path / "shelf" / "wedge"
    folder.mkdir(parents=True)
    (folder / "experiment.toml").write_text(EXPERIMENT)
    (folder / "wedge.toml").write_text(SCENE)
    return tmp_path / "shelf"
