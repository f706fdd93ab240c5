"""Whole searches: every method from the same start against the same target, the answer checked by the MPM.

Beside the methods of `inverse.optimise` two that serve no other purpose: the paper's descent, and Optuna (an extra,
`pip install 'talus[efficiency]'`), which uses no gradient.
"""

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from itertools import accumulate

import numpy as np
import torch

from datasets.errors import InputError
from gns.simulator import Simulator
from inverse.forward.adjoint import AdjointForward
from inverse.forward.gns import GnsForward
from inverse.forward.interface import Evaluation
from inverse.forward.mpm import MpmForward
from inverse.jacobian import Evaluate, automatic, central, observed
from inverse.optimise import minimise
from inverse.parameters import Vector
from inverse.problem import Problem
from inverse.secants import lowest, sample
from inverse.settings import Method
from inverse.target import Target, read_target
from mpm import simulate, simulate_many

CHECK_SEED = 20_002
"""Jitter of the checks, other than the target's and the search's."""
STEPS = {"deg": 2.0, "m/s": 0.15}
"""Steps whose differences exceed the MPM's scatter over its jitter, by the unit of the number."""
MOST_BY_DIFFERENCES = 20
"""Numbers beyond which no search is made by differences or by Optuna: none ends in time."""


class By(StrEnum):
    """How a search finds its way."""

    SURROGATE = "surrogate, L-BFGS-B"
    PAPER = "surrogate, the paper's descent"
    ADJOINT = "MPM by its adjoint, L-BFGS-B"
    DIFFERENCES = "MPM by differences, Gauss-Newton"
    SECANTS = "MPM by secants"
    OPTUNA = "MPM by Optuna (TPE)"


METHODS = {By.DIFFERENCES: Method.GAUSS_NEWTON, By.SECANTS: Method.SECANTS}
"""Of `inverse.optimise`; L-BFGS-B for the others that use it."""


@dataclass(frozen=True, kw_only=True)
class Descent:
    """The paper's descent on a problem."""

    optimiser: Callable[..., torch.optim.Optimizer]
    rate: float
    iterations: int
    stop_below: float = 0.0


PAPER = {
    "friction-tall-42": Descent(optimiser=torch.optim.SGD, rate=500.0, iterations=20, stop_below=5.0e-4),
    "velocity-layers-10": Descent(optimiser=torch.optim.Adam, rate=0.1, iterations=29),
}
"""Gradient descent on the loss in m^2 with the angle in degrees, and Adam."""


@dataclass(frozen=True, kw_only=True)
class Searched:
    """The search of one method on one problem."""

    by: By
    seconds: tuple[float, ...]
    """When each evaluation was done, since the search began; without compilation and a surrogate's start [s]."""
    losses: tuple[float, ...]
    """By the method's own model."""
    mpm_runs: int
    """Whole runs of the search, the check not included."""
    error: float
    """Of the numbers, root mean square."""
    loss: float
    """What the MPM shows at the answer, with a jitter that neither target nor search used."""

    @property
    def by_mpm(self) -> bool:
        """Whether its own model is the MPM."""
        return self.by not in (By.SURROGATE, By.PAPER)

    def seconds_to(self, loss: float) -> float:
        """When the MPM's loss fell to `loss` [s], of a surrogate's answer its end; inf where it did not."""
        if not self.by_mpm:
            return self.seconds[-1] if self.loss <= loss else math.inf
        pairs = zip(self.seconds, self.losses, strict=True)
        return next((at for at, own in pairs if own <= loss), math.inf)


@dataclass(frozen=True, kw_only=True)
class Models:
    """Target and forward models of one problem."""

    problem: Problem
    target: Target
    surrogate: GnsForward
    mpm: MpmForward
    adjoint: AdjointForward

    @staticmethod
    def build(problem: Problem, simulator: Simulator) -> "Models":
        """Of a problem."""
        target = read_target(problem, simulate)
        return Models(
            problem=problem,
            target=target,
            surrogate=GnsForward(simulator, problem, target.observation),
            mpm=MpmForward(problem, target.observation, simulate_many),
            adjoint=AdjointForward(problem, target.observation, simulate_many),
        )

    def evaluate(self, by: By) -> Evaluate:
        """Loss and, where the method uses one, gradient."""
        values, components = self.target.values, self.target.observation.components
        if by in (By.SURROGATE, By.PAPER):
            return automatic(self.surrogate, self.surrogate.select(values), components=components)
        if by is By.ADJOINT:
            return automatic(self.adjoint, values, components=components)
        if by is By.DIFFERENCES:
            steps = np.array([STEPS[kind.unit] for kind in self.problem.kinds])
            return central(self.mpm, values, steps, components=components)
        return lambda at: observed(self.mpm, values, [at], components=components)[0]

    def checked(self, numbers: Vector) -> float:
        """The loss that the MPM shows at `numbers` [U], with a jitter of its own."""
        scene = dataclasses.replace(self.problem.scene_at(numbers), seed=CHECK_SEED)
        return self.target.misfit(self.target.observation.observe(simulate(scene)))

    @property
    def truth(self) -> Vector:
        """The true numbers, shape [U]."""
        assert self.target.truth, "a twin experiment"
        return np.array([self.target.truth[name] for name in self.problem.names])


def methods(problem: Problem) -> list[By]:
    """Those that are compared on a problem."""
    few, many = len(problem.numbers) <= MOST_BY_DIFFERENCES, len(problem.numbers) > 1
    applies = {By.PAPER: problem.name in PAPER, By.DIFFERENCES: few, By.OPTUNA: few, By.SECANTS: many}
    return [by for by in By if applies.get(by, True)]


def search(by: By, models: Models, limit: float) -> Searched:
    """One search of as many evaluations as fit into `limit` [s], and what the MPM shows at its answer."""
    problem, evaluate = models.problem, models.evaluate(by)
    # The first one compiles kernels; the second is timed.
    evaluate(problem.initial)
    once = evaluate(problem.initial)
    most = max(1, int(limit / (once.forward_s + once.backward_s)))
    records = evaluations(by, models, evaluate, most)
    answer = lowest(records).parameters
    each_runs = {By.SURROGATE: 0, By.PAPER: 0, By.DIFFERENCES: 1 + 2 * len(problem.numbers)}.get(by, 1)
    return Searched(
        by=by,
        seconds=tuple(accumulate(each.forward_s + each.backward_s for each in records)),
        losses=tuple(each.loss for each in records),
        mpm_runs=each_runs * len(records),
        error=float(np.sqrt(np.mean((answer - models.truth) ** 2))),
        loss=models.checked(answer),
    )


def evaluations(by: By, models: Models, evaluate: Evaluate, most: int) -> list[Evaluation]:
    """Every evaluation of a search, in order; at most so many."""
    problem, box, spread = models.problem, models.problem.box, list[Evaluation]()
    if by is By.PAPER:
        return descend(evaluate, problem, PAPER[problem.name], most)
    if by is By.OPTUNA:
        return explore(evaluate, problem, most)
    if by is By.DIFFERENCES:
        # No difference leaves the bounds.
        steps = np.array([STEPS[kind.unit] for kind in problem.kinds])
        box = dataclasses.replace(box, lower=box.lower + steps, upper=box.upper - steps)
    if by is By.SECANTS:
        target = models.target
        spread = sample(models.mpm, target.values, problem.initial, box, components=target.observation.components)
    settings = dataclasses.replace(
        problem.optimiser, method=METHODS.get(by, Method.LBFGSB), max_iterations=max(1, most - len(spread))
    )
    return spread + minimise(evaluate, problem.initial, box, settings, by, spread)


def descend(evaluate: Evaluate, problem: Problem, descent: Descent, most: int) -> list[Evaluation]:
    """The paper's descent, projected onto the bounds."""
    at, found = torch.tensor(problem.initial), list[Evaluation]()
    optimiser = descent.optimiser([at], lr=descent.rate)
    while len(found) < min(descent.iterations, most):
        found.append(evaluate(at.numpy().copy()))
        if found[-1].loss < descent.stop_below:
            break
        at.grad = torch.from_numpy(found[-1].slope)
        optimiser.step()
        at.copy_(torch.from_numpy(problem.box.clip(at.numpy())))
    return found


def explore(evaluate: Evaluate, problem: Problem, most: int) -> list[Evaluation]:
    """A search without gradients, from the problem's start. Raises InputError."""
    try:
        import optuna
    except ImportError:
        raise InputError("expected the package optuna: pip install 'talus[efficiency]'", key="optuna") from None
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    found = list[Evaluation]()

    def objective(trial: "optuna.Trial") -> float:
        found.append(evaluate(np.array([trial.suggest_float(each.name, *each.bounds) for each in problem.numbers])))
        return found[-1].loss

    study = optuna.create_study(sampler=optuna.samplers.TPESampler(seed=problem.optimiser.seed))
    study.enqueue_trial(problem.named(problem.initial))
    study.optimize(objective, n_trials=most)
    return found
