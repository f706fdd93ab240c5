"""A run that goes on from a checkpoint is the run that was never interrupted, to the bit."""

import dataclasses
import json
import os
import signal
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tqdm import tqdm

from datasets.command_line import run
from datasets.errors import InputError
from datasets.scene import Baffle, Domain, Mass, Scene
from datasets.trajectory import Trajectory
from mpm import AT_REST, WITH_FIELDS, Recording, simulate
from mpm import simulation as solver
from mpm.output.checkpoint import Checkpoint
from mpm.output.request import FIELDS
from mpm.run import command
from mpm.simulation import Options, simulate_resumably
from tests.mpm.scenes import COLUMN, box

RECORD = Recording(frames=3, fields=frozenset(FIELDS), wall_forces=True)
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


@pytest.mark.parametrize(
    ("precision", "shared"),
    [
        ("f32", False),
        pytest.param("f64", False, marks=pytest.mark.slow),
        pytest.param("f32", True, marks=pytest.mark.slow),
    ],
)
def test_a_resumed_run_is_the_unbroken_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, precision: Any, shared: bool
) -> None:
    """Broken off twice, in the middle of a launch and at its end; a large scene is sorted at every launch."""
    if shared:
        monkeypatch.setattr("mpm.runtime.PARTICLES_PER_WORKER", 100)
        monkeypatch.setattr(solver, "SORTED", 0)
    options: Options = {"precision": precision, "record": RECORD, "threads": 2 if shared else 1}
    whole = simulate(FLOW, **options)
    _, first = simulate_resumably(dataclasses.replace(FLOW, duration=0.065), **options)
    first.save(tmp_path / "checkpoint.npz")
    again = Checkpoint.load(tmp_path / "checkpoint.npz")
    # What is recorded and the precision are the checkpoint's.
    threads = options["threads"]
    _, second = simulate_resumably(dataclasses.replace(FLOW, duration=0.2), resume=again, threads=threads)
    assert (first.run.frame, second.run.frame) == (13, 40)
    same(simulate(FLOW, resume=second, threads=threads), whole)
    # A run that is finished has nothing left to do.
    same(simulate(dataclasses.replace(FLOW, duration=0.2), resume=second, threads=threads), _)


def test_rest_is_remembered(tmp_path: Path) -> None:
    scene = box(floor_friction=0.5, duration=1.5)
    options: Options = {"record": AT_REST, "threads": 1}
    whole = simulate(scene, **options)
    for duration in (0.7, 1.2):
        _, checkpoint = simulate_resumably(dataclasses.replace(scene, duration=duration), **options)
        assert bool(checkpoint.run.rest) == (duration == 1.2)
        same(simulate(scene, resume=checkpoint, threads=1), whole)
    assert whole.summary["rest_time"] is not None


@pytest.fixture(scope="module")
def checkpoint() -> Checkpoint:
    """Of the column, after 0.02 s."""
    return simulate_resumably(box(duration=0.02), threads=1)[1]


@pytest.mark.parametrize(
    ("scene", "options", "said"),
    [
        (box(damping=0.1), {}, "damping"),
        (box(COLUMN, Mass(lower=(0.5, 0.0), size=(0.1, 0.1))), {}, "masses"),
        (box(domain=Domain(size=(1.0, 1.0), cell=0.01)), {}, "domain.cell"),
        (box(duration=0.015), {}, "duration"),
        (box(), {"record": WITH_FIELDS}, "fields"),
        (box(), {"precision": "f64"}, "precision"),
    ],
)
def test_another_run_is_refused_with_the_key(checkpoint: Checkpoint, scene: Scene, options: Any, said: str) -> None:
    with pytest.raises(InputError) as caught:
        simulate(scene, resume=checkpoint, threads=1, **options)
    assert str(caught.value).startswith(f"{said}: expected the run of the checkpoint, for 0.02 s or longer")


@pytest.mark.parametrize("key", ["state", "positions"])
def test_arrays_of_another_shape(checkpoint: Checkpoint, key: str) -> None:
    broken = dataclasses.replace(checkpoint, arrays=checkpoint.arrays | {key: checkpoint.arrays[key][:-1]})
    with pytest.raises(InputError, match=f"{key}: expected"):
        simulate(box(duration=0.02), resume=broken, threads=1)


@pytest.mark.parametrize("change", [{"run": None}, {"scene": np.array("{")}])
def test_a_file_that_is_no_checkpoint(tmp_path: Path, checkpoint: Checkpoint, change: dict[str, Any]) -> None:
    path = tmp_path / "checkpoint.npz"
    with pytest.raises(InputError, match=r"expected a whole NPZ .*a checkpoint.*, there is none"):
        Checkpoint.load(path)
    checkpoint.save(path)
    with np.load(path, allow_pickle=False) as file:
        arrays = {key: value for key, value in (dict(file) | change).items() if value is not None}
    np.savez(path, **arrays)
    with pytest.raises(InputError) as caught:
        Checkpoint.load(path)
    assert caught.value.where == str(path)


SCENE = """
duration = 0.4
frame_dt = 0.005
[domain]
size = [1.0, 1.0]
cell = 0.02
[material]
friction_deg = 30.0
[[masses]]
lower = [0.0, 0.0]
size = [0.2, 0.2]
"""


@pytest.mark.parametrize(("number", "status"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_signal_leaves_a_checkpoint_from_which_the_command_goes_on(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    number: signal.Signals,
    status: int,
) -> None:
    class Bar(tqdm):  # type: ignore[type-arg]
        """Sends the signal after the first launch."""

        def update(self, n: float | None = 1) -> bool | None:
            os.kill(os.getpid(), number)
            return super().update(n)

    scene, out = tmp_path / "pile.toml", tmp_path / "out"
    scene.write_text(SCENE)
    before = signal.getsignal(number)
    with monkeypatch.context() as patch:
        patch.setattr(solver, "tqdm", Bar)
        assert run(command, "mpm.run", [str(scene), "--out", str(out), "--every", "8"]) == status
    assert signal.getsignal(number) is before
    said = capsys.readouterr().err.splitlines()[-1]
    assert said == f"talus: interrupted at t = 0.04 s; the same command goes on from {out}/checkpoint.npz"
    assert [file.name for file in out.iterdir()] == ["checkpoint.npz"]
    for folder in (out, tmp_path / "whole"):
        assert run(command, "mpm.run", [str(scene), "--out", str(folder), "--every", "8"]) == 0
    assert not (out / "checkpoint.npz").exists()
    found = Trajectory.load(out / "trajectory.npz")
    assert len(found.time) == 11
    same(found, Trajectory.load(tmp_path / "whole" / "trajectory.npz"))


def test_the_command_goes_on_for_longer(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene, out = tmp_path / "pile.toml", tmp_path / "out"
    flags = [str(scene), "--out", str(out), "--last-frame", "--checkpoint"]
    for duration, frames in ((0.035, 8), (0.06, 13)):
        scene.write_text(SCENE.replace("duration = 0.4", f"duration = {duration}"))
        assert run(command, "mpm.run", flags) == 0
        assert Trajectory.load(out / "trajectory.npz").time.tolist() == [pytest.approx(duration)]
        assert len(json.loads((out / "summary.json").read_text())["energy"]["kinetic"]) == frames
        assert Checkpoint.load(out / "checkpoint.npz").run.frame == frames - 1
    scene.write_text(SCENE.replace("friction_deg = 30.0", "friction_deg = 31.0"))
    capsys.readouterr()
    assert run(command, "mpm.run", flags) == 0
    said = f"talus: {out}/checkpoint.npz: material.friction_deg: that of another run; beginning anew\n"
    assert said in capsys.readouterr().err
    assert run(command, "mpm.run", [str(scene), "--out", str(out), "--every", "2", "--last-frame"]) == 2
