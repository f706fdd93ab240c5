"""Searches by the clock: every method from the same start against the same target, each answer checked by the MPM.

Beside the methods of `inverse.optimise` two that serve no other purpose: the paper's descent, and Optuna (an extra,
`pip install talus[efficiency]`), which uses no gradient.
"""

import dataclasses
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np
import torch
from inverse.target import Target, read_target

from datasets.errors import InputError
from gns.model.simulator import Simulator
from inverse.forward.adjoint import AdjointForward
from inverse.forward.gns import GnsForward
from inverse.forward.interface import Evaluation
from inverse.forward.mpm import MpmForward
from inverse.jacobian import Evaluate, automatic, central, observed
from inverse.optimise import minimise
from inverse.parameters import Vector
from inverse.problem import Problem
from inverse.secants import sample
from inverse.settings import Method, OptimiserSettings
from mpm import simulate, simulate_many

CHECK_SEED = 20_002
"""Jitter of the checks, other than the target's and the search's."""
CHECKS = 6
"""Most iterates of a method that the MPM checks."""
WARM_UP_S = 0.1
"""Flow that surrogate and adjoint are compiled on [s]."""
STEPS = {"deg": 2.0, "m/s": 0.15}
"""Steps whose differences exceed the MPM's scatter over its jitter, by the unit of the number."""
MOST_BY_DIFFERENCES = 20
"""Numbers beyond which no search is made by differences: none ends in time."""


class By(StrEnum):
    """How a search finds its way."""

    SURROGATE = "surrogate, L-BFGS-B"
    PAPER = "surrogate, the paper's descent"
    ADJOINT = "MPM by its adjoint, L-BFGS-B"
    DIFFERENCES = "MPM by differences, Gauss-Newton"
    SECANTS = "MPM by secants"
    OPTUNA = "MPM by Optuna (TPE)"


@dataclass(frozen=True, kw_only=True)
class Descent:
    """The paper's descent on a problem."""

    optimiser: type[torch.optim.Optimizer]
    rate: float
    iterations: int
    stop_below: float = 0.0


PAPER = {
    "friction-tall-42": Descent(optimiser=torch.optim.SGD, rate=500.0, iterations=20, stop_below=5.0e-4),
    "velocity-layers-10": Descent(optimiser=torch.optim.Adam, rate=0.1, iterations=29),
}
"""Gradient descent on the loss in m^2 with the angle in degrees, and Adam."""


@dataclass(frozen=True, kw_only=True)
class CheckedLoss:
    """What the MPM shows at the best iterate that a search had after some time."""

    seconds: float
    loss: float
    """Of a run whose jitter neither target nor search used."""


@dataclass(frozen=True, kw_only=True)
class Searched:
    """The search of one method on one problem."""

    by: By
    evaluations: int
    mpm_runs: int
    """Whole runs of the search, checks not included."""
    seconds: float
    """Of the whole search, a surrogate's start not included."""
    ended: str
    error: float
    """Of the numbers, root mean square."""
    curve: tuple[CheckedLoss, ...]
    """From the first iterate to the last improvement."""

    @property
    def loss(self) -> float:
        """What the MPM shows at the answer."""
        return self.curve[-1].loss

    def seconds_to(self, loss: float) -> float:
        """When the MPM loss fell to `loss` and stayed there [s], inf where it did not."""
        above = [number for number, each in enumerate(self.curve) if each.loss > loss]
        first = above[-1] + 1 if above else 0
        return self.curve[first].seconds if first < len(self.curve) else float("inf")


@dataclass(frozen=True, kw_only=True)
class Models:
    """Target and forward models of one problem."""

    problem: Problem
    target: Target
    surrogate: GnsForward
    mpm: MpmForward
    adjoint: AdjointForward
    check: MpmForward
    """The MPM with a jitter of its own."""

    @staticmethod
    def build(problem: Problem, simulator: Simulator) -> "Models":
        """Of a problem; the surrogate and the adjoint are compiled on a short flow before."""
        target = read_target(problem, simulate)
        observation, short = target.observation, dataclasses.replace(problem.scene, duration=WARM_UP_S)
        other = dataclasses.replace(problem.scene, seed=CHECK_SEED)
        for scene in (short, problem.scene):
            each = dataclasses.replace(problem, scene=scene)
            surrogate = GnsForward(simulator, each, observation)
            adjoint = AdjointForward(each, observation, simulate_many)
            if scene is short:
                for forward in (surrogate, adjoint):
                    values = forward.select(target.values)
                    automatic(forward, values, components=observation.components)(problem.initial)
        return Models(
            problem=problem,
            target=target,
            surrogate=surrogate,
            mpm=MpmForward(problem, observation, simulate_many),
            adjoint=adjoint,
            check=MpmForward(dataclasses.replace(problem, scene=other), observation, simulate_many),
        )

    def checked(self, points: Sequence[Vector]) -> list[float]:
        """Losses that the MPM shows at `points`."""
        return [self.target.misfit(values) for values in self.check.observe(points)]

    @property
    def truth(self) -> Vector:
        """The true numbers, shape [U]."""
        assert self.target.truth, "a twin experiment"
        return np.array([self.target.truth[name] for name in self.problem.names])


class OutOfTime(Exception):
    """The next evaluation would end after the limit."""


@dataclass
class Stopwatch:
    """Times a search, keeps its evaluations and ends it before the limit."""

    limit: float
    """[s]."""
    clock: Callable[[], float] = time.perf_counter
    found: list[tuple[float, Evaluation]] = field(default_factory=list)
    """Seconds since the search began, and what it had then."""
    longest: float = 0.0
    """Of an evaluation [s]."""

    def __post_init__(self) -> None:
        self.began = self.clock()

    @property
    def elapsed(self) -> float:
        """Since the search began [s]."""
        return self.clock() - self.began

    def timed(self, evaluate: Evaluate) -> Evaluate:
        """`evaluate`, timed. Raises OutOfTime; for the first one there is always enough."""

        def within(numbers: Vector) -> Evaluation:
            before = self.elapsed
            if self.found and before + self.longest > self.limit:
                raise OutOfTime
            found = evaluate(numbers)
            self.longest = max(self.longest, self.elapsed - before)
            self.found.append((self.elapsed, found))
            return found

        return within

    def improvements(self) -> list[tuple[float, Evaluation]]:
        """Each evaluation that was better than all before it."""
        found: list[tuple[float, Evaluation]] = []
        for each in self.found:
            if np.isfinite(each[1].loss) and (not found or each[1].loss < found[-1][1].loss):
                found.append(each)
        return found or self.found[:1]


def methods(problem: Problem) -> list[By]:
    """Those that are compared on a problem."""
    few = len(problem.numbers) <= MOST_BY_DIFFERENCES
    applies = {By.PAPER: problem.name in PAPER, By.DIFFERENCES: few, By.OPTUNA: few}
    return [by for by in By if applies.get(by, len(problem.numbers) > 1 or by is not By.SECANTS)]


def search(
    by: By, models: Models, limit: float, *, checks: int = CHECKS, clock: Callable[[], float] = time.perf_counter
) -> Searched:
    """One search, and what the MPM shows at its iterates."""
    stopwatch = Stopwatch(limit=limit, clock=clock)
    try:
        _search(by, models, stopwatch)
        ended = "by itself"
    except OutOfTime:
        ended = "out of time"
    seconds, best = stopwatch.elapsed, thinned(stopwatch.improvements(), checks)
    losses = models.checked([each.parameters for _, each in best])
    count = len(stopwatch.found)
    each_runs = {By.SURROGATE: 0, By.PAPER: 0, By.DIFFERENCES: 1 + 2 * len(models.problem.numbers)}.get(by, 1)
    return Searched(
        by=by,
        evaluations=count,
        mpm_runs=each_runs * count,
        seconds=seconds,
        ended=ended,
        error=float(np.sqrt(np.mean((best[-1][1].parameters - models.truth) ** 2))),
        curve=tuple(CheckedLoss(seconds=at, loss=loss) for (at, _), loss in zip(best, losses, strict=True)),
    )


def _search(by: By, models: Models, stopwatch: Stopwatch) -> None:
    """Run a search to its end. Raises OutOfTime."""
    problem, components = models.problem, models.target.observation.components
    box, values, settings = problem.box, models.target.values, problem.optimiser

    def with_method(method: Method) -> OptimiserSettings:
        return dataclasses.replace(settings, method=method, max_iterations=settings.max_iterations or 40)

    if by in (By.SURROGATE, By.PAPER):
        evaluate = automatic(models.surrogate, models.surrogate.select(values), components=components)
        if by is By.PAPER:
            descend(stopwatch.timed(evaluate), problem, PAPER[problem.name])
            return
        minimise(stopwatch.timed(evaluate), problem.initial, box, with_method(Method.LBFGSB), by)
    elif by is By.ADJOINT:
        evaluate = automatic(models.adjoint, values, components=components)
        minimise(stopwatch.timed(evaluate), problem.initial, box, with_method(Method.LBFGSB), by)
    elif by is By.DIFFERENCES:
        steps = np.array([STEPS[kind.unit] for kind in problem.kinds])
        evaluate = central(models.mpm, values, steps, components=components)
        # No difference leaves the bounds.
        inner = dataclasses.replace(box, lower=box.lower + steps, upper=box.upper - steps)
        minimise(stopwatch.timed(evaluate), problem.initial, inner, with_method(Method.GAUSS_NEWTON), by)
    else:
        evaluate = stopwatch.timed(lambda at: observed(models.mpm, values, [at], components=components)[0])
        if by is By.OPTUNA:
            explore(evaluate, problem)
            return
        spread = sample(models.mpm, values, problem.initial, box, components=components)
        stopwatch.found += [(stopwatch.elapsed, each) for each in spread]
        minimise(evaluate, problem.initial, box, with_method(Method.SECANTS), by, spread)


def descend(evaluate: Evaluate, problem: Problem, descent: Descent) -> None:
    """The paper's descent, projected onto the bounds."""
    at = torch.tensor(problem.initial)
    optimiser = descent.optimiser([at], lr=descent.rate)  # type: ignore[call-arg]
    for _ in range(descent.iterations):
        found = evaluate(at.numpy().copy())
        if found.loss < descent.stop_below:
            return
        at.grad = torch.from_numpy(found.slope)
        optimiser.step()
        at.copy_(torch.from_numpy(problem.box.clip(at.numpy())))


def explore(evaluate: Evaluate, problem: Problem) -> None:
    """A search without gradients, from the problem's start, until `evaluate` ends it. Raises InputError."""
    try:
        import optuna
    except ImportError:
        raise InputError("expected the package optuna: pip install 'talus[efficiency]'", key="optuna") from None
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    study = optuna.create_study(sampler=optuna.samplers.TPESampler(seed=problem.optimiser.seed))
    study.enqueue_trial(problem.named(problem.initial))

    def objective(trial: "optuna.Trial") -> float:
        pairs = zip(problem.names, problem.bounds, strict=True)
        return evaluate(np.array([trial.suggest_float(name, *bounds) for name, bounds in pairs])).loss

    while True:
        study.optimize(objective, n_trials=1)


def thinned(found: Sequence[tuple[float, Evaluation]], most: int) -> list[tuple[float, Evaluation]]:
    """About `most` of them, evenly over the logarithm of time, the first and the last included."""
    if len(found) <= most:
        return list(found)
    seconds = np.array([at for at, _ in found])
    even = np.geomspace(seconds[0], seconds[-1], most)
    chosen = {0, len(found) - 1, *(int(np.abs(np.log(seconds / each)).argmin()) for each in even)}
    return [found[number] for number in sorted(chosen)]
