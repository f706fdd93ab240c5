"""Work timed in turn, so that other load of the machine affects all of it alike."""

import statistics
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TypeVar

from tqdm import tqdm

from datasets.scene import Scene
from mpm import simulate_many
from mpm.arrays.layout import Precision
from mpm.output.request import ALL, Recording

Key = TypeVar("Key")
Found = TypeVar("Found")


@dataclass(frozen=True, kw_only=True)
class TimedRun:
    """Scenes, and how the MPM runs them side by side."""

    scenes: tuple[Scene, ...]
    precision: Precision = "f32"
    threads: int = 1
    record: Recording = ALL


@dataclass(frozen=True, kw_only=True)
class Timing:
    """Of one run of the MPM."""

    seconds: float
    """Without compilation."""
    particle_steps: int
    """Particles times steps, over all scenes."""
    front: float
    """Of the first scene's deposit [m]."""
    rest_time: float | None = None
    """When the first scene came to rest [s], where it was to end there."""

    @property
    def rate(self) -> float:
        """Million particle-steps a second."""
        return self.particle_steps / self.seconds / 1.0e6


@dataclass(frozen=True, kw_only=True)
class Spread:
    """Minimum, median and maximum of some measurements."""

    minimum: float
    median: float
    maximum: float

    def written(self, digits: int) -> str:
        """The median, and the range where there is one."""
        middle = f"{self.median:.{digits}f}"
        low, high = f"{self.minimum:.{digits}f}", f"{self.maximum:.{digits}f}"
        return middle if low == high else f"{middle} ({low}-{high})"


def spread(values: Iterable[float]) -> Spread:
    """The spread of at least one value."""
    values = list(values)
    return Spread(minimum=min(values), median=statistics.median(values), maximum=max(values))


def in_turn(runs: Mapping[Key, TimedRun], rounds: int, what: str) -> dict[Key, list[Timing]]:
    """Every run once, then every run once more, `rounds` times in all."""
    # Taichi starts anew for another precision or number of threads.
    ordered = sorted(runs.items(), key=lambda item: (item[1].precision, item[1].threads))
    found = turns({key: partial(timed, run) for key, run in ordered}, rounds, what)
    return {key: found[key] for key in runs}


def turns(work: Mapping[Key, Callable[[], Found]], rounds: int, what: str) -> dict[Key, list[Found]]:
    """All work once, then all of it once more, `rounds` times in all."""
    found: dict[Key, list[Found]] = {key: [] for key in work}
    with tqdm(total=rounds * len(work), desc=what, unit="run", dynamic_ncols=True) as progress:
        for _ in range(rounds):
            for key, each in work.items():
                found[key].append(each())
                progress.update()
    return found


def seconds_of(action: Callable[[], object]) -> float:
    """Wall time of `action` [s]."""
    began = time.perf_counter()
    action()
    return time.perf_counter() - began


def timed(run: TimedRun) -> Timing:
    """Simulate once."""
    flows = simulate_many(run.scenes, precision=run.precision, threads=run.threads, record=run.record)
    summaries = [flow.summary for flow in flows]
    return Timing(
        seconds=summaries[0]["wall_s"],
        particle_steps=sum(summary["particles"] * summary["steps"] for summary in summaries),
        front=summaries[0]["front"],
        rest_time=summaries[0]["rest_time"],
    )


def ratio(these: Sequence[Timing], those: Sequence[Timing]) -> Spread:
    """Seconds of these over seconds of those, round by round."""
    return spread(a.seconds / b.seconds for a, b in zip(these, those, strict=True))
