"""geoelements/gns NPZ: written as the peers' loader unpacks it, read in every form that its files come in."""

import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from datasets.errors import InputError
from datasets.exchange import geoelements
from datasets.exchange.cloud import Cloud, cloud_of
from datasets.exchange.geoelements import ParticleType
from tests.datasets.toys import toy

STREAM = np.random.default_rng(0)
POSITIONS = STREAM.random((4, 5, 2))
TYPES = np.array([6, 3, 6, 6, 3])
FRICTION = np.array([0.5, 0.0, 0.6, 0.7, 0.0], np.float32)


def stored(path: Path, *parts: Any, key: str = "simulation_trajectory_0") -> Path:
    data = np.empty(len(parts), dtype=object)
    for index, part in enumerate(parts):
        data[index] = part
    np.savez(path, **{key: data})
    return path


def only(path: Path) -> Cloud:
    (name,) = geoelements.names(path)
    (particles,) = geoelements.read(path, {name})
    assert particles.name == name
    return particles


@pytest.mark.parametrize("dimension", [2, 3])
def test_numpy_reads_what_talus_writes(tmp_path: Path, dimension: int) -> None:
    path = tmp_path / "train.npz"
    written = [cloud_of(toy(dimension, seed), f"toy-{seed}") for seed in range(2)]
    geoelements.write(path, written)
    # As the peers' loader does it, on a file that this test has just written.
    with np.load(path, allow_pickle=True) as file:
        data = [item for _, item in file.items()]
        assert file.files == ["toy-0", "toy-1"]
    for (positions, types, material), particles in zip(data, written, strict=True):
        assert positions.dtype == np.float32
        np.testing.assert_array_equal(positions, particles.positions)
        count = positions.shape[1]
        np.testing.assert_array_equal(np.full(count, types, dtype=int) == 3, particles.stationary)
        assert set(types.tolist()) == {3, 6}
        np.testing.assert_array_equal(np.full(count, material, dtype=float) == 0.0, particles.stationary)
        np.testing.assert_array_equal(np.transpose(positions, (1, 0, 2))[0, :2], particles.positions[:2, 0])


def test_the_bytes_depend_on_the_trajectories_alone(tmp_path: Path) -> None:
    for name in ("a.npz", "b.npz"):
        geoelements.write(tmp_path / name, [cloud_of(toy(2), "toy")])
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()


def test_obstacles_come_last_and_stand(tmp_path: Path) -> None:
    trajectory = toy(3)
    geoelements.write(tmp_path / "a.npz", [cloud_of(trajectory, "toy")])
    particles = only(tmp_path / "a.npz")
    sand = trajectory.positions.shape[1]
    assert particles.stationary.tolist() == [False] * sand + [True] * (len(particles.stationary) - sand)
    np.testing.assert_array_equal(particles.positions[:, :sand], trajectory.positions)
    assert (np.ptp(particles.positions[:, sand:], axis=0) == 0.0).all()
    for baffle in trajectory.scene.baffles:
        lower, upper = np.array(baffle.lower), np.array(baffle.lower) + baffle.size
        inside = ((particles.positions[0] > lower) & (particles.positions[0] < upper)).all(axis=1)
        share = trajectory.scene.domain.cell / 2
        assert inside.sum() == pytest.approx(np.prod(baffle.size) / share**3, rel=0.2)


@pytest.mark.parametrize(
    ("material", "expected"),
    [
        (None, None),
        (FRICTION, FRICTION),
        (FRICTION.astype(np.float64)[:, None], FRICTION),
        (0.5, [0.5, 0.0, 0.5, 0.5, 0.0]),
        (np.float32(0.5), [0.5, 0.0, 0.5, 0.5, 0.0]),
        (np.array(0.5), [0.5, 0.0, 0.5, 0.5, 0.0]),
        (FRICTION[TYPES == 6], FRICTION),
        (FRICTION[TYPES == 6][:, None], FRICTION),
    ],
)
def test_material_properties(tmp_path: Path, material: Any, expected: Any) -> None:
    parts = (POSITIONS, TYPES) if material is None else (POSITIONS, TYPES, material)
    particles = only(stored(tmp_path / "train.npz", *parts))
    np.testing.assert_array_equal(particles.stationary, TYPES == ParticleType.STATIONARY)
    np.testing.assert_array_equal(particles.positions, POSITIONS)
    if expected is None:
        assert particles.friction is None
    else:
        np.testing.assert_array_equal(particles.friction, np.asarray(expected, np.float32))


def test_one_type_for_all(tmp_path: Path) -> None:
    assert not only(stored(tmp_path / "train.npz", POSITIONS, 6)).stationary.any()


def test_all_trajectories_in_one_array(tmp_path: Path) -> None:
    data = np.empty(3, dtype=object)
    for index in range(3):
        data[index] = (POSITIONS + index, 6, 0.5)
    np.savez_compressed(tmp_path / "train.npz", gns_data=data)
    assert geoelements.names(tmp_path / "train.npz") == ["00000", "00001", "00002"]
    found = list(geoelements.read(tmp_path / "train.npz", {"00000", "00002"}))
    assert [particles.name for particles in found] == ["00000", "00002"]
    np.testing.assert_array_equal(found[1].positions, POSITIONS + 2)


def test_a_table_of_trajectories(tmp_path: Path) -> None:
    table = np.empty((2, 2), dtype=object)
    for index in range(2):
        table[index, 0], table[index, 1] = POSITIONS, 6
    np.savez(tmp_path / "train.npz", gns_data=table)
    assert len(list(geoelements.read(tmp_path / "train.npz", {"00000", "00001"}))) == 2


@pytest.mark.parametrize(
    ("parts", "expected"),
    [
        ((POSITIONS,), "positions, particle types"),
        ((POSITIONS, TYPES, FRICTION, FRICTION), "positions, particle types"),
        ((POSITIONS.tolist(), TYPES), "positions as an array"),
        ((POSITIONS.astype(int), TYPES), "floating point"),
        ((POSITIONS[0], TYPES), "shape [T, N, 2 or 3]"),
        ((POSITIONS[:1], TYPES), "two frames"),
        ((np.where(POSITIONS > 0.5, np.nan, POSITIONS), TYPES), "positions within"),
        ((POSITIONS * 1e300, TYPES), "positions within"),
        ((POSITIONS, TYPES[:3]), "for each of 5"),
        ((POSITIONS, TYPES.astype(float)), "integers"),
        ((POSITIONS, np.array([6, 5, 6, 6, 3])), "types of [3, 6], got [3, 5, 6]"),
        ((POSITIONS, 3), "sand that moves"),
        ((POSITIONS, TYPES, np.ones((5, 2))), "one material property"),
        ((POSITIONS, TYPES, np.ones(4)), "one material property"),
        ((POSITIONS, TYPES, np.full(5, np.nan)), "a tan(phi)"),
        ((POSITIONS, TYPES, 1e300), "a tan(phi)"),
        ((POSITIONS, TYPES, 10**30), "a tan(phi)"),
        ((POSITIONS, 10**30), "types as integers"),
        ((POSITIONS, TYPES, np.array(["a"] * 5)), "found the dtype"),
    ],
)
def test_what_is_no_trajectory(tmp_path: Path, parts: tuple[Any, ...], expected: str) -> None:
    path = stored(tmp_path / "train.npz", *parts)
    with pytest.raises(InputError) as caught:
        only(path)
    assert expected in str(caught.value)
    assert caught.value.where == str(path)
    assert caught.value.key == "simulation_trajectory_0"


def test_the_name_that_means_all(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="gns_data"):
        geoelements.write(tmp_path / "train.npz", [cloud_of(toy(2), "gns_data")])
    assert list(tmp_path.iterdir()) == []


def test_a_failing_source_leaves_no_file(tmp_path: Path) -> None:
    def interrupted() -> Any:
        yield cloud_of(toy(2), "toy")
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        geoelements.write(tmp_path / "train.npz", interrupted())
    assert list(tmp_path.iterdir()) == []


def test_members_are_written_one_by_one(tmp_path: Path) -> None:
    """When the second trajectory is asked for, the first is in the file and no longer held."""
    import gc
    import weakref

    kept: list[weakref.ref[Cloud]] = []

    def trajectories() -> Any:
        for seed in range(3):
            gc.collect()
            assert [reference() for reference in kept[:-1]] == [None] * len(kept[:-1])
            particles = cloud_of(toy(2, seed), f"toy-{seed}")
            kept.append(weakref.ref(particles))
            yield particles
            del particles

    geoelements.write(tmp_path / "train.npz", trajectories())
    with zipfile.ZipFile(tmp_path / "train.npz") as archive:
        assert archive.testzip() is None
        assert len(archive.namelist()) == 3
