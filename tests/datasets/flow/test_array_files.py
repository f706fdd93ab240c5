"""Trajectories on disk: an NPZ is mapped, HDF5 read frame by frame; what is foreign is read, or is one line."""

import dataclasses
import pickle
import zipfile
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from datasets.flow.array_files import FrameWriter, read_arrays
from datasets.flow.trajectory import STORED, Trajectory, open_trajectory, read_trajectory, stored_scene
from tests.refusals import refused

TERABYTES = "{'descr': '<f8', 'fortran_order': False, 'shape': (999999999999,), }"
OBJECTS = "{'descr': '|O', 'fortran_order': False, 'shape': (1,), }"


@pytest.fixture
def flow(trajectory: Trajectory) -> Trajectory:
    """Particles that move on from frame to frame, with all that can be recorded."""
    stream = np.random.default_rng(1)
    frames, count = 37, 2000
    steps = stream.normal(0.0, 0.002, (frames, count, 2))
    shapes = {"volume": (count,), "velocities": (frames, count, 2), "stress": (frames, count, 4)}
    shapes |= dict.fromkeys(("pressure", "plastic_strain", "pore_pressure"), (frames, count))
    shapes |= {"solid_impulse": (frames, 0, 2), "entry_time": (count,)}
    return dataclasses.replace(
        trajectory,
        positions=(0.5 + np.cumsum(steps, axis=0)).astype(np.float32),
        time=0.0025 * np.arange(frames),
        velocity0=stream.random((count, 2), np.float32),
        friction=np.full(count, 0.5, np.float32),
        mass=np.zeros(count, np.int32),
        **{key: (0.1 + stream.random(shape)).astype(STORED[key][0]) for key, shape in shapes.items()},
    )


@pytest.fixture(params=["trajectory.npz", "trajectory.h5"])
def saved(flow: Trajectory, tmp_path: Path, request: pytest.FixtureRequest) -> Path:
    path = tmp_path / str(request.param)
    flow.save(str(path))
    return path


def test_everything_comes_back_to_the_bit(flow: Trajectory, saved: Path) -> None:
    for read in (Trajectory.load(str(saved)), read_trajectory(str(saved.parent))):
        for key in ("positions", *STORED):
            np.testing.assert_array_equal(getattr(read, key), getattr(flow, key))
            assert getattr(read, key).dtype == getattr(flow, key).dtype
        assert (read.scene, read.summary) == (flow.scene, flow.summary)
    assert stored_scene(saved) == flow.scene


def test_an_opened_trajectory_has_the_frames_that_are_asked_for(flow: Trajectory, saved: Path) -> None:
    opened = open_trajectory(saved)
    for key in ("velocity0", "friction", "time", "volume", "mass"):
        np.testing.assert_array_equal(getattr(opened, key), getattr(flow, key))
    assert (opened.scene, opened.frame_dt, opened.velocities) == (flow.scene, flow.frame_dt, None)
    ours, theirs = opened.positions, flow.positions
    assert (ours.shape, ours.ndim, len(ours), ours.size) == (theirs.shape, 3, len(theirs), theirs.size)
    few = np.array([3, 1, 4])
    for key in (0, -1, np.int64(5), slice(2, 5), slice(None, None, 7), (-1, slice(None), 0), (slice(4, 9), few)):
        np.testing.assert_array_equal(ours[key], theirs[key])
    np.testing.assert_array_equal(ours[::3][2:5][:, few], theirs[::3][2:5][:, few])
    np.testing.assert_array_equal(ours[1] - ours[0], theirs[1] - theirs[0])
    with pytest.raises(IndexError):
        ours[len(theirs)]


def test_a_file_grows_by_frames_and_appears_at_the_end(flow: Trajectory, tmp_path: Path) -> None:
    path = tmp_path / "flow.h5"
    with FrameWriter(path) as file:
        file.put(scene=flow.scene.to_json(), velocity0=flow.velocity0, friction=flow.friction)
        for first in range(0, len(flow.time), 5):
            part = slice(first, first + 5)
            file.append(time=flow.time[part], positions=flow.positions[part])
        np.testing.assert_array_equal(file.frames("positions")[-1], flow.positions[-1])
        assert not path.exists()
    np.testing.assert_array_equal(Trajectory.load(path).positions, flow.positions)
    with pytest.raises(TypeError), FrameWriter(tmp_path / "lost.h5") as file:
        file.put(scene=object())
    assert [entry.name for entry in tmp_path.iterdir()] == ["flow.h5"]


def test_damage_within_a_frame_is_one_line_when_it_is_read(flow: Trajectory, tmp_path: Path) -> None:
    path = tmp_path / "flow.h5"
    flow.save(path)
    with h5py.File(path) as file:
        place = file["positions"].id.get_chunk_info(5)
    content = bytearray(path.read_bytes())
    content[place.byte_offset : place.byte_offset + 64] = bytes(64)
    path.write_bytes(content)
    positions = open_trajectory(path).positions
    refused(lambda: [positions[frame] for frame in range(len(positions))], said="flow.h5: positions: expected a")


def test_one_flipped_byte_is_found_where_frames_from_everywhere_are_used(flow: Trajectory, tmp_path: Path) -> None:
    path = tmp_path / "flow.npz"
    flow.save(path)
    open_trajectory(path, sound=True)
    content = bytearray(path.read_bytes())
    content[content.index(flow.positions[20].tobytes())] ^= 1
    path.write_bytes(content)
    for read in (read_trajectory, lambda name: open_trajectory(name, sound=True)):
        assert refused(read, path, said="Bad CRC-32").key == "positions"


@pytest.mark.parametrize("name", ["flow.npz", "flow.h5"])
def test_a_flow_that_blew_up_is_refused_before_its_frames_are_read(flow: Trajectory, tmp_path: Path, name: str) -> None:
    """A page of it was written, with a warning of NumPy."""
    positions = flow.positions.copy()
    positions[3:, 2] = np.nan
    dataclasses.replace(flow, positions=positions).save(tmp_path / name)
    assert refused(open_trajectory, tmp_path / name, said="finite numbers").key == "positions"


def with_member(path: Path, content: bytes) -> Path:
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("data.npy", content)
    return path


def npy(header: str, content: bytes = b"") -> bytes:
    return b"\x93NUMPY\1\0" + len(header).to_bytes(2, "little") + header.encode() + content


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (b"", "a trajectory"),
        (npy(TERABYTES, bytes(8)), "got 7.28 TiB"),
        (npy("{'descr': '<f8', 'fortran_order': False, 'shape': (__import__('os'),), }"), "a trajectory"),
        (npy("(" * 5000), "a trajectory"),
        (npy(OBJECTS, b"cos\nsystem\n."), "Object arrays cannot be loaded"),
    ],
)
def test_hostile_members(tmp_path: Path, content: bytes, expected: str) -> None:
    error = refused(read_arrays, with_member(tmp_path / "bad.npz", content), said=expected)
    assert (error.where, error.key) == (str(tmp_path / "bad.npz"), "data")


def test_hdf5_of_numbers(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "data.h5", "w") as file:
        file["fine/numbers"] = np.arange(3)
        file["text"] = "sand"
        file.create_dataset("endless", (2**45,), np.float64, chunks=(2**10,))
    assert read_arrays(tmp_path / "data.h5", "fine/numbers")["fine/numbers"].tolist() == [0, 1, 2]
    for key in ("absent", "fine", "text", "endless"):
        refused(read_arrays, tmp_path / "data.h5", key, said=f"data.h5: {key}: expected an array")
    refused(read_arrays, tmp_path / "none" / "other.h5", said="other.h5: expected a trajectory, there is no such file")


def test_volumes_and_the_time_between_frames(trajectory: Trajectory) -> None:
    assert trajectory.frame_dt == trajectory.scene.frame_dt == 0.0025
    np.testing.assert_allclose(trajectory.volumes, np.full(5, 0.04 * 0.02 / 5))
    single = dataclasses.replace(trajectory, positions=np.zeros((1, 32, 2), np.float32), time=np.zeros(1))
    assert (single.volumes == single.scene.particle_volume).all()
    weighted = dataclasses.replace(trajectory, volume=np.arange(1.0, 6.0, dtype=np.float32), time=np.arange(3) * 0.01)
    np.testing.assert_allclose(weighted.volumes, np.arange(1.0, 6.0))
    assert weighted.frame_dt == pytest.approx(0.01)
    uneven = dataclasses.replace(trajectory, time=np.array([0.0, 0.0025, 0.01]))
    refused(lambda: uneven.frame_dt, said="evenly spaced")


class Calls:
    """Pickles as a call of `function`."""

    def __init__(self, function: Any, *arguments: Any) -> None:
        self.made = (function, arguments)

    def __reduce__(self) -> Any:
        return self.made


def test_a_pickle_is_refused_and_not_run(tmp_path: Path) -> None:
    mark = tmp_path / "mark"
    (tmp_path / "plain.npz").write_bytes(pickle.dumps(Calls(Path.touch, mark)))
    np.savez(tmp_path / "object.npz", gns_data=np.array([Calls(Path.touch, mark)], dtype=object))
    for name in ("plain.npz", "object.npz"):
        error = refused(Trajectory.load, tmp_path / name, said="whole NPZ of plain arrays")
        assert error.where == str(tmp_path / name)
    assert not mark.exists()


@pytest.mark.parametrize(
    ("key", "value", "expected"),
    [
        ("positions", None, "missing"),
        ("positions", np.full((3, 5, 2), np.nan), "finite numbers"),
        ("time", np.zeros(3), "ascending times"),
        ("plastic_strain", np.zeros((3, 5), int), "floating-point"),
        ("volume", np.zeros(5), "positive volumes"),
        ("mass", np.ones(5, int), "the index of one of 1 masses for each of 5"),
        ("summary", np.array("nonsense"), "JSON"),
    ],
)
def test_a_foreign_npz(tmp_path: Path, trajectory: Trajectory, key: str, value: Any, expected: str) -> None:
    path = tmp_path / "trajectory.npz"
    trajectory.save(path)
    with np.load(path, allow_pickle=False) as file:
        arrays = {name: array for name, array in (dict(file) | {key: value}).items() if array is not None}
    np.savez(path, **arrays)
    assert refused(Trajectory.load, path, said=expected).where == str(path)
