"""The pages: finished work is held, each of few runs is written, one of a GPU needs one; mounds, prices of errors."""

import math
import shutil
from pathlib import Path

import numpy as np
import pytest

from datasets import Mass, Scene, Trajectory
from datasets.lock import locked
from datasets.scene.particles import initial_particles, released_volume
from tests.scenes import flow_of, scene_of
from validation.bench import efficiency
from validation.bench import gns as bench_gns
from validation.bench.__main__ import main
from validation.bench.accuracy import bench as accuracy
from validation.bench.gns import mpm_seconds
from validation.bench.held_out import MOUNDS, creep, mound
from validation.bench.page import kept


def test_finished_work_is_held_and_goes_with_a_temporary_folder(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with kept(None) as folder:
        assert folder.is_dir()
    assert not folder.exists()
    with locked(tmp_path / "keep"):
        assert main(["accuracy", "--out", str(tmp_path), "--keep", str(tmp_path / "keep")]) == 1
    assert "writes here since" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:masses:UserWarning")  # the MPM beside a network is coarse on purpose
@pytest.mark.parametrize(("name", "flags"), [("accuracy", ()), ("efficiency", ()), ("gns", ("--model", "flow2d"))])
def test_a_page_of_few_runs(name: str, flags: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(efficiency, "CUTS", ((1, 1),))
    monkeypatch.setattr(efficiency, "JITTERS", 2)
    monkeypatch.setattr(efficiency, "BAFFLE_JITTERS", 1)
    monkeypatch.setattr(accuracy, "REFERENCE", {2: 14.0})
    monkeypatch.setattr(accuracy, "TRIED", (0.2,))
    monkeypatch.setattr(bench_gns, "SCENES", {2: {"columns2d": 2}})
    monkeypatch.setattr(bench_gns, "CELLS", {2: (7, 10)})
    monkeypatch.setattr(bench_gns, "JITTERS", 1)
    assert main([name, "--out", str(tmp_path), *flags]) == 0
    assert (tmp_path / f"{name}.md").read_text().startswith("# ")
    assert list(tmp_path.rglob("*.png")) or name == "efficiency"


@pytest.mark.skipif(shutil.which("nvidia-smi") is not None, reason="there may be a GPU here")
def test_a_page_of_a_gpu_needs_one(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["gpu", "--out", str(tmp_path)]) == 2
    assert "expected a GPU that torch can use, there is none" in capsys.readouterr().err
    assert not (tmp_path / "gpu.md").exists()


BLOCK = scene_of(Mass(lower=(0.1, 0.0), size=(0.2, 0.2)), size=(1.0, 0.4), duration=1.0, frame_dt=0.1)


def stretched(scene: Scene, by: float) -> Trajectory:
    """A block whose particles move away from its rear, evenly over the time, until it is `by` times as long."""
    particles = initial_particles(scene)
    time = np.arange(scene.frames) * scene.frame_dt
    factor = 1.0 + (by - 1.0) * time / time[-1]
    positions = np.repeat(particles.positions[None], len(time), axis=0)
    positions[..., 0] = 0.1 + factor[:, None] * (positions[..., 0] - 0.1)
    return flow_of(scene, positions, summary={"wall_s": 1.0})


def test_a_mound_that_creeps_is_measured_from_its_start_on() -> None:
    flow = stretched(BLOCK, 2.0)
    assert creep(flow, 1.0) == pytest.approx(creep(flow), rel=1e-4)
    assert creep(flow, 1.0) == pytest.approx(200.0, rel=0.03)
    for title, (friction_deg, slope_deg) in MOUNDS.items():
        scene, steepest = mound(title, 0), math.degrees(math.atan(0.5)) + slope_deg
        assert steepest < friction_deg
        assert released_volume(scene) == pytest.approx(0.08)


def test_the_price_of_an_error_is_read_off_the_curve() -> None:
    points = [(1.0, 0.02), (0.25, 0.04), (0.0625, 0.08)]
    assert mpm_seconds(points, 0.2) == pytest.approx(0.0625)
    assert mpm_seconds(points, 0.04) == pytest.approx(0.25)
    assert mpm_seconds(points, 0.04 / math.sqrt(2.0)) == pytest.approx(0.5)
    assert mpm_seconds(points, 0.001) is None
