"""Processes that end with the one that started them, however that ends."""

import ctypes
import os
import signal
import sys
import threading
import time
from multiprocessing import parent_process
from multiprocessing.connection import wait

PARENT = "TALUS_PARENT"
"""Environment variable: a command ends with the process of this number if that has started it."""
PR_SET_PDEATHSIG = 1
"""Of Linux's prctl(2): the signal that a process gets when its parent ends."""
POLL = 0.5
"""Seconds between two looks at the parent's number."""


def end_with_parent() -> None:
    """End this process at once when the process that started it has ended, even by SIGKILL.

    On Linux by the kernel. Elsewhere, and where the parent has ended before, by a thread that watches the pipe which
    multiprocessing keeps to the parent, or the parent's number.
    """
    parent = os.getppid()
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    threading.Thread(target=_watch, args=(parent,), name="parent", daemon=True).start()


def parent_environment() -> dict[str, str]:
    """The environment of a command that is to end with this process."""
    return {**os.environ, PARENT: str(os.getpid())}


def end_with_stated_parent() -> None:
    """`end_with_parent` where the environment says that the present parent asks for it."""
    if os.environ.get(PARENT) == str(os.getppid()):
        end_with_parent()


def _watch(parent: int) -> None:
    started_by = parent_process()
    if started_by is not None:
        wait([started_by.sentinel])
    else:
        while os.getppid() == parent:
            time.sleep(POLL)
    os._exit(1)
