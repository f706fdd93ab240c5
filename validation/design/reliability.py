"""The probability that a design keeps the limit, by an emulator of the MPM, and where further runs improve it most.

The emulator (`inverse.posterior.emulator`) predicts the response y from all numbers, variables d and uncertain u:

    P(d) = mean over u of T_nu((L - m(d, u)) / s(d, u)),    s^2 = k (V + S)

| symbol | variable | meaning |
|---|---|---|
| m, V, S | `Emulator.predict`, `scatter` | mean over jitter seeds, variance of that mean, scatter of one flow |
| k, nu | `variance_ratio`, `freedom` | factor by which the emulator errs more than stated, its degrees of freedom |
| T | - | Student's distribution function |

Waves of runs are placed where they reduce V most near the limit state m = L, at the best design so far and at cheaper
ones that may still keep the limit (the targeted mean squared error of Picheny, Ginsbourger, Roustant, Haftka & Kim,
Adaptive designs of experiments for accurate approximation of a target region, J. Mech. Des. 132 (2010) 071008; the
criterion U of Echard, Gayton & Lemaire, AK-MCS, Struct. Saf. 33 (2011) 145-154, applies to responses without scatter,
one run at a time).
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from scipy.optimize import NonlinearConstraint, differential_evolution
from scipy.stats import qmc, t

from inverse.posterior import Matrix, Row
from inverse.posterior.emulator import Emulator, fitted, most_informative
from inverse.posterior.posterior import repeated_scatter
from inverse.search.waves import ModelRun, WaveSearch
from validation.design.problem import DesignProblem, with_draws

DRAWS = 256
"""Draws of the uncertain numbers in the mean of a probability: of too few, quantiles lie too near the median."""
RIVALS, CANDIDATES = 7, 64
"""Cheaper designs that may keep the limit, which a wave considers besides the best one; draws at each of them."""
NEAR = 0.1  # standard deviation from the best design, over the ranges, of half of the candidates for rivals
SURE = 0.25
"""Further runs decide little if a mean larger by a standard deviation lowers P by less than this share of 1 - p."""
GENERATIONS, POPULATION = 40, 8  # generations of the search for the best design; members for each variable


@dataclass(frozen=True, kw_only=True)
class Reliability:
    """The reliability of designs, estimated from runs."""

    problem: DesignProblem
    points: Matrix
    """All numbers of the runs, in fractions of the ranges, shape [n, K + Q]."""
    responses: Row
    """Shape [n]."""

    def updated(self, search: "WaveSearch[ModelRun, Reliability]") -> "Reliability":
        """The estimate from all runs of `search`."""
        return replace(self, points=search.points, responses=search.numbers[:, 0])

    @cached_property
    def emulator(self) -> Emulator:
        """Emulator of the response."""
        numbers = self.responses[:, None]
        expected = np.array([self.problem.limit.scatter(self.problem.scene)])
        deviation, repeats = repeated_scatter(self.points, numbers, expected)
        return fitted(self.points, numbers, deviation, repeats=repeats)

    @cached_property
    def draws(self) -> Matrix:
        """Draws of the uncertain numbers, the same for every design, shape [DRAWS, Q]."""
        return self.problem.draws(DRAWS, np.random.default_rng([self.problem.budget.seed, 1]))

    def probability(self, designs: Matrix, *, error: float = 0.0) -> Row:
        """P of designs [S, K], shape [S]; error: number of standard deviations, of variance V, added to the mean."""
        mean, variance, total = self.moments(with_draws(designs, self.draws))
        if error:
            mean, total = mean + error * np.sqrt(variance), np.maximum(total - variance, self.emulator.scatter[0, 0])
        below = t.cdf((self.problem.limit.below - mean) / np.sqrt(total), self.emulator.freedom)
        return np.asarray(below.reshape(len(designs), DRAWS).mean(axis=1))

    def moments(self, points: Matrix) -> tuple[Row, Row, Row]:
        """m, V and s^2 at points [S, K + Q], each of shape [S]."""
        mean, variance = (moment[:, 0] for moment in self.emulator.predict(points))
        ratio = self.emulator.variance_ratio(points)[:, 0]
        return mean, variance, ratio * (variance + self.emulator.scatter[0, 0])

    @cached_property
    def best(self) -> Row:
        """The cheapest design with the required P; the most reliable one if there is none or no cost. Shape [K]. P is
        computed with a mean one standard deviation larger than expected, because an optimum favours places where the
        emulator errs low. The search is SciPy's differential evolution with Lampinen's rule for constraints."""
        problem, rng = self.problem, np.random.default_rng([self.problem.budget.seed, 2])

        def cautious(x: Matrix) -> Row:
            return self.probability(np.atleast_2d(x.T), error=1.0)

        demanded = NonlinearConstraint(lambda x: cautious(x)[None], problem.required, np.inf)
        count = len(problem.variables)
        start = qmc.Sobol(count, seed=rng).random_base2(max(4, (POPULATION * count - 1).bit_length()))
        optimum = differential_evolution(
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
        return np.asarray(optimum.x)

    @cached_property
    def expected(self) -> float:
        """P of the best design."""
        return float(self.probability(self.best[None])[0])

    @cached_property
    def cautious(self) -> float:
        """P of the best design if the mean were a standard deviation larger."""
        return float(self.probability(self.best[None], error=1.0)[0])

    @property
    def price(self) -> float:
        """Cost of the best design."""
        return float(self.problem.price(self.best))

    @property
    def decided(self) -> bool:
        """Whether further runs decide little: far below the limit's probability a rough estimate is enough."""
        probability = self.problem.limit.probability
        far = (probability - self.expected) / 3.0
        return self.expected - self.cautious < max(SURE * (1.0 - probability), far)

    def as_json(self) -> dict[str, Any]:
        """A wave in `design.json`."""
        design, probabilities = self.problem.named(self.best), {"probability": self.expected, "cautious": self.cautious}
        return {"runs": len(self.points), "design": design} | probabilities

    def next_points(self, count: int, rng: np.random.Generator) -> Matrix:
        """The points of the next wave, shape [count, K + Q]."""
        problem = self.problem
        anywhere = rng.random((CANDIDATES, len(problem.variables)))
        designs = np.vstack([anywhere, np.clip(self.best + NEAR * rng.standard_normal(anywhere.shape), 0.0, 1.0)])
        hopes = self.probability(designs, error=-1.0)
        may = hopes >= (problem.required if problem.cost else self.expected)
        if self.expected >= problem.required:
            may &= problem.price(designs) <= self.price
        hopes[~may] = 0.0
        rivals = designs[np.argsort(-hopes)[: min(RIVALS, int(may.sum()))]]
        points = with_draws(np.vstack([self.best, rivals]), self.draws[:CANDIDATES])
        mean, _, total = self.moments(points)
        relevance = np.exp(-0.5 * (mean - problem.limit.below) ** 2 / total)
        # The best design counts as much as its rivals together.
        relevance[:CANDIDATES] *= max(1, len(rivals))
        return points[most_informative(self.emulator, points, count, np.ones(1), relevance)]
