"""In place of a pool of processes: its tasks run here, in turn, with the kernels that are compiled here."""

from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future
from contextlib import contextmanager
from typing import Any

from mpm.cluster import Workers


class Here(Executor):
    """Runs a task when it is handed out."""

    def submit(self, work: Callable[..., Any], /, *given: Any, **named: Any) -> "Future[Any]":
        future = Future[Any]()
        try:
            future.set_result(work(*given, **named))
        except Exception as error:
            future.set_exception(error)
        return future


@contextmanager
def pool(jobs: int) -> Iterator[Workers]:
    """As `mpm.cluster.pool`."""
    yield Workers(executor=Here(), width=lambda: jobs)
