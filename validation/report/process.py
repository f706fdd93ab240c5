"""Work in a process of its own: memory that other work left behind does not count."""

from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import get_context
from typing import ParamSpec, TypeVar

from datasets.command_line import WorkFailed
from datasets.processes import end_with_parent

P = ParamSpec("P")
T = TypeVar("T")


def isolated(work: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> T:
    """`work(...)` in a new interpreter; what it raises is raised here. Raises WorkFailed."""
    with ProcessPoolExecutor(1, mp_context=get_context("spawn"), initializer=end_with_parent) as pool:
        try:
            return pool.submit(work, *args, **kwargs).result()
        except BrokenProcessPool:
            raise WorkFailed("killed, out of memory") from None
