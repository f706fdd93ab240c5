"""Trajectory files: written whole and the same every time, read back exactly, anything else refused in one line."""

import dataclasses
import pickle
from pathlib import Path

import numpy as np
import pytest

from datasets.errors import InputError
from datasets.scene import Baffle
from datasets.trajectory import Trajectory


def test_volumes_and_the_time_between_frames(tmp_path: Path, trajectory: Trajectory) -> None:
    assert trajectory.frame_dt == trajectory.scene.frame_dt == 0.0025
    whole = 0.04 * 0.02
    np.testing.assert_allclose(trajectory.volumes, np.full(5, whole / 5))
    own = dataclasses.replace(trajectory, positions=np.zeros((1, 32, 2), np.float32), time=np.zeros(1))
    assert (own.volumes == own.scene.particle_volume).all()
    weighted = dataclasses.replace(
        trajectory, volume=np.array([1, 2, 3, 1, 1], np.float32) * 1e-4, time=np.array([0.0, 0.01, 0.02])
    )
    weighted.save(tmp_path / "trajectory.npz")
    again = Trajectory.load(tmp_path / "trajectory.npz")
    np.testing.assert_allclose(again.volumes, [1e-4, 2e-4, 3e-4, 1e-4, 1e-4], rtol=1e-6)
    assert again.frame_dt == pytest.approx(0.01)
    with pytest.raises(InputError, match="evenly spaced"):
        _ = dataclasses.replace(trajectory, time=np.array([0.0, 0.0025, 0.01])).frame_dt
    dataclasses.replace(weighted, volume=np.ones(4, np.float32)).save(tmp_path / "bad.npz")
    with pytest.raises(InputError, match=r"volume: expected shape \(5,\)"):
        Trajectory.load(tmp_path / "bad.npz")


@pytest.fixture
def with_baffles(trajectory: Trajectory) -> Trajectory:
    """Five points before two baffles, with all that can be recorded."""
    stream = np.random.default_rng(1)
    baffles = (Baffle(lower=(0.12, 0.0), size=(0.02, 0.03)), Baffle(lower=(0.16, 0.0), size=(0.02, 0.03)))
    return dataclasses.replace(
        trajectory,
        scene=dataclasses.replace(trajectory.scene, baffles=baffles),
        volume=stream.random(5, np.float32),
        velocities=stream.random((3, 5, 2), np.float32),
        stress=stream.random((3, 5, 4), np.float32),
        pressure=stream.random((3, 5), np.float32),
        density=stream.random((3, 5), np.float32),
        plastic_strain=stream.random((3, 5), np.float32),
        solid_impulse=stream.random((3, 2, 2)),
    )


def test_the_mass_of_each_particle(tmp_path: Path, trajectory: Trajectory) -> None:
    second = dataclasses.replace(trajectory.scene.masses[0], lower=(0.1, 0.0))
    scene = dataclasses.replace(trajectory.scene, masses=(*trajectory.scene.masses, second))
    mass = np.array([0, 1, 1, 0, 1], np.int32)
    path = tmp_path / "trajectory.npz"
    dataclasses.replace(trajectory, scene=scene, mass=mass).save(path)
    again = Trajectory.load(path)
    assert again.mass is not None
    assert again.mass.dtype == np.int32
    np.testing.assert_array_equal(again.mass, mass)
    for wrong in (mass[:4], mass + 1, mass - 1):
        dataclasses.replace(trajectory, scene=scene, mass=wrong).save(path)
        with pytest.raises(InputError, match="mass: expected the index of one of 2 masses for each of 5 particles"):
            Trajectory.load(path)
    content = dict(np.load(path, allow_pickle=False))
    np.savez(path, **{**content, "mass": np.zeros(5)})
    with pytest.raises(InputError, match="mass: expected the index"):
        Trajectory.load(path)


@pytest.mark.parametrize(
    ("key", "value", "expected"),
    [
        ("velocities", np.zeros((3, 5)), "expected shape (3, 5, 2), got (3, 5)"),
        ("stress", np.zeros((3, 5, 6)), "expected shape (3, 5, 4), got (3, 5, 6)"),
        ("pressure", np.zeros((2, 5)), "expected shape (3, 5), got (2, 5)"),
        ("density", np.zeros((3, 5, 1)), "expected shape (3, 5), got (3, 5, 1)"),
        ("plastic_strain", np.zeros((3, 5), int), "floating-point"),
        ("solid_impulse", np.zeros((3, 1, 2)), "expected shape (3, 2, 2), got (3, 1, 2)"),
    ],
)
def test_fields_of_another_flow(
    tmp_path: Path, with_baffles: Trajectory, key: str, value: np.ndarray, expected: str
) -> None:
    path = tmp_path / "trajectory.npz"
    with_baffles.save(path)
    with np.load(path, allow_pickle=False) as file:
        arrays = dict(file)
    np.savez(path, **(arrays | {key: value}))
    error = refused(path)
    assert error.key == key
    assert expected in error.message


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
        ("scene", None, "missing"),
        ("positions", np.zeros((3, 5)), "[T, N, 2 or 3]"),
        ("positions", np.zeros((0, 5, 2)), "at least one frame"),
        ("positions", np.zeros((3, 5, 3)), "(5, 3)"),
        ("time", np.zeros(4), "(3,)"),
        ("friction", np.zeros(4), "(5,)"),
        ("positions", np.full((3, 5, 2), "a"), "numbers"),
        ("scene", np.array("{}"), "missing"),
        ("scene", np.array("nonsense"), "JSON"),
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
