"""The peak of the memory of a piece of work."""

import ctypes
import gc
import re
import resource
from collections.abc import Callable
from pathlib import Path

STATUS = Path("/proc/self/status")
CLEAR = Path("/proc/self/clear_refs")
FORGET_PEAK = "5"
"""Written to `CLEAR`, it resets the peak that Linux records."""


def resident() -> int | None:
    """Resident memory of this process now [bytes]; None elsewhere than on Linux."""
    return status_field("VmRSS")


def peak() -> int:
    """The most memory that this process ever held, or held since `forgotten` [bytes].

    Elsewhere than on Linux it is that of getrusage, which starts from the peak of the parent process.
    """
    return status_field("VmHWM") or resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


def status_field(key: str) -> int | None:
    """A size from Linux's description of this process [bytes]."""
    if not STATUS.exists():
        return None
    found = re.search(rf"^{key}:\s+(\d+) kB$", STATUS.read_text(encoding="utf-8"), re.MULTILINE)
    return int(found[1]) * 1024 if found else None


def forgotten() -> bool:
    """Give back what is free and begin the record of the peak anew; whether the system could."""
    gc.collect()
    try:
        # Free memory that stays with the process would not count when it is used again.
        ctypes.CDLL(None).malloc_trim(0)
        CLEAR.write_text(FORGET_PEAK, encoding="utf-8")
    except (AttributeError, OSError):
        return False
    return True


def extra(work: Callable[[], object]) -> int | None:
    """Peak memory during `work` above what was resident before [bytes]; None where the system does not record it."""
    before = resident() if forgotten() else None
    work()
    return None if before is None else max(0, peak() - before)
