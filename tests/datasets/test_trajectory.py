"""Trajectory files of others: anything but a trajectory is refused in one line that names file and key."""

import dataclasses
import pickle
from pathlib import Path

import numpy as np
import pytest

from datasets.errors import InputError
from datasets.trajectory import Trajectory


def test_volumes_and_the_time_between_frames(trajectory: Trajectory) -> None:
    assert trajectory.frame_dt == trajectory.scene.frame_dt == 0.0025
    np.testing.assert_allclose(trajectory.volumes, np.full(5, 0.04 * 0.02 / 5))
    own = dataclasses.replace(trajectory, positions=np.zeros((1, 32, 2), np.float32), time=np.zeros(1))
    assert (own.volumes == own.scene.particle_volume).all()
    weighted = dataclasses.replace(trajectory, volume=np.arange(1.0, 6.0, dtype=np.float32), time=np.arange(3) * 0.01)
    np.testing.assert_allclose(weighted.volumes, np.arange(1.0, 6.0))
    assert weighted.frame_dt == pytest.approx(0.01)
    with pytest.raises(InputError, match="evenly spaced"):
        _ = dataclasses.replace(trajectory, time=np.array([0.0, 0.0025, 0.01])).frame_dt


def refused(path: Path) -> InputError:
    with pytest.raises(InputError) as caught:
        Trajectory.load(path)
    assert caught.value.where == str(path)
    assert "\n" not in str(caught.value)
    return caught.value


class Intruder:
    """Leaves a mark when unpickled."""

    def __init__(self, mark: Path) -> None:
        self.mark = mark

    def __reduce__(self) -> tuple[object, ...]:
        return (Path.touch, (self.mark,))


def test_a_pickle_is_refused_and_not_run(tmp_path: Path) -> None:
    mark = tmp_path / "mark"
    (tmp_path / "plain.npz").write_bytes(pickle.dumps(Intruder(mark)))
    np.savez(tmp_path / "object.npz", gns_data=np.array([Intruder(mark)], dtype=object))
    for name in ("plain.npz", "object.npz"):
        assert "whole NPZ of plain arrays" in refused(tmp_path / name).message
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
def test_a_foreign_npz(
    tmp_path: Path, trajectory: Trajectory, key: str, value: np.ndarray | None, expected: str
) -> None:
    path = tmp_path / "trajectory.npz"
    trajectory.save(path)
    with np.load(path, allow_pickle=False) as file:
        arrays = dict(file)
    if value is None:
        del arrays[key]
    else:
        arrays[key] = value
    np.savez(path, **arrays)
    assert expected in str(refused(path))
