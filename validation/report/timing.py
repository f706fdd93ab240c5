"""Work timed in turn, so that what else the machine does meets all of it alike."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from statistics import median
from typing import TypeVar

from tqdm import tqdm

from datasets.scene import Scene
from mpm import ALL, Recording, simulate_many
from mpm.arrays.layout import Precision

Key = TypeVar("Key")
Found = TypeVar("Found")


@dataclass(frozen=True, kw_only=True)
class Run:
    """Scenes, and how they are simulated side by side."""

    scenes: tuple[Scene, ...]
    precision: Precision = "f32"
    threads: int = 1
    record: Recording = ALL


@dataclass(frozen=True, kw_only=True)
class Took:
    """What a run took."""

    seconds: float
    """Without compilation."""
    particle_steps: int
    """Material points times steps, over all scenes."""
    front: float
    """Of the first scene's deposit [m]."""
    rest_time: float | None = None
    """When the first scene came to rest [s], where it was to end there."""

    @property
    def rate(self) -> float:
        """Million point-steps a second."""
        return self.particle_steps / self.seconds / 1.0e6


@dataclass(frozen=True, kw_only=True)
class Spread:
    """Least, middle and greatest of some measurements."""

    least: float
    middle: float
    greatest: float

    @staticmethod
    def of(values: Iterable[float]) -> "Spread":
        """The spread of at least one value."""
        values = list(values)
        return Spread(least=min(values), middle=median(values), greatest=max(values))

    def written(self, digits: int) -> str:
        """The median, and the range where there is one."""
        middle = f"{self.middle:.{digits}f}"
        least, greatest = f"{self.least:.{digits}f}", f"{self.greatest:.{digits}f}"
        return middle if least == greatest else f"{middle} ({least}-{greatest})"


def in_turn(runs: Mapping[Key, Run], rounds: int, what: str) -> dict[Key, list[Took]]:
    """Every run once, then every run once more, `rounds` times in all."""
    # Taichi starts anew for another precision or number of threads.
    ordered = sorted(runs.items(), key=lambda item: (item[1].precision, item[1].threads))
    took = turns({key: partial(timed, run) for key, run in ordered}, rounds, what)
    return {key: took[key] for key in runs}


def turns(work: Mapping[Key, Callable[[], Found]], rounds: int, what: str) -> dict[Key, list[Found]]:
    """All work once, then all of it once more, `rounds` times in all."""
    found: dict[Key, list[Found]] = {key: [] for key in work}
    with tqdm(total=rounds * len(work), desc=what, unit="run", dynamic_ncols=True) as bar:
        for _ in range(rounds):
            for key, each in work.items():
                found[key].append(each())
                bar.update()
    return found


def timed(run: Run) -> Took:
    """Simulate once."""
    flows = simulate_many(
        run.scenes,
        precision=run.precision,
        threads=run.threads,
        record=run.record,
    )
    summaries = [flow.summary for flow in flows]
    return Took(
        seconds=summaries[0]["wall_s"],
        particle_steps=sum(summary["particles"] * summary["steps"] for summary in summaries),
        front=summaries[0]["front"],
        rest_time=summaries[0]["rest_time"],
    )


def ratio(these: Sequence[Took], those: Sequence[Took]) -> Spread:
    """Seconds of these over seconds of those, round by round."""
    return Spread.of(a.seconds / b.seconds for a, b in zip(these, those, strict=True))
