"""An NPZ or HDF5 of anybody's: read as its library reads it where it holds arrays, else one line; nothing is run."""

import os
import pickle
import zipfile
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from datasets.arrays import open_hdf5, open_npz, read_array
from datasets.errors import InputError


class Calls:
    """Pickles as a call of `function`."""

    def __init__(self, function: Any, *arguments: Any) -> None:
        self.made = (function, arguments)

    def __reduce__(self) -> Any:
        return self.made


def trajectories() -> np.ndarray[Any, Any]:
    """Two trajectories as other codes pickle them: positions, types, a number of NumPy's."""
    found = np.empty(2, dtype=object)
    for index, shape in enumerate(((4, 3, 2), (2, 5, 3))):
        positions = np.arange(np.prod(shape), dtype=np.float32).reshape(shape)
        found[index] = (positions, np.full(shape[1], 6), np.float64(0.5))
    return found


def everything(path: Path) -> dict[str, Any]:
    with open_npz(path) as file:
        return {key: file.read(key, objects=True) for key in file.keys}


def with_member(path: Path, content: bytes) -> Path:
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("data.npy", content)
    return path


def npy(header: str, content: bytes = b"") -> bytes:
    return b"\x93NUMPY\1\0" + len(header).to_bytes(2, "little") + header.encode() + content


@pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
def test_arrays_as_numpy_wrote_them(tmp_path: Path, save: Any) -> None:
    arrays = {
        "numbers": np.arange(12.0).reshape(3, 4),
        "turned": np.asfortranarray(np.arange(12).reshape(3, 4)),
        "none": np.zeros((0, 3), np.float32),
        "one": np.array(2.5),
        "text": np.array("sand"),
    }
    save(tmp_path / "all.npz", **arrays)
    found = everything(tmp_path / "all.npz")
    assert list(found) == list(arrays)
    for key, array in arrays.items():
        np.testing.assert_array_equal(found[key], array, strict=True)
    with open_npz(tmp_path / "all.npz") as file:
        assert {key: file.shape(key) for key in file.keys} == {key: array.shape for key, array in arrays.items()}


@pytest.mark.parametrize("older", [False, True])
def test_pickled_trajectories(tmp_path: Path, older: bool) -> None:
    data = trajectories()
    content = npy("{'descr': '|O', 'fortran_order': False, 'shape': (2,), }", pickle.dumps(data, 2 if older else 4))
    if older:
        content = content.replace(b"numpy._core.", b"numpy.core.")
    for expected, found in zip(data, everything(with_member(tmp_path / "data.npz", content))["data"], strict=True):
        for one, other in zip(expected, found, strict=True):
            np.testing.assert_array_equal(one, other)
            assert one.dtype == other.dtype


def test_a_pickle_is_refused_by_name_and_not_run(tmp_path: Path) -> None:
    mark = tmp_path / "mark"
    data = np.empty(1, dtype=object)
    data[0] = (np.zeros((2, 3, 2)), Calls(os.system, f"touch {mark}"))
    np.savez(tmp_path / "bad.npz", fine=np.arange(3), flow=data)
    with pytest.raises(InputError, match=rf"bad.npz: flow: expected arrays .* '{os.name}.system'"):
        everything(tmp_path / "bad.npz")
    assert not mark.exists()


TERABYTES = "{'descr': '<f8', 'fortran_order': False, 'shape': (999999999999,), }"
OBJECTS = "{'descr': '|O', 'fortran_order': False, 'shape': (1,), }"


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (b"", "whole NPZ"),
        (npy(TERABYTES, bytes(8)), "as large as its bytes"),
        (npy(TERABYTES.replace("999999999999", "1"), bytes(16)), "as large as its bytes"),
        (npy("{'descr': '<f8', 'fortran_order': False, 'shape': (__import__('os'),), }"), "whole NPZ"),
        (npy("(" * 5000), "whole NPZ"),
        (npy(OBJECTS), "whole NPZ"),
        (npy(OBJECTS, pickle.dumps([1, 2])), "of the shape that its header states"),
        (npy(OBJECTS, pickle.dumps(Calls(np.dtype, "V9", False, True))), "the dtype 'V9'"),
        (npy(OBJECTS, b"\x80\x04Nr\xff\xff\xff\x7f."), "more values than bytes"),
        (npy(OBJECTS, pickle.dumps(np.arange(3)).replace(b"K\x03\x85", b"J\xff\xff\xff\x7f\x85")), "match its content"),
    ],
)
def test_hostile_members(tmp_path: Path, content: bytes, expected: str) -> None:
    with pytest.raises(InputError) as caught:
        everything(with_member(tmp_path / "bad.npz", content))
    assert (caught.value.where, caught.value.key) == (str(tmp_path / "bad.npz"), "data")
    assert expected in caught.value.message


def test_hdf5_of_numbers_in_the_file_itself(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file["secret"] = np.arange(3)
    with h5py.File(tmp_path / "data.h5", "w") as file:
        file["fine/numbers"] = np.arange(3)
        file["text"] = "sand"
        file["elsewhere"] = h5py.ExternalLink("other.h5", "secret")
        file.create_dataset("endless", (2**45,), np.float64, chunks=(2**10,))
    with open_hdf5(tmp_path / "data.h5") as file:
        assert read_array(file, "fine/numbers").tolist() == [0, 1, 2]
        for key in ("absent", "fine", "text", "elsewhere", "endless"):
            with pytest.raises(InputError, match=f"data.h5: {key}: expected an array"):
                read_array(file, key)
    with (
        pytest.raises(InputError, match=r"other\.npz: expected an HDF5 file, there is none"),
        open_hdf5(tmp_path / "other.npz"),
    ):
        pass
