"""The command that runs one scene."""

import json
from pathlib import Path

import pytest

from datasets.command_line import run
from datasets.trajectory import Trajectory
from mpm.run import command

SCENE = """
duration = 0.02
frame_dt = 0.005
[domain]
size = [0.4, 0.4]
cell = 0.02
[material]
friction_deg = 30.0
[[masses]]
lower = [0.0, 0.0]
size = [0.1, 0.2]
"""


def test_it_leaves_a_trajectory_and_a_summary(tmp_path: Path) -> None:
    scene, out = tmp_path / "heap.toml", tmp_path / "out"
    scene.write_text(SCENE)
    assert run(command, "mpm.run", [str(scene), "--out", str(out)]) == 0
    trajectory = Trajectory.load(out / "trajectory.npz")
    assert trajectory.positions.shape == (5, 200, 2)
    summary = json.loads((out / "summary.json").read_text())
    wanted = ["runout", "front", "toe", "steps", "particles", "wall_s", "compile_s", "energy", "arch", "precision"]
    assert set(wanted) <= set(summary)
    assert summary["particles"] == 200
    assert len(summary["energy"]["kinetic"]) == 5
    assert summary["runout"] == pytest.approx(float(trajectory.positions[-1, :, 0].max()))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ("cell = 0.02\n[material]", None),
        ("cell = 0.02\ncel = 1\n[material]", "domain.cel: expected a known key"),
        ("cell = 0.3\n[material]", "whole number of cells"),
    ],
)
def test_a_mistake_is_one_line_and_leaves_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], change: str, said: str | None
) -> None:
    scene, out = tmp_path / "heap.toml", tmp_path / "out"
    scene.write_text(SCENE.replace("cell = 0.02\n[material]", change))
    status = run(command, "mpm.run", [str(scene), "--out", str(out)])
    error = capsys.readouterr().err
    if said is None:
        assert status == 0
        return
    assert status == 2
    assert said in error
    assert str(scene) in error
    assert error.count("\n") == 1
    assert not out.exists()


def test_three_dimensions_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene = tmp_path / "heap.toml"
    for two, three in (
        ("[0.4, 0.4]", "[0.4, 0.4, 0.4]"),
        ("[0.0, 0.0]", "[0.0, 0.0, 0.0]"),
        ("[0.1, 0.2]", "[0.1, 0.2, 0.1]"),
    ):
        scene.write_text((scene.read_text() if scene.exists() else SCENE).replace(two, three))
    assert run(command, "mpm.run", [str(scene), "--out", str(tmp_path / "out")]) == 2
    assert "two-dimensional" in capsys.readouterr().err
