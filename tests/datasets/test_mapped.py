"""Positions as a map of the file: the numbers that `Trajectory.load` gives, without reading them."""

import dataclasses
import zipfile
from pathlib import Path

import numpy as np
import pytest

from datasets.errors import InputError
from datasets.training.memory_mapped import mapped, open_trajectory
from datasets.trajectory import Trajectory


@pytest.fixture
def saved(trajectory: Trajectory, tmp_path: Path) -> Path:
    """A trajectory on disk."""
    path = tmp_path / "a.npz"
    trajectory.save(path)
    return path


def test_a_trajectory_is_opened_as_it_was_saved(saved: Path) -> None:
    whole, opened = Trajectory.load(saved), open_trajectory(saved)
    for key in ("positions", "velocity0", "friction", "time"):
        assert np.array_equal(getattr(opened, key), getattr(whole, key))
        assert getattr(opened, key).dtype == getattr(whole, key).dtype
    assert opened.scene == whole.scene
    assert opened.mass is opened.volume is None


def test_the_volume_and_the_mass_of_each_particle_are_opened_too(trajectory: Trajectory, tmp_path: Path) -> None:
    volume = np.linspace(1.0, 2.0, 5, dtype=np.float32)
    dataclasses.replace(trajectory, volume=volume, mass=np.zeros(5, np.int32)).save(tmp_path / "a.npz")
    opened = open_trajectory(tmp_path / "a.npz")
    np.testing.assert_array_equal(opened.volumes, volume)
    np.testing.assert_array_equal(opened.mass, np.zeros(5))
    dataclasses.replace(trajectory, mass=np.ones(5, np.int32)).save(tmp_path / "b.npz")
    with pytest.raises(InputError, match=r"b\.npz: mass: expected the index of one of 1 masses for each of 5"):
        open_trajectory(tmp_path / "b.npz")


def test_positions_are_a_map_of_the_file_that_nobody_can_write_to(saved: Path, trajectory: Trajectory) -> None:
    positions = open_trajectory(saved).positions
    assert not positions.flags.owndata
    assert not positions.flags.writeable
    # What happens to the file is seen through the map: nothing was read before.
    content = saved.read_bytes()
    index = content.index(trajectory.positions[2].tobytes())
    with saved.open("r+b") as file:
        file.seek(index)
        file.write(np.float32(7.0).tobytes())
    assert positions[2, 0, 0] == 7.0


@pytest.mark.parametrize("order", ["C", "F"])
def test_either_order_is_mapped(tmp_path: Path, order: str) -> None:
    array = np.arange(24, dtype=np.float32).reshape(2, 3, 4)
    np.savez(tmp_path / "a.npz", other=np.arange(3), positions=np.asarray(array, order=order))
    assert np.array_equal(mapped(tmp_path / "a.npz", "positions"), array)


def test_what_cannot_be_mapped_is_read_up_to_a_limit(tmp_path: Path) -> None:
    array = np.arange(24.0).reshape(2, 3, 4)
    np.savez(tmp_path / "double.npz", positions=array)
    np.savez_compressed(tmp_path / "small.npz", positions=array.astype(np.float32))
    for name in ("double.npz", "small.npz"):
        read = mapped(tmp_path / name, "positions")
        assert read.dtype == np.float32
        assert np.array_equal(read, array)
        with pytest.raises(InputError, match=rf"{name}: positions: expected float32 numbers that are stored uncomp"):
            mapped(tmp_path / name, "positions", limit=64)


def test_objects_are_refused(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", positions=np.array([{}], dtype=object))
    with pytest.raises(InputError, match=r"a\.npz: positions: expected a whole NPZ of plain arrays"):
        mapped(tmp_path / "a.npz", "positions")


def test_a_broken_file_is_one_clear_line(saved: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="there is none"):
        mapped(tmp_path / "none.npz", "positions")
    with pytest.raises(InputError, match=r"a\.npz: speeds: expected an array, the key is missing"):
        mapped(saved, "speeds")
    (tmp_path / "cut.npz").write_bytes(saved.read_bytes()[:-100])
    with pytest.raises(InputError, match=r"cut\.npz: expected a whole NPZ of plain arrays"):
        open_trajectory(tmp_path / "cut.npz")
    content = bytearray(saved.read_bytes())
    with zipfile.ZipFile(saved) as archive:
        begin = archive.getinfo("positions.npy").header_offset
    content[begin : begin + 4] = b"none"
    (tmp_path / "lost.npz").write_bytes(content)
    with pytest.raises(
        InputError, match=r"lost\.npz: positions: expected a whole NPZ of plain arrays .*, no member begins at"
    ):
        mapped(tmp_path / "lost.npz", "positions")


def test_arrays_of_other_shapes_are_named(trajectory: Trajectory, tmp_path: Path) -> None:
    for key, array, message in (
        ("friction", np.zeros(4, np.float32), r"friction: expected shape \(5,\), got \(4,\)"),
        ("time", np.zeros(2), r"time: expected shape \(3,\), got \(2,\)"),
        ("positions", np.zeros((3, 5), np.float32), r"positions: expected shape \[T, N, 2 or 3\]"),
        ("positions", np.zeros((3, 5, 3), np.float32), "expected shape"),
    ):
        dataclasses.replace(trajectory, **{key: array}).save(tmp_path / "a.npz")
        with pytest.raises(InputError, match=message):
            open_trajectory(tmp_path / "a.npz")
