"""A back-analysis whose flow has a formula; the history that ships, where scenes have a terrain."""

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from datasets.errors import InputError
from datasets.scene import Scene
from validation.bench.case_history import bench
from validation.bench.case_history.history import FOLDER, read_history, rounded
from validation.runs import RunStore

HISTORY = """
title = "A wedge"
what = "A formula."
source = "this test"
licence = "MIT"
scene = "scene.toml"
bed = "floor_friction"
cells = [0.02, 0.01]
raster = 0.01
spread = 0.01
spread_from = "this test"

[twin]
bed_friction = 0.4
seed = 7
cell = 0.01
"""

SCENE = """
duration = 0.1
frame_dt = 0.01
floor_friction = 0.1

[domain]
size = [2.0, 0.2]
cell = 0.02

[material]
friction_deg = 30.0

[[masses]]
lower = [0.0, 0.0]
size = [0.2, 0.1]
"""


def deposits(scenes: Sequence[Scene]) -> list[NDArray[np.float64]]:
    """Wedges whose front is at 0.4 m over the bed friction."""
    found = []
    for scene in scenes:
        x = np.linspace(0.0, 0.4 / scene.floor_friction / 0.995, 2001)
        found.append(np.stack([x, np.full(2001, 0.01)], axis=1))
    return found


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """The history of the wedge."""
    path = tmp_path / "wedge"
    path.mkdir()
    (path / "history.toml").write_text(HISTORY)
    (path / "scene.toml").write_text(SCENE)
    return path


def test_the_friction_is_inferred(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    simulated: list[Scene] = []

    def simulate(_: RunStore, scenes: Sequence[Scene]) -> list[NDArray[np.float64]]:
        simulated.extend(scenes)
        return deposits(scenes)

    monkeypatch.setattr(bench, "deposits_of", simulate)
    text = bench.bench(tmp_path / "out", quick=False, keep=tmp_path, history=folder)
    truth = math.degrees(math.atan(0.4))
    page = (tmp_path / "out" / "case-history.md").read_text()
    # 10 mm of the front are 0.23 degrees here; the runout was rounded by up to 5 mm.
    line = next(line for line in page.splitlines() if line.startswith("| fine"))
    angle, width = (float(word) for word in line.split("|")[3].replace("°", "").split("±"))
    assert angle == pytest.approx(truth, abs=width)
    assert width == pytest.approx(math.degrees(0.01 * 0.4 / (1.0 + 0.4**2)), rel=0.3)
    assert f"the twin's {truth:.2f}° is within that" in text
    assert (tmp_path / "out" / "case-history.png").stat().st_size > 1000
    # The search uses neither the twin's jitter nor its friction.
    assert simulated[0].floor_friction == 0.4
    assert all(scene.seed != simulated[0].seed for scene in simulated[1:])
    assert all(abs(scene.floor_friction - 0.4) > 1e-6 for scene in simulated[1:])


def test_a_runout_is_rounded_to_its_pixel() -> None:
    assert rounded(103.0, 20.0) == 110.0
    assert rounded(119.9, 20.0) == 110.0
    assert rounded(120.1, 20.0) == 130.0


def test_a_bed_that_the_scene_lacks_is_refused(folder: Path) -> None:
    path = folder / "history.toml"
    path.write_text(HISTORY.replace('bed = "floor_friction"', 'bed = "solids[0].friction"'))
    with pytest.raises(InputError, match=r"scene\.toml: solids\[0\]\.friction"):
        read_history(folder).scene(0.3, 0.01, 0)


def test_what_ships_can_be_read() -> None:
    read = read_history(FOLDER / "yildiz-parabola")
    assert len(read.history.assumptions) >= 3
    for cell in (*read.history.cells, read.history.twin.cell):
        scene = read.scene(0.25, cell, 1)
        assert scene.damping == 0.0
        assert scene.domain.cell == cell
