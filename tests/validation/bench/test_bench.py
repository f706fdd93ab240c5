"""The pages: each of few runs is written, one of a GPU needs one."""

import math
import shutil
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from datasets import Scene
from datasets.errors import WorkFailed
from tests.refusals import refused
from validation.bench import gns as bench_gns
from validation.bench import speed
from validation.bench.__main__ import main
from validation.bench.accuracy import bench as accuracy
from validation.bench.mountain import sliding_point, written_scene
from validation.bench.speed import feature_row, featured


def test_a_point_that_slides_loses_what_the_bed_turns() -> None:
    """Down a slope, through a kink and along a plain: v^2 falls by exp(-2 mu theta) there; raised it is the same."""
    x, mu, steep = np.linspace(0.0, 3000.0, 3001), 0.35, 0.7
    height = np.maximum(0.0, steep * (1000.0 - x))
    energy = 1000.0 * (steep - mu) * math.exp(-2.0 * mu * math.atan(steep))
    exact = 1000.0 * steep / (1000.0 + energy / mu)
    assert sliding_point(x, height, 0.0, mu) == pytest.approx(exact, rel=1e-9)
    assert sliding_point(x, height + 1.0e3, 0.0, mu) == pytest.approx(exact, rel=1e-9)
    with pytest.raises(WorkFailed, match="off the profile"):
        sliding_point(x, steep * (3000.0 - x), 0.0, mu)


def test_a_folder_without_its_raster_is_named(tmp_path: Path) -> None:
    data = tmp_path / "CoulombOnly"
    data.mkdir()
    (data / "simulationParameterValues_CoulombOnly.csv").write_text("releaseThickness,mu,xi\n1.5,0.4,\n")
    assert refused(written_scene, data, 4.0, tmp_path, said="expected one file DEM_*.*, there are 0").where == str(data)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:masses:UserWarning")  # the MPM beside a network is coarse on purpose
@pytest.mark.parametrize(("name", "flags"), [("accuracy", ()), ("gns", ("--model", "flow2d"))])
def test_a_page_of_few_runs(name: str, flags: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(accuracy, "REFERENCE", {2: 14.0})
    monkeypatch.setattr(accuracy, "TRIED", (0.2,))
    monkeypatch.setattr(bench_gns, "SCENES", {2: {"columns2d": 2}})
    monkeypatch.setattr(bench_gns, "CELLS", {2: (7, 10)})
    monkeypatch.setattr(bench_gns, "JITTERS", 1)
    assert main([name, "--out", str(tmp_path), *flags]) == 0
    assert (tmp_path / f"{name}.md").read_text().startswith("# ")
    assert list(tmp_path.rglob("*.png")) or name == "accuracy"


def test_baffles_are_priced_beside_the_same_scene_without_them(monkeypatch: pytest.MonkeyPatch) -> None:
    def simulate(scene: Scene, **_: object) -> SimpleNamespace:
        return SimpleNamespace(summary={"wall_s": 3e-5 if scene.baffles else 2e-5, "particles": 100, "steps": 10})

    monkeypatch.setattr(speed, "simulate", simulate)
    row = feature_row("short", *featured()["column-short-21"], 2)
    assert [*row.values()] == ["`short`", "3,200", "1 baffle", "30.0", "20.0", "1.500"]


@pytest.mark.skipif(shutil.which("nvidia-smi") is not None, reason="there may be a GPU here")
def test_a_page_of_a_gpu_needs_one(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["gpu", "--out", str(tmp_path)]) == 2
    assert "expected a GPU that torch can use, there is none" in capsys.readouterr().err
    assert not (tmp_path / "gpu.md").exists()
