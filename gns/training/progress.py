"""The progress bar of a training, with an honest estimate of the time left."""

import time
from collections import deque
from collections.abc import Sequence

import numpy as np
from tqdm import tqdm

from gns.training.budget import Budget
from gns.training.objective import remaining_steps

RECENT = 100
"""Updates over which the shown loss and rate are means."""


class Bar:
    """Shows the share of the budget that is spent.

    The time left is work left times wall time per work, validations included. Work is the budget's own: seconds of its
    clock, or unrolled steps, of which later updates have more than the first.
    """

    def __init__(self, budget: Budget, schedule: Sequence[int], *, seconds: float, batch: int, shown: bool) -> None:
        """seconds: of the clock, spent before [s]; schedule: see `unrolled_steps`; batch: samples."""
        self._budget, self._schedule, self._seconds, self._batch = budget, schedule, seconds, batch
        self._begun = time.perf_counter()
        self._steps = 0
        self._recent: deque[tuple[float, float]] = deque(maxlen=RECENT)
        self._bar = tqdm(total=100.0, bar_format="{desc} {bar} {percentage:.0f} %", disable=not shown)

    def show(self, progress: float, *, seconds: float, steps: int, loss: float) -> None:
        """After an update through `steps` steps; seconds: of the clock, spent in all [s]."""
        self._steps += steps
        self._recent.append((time.perf_counter(), loss))
        times, losses = zip(*self._recent, strict=True)
        rate = self._batch * (len(times) - 1) / max(times[-1] - times[0], 1.0e-9)
        left = tqdm.format_interval(self.seconds_left(progress, seconds, times[-1] - self._begun))
        self._bar.set_description_str(
            f"{steps} steps, loss {np.mean(losses):.4f}, {rate:.1f} samples/s, {left} left", refresh=False
        )
        self._bar.update(100.0 * progress - self._bar.n)

    def seconds_left(self, progress: float, seconds: float, wall: float) -> float:
        """Wall time left [s]; wall: since this bar began [s]."""
        if self._budget.updates is None:
            done, left = seconds - self._seconds, 60.0 * self._budget.minutes - seconds
        else:
            done, left = float(self._steps), remaining_steps(self._schedule, progress) * self._budget.updates
        return wall * max(left, 0.0) / max(done, 1.0e-9)

    def close(self) -> None:
        """Leave the bar as it stands."""
        self._bar.close()
