"""Ctrl-C and SIGTERM without half an update: training stops after the update in progress."""

import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

from datasets.command_line import Terminated

REPEAT = 3.0
"""A signal more than this [s] after the first is a second one; before, it is the same, forwarded by torchrun."""


class Stop:
    """Records a signal. Within `at_once`, or when it is repeated, it is a KeyboardInterrupt as usual."""

    SIGNALS = (signal.SIGINT, signal.SIGTERM)

    def __init__(self) -> None:
        self._at_once = False
        self._received: float | None = None
        self._number = signal.SIGINT

    @property
    def requested(self) -> bool:
        """Whether there was a signal."""
        return self._received is not None

    @property
    def interrupt(self) -> KeyboardInterrupt:
        """What to raise for the signal."""
        return Terminated() if self._number == signal.SIGTERM else KeyboardInterrupt()

    def _record(self, number: int, frame: FrameType | None) -> None:
        now = time.monotonic()
        if self._received is None:
            self._received, self._number = now, signal.Signals(number)
        if self._at_once or now - self._received > REPEAT:
            raise self.interrupt

    @contextmanager
    def watching(self) -> Iterator["Stop"]:
        """Handle the signals in this block."""
        before = {number: signal.signal(number, self._record) for number in self.SIGNALS}
        try:
            yield self
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)

    @contextmanager
    def at_once(self) -> Iterator[None]:
        """A block that may be broken off anywhere: what it would lose is saved."""
        if self.requested:
            raise self.interrupt
        self._at_once = True
        try:
            yield
        finally:
            self._at_once = False
