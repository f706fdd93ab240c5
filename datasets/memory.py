"""What a piece of work may take: the memory that this machine has free, and one line where more is asked for."""

import os
import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from datasets.errors import InputError

if sys.platform != "win32":
    import resource

MEMINFO = Path("/proc/meminfo")
STATUS = Path("/proc/self/statm")
GROUP = Path("/sys/fs/cgroup")
"""Of a container under Linux, whose limit may be below what the machine has."""
USABLE = 0.9
"""Part of the free memory that is given away."""


def free() -> int:
    """Memory that this process may still take [bytes]: what the machine, its container and its own limit leave."""
    found = [whole()]
    if MEMINFO.exists():
        available = re.search(r"^MemAvailable:\s+(\d+) kB$", MEMINFO.read_text(encoding="utf-8"), re.MULTILINE)
        found += [1024 * int(available[1])] if available else []
    most, used = (read_number(GROUP / f"memory.{name}") for name in ("max", "current"))
    if most is not None and used is not None:
        found.append(most - used)
    if sys.platform == "linux":
        limit = resource.getrlimit(resource.RLIMIT_AS)[0]
        if limit != resource.RLIM_INFINITY:
            found.append(limit - address_space())
    return max(0, min(found))


def whole() -> int:
    """The memory of the machine [bytes]; 2^62 where it does not say."""
    names = getattr(os, "sysconf_names", {})
    if "SC_PHYS_PAGES" not in names:
        return 2**62
    return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")


def address_space() -> int:
    """Addresses that this process uses [bytes]; Linux alone."""
    return int(STATUS.read_text(encoding="utf-8").split()[0]) * os.sysconf("SC_PAGE_SIZE")


def read_number(path: Path) -> int | None:
    """The number in a file of the system; None where there is none."""
    try:
        return int(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None


def require(size: float, what: str, instead: str, *, key: str = "", where: str = "") -> None:
    """Raise InputError where `size` [bytes] is more than is free: the number, what it is for, what to change."""
    room = USABLE * free()
    if not size <= room:
        raise InputError(
            f"expected {what} in the {spoken(room)} of memory that are free, got {spoken(size)}: {instead}",
            key=key,
            where=where,
        )


@contextmanager
def at_most(extra: int) -> Iterator[None]:
    """While this lasts, the process gets no more than `extra` bytes: beyond them a MemoryError. Linux alone.

    For libraries that allocate what a file says, where nothing else runs beside them.
    """
    if sys.platform != "linux":
        yield
        return
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    limit = address_space() + extra
    if soft != resource.RLIM_INFINITY:
        limit = min(limit, soft)
    resource.setrlimit(resource.RLIMIT_AS, (limit, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))


def spoken(size: float) -> str:
    """A size in the unit in which it is short: `350 MiB`, `1.2 TiB`."""
    for unit, limit in (("B", 2**10), ("KiB", 2**20), ("MiB", 2**30), ("GiB", 2**40), ("TiB", 2**50)):
        if size < 1000 * limit / 1024:
            return f"{size * 1024 / limit:.3g} {unit}"
    return f"{size / 2**50:.3g} PiB"
