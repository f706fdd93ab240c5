"""Tests in double precision run last: Taichi starts, and compiles every kernel, anew where the precision changes."""

import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from mpm import runtime

FOLDER = Path(__file__).parent


def precision(item: pytest.Item) -> int:
    """0 for single precision; 1 for double, by marker `double` or parameter `precision`; 2 for both, by its name."""
    parameters = getattr(item, "callspec", None)
    given = None if parameters is None else parameters.params.get("precision")
    if "single_precision" in item.name:
        return 2
    return int(given == "f64" or (given is None and item.get_closest_marker("double") is not None))


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Sort the tests of this folder, which stay where they are among those of others."""
    here = [index for index, item in enumerate(items) if FOLDER in item.path.parents]
    for index, item in zip(here, sorted((items[index] for index in here), key=precision), strict=True):
        items[index] = item


@pytest.fixture
def gpu(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Where there is no GPU, its kernels run on the CPU: with a thread per particle and atomic sums, as there."""
    if shutil.which("nvidia-smi") is None:
        monkeypatch.setitem(runtime.ARCHES, "cuda", runtime.ARCHES["cpu"])
    yield
    # What has started for a GPU that is not there is nobody else's.
    runtime._running = None
