"""The cache of compiled kernels, which a killed process must not close for good."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from mpm.runtime import STALE, drop_stale_lock

RUN = """
from mpm import runtime
runtime.start("f32", 1)
"""


@pytest.mark.parametrize(("age", "there"), [(2.0 * STALE, False), (0.0, True)])
def test_a_lock_that_a_killed_run_left_is_removed(tmp_path: Path, age: float, there: bool) -> None:
    lock = tmp_path / "ticache.lock"
    lock.touch()
    os.utime(lock, (lock.stat().st_mtime - age,) * 2)
    drop_stale_lock(lock)
    assert lock.exists() is there
    drop_stale_lock(tmp_path / "none")


def test_a_run_opens_the_cache_again(tmp_path: Path) -> None:
    lock = tmp_path / "ticache.lock"
    lock.touch()
    os.utime(lock, (1.0, 1.0))
    environment = os.environ | {"TI_OFFLINE_CACHE_FILE_PATH": str(tmp_path)}
    subprocess.run([sys.executable, "-c", RUN], env=environment, check=True)
    assert not lock.exists()
