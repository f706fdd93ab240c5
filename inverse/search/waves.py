"""The search in waves: run a forward model, learn from all its runs, and run it again where they leave most open.

One search serves three purposes, each with its own forward model and its own knowledge from the runs:

| search | forward model | knowledge |
|---|---|---|
| `python -m inverse` | the surrogate, the MPM, its adjoint | `inverse.search.inference`: posterior of the parameters |
| `validation.loop` | the MPM, each run with its own jitter seed | the same, possibly within the region of a surrogate |
| `validation.design` | one response of such runs | `validation.design.reliability`: probability of keeping a limit |

Knowledge is a frozen dataclass with one method, `updated`, which returns the knowledge from all runs of a search. A
posterior compares many numbers with a target; the reliability of a design has one response and no target. They
therefore share only an emulator.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Generic, Self, TypeVar

import numpy as np

from inverse.posterior import Matrix, Row
from inverse.posterior.posterior import Region


@dataclass(frozen=True, kw_only=True)
class ModelRun:
    """A run of a forward model."""

    point: Row  # its parameters in fractions of their ranges, shape [U]
    numbers: Row  # its results, shape [M]


def runs_of(points: Matrix, numbers: Iterable[Row]) -> list[ModelRun]:
    """The runs at points [n, U] with results `numbers` [n, M]."""
    return [ModelRun(point=point, numbers=row) for point, row in zip(points, numbers, strict=True)]


R = TypeVar("R", bound=ModelRun)
K = TypeVar("K")


@dataclass(frozen=True, kw_only=True)
class WaveSearch(Generic[R, K]):
    """All runs so far and the knowledge from them. It is immutable: more runs make another search."""

    model: Callable[..., Sequence[R]]
    """The forward model: points [n, U] in fractions of the ranges, and the number of the first run -> the runs. It
    decides the jitter of each, so that an interrupted search finds its stored runs again."""
    knowledge: K  # the latest knowledge from the runs
    seed: int  # seed of the random numbers
    budget: int  # largest number of runs
    runs: tuple[R, ...] = ()
    known: tuple[R, ...] = ()  # earlier runs for other targets, which do not count towards the budget
    waves: tuple[K, ...] = ()  # the knowledge after each wave

    @property
    def left(self) -> int:
        """Number of runs left in the budget."""
        return max(0, self.budget - len(self.runs))

    @property
    def every(self) -> tuple[R, ...]:
        """The known runs, then those of this search."""
        return (*self.known, *self.runs)

    @property
    def points(self) -> Matrix:
        """Points of all runs, shape [n, U]."""
        return np.stack([run.point for run in self.every])

    @property
    def numbers(self) -> Matrix:
        """Results of all runs, shape [n, M]."""
        return np.stack([run.numbers for run in self.every])

    def generator(self, number: int | None = None) -> np.random.Generator:
        """Random numbers of a step, the same after a restart; number: of the step, by default the number of runs."""
        return np.random.default_rng([self.seed, len(self.runs) if number is None else number])

    def ran(self, points: Matrix, **options: Any) -> Self:
        """The search with runs at points [n, U], as far as the budget allows; options: for the forward model."""
        return replace(self, runs=(*self.runs, *self.model(points[: self.left], len(self.runs), **options)))

    def informed(self, **changes: Any) -> Self:
        """The search with the knowledge from all runs; changes: first applied to the fields of `knowledge`."""
        before: Any = self.knowledge
        knowledge: K = replace(before, **changes).updated(self)
        return replace(self, knowledge=knowledge, waves=(*self.waves, knowledge))

    def in_waves(self, next_points: Callable[[Self], Matrix | None]) -> Self:
        """The search after waves at `next_points`, until these are None."""
        state = self.informed()
        while (points := next_points(state)) is not None:
            state = state.ran(points).informed()
        return state


def filling(unknowns: int, count: int, rng: np.random.Generator, *, repeats: int = 0) -> Matrix:
    """Points that fill the unit box evenly, then its middle `repeats` times, shape [count + repeats, U]."""
    return np.concatenate([Region.whole(unknowns).filled(count, rng), np.full((repeats, unknowns), 0.5)])


def jitter_seed(seed: int, number: int) -> int:
    """Jitter seed of the run of this number in a scene with `seed`."""
    return int(np.random.SeedSequence([seed, number]).generate_state(1)[0])
