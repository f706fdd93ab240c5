"""Compressed trajectories: positions to a part of a cell, everything else as it was; foreign files are refused."""

import dataclasses
from pathlib import Path

import h5py
import numpy as np
import pytest

from datasets.compressed import FINENESS, GROUP
from datasets.errors import InputError
from datasets.training.memory_mapped import open_trajectory
from datasets.trajectory import Trajectory, read_trajectory, stored_scene, stored_shape, trajectory_files


@pytest.fixture
def flow(trajectory: Trajectory) -> Trajectory:
    """Points that move on from frame to frame over more than two groups, with a field and volumes."""
    stream = np.random.default_rng(1)
    frames, count = 2 * GROUP + 5, 2000
    steps = stream.normal(0.0, 0.002, (frames, count, 2))
    return dataclasses.replace(
        trajectory,
        positions=(0.5 + np.cumsum(steps, axis=0)).astype(np.float32),
        time=0.0025 * np.arange(frames),
        velocity0=stream.random((count, 2), np.float32),
        friction=np.full(count, 0.5, np.float32),
        volume=stream.random(count, np.float32) + 0.1,
        mass=np.zeros(count, np.int32),
        pressure=stream.random((frames, count), np.float32),
    )


@pytest.fixture
def saved(flow: Trajectory, tmp_path: Path) -> Path:
    path = tmp_path / "trajectory.h5"
    flow.save(path)
    return path


def test_positions_are_within_a_part_of_a_cell_and_the_rest_is_the_same(flow: Trajectory, saved: Path) -> None:
    for read in (Trajectory.load(saved), read_trajectory(saved.parent)):
        error = np.abs(read.positions.astype(np.float64) - flow.positions).max()
        # Half a quantum, and the rounding of single precision.
        assert 0.0 < error <= 0.5 * flow.scene.domain.cell / FINENESS + 1.0e-7
        for key in ("time", "velocity0", "friction", "volume", "mass", "pressure"):
            np.testing.assert_array_equal(getattr(read, key), getattr(flow, key))
        assert (read.scene, read.summary) == (flow.scene, flow.summary)
    opened = open_trajectory(saved)
    np.testing.assert_array_equal(opened.positions, Trajectory.load(saved).positions)
    assert stored_scene(saved) == flow.scene
    assert stored_shape(saved, "positions") == flow.positions.shape


def test_saving_what_was_read_changes_nothing(saved: Path, tmp_path: Path) -> None:
    Trajectory.load(saved).save(tmp_path / "again.h5")
    assert (tmp_path / "again.h5").read_bytes() == saved.read_bytes()


def test_it_is_smaller(flow: Trajectory, saved: Path, tmp_path: Path) -> None:
    resting = dataclasses.replace(flow, positions=np.repeat(flow.positions[:1], len(flow.time), axis=0), pressure=None)
    resting.save(tmp_path / "resting.h5")
    assert (tmp_path / "resting.h5").stat().st_size < 0.1 * resting.positions.nbytes
    np.testing.assert_allclose(
        Trajectory.load(tmp_path / "resting.h5").positions, resting.positions, rtol=0.0, atol=1.0e-6
    )


def test_positions_far_out_are_stored_as_they_are(flow: Trajectory, tmp_path: Path) -> None:
    far = dataclasses.replace(flow, positions=flow.positions + np.float32(1.0e6))
    far.save(tmp_path / "far.h5")
    np.testing.assert_array_equal(Trajectory.load(tmp_path / "far.h5").positions, far.positions)


def test_trajectories_of_both_kinds_are_found_and_parts_of_none(trajectory: Trajectory, tmp_path: Path) -> None:
    for name in ("b.h5", "a.npz"):
        trajectory.save(tmp_path / name)
    (tmp_path / ".part-c.h5").write_bytes(b"")
    assert [path.name for path in trajectory_files(tmp_path)] == ["a.npz", "b.h5"]


@pytest.mark.parametrize(
    ("key", "change", "line"),
    [
        ("time", "remove", "time: expected an array, the key is missing"),
        ("positions", "quantum", "positions: expected the attributes quantum and group, both positive"),
        ("positions", "group", "positions: expected the attributes quantum and group, both positive"),
        ("scene", "numbers", "scene: expected text, as bytes"),
    ],
)
def test_a_broken_file_is_one_line(saved: Path, key: str, change: str, line: str) -> None:
    with h5py.File(saved, "a") as file:
        if change == "remove":
            del file[key]
        elif change == "numbers":
            del file[key]
            file[key] = np.zeros(3)
        else:
            file[key].attrs[change] = -1
    with pytest.raises(InputError, match=line):
        Trajectory.load(saved)


def test_what_is_no_hdf5_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "a.h5").write_text("no HDF5")
    with pytest.raises(InputError, match=r"a\.h5"):
        Trajectory.load(tmp_path / "a.h5")
