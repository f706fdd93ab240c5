"""The workers of a Dask scheduler: the same results as here, also when one of them is killed."""

import os
import signal
import time
from collections.abc import Iterator
from typing import Any

import pytest

from datasets.errors import InputError, WorkFailed
from mpm.cluster import Workers, connected

distributed = pytest.importorskip("distributed")


@pytest.fixture(scope="module")
def workers() -> Iterator[Any]:
    """Two workers on this machine, processes of their own."""
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=":0") as cluster:
        yield cluster


@pytest.fixture
def cluster(workers: Any) -> Iterator[Workers]:
    with connected(workers.scheduler_address) as connection:
        yield connection


def wait_and_name(number: float) -> tuple[float, int]:
    """Something that takes a moment, and who did it."""
    time.sleep(0.2 if number < 12.0 else number)
    return number, os.getpid()


@pytest.mark.slow
def test_tasks_of_a_killed_worker_are_made_by_others(cluster: Workers) -> None:
    numbers, first = {}, None
    for index, (number, process) in cluster.finished(wait_and_name, [(float(value),) for value in range(12)]):
        numbers[index] = number
        if first is None:
            first = process
            os.kill(first, signal.SIGKILL)
    assert numbers == {index: float(index) for index in range(12)}


@pytest.mark.parametrize(
    ("workers", "threads", "error", "said"),
    [(1, 2, InputError, "one thread each"), pytest.param(0, 1, WorkFailed, "no worker for", marks=pytest.mark.slow)],
)
def test_no_workers_and_workers_of_two_threads_are_refused(
    workers: int, threads: int, error: type[Exception], said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("mpm.cluster.PATIENCE", 0.5)
    settings = {"threads_per_worker": threads, "processes": False, "dashboard_address": ":0"}
    with (
        distributed.LocalCluster(n_workers=workers, **settings) as local,
        pytest.raises(error, match=said),
        connected(local.scheduler_address),
    ):
        pytest.fail("they are let in")
