"""HDF5 of anybody's: arrays of numbers in the file itself, as large as their bytes in it.

HDF5 could as well point to another file of this machine, read through a filter of its own, or fill a terabyte with the
number that stands for what was never written.
"""

import math
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from datasets import memory
from datasets.errors import InputError
from datasets.untrusted.archives import LARGEST, MOST_RATIO, SMALL
from datasets.untrusted.files import file_size, reading

FILTERS = {h5py.h5z.FILTER_DEFLATE, h5py.h5z.FILTER_SHUFFLE, h5py.h5z.FILTER_FLETCHER32}
LARGEST_CHUNK = 2**30
"""Bytes that a filter may give at once."""
WHAT = "a whole HDF5 file"


@contextmanager
def open_hdf5(path: Path) -> Iterator[h5py.File]:
    """Open an HDF5 file. Raises InputError, which names it."""
    file_size(path, "an HDF5 file")
    with reading(path, WHAT):
        file = h5py.File(path, "r", locking=False)
    with file:
        yield file


def read_array(file: h5py.File, key: str, *, ratio: float = MOST_RATIO) -> NDArray[Any]:
    """One array of numbers of the file itself, at most `ratio` times its bytes there.

    Raises InputError, which names the file.
    """
    path = Path(file.filename)
    with reading(path, WHAT, key):
        array = plain_array(file, key)
        check_size(array, path.stat().st_size, key, ratio)
        return np.asarray(array[()])


def plain_array(file: h5py.File, key: str) -> h5py.Dataset:
    """An array of numbers of the file itself, unread. Raises InputError, which names the file."""
    with reading(Path(file.filename), WHAT, key):
        parts = key.split("/")
        links = [file["/".join(parts[:depth]) or "/"].get(part, getlink=True) for depth, part in enumerate(parts)]
        if not all(isinstance(link, h5py.HardLink) for link in links):
            raise InputError("expected an array in the file, found none", key=key)
        array = file[key]
        if not isinstance(array, h5py.Dataset) or array.external or array.is_virtual or array.dtype.kind not in "biuf":
            raise InputError("expected an array of numbers in the file", key=key)
        return array


def check_size(array: h5py.Dataset, whole: int, key: str, ratio: float) -> None:
    """Raise InputError for an array that swells to more than its bytes in a file of `whole` bytes could be."""
    size, stored = math.prod(array.shape) * array.dtype.itemsize, array.id.get_storage_size()
    if size > LARGEST or size > max(SMALL, ratio * min(stored, whole)):
        got = f"{memory.spoken(stored)} that swell to {memory.spoken(size)}"
        raise InputError(f"expected an array of at most {ratio:g} times its bytes in the file, got {got}", key=key)
    plan = array.id.get_create_plist()
    filters = {plan.get_filter(index)[0] for index in range(plan.get_nfilters())}
    if filters - FILTERS:
        raise InputError("expected an array that is plain or compressed by deflate", key=key)
    if array.chunks and math.prod(array.chunks) * array.dtype.itemsize > LARGEST_CHUNK:
        raise InputError(f"expected chunks of at most {memory.spoken(LARGEST_CHUNK)}", key=key)
    memory.require(size, "an array", "it must fit into memory", key=key)
