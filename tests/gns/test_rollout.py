"""`python -m gns.rollout` from rest and from frames, and its refusals."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from datasets import Mass, Scene, Trajectory, command_line, write_scene
from datasets.flow import measures
from gns import checkpoint, inference, library
from gns.rollout import rollout
from gns.simulator import Simulator
from tests.gns.conftest import spreading
from tests.mpm.test_terrain import hill
from tests.refusals import refused_by
from tests.scenes import scene_of

SCENE = spreading(30.0).scene
DEEP = scene_of(Mass(lower=(0.0, 0.0, 0.0), size=(0.12, 0.16, 0.1)), size=(0.6, 0.4, 0.1), cell=0.01, duration=0.25)


@pytest.fixture
def files(simulator: Simulator, tmp_path: Path) -> dict[str, Path]:
    """A scene, a model, and the first 22 and the first 4 frames of a run of the scene: 5.25 and 0.75 steps."""
    paths = {"scene": tmp_path / "scene.toml", "model": tmp_path / "model.safetensors", "start": tmp_path / "start.npz"}
    write_scene(SCENE, paths["scene"])
    checkpoint.save(paths["model"], simulator, {})
    whole = spreading(30.0)
    short = replace(SCENE, duration=0.05)
    for name, last in (("start", 22), ("brief", 4)):
        path = paths.setdefault(name, tmp_path / f"{name}.npz")
        replace(whole, positions=whole.positions[:last], time=whole.time[:last], scene=short).save(path)
    return paths


def run(files: dict[str, Path], out: Path, *flags: str) -> int:
    """Run the command."""
    arguments = [str(files["scene"]), "--out", str(out), "--model", str(files["model"]), "--threads", "1", *flags]
    return command_line.run(rollout, "rollout", arguments)


def test_from_rest_and_from_frames(files: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(files, tmp_path / "rest") == 0
    assert "begins" not in capsys.readouterr().out
    assert run(files, tmp_path / "frames", "--start", str(files["start"])) == 0
    assert f"the rollout begins at 0.05 s of the 0.0525 s of {files['start']}" in capsys.readouterr().out
    brief = ("--out", tmp_path / "brief", "--model", files["model"], "--start", files["brief"])
    said = refused_by(capsys, rollout, files["scene"], *brief)
    assert "start: time: expected frames over at least one step of the model, 0.01 s, got 0.0075 s" in said
    for name, kind, steps in (("rest", "rest", 25), ("frames", "frames", 20)):
        trajectory = Trajectory.load(tmp_path / name / "trajectory.npz")
        summary = json.loads((tmp_path / name / "summary.json").read_text())
        np.testing.assert_allclose(trajectory.time, np.arange(26) * 0.01)
        assert trajectory.positions.shape == (26, 12 * 16, 2)
        assert (summary["start"], summary["steps"], summary["particles"]) == (kind, steps, 192)
        assert summary["front"] == pytest.approx(measures.front(trajectory.positions[-1], trajectory.volumes))
        assert trajectory.scene.frames == len(trajectory.time)
        assert trajectory.volumes.sum() == pytest.approx(0.12 * 0.16, rel=1e-5)
        assert trajectory.mass.tolist() == [0] * 192
    # The known frames are those of the run that was handed over, whatever the model makes of the rest.
    start = Trajectory.load(files["start"]).positions[::4]
    first = Trajectory.load(tmp_path / "frames" / "trajectory.npz").positions[:6]
    assert all(point in start[5].tolist() for point in first[5].tolist())


@pytest.mark.parametrize(
    ("scene", "model"),
    [(SCENE, "flow2d.safetensors"), (DEEP, "obstacle3d.safetensors"), (hill(), "terrain3d.safetensors")],
)
def test_the_shipped_model_is_that_of_the_dimension_and_of_terrain(
    scene: Scene, model: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    write_scene(scene, tmp_path / "scene.toml")
    monkeypatch.setattr(library, "WEIGHTS", tmp_path)
    said = refused_by(capsys, rollout, tmp_path / "scene.toml", "--out", tmp_path / "out")
    assert f"{model}: expected a model, the folder of a training or one of" in said


def test_refusals(
    files: dict[str, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    spreading(31.0).save(tmp_path / "other.npz")
    (tmp_path / "run").mkdir()
    files["start"].rename(tmp_path / "run" / "trajectory.npz")
    for start in (tmp_path / "run", tmp_path / "run" / "trajectory.npz"):
        said = refused_by(capsys, rollout, files["scene"], "--out", tmp_path / "run", "--start", start)
        assert "--out: expected a folder other than that of --start" in said
    deep = tmp_path / "deep.toml"
    write_scene(DEEP, deep)
    cases = [
        ({**files, "model": tmp_path / "none"}, [], "expected a model, the folder of a training or one of flow2d"),
        (files, ["--start", str(tmp_path / "other.npz")], "these belong to another scene"),
        (files, ["--start", str(tmp_path / "none.npz")], "there is no such file"),
        ({**files, "scene": deep}, [], "deep.toml: expected a 2D scene"),
        (files, ["--device", "tpu"], "tpu"),
        (files, ["--threads", "0"], "--threads"),
    ]
    if not torch.cuda.is_available():
        cases.append((files, ["--device", "cuda"], "expected a GPU"))
    for paths, flags, message in cases:
        arguments = paths["scene"], "--out", tmp_path / "out", "--model", paths["model"], *flags
        assert message in refused_by(capsys, rollout, *arguments)
    assert not (tmp_path / "out").exists()
    # Before the work, which would be lost.
    (tmp_path / "out").write_text("")
    monkeypatch.setattr(inference, "simulate", pytest.fail)
    arguments = files["scene"], "--out", tmp_path / "out", "--model", files["model"]
    assert "--out: expected a folder to write to" in refused_by(capsys, rollout, *arguments)
