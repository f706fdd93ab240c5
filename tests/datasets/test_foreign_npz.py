"""An NPZ of anybody's: read as numpy reads it where it holds arrays, one InputError where it holds anything else."""

import json
import os
import pickle
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from datasets.errors import InputError
from datasets.untrusted import archives
from datasets.untrusted.arrays import open_untrusted_npz
from tests.datasets.test_pickle_reading import Calls, same, trajectories


def everything(path: Path) -> dict[str, Any]:
    with open_untrusted_npz(path) as file:
        return {key: file.read(key, objects=True) for key in file.keys}


def refused(path: Path) -> InputError:
    with pytest.raises(InputError) as caught:
        everything(path)
    assert caught.value.where == str(path)
    assert "\n" not in str(caught.value)
    return caught.value


def with_member(path: Path, content: bytes, name: str = "data.npy", **options: Any) -> Path:
    with zipfile.ZipFile(path, "w", **options) as archive:
        archive.writestr(name, content)
    return path


def npy(header: str, content: bytes = b"", version: bytes = b"\1\0") -> bytes:
    size = len(header).to_bytes(2 if version == b"\1\0" else 4, "little")
    return b"\x93NUMPY" + version + size + header.encode() + content


@pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
def test_arrays_as_numpy_wrote_them(tmp_path: Path, save: Any) -> None:
    arrays = {
        "gns_data": trajectories(),
        "numbers": np.arange(12.0).reshape(3, 4),
        "turned": np.asfortranarray(np.arange(12).reshape(3, 4)),
        "none": np.zeros((0, 3), np.float32),
        "one": np.array(2.5),
        "true": np.array([True, False]),
    }
    save(tmp_path / "all.npz", **arrays)
    found = everything(tmp_path / "all.npz")
    assert list(found) == list(arrays)
    for key, array in arrays.items():
        same(found[key], array)
    with open_untrusted_npz(tmp_path / "all.npz") as file:
        assert {key: file.shape(key) for key in file.keys} == {key: array.shape for key, array in arrays.items()}


def test_a_pickle_is_refused_by_name_and_not_run(tmp_path: Path) -> None:
    mark = tmp_path / "mark"
    data = np.empty(1, dtype=object)
    data[0] = (np.zeros((2, 3, 2)), Calls(os.system, f"touch {mark}"))
    np.savez(tmp_path / "bad.npz", fine=np.arange(3), simulation_trajectory_0=data)
    error = refused(tmp_path / "bad.npz")
    assert error.key == "simulation_trajectory_0"
    assert f"{os.name}.system" in error.message
    assert not mark.exists()


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (b"", "whole NPZ"),
        (pickle.dumps(np.arange(3)), "whole NPZ"),
        (npy("{'descr': '<f8', 'fortran_order': False, 'shape': (2,), }", bytes(8)), "match its bytes"),
        (npy("{'descr': '<f8', 'fortran_order': False, 'shape': (1,), }", bytes(16)), "match its bytes"),
        (npy("{'descr': '<f8', 'fortran_order': False, 'shape': (999999999999999999,), }"), "shape"),
        (npy("{'descr': '<M8', 'fortran_order': False, 'shape': (1,), }", bytes(8)), "numbers"),
        (npy("{'descr': [('x', '|O')], 'fortran_order': False, 'shape': (1,), }"), "numbers"),
        (npy("{'descr': '<f8', 'fortran_order': False, 'shape': (__import__('os'),), }"), "whole NPZ"),
        (npy("(" * 5000), "whole NPZ"),
        (npy(" " * 20_000, version=b"\2\0"), "header"),
        (npy("{}", version=b"\4\0"), "numpy's format"),
        (b"\x93NUMPY\1\0\1", "whole NPZ"),
        (npy("{'descr': '|O', 'fortran_order': False, 'shape': (1,), }"), "whole NPZ"),
        (npy("{'descr': '|O', 'fortran_order': False, 'shape': (1,), }", pickle.dumps([1])), "announces"),
        (npy("{'descr': '|O', 'fortran_order': False, 'shape': (4,), }", pickle.dumps(trajectories(), 4)), "announces"),
        (
            npy("{'descr': '|O', 'fortran_order': False, 'shape': (3,), }", pickle.dumps(trajectories(), 4) + b"x"),
            "end",
        ),
    ],
)
def test_hostile_members(tmp_path: Path, content: bytes, expected: str) -> None:
    error = refused(with_member(tmp_path / "bad.npz", content))
    assert error.key == "data"
    assert expected in error.message


def test_members_that_are_no_arrays_or_come_twice(tmp_path: Path) -> None:
    assert "run.sh" in refused(with_member(tmp_path / "bad.npz", b"", name="run.sh")).key
    nothing = npy("{'descr': '<f8', 'fortran_order': False, 'shape': (0,), }")
    with zipfile.ZipFile(tmp_path / "twice.npz", "w") as archive:
        archive.writestr("data.npy", nothing)
        with pytest.warns(UserWarning, match="Duplicate"):
            archive.writestr("data.npy", nothing)
    assert "each member once" in refused(tmp_path / "twice.npz").message


def test_what_swells(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    np.savez_compressed(tmp_path / "bomb.npz", zeros=np.zeros(1_000_000))
    assert (tmp_path / "bomb.npz").stat().st_size < 20_000
    monkeypatch.setattr(archives, "LARGEST", 2**20)
    assert "at most 1 MiB" in refused(tmp_path / "bomb.npz").message


def test_other_compression(tmp_path: Path) -> None:
    path = with_member(tmp_path / "bad.npz", b"", compression=zipfile.ZIP_LZMA)
    assert "deflated" in refused(path).message


@pytest.mark.parametrize("content", [b"", b"x, y\n1, 2\n", pickle.dumps(1)])
def test_what_is_no_archive(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "file.npz").write_bytes(content)
    assert "whole NPZ" in refused(tmp_path / "file.npz").message


def test_no_file_and_a_folder(tmp_path: Path) -> None:
    assert "there is none" in refused(tmp_path / "absent.npz").message
    (tmp_path / "folder.npz").mkdir()
    refused(tmp_path / "folder.npz")


@pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
def test_random_damage_is_an_input_error_or_none(tmp_path: Path, save: Any) -> None:
    """Bytes of the file changed, cut and doubled: each time the arrays come back, or one InputError does."""
    path = tmp_path / "data.npz"
    save(path, gns_data=trajectories(), numbers=np.arange(5.0))
    damage(path, stream=np.random.default_rng(1), whole=path.read_bytes())


def test_random_damage_under_a_right_checksum(tmp_path: Path) -> None:
    """The same inside the pickle, with the checksum of the damaged bytes: the opcodes themselves are what is read."""
    path = tmp_path / "data.npz"
    np.savez(path, gns_data=trajectories())
    with zipfile.ZipFile(path) as archive:
        content = archive.read("gns_data.npy")
    stream = np.random.default_rng(2)
    outcomes = []
    for _ in range(150):
        outcomes.append(outcome(with_member(path, damaged(stream, content), "gns_data.npy")))
    assert outcomes.count("InputError") > 40


def damage(path: Path, *, stream: np.random.Generator, whole: bytes) -> None:
    outcomes = []
    for _ in range(80):
        path.write_bytes(damaged(stream, whole))
        outcomes.append(outcome(path))
    assert outcomes.count("InputError") > 20


def damaged(stream: np.random.Generator, content: bytes) -> bytes:
    changed = bytearray(content)
    for _ in range(int(stream.integers(1, 4))):
        index = int(stream.integers(len(changed)))
        match int(stream.integers(4)):
            case 0:
                changed[index] = int(stream.integers(256))
            case 1:
                changed[index] ^= 1 << int(stream.integers(8))
            case 2:
                del changed[index : index + int(stream.integers(1, 20))]
            case _:
                changed[index:index] = changed[index : index + int(stream.integers(1, 20))]
    return bytes(changed)


def outcome(path: Path) -> str:
    try:
        everything(path)
    except InputError as error:
        json.dumps(str(error))
        return "InputError"
    return "arrays"
