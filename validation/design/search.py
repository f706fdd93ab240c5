"""The cheapest design that keeps the limit with a given probability: waves of MPM runs, then a check by the MPM.

The check consists of MPM flows at the design, each with a fresh draw of u and of the jitter. The probability has the
interval of Clopper & Pearson (The use of confidence or fiducial limits illustrated in the case of the binomial,
Biometrika 26 (1934) 404-413), which is conservative for stratified draws (Hoeffding, On the distribution of the number
of successes in independent trials, Ann. Math. Stat. 27 (1956) 713-721).
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.stats import binomtest

from inverse.answer import Verdict
from inverse.posterior import Matrix, Row
from inverse.posterior.settings import CONSTANTS
from inverse.search.waves import ModelRun, WaveSearch, filling, runs_of
from validation.design.problem import DesignProblem, with_draws
from validation.design.reliability import Reliability

Respond = Callable[[Matrix, int], Row]
"""All numbers [n, K + Q] in fractions of their ranges, and the number of the first flow -> responses [n]."""
FIRST = 8
"""First runs for each number: of the usual ten (Loeppky, Sacks & Welch, Technometrics 51 (2009) 366-376), two are left
to the waves."""
SETTLED = 0.02  # change of the cost from wave to wave, over its range, below which the search has converged
ROUNDS = 2  # largest number of checks: if too many flows of the first exceed the limit, they inform the emulator


@dataclass(frozen=True, kw_only=True)
class Checked:
    """A design with its check by the MPM."""

    problem: DesignProblem
    best: Row
    """In fractions of the ranges, shape [K]."""
    points: Matrix
    """All numbers of the check's flows, in fractions of the ranges, shape [N, K + Q]."""
    responses: Row
    """Responses of the check's flows, shape [N]."""
    expected: float
    """The probability that the design keeps the limit, before the check."""
    spent: int
    """Number of MPM runs; of an emulator without the checks."""
    seconds: float
    remark: str = ""
    """A remark on these flows."""
    moving: int = 0
    """Number of flows in the check that keep the limit at their end but still move, and may yet exceed it."""

    @property
    def design(self) -> dict[str, float]:
        """Variable name -> value."""
        return self.problem.named(self.best)

    @property
    def price(self) -> float:
        return float(self.problem.price(self.best))

    @property
    def exceeding(self) -> int:
        """Number of flows in the check at the limit or beyond."""
        return int(np.sum(self.responses >= self.problem.limit.below))

    @property
    def interval(self) -> tuple[float, float]:
        """95 % interval of the probability that the limit is kept, from the check (Clopper & Pearson)."""
        bounds = binomtest(len(self.responses) - self.exceeding, len(self.responses)).proportion_ci(0.95)
        return float(bounds.low), float(bounds.high)

    @property
    def verdict(self) -> Verdict:
        """Confirmed if at most a share 1 - p of the check's flows exceeds the limit, or may do so once at rest.
        Unreachable if a larger share exceeds it and no design within the bounds is expected to reach p."""
        if self.exceeding + self.moving <= self.problem.allowed:
            return Verdict.CONFIRMED
        hopeful = self.exceeding <= self.problem.allowed or self.expected >= self.problem.limit.probability
        return Verdict.UNCONFIRMED if hopeful else Verdict.UNREACHABLE


@dataclass(frozen=True, kw_only=True)
class Design(Checked):
    """A design found by waves of runs."""

    search: WaveSearch[ModelRun, Reliability]
    """The search, whose last runs are the flows of the check."""

    @property
    def reliability(self) -> Reliability:
        """The estimate from the runs before the check."""
        return self.search.knowledge


def designed(problem: DesignProblem, respond: Respond) -> Design:
    """The design, checked by flows of `respond`."""
    began, count = time.perf_counter(), len(problem.numbers)

    def run(points: Matrix, first: int) -> list[ModelRun]:
        return runs_of(points, respond(points, first)[:, None])

    nothing = Reliability(problem=problem, points=np.zeros((0, count)), responses=np.zeros(0))
    search = WaveSearch(model=run, knowledge=nothing, seed=problem.budget.seed, budget=problem.runs)
    fill = min(FIRST * count, problem.runs - CONSTANTS.repeats)
    search = search.ran(filling(count, fill, search.generator(0), repeats=CONSTANTS.repeats))
    for turn in range(ROUNDS):
        search = searched(search)
        known, draws = search.knowledge, problem.draws(problem.budget.checks, search.generator(3 + turn))
        points = with_draws(known.best, draws)
        # Checks do not count towards the budget.
        search = replace(search, budget=search.budget + len(points)).ran(points)
        design = Design(
            problem=problem,
            search=search,
            best=known.best,
            points=points,
            responses=search.numbers[-len(points) :, 0],
            expected=known.expected,
            spent=problem.runs - search.left,
            seconds=time.perf_counter() - began,
        )
        if design.verdict is not Verdict.UNCONFIRMED:
            break
    return design


def searched(search: WaveSearch[ModelRun, Reliability]) -> WaveSearch[ModelRun, Reliability]:
    """The search after waves of runs, until two in a row decide and change little or the budget is spent."""
    problem, before = search.knowledge.problem, len(search.waves)
    prices = problem.price(np.vstack([np.zeros(len(problem.variables)), np.eye(len(problem.variables))]))
    change = SETTLED * float(np.abs(prices[1:] - prices[0]).sum())

    def next_wave(state: WaveSearch[ModelRun, Reliability]) -> Matrix | None:
        last = state.waves[before:][-3:]
        calm = [wave.decided and abs(wave.price - other.price) <= change for other, wave in pairwise(last)]
        if calm == [True, True] or state.left == 0:
            return None
        size = min(CONSTANTS.wave + len(problem.numbers), state.left)
        return state.knowledge.next_points(size, state.generator(10 + len(state.runs)))

    return search.in_waves(next_wave)
