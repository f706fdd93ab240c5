"""The cheapest design by thousands of predictions: designs race, each over ever more draws of the uncertain numbers.

If a design keeps the limit in k of n predictions, its probability P(d) lies in the interval of Clopper & Pearson. A
design whose upper end is below the required probability drops out. The next predictions go to the cheapest remaining
designs (as in Maron & Moore, The racing algorithm: model selection for lazy learners, Artif. Intell. Rev. 11 (1997)
193-225) and to new designs near them. All designs see the same draws in the same order.

A predictor errs. P runs of the MPM that are also predicted give the differences e, MPM minus prediction. Each predicted
response adds one of them,

    y = m(d, u) + e_i,    i = 1 .. P in turn

so that the probability includes the predictor's bias and scatter.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from scipy.stats import beta, qmc

from inverse.answer import Verdict
from inverse.posterior import Matrix, Row
from validation.design.problem import DesignProblem, with_draws
from validation.design.search import Checked

Predict = Callable[[Matrix], Row]  # all numbers [n, K + Q] in fractions of their ranges -> responses [n]
DESIGNS, FIRST = 64, 16  # initial designs, which fill the box; draws of each
TURN, NEXT = 8, 32  # designs that continue in a round, with as many new ones; further draws of each
MOST = 512  # largest number of draws of a design
SETTLED = 256  # draws that a design needs to win
OUTSIDE = 0.05  # probability that a good enough design drops out in a round
SHARES = (0.75, 0.25)  # shares of the predictions before the first check and before the second
NEAR, NEARER = 0.15, 0.97
"""Standard deviation of new designs from the leading ones, over the ranges, at first; its factor for each round."""


@dataclass(eq=False)
class Entry:
    """A design in the race."""

    design: Row
    """In fractions of the ranges, shape [K]."""
    responses: Row = field(default_factory=lambda: np.zeros(0))
    """Predicted responses for the first n draws, shape [n]."""


class Race:
    """All predictions so far, and the design that leads."""

    def __init__(self, problem: DesignProblem, predict: Predict) -> None:
        self.problem, self.predict = problem, predict
        self.rng = np.random.default_rng([problem.budget.seed, 5])
        draws = problem.draws(MOST, self.rng)
        # Shuffled, so that any first part of the draws covers the distribution.
        self.draws = draws[self.rng.permutation(MOST)]
        self.errors = np.zeros(1)
        """e [P]."""
        cube = qmc.Sobol(len(problem.variables), rng=problem.budget.seed)
        self.entries = [Entry(design) for design in cube.random(DESIGNS)]
        self.spent, self.rounds = 0, 0

    def kept(self, entry: Entry) -> tuple[int, int]:
        """The number of draws in which a design keeps the limit, and the number n of its draws."""
        errors = np.resize(self.errors, len(entry.responses))
        return int(np.sum(entry.responses + errors < self.problem.limit.below)), len(entry.responses)

    def probability(self, entry: Entry) -> float:
        """P(d), estimated with a uniform prior."""
        good, count = self.kept(entry)
        return (good + 1.0) / (count + 2.0)

    def highest(self, entry: Entry) -> float:
        """Upper end of the interval of P(d)."""
        good, count = self.kept(entry)
        return 1.0 if good == count else float(beta.ppf(1.0 - OUTSIDE, good + 1, count - good))

    def rank(self, entry: Entry) -> tuple[float, float]:
        """Sorting key, better designs first: the cheaper ones or, if nothing has a price, the more reliable ones."""
        price = float(self.problem.price(entry.design))
        return (price, -self.probability(entry)) if self.problem.cost else (-self.probability(entry), 0.0)

    @property
    def settled(self) -> list[Entry]:
        """The designs with at least `SETTLED` draws."""
        return [entry for entry in self.entries if len(entry.responses) >= SETTLED]

    @property
    def best(self) -> Entry:
        """The best of the settled designs that are good enough, else the most reliable one."""
        settled = self.settled or self.entries
        good = [entry for entry in settled if self.probability(entry) >= self.problem.required]
        return min(good, key=self.rank) if good else max(settled, key=self.probability)

    def run(self, predictions: int) -> None:
        """Continue the race with so many more predictions."""
        end = self.spent + predictions
        while self.spent < end:
            leaders = self.leaders()
            if self.rounds:
                spread = NEAR * NEARER**self.rounds
                for parent in leaders[:TURN]:
                    moved = parent.design + spread * self.rng.standard_normal(len(parent.design))
                    self.entries.append(Entry(np.clip(moved, 0.0, 1.0)))
                turns = [*leaders[:TURN], *self.entries[-len(leaders[:TURN]) :]]
            else:
                turns = self.entries
            if not turns:
                return
            self.advance(turns)
            self.rounds += 1

    def leaders(self) -> list[Entry]:
        """Designs that may be the best and have draws left, the best first."""
        best, able = self.best, [entry for entry in self.entries if len(entry.responses) < MOST]
        may = [entry for entry in able if self.highest(entry) >= self.problem.required]
        if self.problem.cost and self.probability(best) >= self.problem.required and len(best.responses) >= SETTLED:
            may = [entry for entry in may if self.rank(entry)[0] < self.rank(best)[0]] or [best]
        # Designs that seem good enough, then those nearest to it.
        good = [entry for entry in may if self.probability(entry) >= self.problem.required]
        others = sorted((entry for entry in may or able if entry not in good), key=self.probability, reverse=True)
        return [*sorted(good, key=self.rank), *others]

    def advance(self, entries: list[Entry]) -> None:
        """Predict more draws of each design."""
        pieces = [self.draws[len(entry.responses) :][: NEXT if len(entry.responses) else FIRST] for entry in entries]
        points = [with_draws(entry.design, piece) for entry, piece in zip(entries, pieces, strict=True)]
        responses = self.predict(np.concatenate(points))
        ends = np.cumsum([len(piece) for piece in pieces])
        for entry, added in zip(entries, np.split(responses, ends[:-1]), strict=True):
            entry.responses = np.append(entry.responses, added)
        self.spent += int(ends[-1])


@dataclass(frozen=True, kw_only=True)
class RacedDesign(Checked):
    """A design found by predictions."""

    race: Race
    winner: Entry
    pairs: tuple[Row, Row]
    """Responses of the same flows by the predictor and by the MPM, shape [P] each."""
    predicting: float
    """Time of the predictor [s]."""


def raced(problem: DesignProblem, predict: Predict, respond: Callable[[Matrix, int], Row]) -> RacedDesign:
    """The winning design, checked by flows of `respond`, which also takes the number of the first flow. A few initial
    flows measure the errors of the predictor. If the check refuses the design, the flows of the check measure them too,
    and the race continues for a second design."""
    began, predicting = time.perf_counter(), 0.0
    race, rng = Race(problem, predict), np.random.default_rng([problem.budget.seed, 6])

    def timed(points: Matrix) -> Row:
        nonlocal predicting
        start = time.perf_counter()
        responses = predict(points)
        predicting += time.perf_counter() - start
        return responses

    race.predict = timed
    count = problem.budget.pairs
    designs = qmc.LatinHypercube(len(problem.variables), rng=rng).random(count)
    points = np.hstack([designs, problem.draws(count, rng)])
    ours, theirs = timed(points), respond(points, 0)
    for share in SHARES:
        race.errors = theirs - ours
        race.run(round(share * problem.budget.predictions))
        best = race.best
        draws = problem.draws(problem.budget.checks, rng)
        points = with_draws(best.design, draws)
        shown = respond(points, len(theirs))
        ours, theirs = np.append(ours, timed(points)), np.append(theirs, shown)
        design = RacedDesign(
            problem=problem,
            race=race,
            winner=best,
            best=best.design,
            pairs=(ours, theirs),
            points=points,
            responses=shown,
            expected=race.probability(best),
            spent=len(ours),
            seconds=time.perf_counter() - began,
            predicting=predicting,
        )
        if design.verdict is not Verdict.UNCONFIRMED:
            break
    return design
