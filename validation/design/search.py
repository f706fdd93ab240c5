"""The cheapest design that keeps the limit as often as asked, by an emulator of the MPM, and its check by the MPM.

The emulator (`inverse.posterior.emulator`) is of the response y over all numbers at once, chosen d and uncertain u:

    P(d) = mean over u of T_nu((L - m(d, u)) / s(d, u)),    s^2 = k (V + S)

| symbol | variable | meaning |
|---|---|---|
| m, V, S | `Emulator.predict`, `scatter` | mean over jitter seeds, how little of it is known, scatter of one flow |
| k, nu | `variance_ratio`, `freedom` | how much more than stated the emulator errs there, its degrees of freedom |
| T | - | Student's distribution function |

Runs fill the box; then waves of them go where they shrink V most near the limit state m = L, at the best design so far
and at cheaper ones that may yet keep the limit (the targeted mean squared error of Picheny, Ginsbourger, Roustant,
Haftka & Kim, Adaptive designs of experiments for accurate approximation of a target region, J. Mech. Des. 132 (2010)
071008: the criterion U of Echard, Gayton & Lemaire, AK-MCS, Struct. Saf. 33 (2011) 145-154, is for responses without
scatter, one run at a time).

The check is flows of the MPM at the design, each of a fresh draw of u and of the jitter. The probability has the
interval of Clopper & Pearson (The use of confidence or fiducial limits illustrated in the case of the binomial,
Biometrika 26 (1934) 404-413), rather too wide than too narrow for draws that fill their distribution evenly
(Hoeffding, On the distribution of the number of successes in independent trials, Ann. Math. Stat. 27 (1956) 713-721).
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from enum import StrEnum
from functools import cached_property
from typing import Any

import numpy as np
from scipy.optimize import NonlinearConstraint, differential_evolution
from scipy.stats import binomtest, qmc, t

from inverse.posterior import Matrix, Row
from inverse.posterior.emulator import Emulator, fitted, most_informative
from inverse.posterior.posterior import Region, repeated_scatter
from inverse.posterior.settings import CONSTANTS
from validation.design.problem import DesignProblem

Respond = Callable[[Matrix, int], Row]
"""All numbers [n, K + Q] in fractions of their ranges, and the number of the first flow -> responses [n]."""
FIRST = 8
"""First runs, for each number: of ten that are usual (Loeppky, Sacks & Welch, Technometrics 51 (2009) 366-376) two are
left to the waves."""
DRAWS = 256
"""Draws of what is uncertain, over which a probability is the mean: of few, a quantile is too near the middle."""
RIVALS, CANDIDATES = 7, 64
"""Cheaper designs that may keep the limit, at which a wave looks besides the best one; draws at each of them."""
NEAR = 0.1
"""Of the ranges: deviation from the best design of half of those among which rivals are looked for."""
SURE = 0.25
"""Of 1 - p: decrease of P by a mean that is a standard deviation larger, below which further runs decide little."""
SETTLED = 0.02
"""Of the range of the cost: change from wave to wave, below which it is the cheapest design's."""
ROUNDS = 2
"""Checks, at most: flows of the first inform the emulator where too many exceed."""
GENERATIONS, POPULATION = 40, 8
"""Of the search for the best design; members for each variable."""


class Verdict(StrEnum):
    """What the MPM says of a design."""

    CONFIRMED = "confirmed"
    """Of the flows of its check no larger share exceeds the limit than 1 - p."""
    UNCONFIRMED = "unconfirmed"
    """A larger one does."""
    UNREACHABLE = "unreachable"
    """A larger one does, and no design between the bounds is expected to do better than p."""


@dataclass(frozen=True, kw_only=True)
class Search:
    """All runs so far, and what they say."""

    problem: DesignProblem
    respond: Respond
    points: Matrix
    """Of the runs, in fractions of the ranges, shape [n, K + Q]."""
    responses: Row
    """Shape [n]."""
    spent: int = 0
    """Runs that were no check."""
    waves: list[dict[str, Any]] = field(default_factory=list)
    """What was known after some of the runs, of all searches that go on from one another."""

    def generator(self, number: int) -> np.random.Generator:
        """Random numbers of a step."""
        return np.random.default_rng([self.problem.budget.seed, number])

    @cached_property
    def emulator(self) -> Emulator:
        """Of the response."""
        numbers = self.responses[:, None]
        expected = np.array([self.problem.limit.scatter(self.problem.scene)])
        deviation, repeats = repeated_scatter(self.points, numbers, expected)
        return fitted(self.points, numbers, deviation, repeats=repeats)

    @cached_property
    def draws(self) -> Matrix:
        """Of what is uncertain, the same for every design, shape [DRAWS, Q]."""
        return self.problem.draws(DRAWS, self.generator(1))

    def joined(self, designs: Matrix, count: int = DRAWS) -> Matrix:
        """Each of designs [S, K] with each of the first draws, shape [S count, K + Q]."""
        return np.hstack([np.repeat(designs, count, axis=0), np.tile(self.draws[:count], (len(designs), 1))])

    def probability(self, designs: Matrix, *, error: float = 0.0) -> Row:
        """P of designs [S, K], shape [S]; error: by so many standard deviations of V the mean is larger."""
        points = self.joined(designs)
        mean, variance, total = self.moments(points)
        if error:
            mean, total = mean + error * np.sqrt(variance), np.maximum(total - variance, self.emulator.scatter[0, 0])
        below = t.cdf((self.problem.limit.below - mean) / np.sqrt(total), self.emulator.freedom)
        return np.asarray(below.reshape(len(designs), DRAWS).mean(axis=1))

    def moments(self, points: Matrix) -> tuple[Row, Row, Row]:
        """m, V and s^2 at points [S, K + Q], each of shape [S]."""
        mean, variance = (each[:, 0] for each in self.emulator.predict(points))
        ratio = self.emulator.variance_ratio(points)[:, 0]
        return mean, variance, ratio * (variance + self.emulator.scatter[0, 0])

    @cached_property
    def best(self) -> Row:
        """The cheapest design with the required P, the most reliable one where there is none or no cost, shape [K].

        P is that of a mean a standard deviation larger than expected: an optimum is where an emulator errs to its
        favour. By differential evolution with Lampinen's rule for constraints, as SciPy has it.
        """
        problem, rng = self.problem, self.generator(2)

        def cautious(x: Matrix) -> Row:
            return self.probability(np.atleast_2d(x.T), error=1.0)

        demanded = NonlinearConstraint(lambda x: cautious(x)[None], problem.required, np.inf)
        count = len(problem.variables)
        start = qmc.Sobol(count, seed=rng).random_base2(max(4, (POPULATION * count - 1).bit_length()))
        found = differential_evolution(
            (lambda x: problem.price(x.T)) if problem.cost else (lambda x: -cautious(x)),
            [(0.0, 1.0)] * count,
            constraints=demanded if problem.cost else (),
            init=start,
            maxiter=GENERATIONS,
            polish=False,
            updating="deferred",
            vectorized=True,
            rng=rng,
        )
        return np.asarray(found.x)

    @cached_property
    def expected(self) -> float:
        """P of the best design."""
        return float(self.probability(self.best[None])[0])

    @cached_property
    def cautious(self) -> float:
        """The same were the mean a standard deviation larger."""
        return float(self.probability(self.best[None], error=1.0)[0])

    def next_points(self, count: int) -> Matrix:
        """Where a wave runs, shape [count, K + Q]."""
        problem, rng = self.problem, self.generator(10 + len(self.points))
        anywhere = rng.random((CANDIDATES, len(problem.variables)))
        designs = np.vstack([anywhere, np.clip(self.best + NEAR * rng.standard_normal(anywhere.shape), 0.0, 1.0)])
        hopes = self.probability(designs, error=-1.0)
        may = hopes >= (problem.required if problem.cost else self.expected)
        if self.expected >= problem.required:
            may &= problem.price(designs) <= problem.price(self.best[None])
        hopes[~may] = 0.0
        rivals = designs[np.argsort(-hopes)[: min(RIVALS, int(may.sum()))]]
        points = self.joined(np.vstack([self.best[None], rivals]), CANDIDATES)
        mean, _, total = self.moments(points)
        relevance = np.exp(-0.5 * (mean - problem.limit.below) ** 2 / total)
        # The best design counts as much as its rivals together.
        relevance[:CANDIDATES] *= max(1, len(rivals))
        return points[most_informative(self.emulator, points, count, np.ones(1), relevance)]

    def with_runs(self, points: Matrix, responses: Row, *, spent: int = 0) -> "Search":
        """With runs at points [n, K + Q] that responded so; spent: how many are part of the budget."""
        points, responses = np.vstack([self.points, points]), np.concatenate([self.responses, responses])
        return replace(self, points=points, responses=responses, spent=self.spent + spent)

    def searched(self) -> "Search":
        """With waves of runs until two in a row decide little and change little, or the budget is spent."""
        problem, state, sure, before = self.problem, self, 0, np.inf
        prices = problem.price(np.vstack([np.zeros(len(problem.variables)), np.eye(len(problem.variables))]))
        change = SETTLED * float(np.abs(prices[1:] - prices[0]).sum())
        while True:
            self.waves.append(
                {
                    "runs": len(state.points),
                    "design": problem.named(state.best),
                    "probability": state.expected,
                    "cautious": state.cautious,
                }
            )
            price = float(problem.price(state.best[None])[0])
            # Far from the probability that is asked for, less has to be known of it.
            far = (problem.limit.probability - state.expected) / 3.0
            known = state.expected - state.cautious < max(SURE * (1.0 - problem.limit.probability), far)
            sure, before = sure + 1 if known and abs(price - before) <= change else 0, price
            left = problem.runs - state.spent
            if sure > 1 or left <= 0:
                return state
            points = state.next_points(min(CONSTANTS.wave + len(problem.numbers), left))
            state = state.with_runs(points, self.respond(points, len(state.points)), spent=len(points))


@dataclass(frozen=True, kw_only=True)
class Design:
    """A design, with what the MPM says of it."""

    problem: DesignProblem
    verdict: Verdict
    search: Search
    points: Matrix
    """Of the flows of the check, in fractions of the ranges, shape [N, K + Q]."""
    responses: Row
    """Their responses, shape [N]."""
    seconds: float
    remark: str = ""
    """What must be known of these flows besides."""

    @property
    def design(self) -> dict[str, float]:
        """Each variable by name."""
        return self.problem.named(self.search.best)

    @property
    def exceeding(self) -> int:
        """Flows of the check at the limit or beyond."""
        return int(np.sum(self.responses >= self.problem.limit.below))

    @property
    def interval(self) -> tuple[float, float]:
        """Of the probability that the limit is kept, by the check (Clopper & Pearson, 95 %)."""
        found = binomtest(len(self.responses) - self.exceeding, len(self.responses)).proportion_ci(0.95)
        return float(found.low), float(found.high)


def designed(problem: DesignProblem, respond: Respond) -> Design:
    """The design, checked by flows that `respond` makes."""
    began = time.perf_counter()
    count, rng = len(problem.numbers), np.random.default_rng([problem.budget.seed, 0])
    filling = Region.whole(count).filled(min(FIRST * count, problem.runs - CONSTANTS.repeats), rng)
    points = np.vstack([filling, np.full((CONSTANTS.repeats, count), 0.5)])
    state = Search(
        problem=problem, respond=respond, points=points, responses=respond(points, 0), spent=len(points)
    ).searched()
    for turn in range(ROUNDS):
        draws = problem.draws(problem.budget.checks, state.generator(3 + turn))
        points = np.hstack([np.tile(state.best, (len(draws), 1)), draws])
        responses = respond(points, len(state.points))
        verdict = Verdict.CONFIRMED
        if np.sum(responses >= problem.limit.below) <= problem.allowed:
            break
        reachable = state.expected >= problem.limit.probability
        verdict = Verdict.UNCONFIRMED if reachable else Verdict.UNREACHABLE
        if not reachable or turn == ROUNDS - 1:
            break
        state = state.with_runs(points, responses).searched()
    seconds = time.perf_counter() - began
    return Design(problem=problem, verdict=verdict, search=state, points=points, responses=responses, seconds=seconds)
