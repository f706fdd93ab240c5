"""Searches by the clock: every method from the same start against the same target, each answer checked by the MPM."""

import dataclasses
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from tqdm import tqdm

from gns.simulator import Simulator
from inverse.forward.adjoint import AdjointForward
from inverse.forward.gns import GnsForward
from inverse.forward.interface import Differentiable, Evaluation, Forward
from inverse.forward.mpm import MpmForward
from inverse.jacobian import Evaluate, automatic, central, observed
from inverse.observations import Observation, Values
from inverse.optimise import ITERATIONS, minimise
from inverse.parameters import Vector
from inverse.problem import Problem
from inverse.secants import sample
from inverse.settings import Method
from inverse.target import Target, read_target
from mpm.simulation import simulate, simulate_many
from validation.bench.efficiency.methods import ForwardModel, GradientBy, SearchMethod
from validation.bench.efficiency.records import CheckedLoss, MethodResult

CHECK_SEED = 20_002
"""Jitter of the checks, other than the target's and the search's."""
CHECKS = 8
"""Most iterates of a method that the MPM checks."""
WARM_UP_S = 0.1
"""Flow that a surrogate is compiled on [s]."""
UNLIMITED = 10**6
Clock = Callable[[], float]


@dataclass(frozen=True, kw_only=True)
class Models:
    """Target and forward models of one problem."""

    target: Target
    components: int
    gns: Differentiable
    gns_target: Values
    """The part of the target that the surrogate predicts."""
    mpm: Forward
    adjoint: Differentiable
    """The MPM with its adjoint."""
    check: Forward
    """The MPM with a jitter of its own."""

    @staticmethod
    def build(problem: Problem, simulator: Simulator) -> "Models":
        """Of a problem; the surrogate and the adjoint are compiled on a short flow before."""
        target = read_target(problem, simulate)
        observation = target.observation
        short = dataclasses.replace(problem, scene=dataclasses.replace(problem.scene, duration=WARM_UP_S))
        for each in (short, problem):
            gns = GnsForward(simulator, each, observation)
            gns_target = gns.select(target.values)
            adjoint = AdjointForward(each, observation, simulate_many)
            if each is short:
                automatic(gns, gns_target, components=observation.components)(problem.initial)
                automatic(adjoint, target.values, components=observation.components)(problem.initial)
        other = dataclasses.replace(problem, scene=dataclasses.replace(problem.scene, seed=CHECK_SEED))
        return Models(
            target=target,
            components=observation.components,
            gns=gns,
            gns_target=gns_target,
            mpm=MpmForward(problem, observation, simulate_many),
            adjoint=adjoint,
            check=MpmForward(other, observation, simulate_many),
        )

    def checked(self, points: Sequence[Vector]) -> list[float]:
        """Losses that the MPM shows at `points`."""
        return [self.target.misfit(values) for values in self.check.observe(points)]

    def floor(self, problem: Problem) -> float | None:
        """Loss that the MPM shows at the truth: its scatter over the jitter."""
        if not self.target.truth:
            return None
        return self.checked([np.array([self.target.truth[name] for name in problem.names])])[0]


@dataclass(frozen=True, kw_only=True)
class Iterate:
    """A prediction of a search."""

    seconds: float
    """Since the search began."""
    unknowns: Vector
    loss: float
    """By the method's own model."""
    forward_s: float
    backward_s: float


class OutOfTime(Exception):
    """The next iteration would end after the limit."""


@dataclass
class Stopwatch:
    """Times a search, keeps its iterates and ends it before the limit."""

    limit: float
    """[s]."""
    clock: Clock = time.perf_counter
    iterates: list[Iterate] = field(default_factory=list)
    longest: float = 0.0
    sample: int = 0
    """How many of the iterates are predictions over the box before the first iteration."""

    def __post_init__(self) -> None:
        self.began = self.clock()

    @property
    def elapsed(self) -> float:
        """Since the search began [s]."""
        return self.clock() - self.began

    def begin(self) -> float:
        """The time, if enough is left for another iteration; for the first one there always is. Raises OutOfTime."""
        if self.iterates and self.elapsed + self.longest > self.limit:
            raise OutOfTime
        return self.elapsed

    def end(self, before: float, iterates: Sequence[tuple[Vector, float, float, float]]) -> None:
        """Record what began at `before`: unknowns, loss, seconds forward and backward of each iterate."""
        self.longest = max(self.longest, self.elapsed - before)
        for unknowns, value, forward_s, backward_s in iterates:
            self.iterates.append(
                Iterate(
                    seconds=self.elapsed,
                    unknowns=unknowns.copy(),
                    loss=value,
                    forward_s=forward_s,
                    backward_s=backward_s,
                )
            )

    def end_sample(self) -> None:
        """What was recorded so far was a sample, which says nothing of how long an iteration lasts."""
        self.sample, self.longest = len(self.iterates), 0.0

    def timed(self, inner: Evaluate) -> Evaluate:
        """`inner`, timed."""

        def evaluate(unknowns: Vector) -> Evaluation:
            before = self.begin()
            found = inner(unknowns)
            self.end(before, [(unknowns, found.loss, found.forward_s, found.backward_s)])
            return found

        return evaluate


@dataclass(frozen=True, kw_only=True)
class TimedForward:
    """A forward model whose predictions are timed, for a search without gradients."""

    inner: Forward
    stopwatch: Stopwatch
    target: Values
    observation: Observation

    def observe(self, unknowns: Sequence[Vector], /) -> list[Values]:
        """The observation [M] for each vector of unknowns [U]."""
        before = self.stopwatch.begin()
        found = self.inner.observe(unknowns)
        each_s = (self.stopwatch.elapsed - before) / len(unknowns)
        losses = [self.observation.misfit(values, self.target) for values in found]
        self.stopwatch.end(before, [(u, value, each_s, 0.0) for u, value in zip(unknowns, losses, strict=True)])
        return found


def search_all(
    methods: Sequence[SearchMethod], models: Models, limit: float, *, checks: int = CHECKS
) -> tuple[MethodResult, ...]:
    """Every method, one after the other, `limit` seconds each."""
    rows = []
    with tqdm(methods, desc=methods[0].problem.name, unit="method", dynamic_ncols=True) as progress:
        for method in progress:
            progress.set_postfix_str(method.name)
            rows.append(search(method, models, limit, checks=checks))
    return tuple(rows)


def search(
    method: SearchMethod, models: Models, limit: float, *, checks: int = CHECKS, clock: Clock = time.perf_counter
) -> MethodResult:
    """One search, and what the MPM shows at its iterates."""
    gns, problem = method.model is ForwardModel.GNS, method.problem
    stopwatch = Stopwatch(limit=limit, clock=clock)
    ended = _minimise(method, models, stopwatch)
    seconds, iterations = stopwatch.elapsed, stopwatch.iterates[stopwatch.sample :]
    count = len(iterations)
    runs_each = 1 + 2 * len(problem.parameters) if method.gradient is GradientBy.DIFFERENCES else 1
    best = thinned(improvements(stopwatch.iterates), checks)
    losses = models.checked([iterate.unknowns for iterate in best])
    settings = method.settings
    return MethodResult(
        method=method.name,
        optimiser=method.optimiser,
        forward=float(np.mean([iterate.forward_s for iterate in iterations or stopwatch.iterates])),
        backward=float(np.mean([iterate.backward_s for iterate in iterations or stopwatch.iterates])),
        paper=method.paper,
        iterations=count,
        allowed=settings.max_iterations or ITERATIONS,
        ended=ended,
        mpm_runs=0 if gns else stopwatch.sample + count * runs_each,
        sample=stopwatch.sample,
        seconds=seconds,
        error=rms_errors(problem, models.target, best[-1].unknowns),
        curve=tuple(
            CheckedLoss(seconds=iterate.seconds, loss=value) for iterate, value in zip(best, losses, strict=True)
        ),
    )


def _minimise(method: SearchMethod, models: Models, stopwatch: Stopwatch) -> str:
    """Run the search to its end; returns why it ended."""
    problem, settings = method.problem, method.settings
    gns = method.model is ForwardModel.GNS
    forward, target = (models.gns, models.gns_target) if gns else (models.mpm, models.target.values)
    components = models.components
    timed = TimedForward(inner=forward, stopwatch=stopwatch, target=target, observation=models.target.observation)
    try:
        with_jacobian = settings.method is Method.GAUSS_NEWTON
        before: list[Evaluation] = []
        if method.gradient is GradientBy.SECANTS:
            before = sample(timed, target, problem.initial, problem.box, components=components)
            stopwatch.end_sample()
        if method.gradient is GradientBy.AD:
            evaluate = automatic(models.gns, target, components=components, with_jacobian=with_jacobian)
        elif method.gradient is GradientBy.ADJOINT:
            evaluate = automatic(models.adjoint, target, components=components)
        elif method.gradient is GradientBy.SECANTS:

            def evaluate(at: Vector) -> Evaluation:
                return observed(forward, target, [at], components=components)[0]

        else:
            evaluate = central(forward, target, problem.steps, components=components)
        minimise(stopwatch.timed(evaluate), problem.initial, problem.box, settings, method.name, before)
    except OutOfTime:
        return "out of time"
    if min(iterate.loss for iterate in stopwatch.iterates) < settings.stop_below:
        return "target met"
    if len(stopwatch.iterates) - stopwatch.sample >= (settings.max_iterations or ITERATIONS):
        return "all iterations"
    return "by itself"


def improvements(iterates: Sequence[Iterate]) -> list[Iterate]:
    """Each iterate that was better than all before it."""
    finite = [iterate for iterate in iterates if np.isfinite(iterate.loss)]
    found = finite[:1] or list(iterates[:1])
    for iterate in finite:
        if iterate.loss < found[-1].loss:
            found.append(iterate)
    return found


def thinned(iterates: Sequence[Iterate], most: int) -> list[Iterate]:
    """About `most` of them, evenly over the logarithm of time, the first and the last included."""
    if len(iterates) <= most:
        return list(iterates)
    seconds = np.array([iterate.seconds for iterate in iterates])
    even = np.geomspace(seconds[0], seconds[-1], most)
    chosen = {0, len(iterates) - 1, *(int(np.abs(np.log(seconds / each)).argmin()) for each in even)}
    return [iterates[number] for number in sorted(chosen)]


def rms_errors(problem: Problem, target: Target, answer: Vector) -> dict[str, float]:
    """Root mean square error of the unknowns, by unit; empty where the truth is not known."""
    squares: dict[str, list[float]] = {}
    for each, value in zip(problem.parameters, answer, strict=True):
        if target.truth:
            squares.setdefault(each.kind.unit, []).append(float(value - target.truth[each.name]) ** 2)
    return {unit: float(np.sqrt(np.mean(values))) for unit, values in squares.items()}
