"""LagrangeBench HDF5: groups and types as their reader takes them; links out of the file and broken files refused."""

from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from datasets.errors import InputError
from datasets.exchange import lagrangebench
from datasets.exchange.cloud import Cloud, cloud_of
from tests.datasets.toys import toy

POSITIONS = np.random.default_rng(0).random((4, 5, 2)).astype(np.float32)
TYPES = np.array([0, 1, 0, 0, 1], np.int32)


def stored(path: Path, **arrays: Any) -> Path:
    with h5py.File(path, "w") as file:
        for name, array in arrays.items():
            file[f"00000/{name}"] = array
    return path


def only(path: Path) -> Cloud:
    (name,) = lagrangebench.names(path)
    (particles,) = lagrangebench.read(path, {name})
    return particles


@pytest.mark.parametrize("dimension", [2, 3])
def test_written_as_their_reader_takes_it(tmp_path: Path, dimension: int) -> None:
    written = [cloud_of(toy(dimension, seed), f"toy-{seed}") for seed in range(2)]
    lagrangebench.write(tmp_path / "train.h5", written)
    with h5py.File(tmp_path / "train.h5") as file:
        assert list(file) == ["00000", "00001"]
        for name, particles in zip(file, written, strict=True):
            assert file[f"{name}/position"].dtype == np.float32
            np.testing.assert_array_equal(file[f"{name}/position"][1:3], particles.positions[1:3])
            np.testing.assert_array_equal(file[f"{name}/particle_type"][:], particles.stationary.astype(int))
            np.testing.assert_array_equal(file[f"{name}/material_property"][:], particles.friction)


def test_round_trip(tmp_path: Path) -> None:
    written = cloud_of(toy(3), "toy")
    lagrangebench.write(tmp_path / "train.h5", [written])
    again = only(tmp_path / "train.h5")
    np.testing.assert_array_equal(again.positions, written.positions)
    np.testing.assert_array_equal(again.stationary, written.stationary)
    np.testing.assert_array_equal(again.friction, written.friction)


def test_the_bytes_depend_on_the_trajectories_alone(tmp_path: Path) -> None:
    for name in ("a.h5", "b.h5"):
        lagrangebench.write(tmp_path / name, [cloud_of(toy(2), "toy")])
    assert (tmp_path / "a.h5").read_bytes() == (tmp_path / "b.h5").read_bytes()


def test_a_set_without_material(tmp_path: Path) -> None:
    particles = only(stored(tmp_path / "train.h5", position=POSITIONS, particle_type=TYPES))
    assert particles.friction is None
    np.testing.assert_array_equal(particles.stationary, TYPES == 1)


def test_the_numbers_of_the_original_sets(tmp_path: Path) -> None:
    types = np.where(TYPES == 1, 3, 6)
    particles = only(stored(tmp_path / "train.h5", position=POSITIONS, particle_type=types))
    np.testing.assert_array_equal(particles.stationary, TYPES == 1)


def test_some_of_many(tmp_path: Path) -> None:
    lagrangebench.write(tmp_path / "train.h5", [cloud_of(toy(2, seed), "toy") for seed in range(3)])
    assert [particles.name for particles in lagrangebench.read(tmp_path / "train.h5", {"00002"})] == ["00002"]


def refused(path: Path) -> InputError:
    with pytest.raises(InputError) as caught:
        only(path)
    assert caught.value.where == str(path)
    assert "\n" not in str(caught.value)
    return caught.value


@pytest.mark.parametrize(
    ("arrays", "expected"),
    [
        ({"particle_type": TYPES}, "an array of numbers in the file"),
        ({"position": POSITIONS}, "an array of numbers in the file"),
        ({"position": POSITIONS, "particle_type": [0, 2, 0, 0, 0]}, "types of [0, 1]"),
        ({"position": POSITIONS, "particle_type": [0, 3, 0, 0, 0]}, "types of [0, 1]"),
        ({"position": POSITIONS, "particle_type": [b"a"] * 5}, "array of numbers"),
        ({"position/more": POSITIONS, "particle_type": TYPES}, "array of numbers"),
    ],
)
def test_what_is_no_trajectory(tmp_path: Path, arrays: dict[str, Any], expected: str) -> None:
    assert expected in str(refused(stored(tmp_path / "train.h5", **arrays)))


def test_links_out_of_the_file(tmp_path: Path) -> None:
    stored(tmp_path / "other.h5", position=POSITIONS)
    path = stored(tmp_path / "train.h5", particle_type=TYPES)
    with h5py.File(path, "a") as file:
        file["00000/position"] = h5py.ExternalLink("other.h5", "00000/position")
    assert "an array of numbers in the file" in refused(path).message
    (tmp_path / "secret").write_bytes(bytes(160))
    with h5py.File(path, "a") as file:
        del file["00000/position"]
        file.create_dataset(
            "00000/position", (4, 5, 2), np.float32, external=[(str(tmp_path / "secret"), 0, h5py.h5f.UNLIMITED)]
        )
    assert "in the file" in refused(path).message


def test_a_group_elsewhere(tmp_path: Path) -> None:
    stored(tmp_path / "other.h5", position=POSITIONS, particle_type=TYPES)
    with h5py.File(tmp_path / "train.h5", "w") as file:
        file["00000"] = h5py.ExternalLink("other.h5", "00000")
    assert "an array of numbers in the file" in refused(tmp_path / "train.h5").message


def test_what_swells(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "train.h5", "w") as file:
        file.create_dataset("00000/position", (10**6, 10**4, 3), np.float32, chunks=(1, 10**4, 3))
        file["00000/particle_type"] = TYPES
    assert "GiB" in refused(tmp_path / "train.h5").message


def test_broken_files(tmp_path: Path) -> None:
    path = stored(tmp_path / "train.h5", position=POSITIONS, particle_type=TYPES)
    content = path.read_bytes()
    for length in (0, 100, len(content) // 2):
        path.write_bytes(content[:length])
        assert "whole HDF5" in refused(path).message
    assert "there is none" in refused(tmp_path / "absent.h5").message
