"""Ctrl-C and SIGTERM without half an update: the signal is noted, and the training stops where its state is whole."""

import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

PATIENCE = 3.0
"""A signal more than this [s] after the first is another; before, it is the same: torchrun hands on the terminal's."""


class Stop:
    """Notes a signal. While `at_once`, or if it comes again, it is a KeyboardInterrupt as usual."""

    SIGNALS = (signal.SIGINT, signal.SIGTERM)

    def __init__(self) -> None:
        self._at_once = False
        self._noted: float | None = None

    @property
    def asked(self) -> bool:
        """Whether there was a signal."""
        return self._noted is not None

    def _note(self, number: int, frame: FrameType | None) -> None:
        now = time.monotonic()
        if self._noted is None:
            self._noted = now
        if self._at_once or now - self._noted > PATIENCE:
            raise KeyboardInterrupt

    @contextmanager
    def watching(self) -> Iterator["Stop"]:
        """Handle the signals in this block."""
        before = {number: signal.signal(number, self._note) for number in self.SIGNALS}
        try:
            yield self
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)

    @contextmanager
    def at_once(self) -> Iterator[None]:
        """A block that may be broken off anywhere: what it would lose is saved."""
        if self.asked:
            raise KeyboardInterrupt
        self._at_once = True
        try:
            yield
        finally:
            self._at_once = False
