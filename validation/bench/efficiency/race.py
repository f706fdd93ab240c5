"""A race: every method from the same start against the same target, by the clock; the MPM says what each one knew."""

import dataclasses
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from tqdm import tqdm

from gns.model.simulator import Simulator
from inverse.finite_difference import central
from inverse.forward.gns import GnsSource
from inverse.forward.interface import Differentiable, Evaluation, Forward
from inverse.forward.mpm import MpmForward
from inverse.gradient import Evaluate, automatic
from inverse.gradient_free import explore
from inverse.observations import deposit as observations
from inverse.observations.deposit import Values, loss
from inverse.observations.target import Target, read_target
from inverse.optimise import Bounds, minimise
from inverse.parameters.parameters import Vector, kind, with_unknowns
from inverse.problem import Method, Problem
from mpm import simulate, simulate_many
from mpm.process import processors
from validation.bench.efficiency.methods import Model, Slope, Way
from validation.bench.efficiency.rows import Row, Shown

CHECK_SEED = 20_002
"""Jitter of the checks: another one than the target's and the search's, so that no method is praised for chance."""
CURVE = 8
"""Most answers of a method that the MPM is asked about."""
WARM_S = 0.1
"""What a surrogate is warmed up on: whatever is compiled at a first call is no part of a search [s]."""
UNLIMITED = 10**6


@dataclass(frozen=True, kw_only=True)
class Field:
    """All that the methods of one problem run on."""

    target: Target
    components: int
    gns: Differentiable
    gns_target: Values
    """What of the target the surrogate is held against."""
    gns_start_s: float
    """Seconds for the MPM's first frames, where the surrogate wants them."""
    mpm: Forward
    check: Forward
    """The MPM with a jitter of its own."""


@dataclass(frozen=True, kw_only=True)
class Moment:
    """A prediction of a search."""

    seconds: float
    """Since the search began."""
    unknowns: Vector
    loss: float
    """By the method's own reckoning."""
    forward_s: float
    backward_s: float


class OutOfTime(Exception):
    """The next iteration would end after the limit."""


@dataclass
class Watch:
    """Times a search, keeps what it found and ends it before the limit."""

    limit: float
    """[s]."""
    spent: float = 0.0
    """Before the search [s]."""
    clock: Callable[[], float] = time.perf_counter
    moments: list[Moment] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.began = self.clock() - self.spent
        self.longest = 0.0

    @property
    def elapsed(self) -> float:
        """Since the search began [s]."""
        return self.clock() - self.began

    def begin(self) -> float:
        """The time, if there is enough left for another iteration; a first one there is always."""
        if self.moments and self.elapsed + self.longest > self.limit:
            raise OutOfTime
        return self.elapsed

    def evaluate(self, inner: Evaluate) -> Evaluate:
        """`inner`, watched."""

        def watched(unknowns: Vector) -> Evaluation:
            before = self.begin()
            found = inner(unknowns)
            self.longest = max(self.longest, self.elapsed - before)
            self.note(unknowns, found.loss, found.forward_s, found.backward_s)
            return found

        return watched

    def note(self, unknowns: Vector, value: float, forward_s: float, backward_s: float) -> None:
        """Keep a prediction."""
        moment = Moment(
            seconds=self.elapsed, unknowns=unknowns.copy(), loss=value, forward_s=forward_s, backward_s=backward_s
        )
        self.moments.append(moment)


@dataclass(frozen=True, kw_only=True)
class Watched:
    """A forward whose predictions are watched: for a search that asks for nothing else."""

    inner: Forward
    watch: Watch
    target: Values
    components: int

    def observe(self, unknowns: Sequence[Vector]) -> list[Values]:
        """The observation [M] for each vector of unknowns [U]."""
        before = self.watch.begin()
        found = self.inner.observe(unknowns)
        took = self.watch.elapsed - before
        self.watch.longest = max(self.watch.longest, took)
        for each, values in zip(unknowns, found, strict=True):
            self.watch.note(each, loss(values, self.target, self.components), took / len(unknowns), 0.0)
        return found


def prepare(problem: Problem, simulator: Simulator) -> Field:
    """The field of a shipped problem."""
    observation = observations.build(problem.observation, problem.scene)
    target = read_target(problem, observation, simulate)
    names = problem.names
    short = dataclasses.replace(problem, scene=dataclasses.replace(problem.scene, duration=WARM_S))
    for each in (short, problem):
        source = GnsSource(simulator, each, observation)
        frames = source.first_frames(with_unknowns(each.scene, names, problem.initial))
        began = time.perf_counter()
        beginning = None if frames is None else simulate(frames)
        took = 0.0 if beginning is None else time.perf_counter() - began
        gns = source.start(beginning)
        wanted = gns.wanted(target.values)
        if each is short:
            automatic(gns, wanted, components=observation.components)(problem.initial)
    other = dataclasses.replace(problem, scene=dataclasses.replace(problem.scene, seed=CHECK_SEED))
    return Field(
        target=target,
        components=observation.components,
        gns=gns,
        gns_target=wanted,
        gns_start_s=took,
        mpm=MpmForward(problem, observation, simulate_many),
        check=MpmForward(other, observation, simulate_many),
    )


def race(ways: Sequence[Way], on: Field, limit: float, *, curve: int = CURVE) -> tuple[Row, ...]:
    """Every way, one after the other, `limit` seconds each."""
    with tqdm(list(ways), desc=ways[0].problem.name, unit="method", dynamic_ncols=True) as bar:
        rows = []
        for way in bar:
            bar.set_postfix_str(way.name)
            rows.append(run(way, on, limit, curve=curve))
        return tuple(rows)


def run(
    way: Way, on: Field, limit: float, *, curve: int = CURVE, clock: Callable[[], float] = time.perf_counter
) -> Row:
    """One search, and what the MPM shows of it."""
    gns = way.model is Model.GNS
    watch = Watch(limit=limit, spent=on.gns_start_s if gns else 0.0, clock=clock)
    target = on.gns_target if gns else on.target.values
    ended = search(way, on.gns if gns else on.mpm, on, target, watch)
    total = watch.elapsed
    iterations = len(watch.moments)
    runs = 0
    if not gns:
        runs = iterations * (1 + 2 * len(way.problem.unknowns) if way.slope is Slope.DIFFERENCES else 1)
    answers = thinned(improvements(watch.moments), curve)
    shown = on.check.observe([moment.unknowns for moment in answers])
    return Row(
        method=way.name,
        optimiser=way.optimiser,
        forward=sum(moment.forward_s for moment in watch.moments) / iterations,
        backward=sum(moment.backward_s for moment in watch.moments) / iterations,
        paper=way.paper,
        iterations=iterations,
        allowed=way.settings.max_trials if way.slope is Slope.NONE else way.settings.max_iterations,
        ended=ended,
        mpm_runs=runs,
        seconds=total,
        error=errors(way.problem, on.target, answers[-1].unknowns),
        curve=tuple(
            Shown(seconds=moment.seconds, loss=loss(values, on.target.values, on.components))
            for moment, values in zip(answers, shown, strict=True)
        ),
    )


def search(way: Way, forward: Forward, on: Field, target: Values, watch: Watch) -> str:
    """Let a way search; returns why it ended."""
    problem, settings = way.problem, way.settings
    try:
        if way.slope is Slope.NONE:
            trials = dataclasses.replace(settings, max_trials=UNLIMITED)
            explore(
                Watched(inner=forward, watch=watch, target=target, components=on.components),
                target,
                dataclasses.replace(problem, optimiser=trials),
                components=on.components,
                at_once=processors() if way.model is Model.MPM else 1,
            )
        else:
            jacobian = settings.method is Method.GAUSS_NEWTON
            if way.slope is Slope.AD:
                evaluate = automatic(on.gns, target, components=on.components, with_jacobian=jacobian)
            else:
                evaluate = central(forward, target, problem, components=on.components, with_jacobian=jacobian)
            lower, upper = np.array(problem.bounds).T
            rates = [unknown.learning_rate for unknown in problem.unknowns]
            bounds = Bounds(lower=lower, upper=upper)
            minimise(watch.evaluate(evaluate), problem.initial, bounds, settings, way.name, rates)
    except OutOfTime:
        return "out of time"
    if min(moment.loss for moment in watch.moments) < settings.stop_below:
        return "target met"
    if way.slope is not Slope.NONE and len(watch.moments) >= settings.max_iterations:
        return "all iterations"
    return "by itself"


def improvements(moments: Sequence[Moment]) -> list[Moment]:
    """Each moment that was better than all before it."""
    finite = [moment for moment in moments if np.isfinite(moment.loss)]
    found = finite[:1] or list(moments[:1])
    for moment in finite:
        if moment.loss < found[-1].loss:
            found.append(moment)
    return found


def thinned(moments: Sequence[Moment], most: int) -> list[Moment]:
    """At most about `most` of them, evenly over the logarithm of time; the first and the last stay."""
    if len(moments) <= most:
        return list(moments)
    seconds = np.array([moment.seconds for moment in moments])
    wanted = np.geomspace(seconds[0], seconds[-1], most)
    places = {0, len(moments) - 1, *(int(np.abs(np.log(seconds / each)).argmin()) for each in wanted)}
    return [moments[place] for place in sorted(places)]


def errors(problem: Problem, target: Target, answer: Vector) -> dict[str, float]:
    """Root mean square error of the unknowns, by unit; empty where the truth is not known."""
    if not target.truth:
        return {}
    squares: dict[str, list[float]] = {}
    for name, value in zip(problem.names, answer, strict=True):
        squares.setdefault(kind(name).unit, []).append(float(value - target.truth[name]) ** 2)
    return {unit: float(np.sqrt(np.mean(values))) for unit, values in squares.items()}


def floor(problem: Problem, on: Field) -> float | None:
    """Loss that the MPM shows at the truth: its own scatter."""
    if not on.target.truth:
        return None
    truth = np.array([on.target.truth[name] for name in problem.names])
    (shown,) = on.check.observe([truth])
    return loss(shown, on.target.values, on.components)
