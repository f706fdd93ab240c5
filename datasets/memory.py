"""Memory: the free amount, an error in one line if more is needed, and the return of freed memory."""

import ctypes
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import ParamSpec, TypeVar

import psutil

from datasets.errors import InputError

GROUP = Path("/sys/fs/cgroup")  # of a container under Linux, whose limit may be below what the machine has
USABLE = 0.9  # usable share of the free memory
TRIM_EVERY = 16
"""Calls between two trims of `trimming`: more frequent ones cost time, less frequent ones leave twice the memory."""

P = ParamSpec("P")
R = TypeVar("R")


def free() -> int:
    """Memory that this process may still use [bytes], within the limits of machine, container and process."""
    limits: list[int] = [psutil.virtual_memory().available]
    with suppress(OSError, ValueError):  # no container, or one without a limit
        most, used = (int((GROUP / f"memory.{name}").read_text()) for name in ("max", "current"))
        limits.append(most - used)
    if hasattr(psutil, "RLIMIT_AS"):
        process = psutil.Process()
        limit = process.rlimit(psutil.RLIMIT_AS)[0]
        if limit != psutil.RLIM_INFINITY:
            limits.append(limit - process.memory_info().vms)
    return max(0, min(limits))


def require(size: float, what: str, instead: str, *, key: str = "") -> None:
    """Raise InputError, with the purpose `what` and the remedy `instead`, if `size` [bytes] exceeds the free memory."""
    room = USABLE * free()
    if not size <= room:
        expected = f"expected {what} in the {spoken(room)} of memory that are free"
        raise InputError(f"{expected}, got {spoken(size)}: {instead}", key=key)


def spoken(size: float) -> str:
    """A size with a suitable unit: `350 MiB`, `1.2 TiB`."""
    for unit in ("B", "KiB", "MiB", "GiB", "TiB"):
        if size < 1000:
            return f"{size:.3g} {unit}"
        size /= 1024
    return f"{size:.3g} PiB"


def trimming(step: Callable[P, R]) -> Callable[P, R]:
    """`step`, which returns freed memory that glibc keeps to the system after every `TRIM_EVERY` calls."""
    try:
        trim = ctypes.CDLL(None).malloc_trim
    except (AttributeError, OSError, TypeError):
        return step  # another C library, which may not need it
    calls = 0

    def called(*args: P.args, **kwargs: P.kwargs) -> R:
        nonlocal calls
        calls += 1
        if calls % TRIM_EVERY == 0:
            trim(0)
        return step(*args, **kwargs)

    return called
