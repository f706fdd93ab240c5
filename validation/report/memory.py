"""How much memory a piece of work takes at its peak."""

import ctypes
import gc
import re
import resource
from collections.abc import Callable
from pathlib import Path

STATUS = Path("/proc/self/status")
CLEAR = Path("/proc/self/clear_refs")
RESET_PEAK = "5"
"""Written there, it begins the record of the peak anew."""


def resident() -> int | None:
    """Memory that this process holds now [bytes], where Linux records it."""
    return status_bytes("VmRSS")


def peak() -> int:
    """The most memory that this process ever held, or held since `reset_peak` [bytes].

    Elsewhere than on Linux it is taken from getrusage, which a process begins with the peak of the one that began it.
    """
    return status_bytes("VmHWM") or resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


def status_bytes(key: str) -> int | None:
    """A size in Linux's description of this process [bytes]."""
    if not STATUS.exists():
        return None
    found = re.search(rf"^{key}:\s+(\d+) kB$", STATUS.read_text(encoding="utf-8"), re.MULTILINE)
    return int(found[1]) * 1024 if found else None


def reset_peak() -> bool:
    """Give back what is free and begin the record of the peak anew; whether the system could."""
    gc.collect()
    try:
        # Free memory that the process keeps would hide the same amount in use later.
        ctypes.CDLL(None).malloc_trim(0)
        CLEAR.write_text(RESET_PEAK, encoding="utf-8")
    except (AttributeError, OSError):
        return False
    return True


def extra(work: Callable[[], object]) -> int | None:
    """The most memory that `work` took above what the process held before [bytes], where the system records it."""
    before = resident() if reset_peak() else None
    work()
    return None if before is None else max(0, peak() - before)
