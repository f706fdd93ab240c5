"""The command that runs one scene, and its cache of kernels, which a killed process must not close for good."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from datasets.command_line import run
from datasets.flow.trajectory import Trajectory
from mpm import safety, simulation
from mpm.run import command
from mpm.runtime import STALE, drop_stale_lock
from tests.breaking import SCENE
from tests.refusals import refused_by

SHORT = SCENE.replace("duration = 0.25", "duration = 0.02\nframe_dt = 0.005")


def ran(folder: Path, text: str = SHORT, *flags: str) -> int:
    """Run the scene of `text`; the exit status."""
    (folder / "pile.toml").write_text(text)
    return run(command, "mpm.run", [str(folder / "pile.toml"), "--out", str(folder / "out"), *flags])


def test_it_leaves_a_trajectory_and_a_summary(tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert ran(tmp_path) == 0
    trajectory = Trajectory.load(out / "trajectory.npz")
    assert trajectory.positions.shape == (5, 400, 2)
    summary = json.loads((out / "summary.json").read_text())
    required = ["runout", "front", "toe", "steps", "particles", "wall_s", "compile_s", "energy", "arch", "precision"]
    assert set(required) <= set(summary)
    assert summary["particles"] == 400
    assert len(summary["energy"]["kinetic"]) == 5
    assert summary["runout"] == pytest.approx(float(trajectory.positions[-1, :, 0].max()))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ("cell = 0.02, cel = 1", "domain.cel: expected a known key"),
        ("cell = 0.3", "domain.size: expected a positive whole number of cells"),
    ],
)
def test_a_mistake_is_one_line_and_leaves_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], change: str, said: str
) -> None:
    (tmp_path / "pile.toml").write_text(SHORT.replace("cell = 0.02", change))
    line = refused_by(capsys, command, tmp_path / "pile.toml", "--out", tmp_path / "out")
    assert f"{tmp_path / 'pile.toml'}: {said}" in line
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("flags", [(), ("--safety",)])
def test_a_folder_that_is_none_is_refused_before_the_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], flags: tuple[str, ...]
) -> None:
    """Its work would be lost."""
    (tmp_path / "pile.toml").write_text(SHORT)
    (tmp_path / "out").write_text("")
    monkeypatch.setattr(simulation, "simulate", pytest.fail)
    monkeypatch.setattr(safety, "safety_factor", pytest.fail)
    line = refused_by(capsys, command, tmp_path / "pile.toml", "--out", tmp_path / "out", *flags)
    assert f"{tmp_path / 'out'}: --out: expected a folder to write to" in line
    monkeypatch.setattr(os, "access", lambda *_: False)
    assert "Permission denied" in refused_by(capsys, command, tmp_path / "pile.toml", "--out", tmp_path / "new", *flags)


def test_a_flow_on_a_map_is_the_same_to_the_bit(tmp_path: Path) -> None:
    """2,600 km east and 2,000 m up, where single precision has steps of 0.25 m; its summary is on the map."""
    found = []
    for name, east, up in (("own", 0.0, 0.0), ("map", 2_600_000.0, 2_000.0)):
        line = f"points = [[{east}, {up + 0.15}], [{east + 1.0}, {up}]]"
        text = SHORT.replace("lower = [0.0, 0.0]", f"lower = [{east}, {up + 0.15}]")
        text = text.replace("cell = 0.02", f"cell = 0.02, origin = [{east}, {up}]" if east else "cell = 0.02")
        folder = tmp_path / name
        folder.mkdir()
        assert ran(folder, f'{text}[[solids]]\nkind = "terrain"\n{line}\n') == 0
        found.append(Trajectory.load(folder / "out" / "trajectory.npz"))
    np.testing.assert_array_equal(*(flow.positions for flow in found))
    one, other = (flow.summary for flow in found)
    assert other["front"] - 2_600_000.0 == pytest.approx(one["front"], abs=1e-6)
    assert np.array(other["toe"]) - [2_600_000.0, 2_000.0] == pytest.approx(np.array(one["toe"]), abs=1e-6)
    assert found[1].scene.domain.origin == (2_600_000.0, 2_000.0)


@pytest.mark.slow
def test_a_baffle_its_forces_and_a_series_for_paraview(tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert ran(tmp_path, SHORT + "[[baffles]]\nlower = [0.22, 0.0]\nsize = [0.1, 0.1]\n", "--vtk", "--forces") == 0
    trajectory = Trajectory.load(out / "trajectory.npz")
    assert trajectory.pressure is not None
    assert (out / "vtk" / "trajectory.pvd").is_file()
    forces = np.genfromtxt(out / "forces.csv", delimiter=",", skip_header=1)
    assert forces.shape == (4, 1 + 2 * 5)
    np.testing.assert_allclose(0.005 * forces[:, 1:3].sum(axis=0), trajectory.solid_impulse[-1, 0], rtol=1e-6)
    assert (out / "forces.png").is_file()


@pytest.mark.double
def test_fields_rest_and_precision(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out, text = tmp_path / "out", SHORT.replace("duration = 0.02", "duration = 2.0\ndamping = 0.2")
    assert ran(tmp_path, text, "--fields", "--until-rest", "--precision", "f64") == 0
    assert "at rest after" in capsys.readouterr().out
    summary = json.loads((out / "summary.json").read_text())
    assert 0.0 < summary["rest_time"] < 2.0
    assert summary["precision"] == "f64"
    assert Trajectory.load(out / "trajectory.npz").velocities is not None


START = """
from mpm import runtime
runtime.start("f32", 1)
"""


@pytest.mark.parametrize(("age", "there"), [(2.0 * STALE, False), (0.0, True)])
def test_a_lock_that_a_killed_run_left_is_removed(tmp_path: Path, age: float, there: bool) -> None:
    lock = tmp_path / "ticache.lock"
    lock.touch()
    os.utime(lock, (lock.stat().st_mtime - age,) * 2)
    drop_stale_lock(lock)
    assert lock.exists() is there
    drop_stale_lock(tmp_path / "none")


def test_a_run_opens_the_cache_again(tmp_path: Path) -> None:
    lock = tmp_path / "ticache.lock"
    lock.touch()
    os.utime(lock, (1.0, 1.0))
    environment = os.environ | {"TI_OFFLINE_CACHE_FILE_PATH": str(tmp_path)}
    subprocess.run([sys.executable, "-c", START], env=environment, check=True)
    assert not lock.exists()
