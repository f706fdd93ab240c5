"""A run that goes on from a checkpoint, and one whose frames go to a file, is the plain run to the bit."""

import dataclasses
import os
import signal
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tqdm import tqdm

from datasets import Baffle, Mass, Scene, Trajectory
from datasets.command_line import run
from datasets.flow.array_files import FrameWriter
from mpm import WITH_FIELDS, Recording, simulate
from mpm import simulation as solver
from mpm.arrays.batch import Batch
from mpm.arrays.layout import FRAMES_PER_CALL, Precision
from mpm.footprint import footprint
from mpm.output.checkpoint import Checkpoint
from mpm.run import command
from mpm.simulation import Interrupted, simulate_each
from tests.breaking import SCENE
from tests.refusals import refused
from tests.scenes import COLUMN, box

RECORD = Recording(frames=3, fields=True, wall_forces=True)
OPEN = box(duration=0.28)
FLOW = box(baffles=(Baffle(lower=(0.3, 0.0), size=(0.1, 0.1)),), floor_friction=0.5, duration=0.28)


def same(one: Trajectory, other: Trajectory) -> None:
    """Every array and every series to the bit; what they cost differs."""
    for field in dataclasses.fields(Trajectory):
        if field.name not in ("scene", "summary"):
            np.testing.assert_array_equal(getattr(one, field.name), getattr(other, field.name), err_msg=field.name)
    costs = ("wall_s", "compile_s")
    assert {k: v for k, v in one.summary.items() if k not in costs} == {
        k: v for k, v in other.summary.items() if k not in costs
    }


def broken_off(scene: Scene, calls: int, **options: Any) -> Checkpoint:
    """What is left of a run that is asked to stop after so many calls of the kernel."""
    asked = iter([False] * calls + [True])
    with pytest.raises(Interrupted) as caught:
        simulate(scene, stop=lambda: next(asked), **options)
    return caught.value.checkpoint


@pytest.mark.parametrize(
    ("scene", "record", "precision", "shared"),
    [
        (OPEN, RECORD, "f32", False),
        (FLOW, Recording(), "f32", False),
        pytest.param(FLOW, RECORD, "f64", False, marks=pytest.mark.slow),
        pytest.param(FLOW, RECORD, "f32", True, marks=pytest.mark.slow),
    ],
)
def test_a_resumed_run_is_the_unbroken_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, scene: Scene, record: Recording, precision: Precision, shared: bool
) -> None:
    """Broken off twice; a large scene is sorted at every launch."""
    if shared:
        monkeypatch.setattr("mpm.runtime.PARTICLES_PER_WORKER", 100)
        monkeypatch.setattr(solver, "LARGE", 0)
    threads = 2 if shared else 1
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
    refused(Checkpoint.load, path, said="expected a whole NPZ of plain arrays (a checkpoint), there is no such file")
    checkpoint.save(path)
    with np.load(path, allow_pickle=False) as file:
        arrays = {key: value for key, value in (dict(file) | change).items() if value is not None}
    np.savez(path, **arrays)
    assert refused(Checkpoint.load, path).where == str(path)


LONG = SCENE.replace("duration = 0.25", "duration = 0.4\nframe_dt = 0.005")


@pytest.mark.parametrize(
    ("number", "status", "flags", "end"),
    [(signal.SIGINT, 130, ["--every", "8"], 0.04), (signal.SIGTERM, 143, ["--hdf5"], 0.005)],
)
def test_a_signal_leaves_a_checkpoint_from_which_the_command_goes_on(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    number: signal.Signals,
    status: int,
    flags: list[str],
    end: float,
) -> None:
    class Bar(tqdm):
        """Sends the signal after the first launch."""

        def update(self, n: float | None = 1) -> bool | None:
            os.kill(os.getpid(), number)
            return super().update(n)

    scene, out = tmp_path / "pile.toml", tmp_path / "out"
    scene.write_text(LONG)
    before = signal.getsignal(number)
    with monkeypatch.context() as patch:
        patch.setattr(solver, "tqdm", Bar)
        assert run(command, "mpm.run", [str(scene), "--out", str(out), *flags]) == status
    assert signal.getsignal(number) is before
    said = capsys.readouterr().err.splitlines()[-1]
    assert said == f"talus: interrupted at t = {end} s; the same command goes on from {out}/checkpoint.npz"
    name = "trajectory.h5" if "--hdf5" in flags else "trajectory.npz"
    if "--hdf5" in flags:
        assert len(Trajectory.load(out / name).positions) == 2
    for folder in (out, tmp_path / "whole"):
        assert run(command, "mpm.run", [str(scene), "--out", str(folder), *flags]) == 0
    assert sorted(file.name for file in out.iterdir()) == ["summary.json", name]
    same(Trajectory.load(out / name), Trajectory.load(tmp_path / "whole" / name))


def test_a_checkpoint_of_another_run_is_named_and_left(
    tmp_path: Path, checkpoint: Checkpoint, capsys: pytest.CaptureFixture[str]
) -> None:
    scene, out = tmp_path / "pile.toml", tmp_path / "out"
    scene.write_text(LONG.replace("duration = 0.4", "duration = 0.01"))
    checkpoint.save(out / "checkpoint.npz")
    assert run(command, "mpm.run", [str(scene), "--out", str(out), "--last-frame"]) == 0
    assert f"talus: {out}/checkpoint.npz: of another scene, recording or precision" in capsys.readouterr().err
    assert run(command, "mpm.run", [str(scene), "--out", str(out), "--every", "2", "--last-frame"]) == 2


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
        refused(simulate, OPEN, record=WITH_FIELDS, file=file, said="file: expected positions alone")
        refused(simulate_each, [OPEN, OPEN], file=file, said="file: expected one scene")
    assert footprint(OPEN, in_file=True).bytes <= footprint(OPEN).bytes - whole.positions.nbytes
