"""Frames that go to a file while a run computes them are those that memory would hold."""

import dataclasses
import os
import signal
from pathlib import Path

import numpy as np
import pytest
from tqdm import tqdm

from datasets.arrays import FrameWriter
from datasets.command_line import run
from datasets.errors import InputError
from datasets.trajectory import Trajectory
from mpm import WITH_FIELDS, Recording, simulate
from mpm import simulation as solver
from mpm.arrays.batch import Batch
from mpm.arrays.layout import FRAMES_PER_CALL
from mpm.footprint import footprint
from mpm.run import command
from mpm.simulation import simulate_each
from tests.mpm.scenes import box

FLOW = box(duration=0.28)


@pytest.mark.parametrize(
    "record",
    [Recording(), Recording(frames=3), Recording(frames=50), Recording(until_rest=True)],
    ids=["all", "every third", "fewer than calls", "all until rest"],
)
def test_frames_in_a_file_are_the_same_to_the_bit(tmp_path: Path, record: Recording) -> None:
    scene = dataclasses.replace(FLOW, duration=0.6) if record.until_rest else FLOW
    assert scene.frames > 2 * FRAMES_PER_CALL
    whole = simulate(scene, record=record)
    with FrameWriter(tmp_path / "flow.h5") as file:
        file.put(**simulate(scene, record=record, file=file).arrays())
    found = Trajectory.load(tmp_path / "flow.h5")
    np.testing.assert_array_equal(found.positions, whole.positions)
    np.testing.assert_array_equal(found.time, whole.time)
    costs = ("wall_s", "compile_s")
    assert {k: v for k, v in found.summary.items() if k not in costs} == {
        k: v for k, v in whole.summary.items() if k not in costs
    }


def test_memory_holds_one_frame(tmp_path: Path) -> None:
    whole = Batch([FLOW], precision="f32")
    with FrameWriter(tmp_path / "flow.h5") as file:
        batch = Batch([FLOW], precision="f32", file=file)
        assert batch.record[0]["positions"].size == whole.positions.size / 57
        assert batch.positions.size == 1
    assert footprint(FLOW, in_file=True).bytes <= footprint(FLOW).bytes - whole.positions.nbytes


def test_fields_and_other_scenes_beside_are_refused(tmp_path: Path) -> None:
    with FrameWriter(tmp_path / "flow.h5") as file:
        with pytest.raises(InputError, match="file: expected positions alone"):
            simulate(FLOW, record=WITH_FIELDS, file=file)
        with pytest.raises(InputError, match="file: expected one scene"):
            simulate_each([FLOW, FLOW], file=file)


SCENE = """
duration = 0.2
frame_dt = 0.005

[domain]
size = [1.0, 0.5]
cell = 0.02

[material]
friction_deg = 30.0

[[masses]]
lower = [0.0, 0.0]
size = [0.2, 0.2]
"""


def test_the_command_appends_and_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Bar(tqdm):  # type: ignore[type-arg]
        """Asks to stop after the first launch."""

        def update(self, n: float | None = 1) -> bool | None:
            os.kill(os.getpid(), signal.SIGINT)
            return super().update(n)

    scene, out = tmp_path / "pile.toml", tmp_path / "out"
    scene.write_text(SCENE)
    assert run(command, "mpm.run", [str(scene), "--out", str(out)]) == 0
    whole = Trajectory.load(out / "trajectory.npz")
    with monkeypatch.context() as patch:
        patch.setattr(solver, "tqdm", Bar)
        assert run(command, "mpm.run", [str(scene), "--out", str(out), "--hdf5"]) == 130
    part = Trajectory.load(out / "trajectory.h5")
    np.testing.assert_array_equal(part.positions, whole.positions[:2])
    assert run(command, "mpm.run", [str(scene), "--out", str(out), "--hdf5"]) == 0
    assert sorted(path.name for path in out.iterdir()) == ["summary.json", "trajectory.h5"]
    np.testing.assert_array_equal(Trajectory.load(out / "trajectory.h5").positions, whole.positions)
