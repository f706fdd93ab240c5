"""How long a training goes on: minutes of a clock, or a number of updates."""

import enum
import time
from dataclasses import dataclass

from datasets.errors import InputError


class Clock(enum.Enum):
    """What counts as time."""

    WALL = "wall"
    """Time that passes, whatever else the machine does."""
    CPU = "cpu"
    """Time that this process computes: fair between runs on a busy machine."""

    def now(self) -> float:
        """Seconds since some start."""
        return time.perf_counter() if self is Clock.WALL else time.process_time()


@dataclass(frozen=True, kw_only=True)
class Budget:
    """Minutes, or updates where they are given; learning rate and curriculum are laid over it.

    Minutes differ from machine to machine and from run to run; updates make a run that can be repeated to the bit.
    """

    minutes: float
    """Time to train [min], validations included."""
    updates: int | None = None
    """Updates to make instead."""

    def __post_init__(self) -> None:
        if not self.minutes > 0.0:
            raise InputError(f"expected a positive number, got {self.minutes}", key="minutes")
        if self.updates is not None and self.updates < 1:
            raise InputError(f"expected an integer of at least 1, got {self.updates}", key="updates")

    def progress(self, seconds: float, updates: int) -> float:
        """Share of the budget that is spent, in [0, 1], after so many seconds and updates."""
        spent = seconds / (60.0 * self.minutes) if self.updates is None else updates / self.updates
        return min(spent, 1.0)
