"""Processes: their number, how they are stopped, and how they end with the process that started them."""

import ctypes
import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing import parent_process
from multiprocessing.connection import wait
from types import FrameType
from typing import Any

import psutil

SIGNALS = (signal.SIGINT, signal.SIGTERM)
REPEAT = 1.0
"""A signal later than this [s] after the first is a second one; earlier, it is the same one, repeated by torchrun."""
PR_SET_PDEATHSIG = 1  # of Linux's prctl(2): the signal that a process gets when its parent ends


class Terminated(KeyboardInterrupt):
    """SIGTERM, which ends a command like Ctrl-C."""


class Stop:
    """True once one of SIGNALS has arrived. A second one, or one within `at_once`, raises KeyboardInterrupt."""

    def __init__(self) -> None:
        self.signal: signal.Signals | None = None
        self.since = 0.0
        self.breaks = False

    def __call__(self) -> bool:
        return self.signal is not None

    @property
    def status(self) -> int:
        """The exit status that a shell reports for the signal: 130 after Ctrl-C, 143 after SIGTERM."""
        return 0 if self.signal is None else 128 + self.signal

    @property
    def interrupt(self) -> KeyboardInterrupt:
        """The exception for the signal."""
        return Terminated() if self.signal == signal.SIGTERM else KeyboardInterrupt()

    def record(self, number: int, _: FrameType | None) -> None:
        """Handle a signal."""
        now = time.monotonic()
        if self.signal is None:
            self.signal, self.since = signal.Signals(number), now
        if self.breaks or now - self.since > REPEAT:
            raise self.interrupt

    @contextmanager
    def at_once(self) -> Iterator[None]:
        """A block that may be interrupted anywhere, because nothing in it can be lost."""
        if self():
            raise self.interrupt
        self.breaks = True
        try:
            yield
        finally:
            self.breaks = False


@contextmanager
def stopping() -> Iterator[Stop]:
    """In this context, a first Ctrl-C or SIGTERM only requests a stop, so that work ends at a consistent point."""
    stop = Stop()
    former = {number: signal.signal(number, stop.record) for number in SIGNALS}
    try:
        yield stop
    finally:
        for number, handler in former.items():
            signal.signal(number, handler)


@contextmanager
def terminable() -> Iterator[None]:
    """In this context, SIGTERM raises Terminated, unless it has another handler or this is not the main thread."""

    def terminate(number: int, _: FrameType | None) -> None:
        raise Terminated

    if threading.current_thread() is not threading.main_thread() or signal.getsignal(signal.SIGTERM) != signal.SIG_DFL:
        yield
        return
    signal.signal(signal.SIGTERM, terminate)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)


def processors() -> int:
    """Number of processors that this process may use."""
    process = psutil.Process()
    return len(process.cpu_affinity()) if hasattr(process, "cpu_affinity") else psutil.cpu_count() or 1


def end_with_parent() -> None:
    """End this process as soon as its parent has ended, even by SIGKILL. On Linux the kernel does so; if
    multiprocessing started it, a thread also watches the pipe to the parent."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    parent = parent_process()
    if parent is not None:
        threading.Thread(target=lambda: wait([parent.sentinel]) and os._exit(1), daemon=True).start()


@contextmanager
def without_main() -> Iterator[None]:
    """In this context, started processes do not run the user's script again, so that it needs no guard. A module
    started by `python -m` has a guard, and processes find its functions there."""
    main: Any = sys.modules["__main__"]
    file = getattr(main, "__file__", None) if getattr(main, "__spec__", None) is None else None
    if file is not None:
        del main.__file__
    try:
        yield
    finally:
        if file is not None:
            main.__file__ = file
