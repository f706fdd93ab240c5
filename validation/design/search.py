"""The cheapest design that keeps the limit as often as asked: waves of runs of the MPM, then its check by the MPM.

The check is flows of the MPM at the design, each of a fresh draw of u and of the jitter. The probability has the
interval of Clopper & Pearson (The use of confidence or fiducial limits illustrated in the case of the binomial,
Biometrika 26 (1934) 404-413), rather too wide than too narrow for draws that fill their distribution evenly
(Hoeffding, On the distribution of the number of successes in independent trials, Ann. Math. Stat. 27 (1956) 713-721).
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
"""First runs, for each number: of ten that are usual (Loeppky, Sacks & Welch, Technometrics 51 (2009) 366-376) two are
left to the waves."""
SETTLED = 0.02  # of the range of the cost: change from wave to wave, below which it is the cheapest design's
ROUNDS = 2  # checks, at most: flows of the first inform the emulator where too many exceed


@dataclass(frozen=True, kw_only=True)
class Checked:
    """A design, with what the MPM says of it."""

    problem: DesignProblem
    best: Row
    """In fractions of the ranges, shape [K]."""
    points: Matrix
    """Of the flows of the check, in fractions of the ranges, shape [N, K + Q]."""
    responses: Row
    """Of the flows of the check, shape [N]."""
    seconds: float
    remark: str = ""
    """What must be known of these flows besides."""
    moving: int = 0
    """Flows of the check that keep the limit at their end but still move, where they may go on to exceed it."""

    @property
    def expected(self) -> float:
        """The probability that the design keeps the limit, before the check."""
        raise NotImplementedError

    @property
    def design(self) -> dict[str, float]:
        """Each variable by name."""
        return self.problem.named(self.best)

    @property
    def price(self) -> float:
        return float(self.problem.price(self.best))

    @property
    def exceeding(self) -> int:
        """Flows of the check at the limit or beyond."""
        return int(np.sum(self.responses >= self.problem.limit.below))

    @property
    def interval(self) -> tuple[float, float]:
        """Of the probability that the limit is kept, by the check (Clopper & Pearson, 95 %)."""
        bounds = binomtest(len(self.responses) - self.exceeding, len(self.responses)).proportion_ci(0.95)
        return float(bounds.low), float(bounds.high)

    @property
    def verdict(self) -> Verdict:
        """Confirmed where no larger share of the check exceeds the limit, or may once it rests, than 1 - p.

        Unreachable where a larger one does, and no design between the bounds is expected to do better than p.
        """
        if self.exceeding + self.moving <= self.problem.allowed:
            return Verdict.CONFIRMED
        hopeful = self.exceeding <= self.problem.allowed or self.expected >= self.problem.limit.probability
        return Verdict.UNCONFIRMED if hopeful else Verdict.UNREACHABLE


@dataclass(frozen=True, kw_only=True)
class Design(Checked):
    """One that waves of runs found."""

    search: WaveSearch[ModelRun, Reliability]
    """Its last runs are the flows of the check."""

    @property
    def reliability(self) -> Reliability:
        """What the runs before the check say."""
        return self.search.knowledge

    @property
    def expected(self) -> float:
        return self.reliability.expected

    @property
    def spent(self) -> int:
        """Runs that were no check."""
        return self.problem.runs - self.search.left


def designed(problem: DesignProblem, respond: Respond) -> Design:
    """The design, checked by flows that `respond` makes."""
    began, count = time.perf_counter(), len(problem.numbers)

    def run(points: Matrix, first: int) -> list[ModelRun]:
        return runs_of(points, respond(points, first)[:, None])

    nothing = Reliability(problem=problem, points=np.zeros((0, count)), responses=np.zeros(0))
    search = WaveSearch(model=run, knowledge=nothing, seed=problem.budget.seed, budget=problem.runs)
    fill = min(FIRST * count, problem.runs - CONSTANTS.repeats)
    search = search.ran(filling(count, fill, search.generator(0), repeats=CONSTANTS.repeats))
    for turn in range(ROUNDS):
        search = searched(search)
        best, draws = search.knowledge.best, problem.draws(problem.budget.checks, search.generator(3 + turn))
        points = with_draws(best, draws)
        # Checks are no part of the budget.
        search = replace(search, budget=search.budget + len(points)).ran(points)
        responses, seconds = search.numbers[-len(points) :, 0], time.perf_counter() - began
        design = Design(problem=problem, search=search, best=best, points=points, responses=responses, seconds=seconds)
        if design.verdict is not Verdict.UNCONFIRMED:
            break
    return design


def searched(search: WaveSearch[ModelRun, Reliability]) -> WaveSearch[ModelRun, Reliability]:
    """With waves of runs until two in a row decide little and change little, or the budget is spent."""
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
