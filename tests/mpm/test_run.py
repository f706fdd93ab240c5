"""The command that runs one scene, its cache of kernels; runs that are broken off and frames in a file, to the bit."""

import dataclasses
import errno
import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from datasets import Baffle, Mass, Scene, Trajectory, files
from datasets.command_line import run
from datasets.flow.array_files import FrameWriter
from mpm import WITH_FIELDS, Recording, safety, simulate, simulation
from mpm.arrays.batch import Batch
from mpm.arrays.layout import FRAMES_PER_CALL, Precision
from mpm.footprint import footprint
from mpm.output.checkpoint import Checkpoint
from mpm.run import command
from mpm.runtime import STALE, drop_stale_lock
from mpm.simulation import Interrupted, simulate_each
from tests.breaking import SCENE
from tests.refusals import refused, refused_by
from tests.scenes import COLUMN, box

SHORT = SCENE.replace("duration = 0.25", "duration = 0.02\nframe_dt = 0.005")


def ran(folder: Path, text: str = SHORT, *flags: str) -> int:
    """Run the scene of `text`; the exit status."""
    (folder / "pile.toml").write_text(text)
    return run(command, "mpm.run", [str(folder / "pile.toml"), "--out", str(folder / "out"), *flags])


def test_it_leaves_a_trajectory_and_a_summary(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "two words"
    folder.mkdir()
    assert ran(folder) == 0
    out = folder / "out"
    assert f"python -m validation.view '{out}' shows it" in capsys.readouterr().out
    trajectory = Trajectory.load(out / "trajectory.npz")
    assert trajectory.positions.shape == (5, 400, 2)
    summary = json.loads((out / "summary.json").read_text())
    required = ["runout", "front", "toe", "steps", "particles", "wall_s", "compile_s", "energy", "arch", "precision"]
    assert set(required) <= set(summary)
    assert summary["particles"] == 400
    assert len(summary["energy"]["kinetic"]) == 5
    assert summary["runout"] == pytest.approx(float(trajectory.positions[-1, :, 0].max()))


def test_a_mistake_is_one_line_and_leaves_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene, unknown = tmp_path / "pile.toml", "domain.cel: expected a known key"
    cells = "domain.size: expected a positive whole number of cells"
    for change, said in (("cell = 0.02, cel = 1", unknown), ("cell = 0.3", cells)):
        scene.write_text(SHORT.replace("cell = 0.02", change))
        assert f"{scene}: {said}" in refused_by(capsys, command, scene, "--out", tmp_path / "out")
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
    flows = []
    for name, east, up in (("own", 0.0, 0.0), ("map", 2_600_000.0, 2_000.0)):
        line = f"points = [[{east}, {up + 0.15}], [{east + 1.0}, {up}]]"
        text = SHORT.replace("lower = [0.0, 0.0]", f"lower = [{east}, {up + 0.15}]")
        text = text.replace("cell = 0.02", f"cell = 0.02, origin = [{east}, {up}]" if east else "cell = 0.02")
        folder = tmp_path / name
        folder.mkdir()
        assert ran(folder, f'{text}[[solids]]\nkind = "terrain"\n{line}\n') == 0
        flows.append(Trajectory.load(folder / "out" / "trajectory.npz"))
    np.testing.assert_array_equal(*(flow.positions for flow in flows))
    one, other = (flow.summary for flow in flows)
    assert other["front"] - 2_600_000.0 == pytest.approx(one["front"], abs=1e-6)
    assert np.array(other["toe"]) - [2_600_000.0, 2_000.0] == pytest.approx(np.array(one["toe"]), abs=1e-6)
    assert flows[1].scene.domain.origin == (2_600_000.0, 2_000.0)


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
    assert ran(tmp_path, SHORT, "--until-rest") == 0
    assert "not at rest when its duration ended" in capsys.readouterr().out


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
    start = "from mpm import runtime; runtime.start('f32', 1)"
    subprocess.run([sys.executable, "-c", start], env=environment, check=True)
    assert not lock.exists()


RECORD = Recording(frames=3, fields=True, wall_forces=True)
OPEN = box(duration=0.28)
FLOW = box(baffles=(Baffle(lower=(0.3, 0.0), size=(0.1, 0.1)),), floor_friction=0.5, duration=0.28)


def same(one: Trajectory, other: Trajectory) -> None:
    """Every array and every series to the bit; what they cost differs."""
    for field in dataclasses.fields(Trajectory):
        if field.name not in ("scene", "summary"):
            np.testing.assert_array_equal(getattr(one, field.name), getattr(other, field.name), err_msg=field.name)
    costs = dict.fromkeys(("wall_s", "compile_s"))
    assert one.summary | costs == other.summary | costs


def broken_off(scene: Scene, calls: int, **options: Any) -> Checkpoint:
    """What is left of a run that is asked to stop after so many calls of the kernel."""
    asked = iter([False] * calls + [True])
    with pytest.raises(Interrupted) as caught:
        simulate(scene, stop=lambda: next(asked), **options)
    return caught.value.checkpoint


@pytest.mark.parametrize(
    ("scene", "record", "precision", "threads"),
    [
        (OPEN, RECORD, "f32", 1),
        (FLOW, Recording(), "f32", 1),
        pytest.param(FLOW, RECORD, "f64", 1, marks=pytest.mark.slow),
        pytest.param(FLOW, RECORD, "f32", 2, marks=pytest.mark.slow),
    ],
)
def test_a_resumed_run_is_the_unbroken_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, scene: Scene, record: Recording, precision: Precision, threads: int
) -> None:
    """Broken off twice; a large scene is sorted at every launch."""
    if threads > 1:
        monkeypatch.setattr("mpm.runtime.PARTICLES_PER_WORKER", 100)
        monkeypatch.setattr(simulation, "LARGE", 0)
    options: Any = {"precision": precision, "record": record, "threads": threads}
    whole = simulate(scene, **options)
    broken_off(scene, 1, **options).save(tmp_path / "checkpoint.npz")
    second = broken_off(scene, 1, resume=Checkpoint.load(tmp_path / "checkpoint.npz"), **options)
    assert second.frame == 2 * (3 if record is RECORD else FRAMES_PER_CALL)
    same(simulate(scene, resume=second, **options), whole)


@pytest.fixture(scope="module")
def checkpoint() -> Checkpoint:
    """Of the column, after 0.05 s."""
    return broken_off(box(), 1, record=Recording(frames=10), threads=1)


@pytest.mark.parametrize(
    ("scene", "options"),
    [
        (box(damping=0.1), {}),
        (box(COLUMN, Mass(lower=(0.5, 0.0), size=(0.1, 0.1))), {}),
        (box(), {"record": Recording(frames=10, fields=True)}),
        (box(), {"precision": "f64"}),
    ],
)
def test_another_run_is_refused(checkpoint: Checkpoint, scene: Scene, options: Any) -> None:
    batch = Batch([scene], **{"precision": "f32", "record": Recording(frames=10)} | options)
    refused(checkpoint.restore, batch, said="expected the run of the checkpoint")


@pytest.mark.parametrize("change", [{"run": None}, {"frame": np.array("{")}])
def test_a_file_that_is_no_checkpoint(tmp_path: Path, checkpoint: Checkpoint, change: dict[str, Any]) -> None:
    path = tmp_path / "checkpoint.npz"
    refused(Checkpoint.load, path, said="expected a whole NPZ of plain arrays (a checkpoint")
    checkpoint.save(path)
    with np.load(path, allow_pickle=False) as file:
        arrays = dict(file) | change
    np.savez(path, **{key: value for key, value in arrays.items() if value is not None})
    assert refused(Checkpoint.load, path, said="; delete the file to begin anew").where == str(path)


LONG = SCENE.replace("duration = 0.25", "duration = 0.4\nframe_dt = 0.005")


def full(_: Path) -> None:
    """A disk that has no room for the last bytes of a file."""
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


@pytest.mark.parametrize(
    ("number", "flags", "end"), [(signal.SIGINT, ["--every", "8"], 0.04), (signal.SIGTERM, ["--hdf5"], 0.005)]
)
def test_a_signal_leaves_a_checkpoint_from_which_the_command_goes_on(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    number: signal.Signals,
    flags: list[str],
    end: float,
) -> None:
    """It comes after the first launch."""
    out, before = tmp_path / "out", signal.getsignal(number)
    with monkeypatch.context() as patch:
        patch.setattr(simulation.tqdm, "update", lambda *_: os.kill(os.getpid(), number))
        assert ran(tmp_path, LONG, *flags) == 128 + number
    assert signal.getsignal(number) is before
    said = capsys.readouterr().err.splitlines()[-1]
    assert said == f"talus: interrupted at t = {end} s; the same command continues from {out}/checkpoint.npz"
    name = "trajectory.h5" if "--hdf5" in flags else "trajectory.npz"
    if "--hdf5" in flags:
        assert len(Trajectory.load(out / name).positions) == 2
    with monkeypatch.context() as patch:
        patch.setattr(files, "flush", full)
        assert ran(tmp_path, LONG, *flags) == 1
    assert f"{name}: No space left on device" in capsys.readouterr().err
    assert (out / "checkpoint.npz").exists()
    assert not (out / "summary.json").exists()
    for folder in (tmp_path, whole := tmp_path / "whole"):
        folder.mkdir(exist_ok=True)
        assert ran(folder, LONG, *flags) == 0
    assert sorted(file.name for file in out.iterdir()) == ["summary.json", name]
    same(Trajectory.load(out / name), Trajectory.load(whole / "out" / name))


def test_what_was_written_of_a_former_flow_goes(tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert ran(tmp_path, SHORT.replace("duration = 0.02", "duration = 0.005"), "--vtk", "--forces") == 0
    for name in ("notes.txt", "vtk/particles.vtp"):
        (out / name).write_text("somebody's")
    assert ran(tmp_path) == 0
    left = ["notes.txt", "summary.json", "trajectory.npz", "vtk", "vtk/particles.vtp"]
    assert sorted(str(path.relative_to(out)) for path in out.rglob("*")) == left
    (out / "vtk" / "particles.vtp").unlink()
    assert ran(tmp_path, SHORT, "--hdf5") == 0
    assert sorted(path.name for path in out.iterdir()) == ["notes.txt", "summary.json", "trajectory.h5"]


def test_a_checkpoint_of_another_run_is_named_and_left(
    tmp_path: Path, checkpoint: Checkpoint, capsys: pytest.CaptureFixture[str]
) -> None:
    checkpoint.save(tmp_path / "out" / "checkpoint.npz")
    assert ran(tmp_path, SHORT, "--last-frame") == 0
    said = f"talus: {tmp_path}/out/checkpoint.npz: of another scene, recording or precision"
    assert said in capsys.readouterr().err
    assert ran(tmp_path, SHORT, "--every", "2", "--last-frame") == 2


@pytest.mark.parametrize(
    "record", [Recording(), Recording(frames=50), Recording(until_rest=True)], ids=["all", "few", "until rest"]
)
def test_frames_in_a_file_are_the_same_to_the_bit(tmp_path: Path, record: Recording) -> None:
    scene = dataclasses.replace(OPEN, duration=0.6) if record.until_rest else OPEN
    whole = simulate(scene, record=record)
    with FrameWriter(tmp_path / "flow.h5") as file:
        file.put(**simulate(scene, record=record, file=file).arrays())
    same(Trajectory.load(tmp_path / "flow.h5"), whole)


def test_memory_holds_one_frame_of_those_in_a_file(tmp_path: Path) -> None:
    whole = Batch([OPEN], precision="f32")
    with FrameWriter(tmp_path / "flow.h5") as file:
        batch = Batch([OPEN], precision="f32", file=file)
        assert batch.record[0]["positions"].size == whole.positions.size / 57
        assert batch.positions.size == 1
        refused(simulate, OPEN, record=WITH_FIELDS, file=file, said="file: expected only positions")
        refused(simulate_each, [OPEN, OPEN], file=file, said="file: expected a single scene")
    assert footprint(OPEN, in_file=True).bytes <= footprint(OPEN).bytes - whole.positions.nbytes
