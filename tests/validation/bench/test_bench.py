"""The pages: finished work is held, each of few runs is written, one of a GPU needs one."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from datasets.lock import locked
from validation.bench import gns as bench_gns
from validation.bench.__main__ import main
from validation.bench.accuracy import bench as accuracy
from validation.bench.speed import mean_x
from validation.run_store import kept


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
@pytest.mark.parametrize(("name", "flags"), [("accuracy", ()), ("gns", ("--model", "flow2d"))])
def test_a_page_of_few_runs(name: str, flags: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(accuracy, "REFERENCE", {2: 14.0})
    monkeypatch.setattr(accuracy, "TRIED", (0.2,))
    monkeypatch.setattr(bench_gns, "SCENES", {2: {"columns2d": 2}})
    monkeypatch.setattr(bench_gns, "CELLS", {2: (7, 10)})
    assert main([name, "--out", str(tmp_path), *flags]) == 0
    assert (tmp_path / f"{name}.md").read_text().startswith("# ")
    assert list(tmp_path.rglob("*.png")) or name == "accuracy"


def test_the_objective_of_the_priced_gradient_has_its_derivative() -> None:
    positions = np.random.default_rng(0).random((1, 5, 2))
    value, slope, _ = mean_x(positions, positions)
    moved = positions.copy()
    moved[0, 3, 0] += 1e-6
    assert (mean_x(moved, moved)[0] - value) / 1e-6 == pytest.approx(slope[0, 3, 0])


@pytest.mark.skipif(shutil.which("nvidia-smi") is not None, reason="there may be a GPU here")
def test_a_page_of_a_gpu_needs_one(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["gpu", "--out", str(tmp_path)]) == 2
    assert "expected a GPU that torch can use, there is none" in capsys.readouterr().err
    assert not (tmp_path / "gpu.md").exists()
