"""Whole searches: every method from the same start against the same target, the answer checked by the MPM.

Of the gradients SciPy's L-BFGS-B and least squares; the paper's descent; and Optuna (an extra, `pip install
'talus[efficiency]'`), which uses no gradient.
"""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import StrEnum
from itertools import accumulate

import numpy as np
import scipy.optimize
import torch
from numpy.typing import NDArray

from datasets.errors import InputError
from gns.simulator import Simulator
from inverse.forward import Differentiable, Forward
from inverse.forward.adjoint import AdjointForward
from inverse.forward.gns import GnsForward
from inverse.forward.mpm import MpmForward
from inverse.observations import Values
from inverse.parameters import Vector
from inverse.problem import Problem
from inverse.target import Target, read_target
from mpm import simulate, simulate_many

CHECK_SEED = 20_002
"""Jitter of the checks, other than the target's and the search's."""
STEPS = {"deg": 2.0, "m/s": 0.15}
"""Steps whose differences exceed the MPM's scatter over its jitter, by the unit of the number."""
CHANGE = 1.0e-3
"""Decrease of the loss, over the loss, with which a search ends."""
LONGEST_FIRST_STEP = 0.5
"""Over the ranges: one gradient at the start says little of the rest."""
MOST_BY_DIFFERENCES = 20
"""Numbers beyond which no search is made by differences or by Optuna: none ends in time."""


class By(StrEnum):
    """How a search finds its way."""

    SURROGATE = "surrogate, L-BFGS-B"
    PAPER = "surrogate, the paper's descent"
    ADJOINT = "MPM by its adjoint, L-BFGS-B"
    DIFFERENCES = "MPM by differences, Gauss-Newton"
    OPTUNA = "MPM by Optuna (TPE)"


@dataclass(frozen=True, kw_only=True)
class Evaluation:
    """The loss at one vector of parameters, mean of the squared distances of what is compared."""

    parameters: Vector
    """Shape [U]."""
    loss: float
    seconds: float
    slope: Vector
    """d(loss)/d(parameters), shape [U], or along k of them, shape [k]; k = 0 for a search without gradients."""
    residual: Values | None = None
    """Prediction less target, shape [m], where the Jacobian is known."""
    jacobian: NDArray[np.float64] | None = None
    """d(residual)/d(parameters), shape [m, U] or [m, k]."""


Evaluate = Callable[[Vector], Evaluation]


@dataclass(frozen=True, kw_only=True)
class Descent:
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
        components = self.target.observation.components
        if by in (By.SURROGATE, By.PAPER, By.ADJOINT):
            forward = self.adjoint if by is By.ADJOINT else self.surrogate
            return by_reverse(forward, forward.select(self.target.values), components)
        moves = np.diag(steps_of(self.problem)) if by is By.DIFFERENCES else np.zeros((0, len(self.problem.numbers)))
        return by_runs(self.mpm, self.mpm.select(self.target.values), components, moves)

    def checked(self, numbers: Vector) -> float:
        """The loss that the MPM shows at `numbers` [U], with a jitter of its own."""
        scene = replace(self.problem.scene_at(numbers), seed=CHECK_SEED)
        return self.target.misfit(self.target.observation.observe(simulate(scene)))

    @property
    def truth(self) -> Vector:
        """The true numbers, shape [U]."""
        assert self.target.truth, "a twin experiment"
        return np.array([self.target.truth[name] for name in self.problem.names])


def by_reverse(forward: Differentiable, target: Values, components: int) -> Evaluate:
    """Loss against `target` [m] and its gradient by one backward pass."""

    def evaluate(at: Vector) -> Evaluation:
        began = time.perf_counter()
        point = torch.tensor(at, dtype=torch.float64, requires_grad=True)
        loss = components * (forward.predict(point) - torch.from_numpy(target)).square().mean()
        loss.backward()  # type: ignore[no-untyped-call]
        assert point.grad is not None, "a leaf"
        seconds = time.perf_counter() - began
        return Evaluation(parameters=at.copy(), loss=loss.item(), slope=point.grad.numpy(), seconds=seconds)

    return evaluate


def by_runs(forward: Forward, target: Values, components: int, moves: NDArray[np.float64]) -> Evaluate:
    """Loss against `target` [m], slope and Jacobian along each of `moves` [k, U] by central differences."""

    def evaluate(at: Vector) -> Evaluation:
        began = time.perf_counter()
        first, *rows = forward.observe([at, *(at + moves), *(at - moves)])
        seconds, residual = time.perf_counter() - began, first - target
        ahead, behind = np.split(np.reshape(rows, (2 * len(moves), len(first))).T.copy(), 2, axis=1)
        jacobian = (ahead - behind) / (2.0 * np.linalg.norm(moves, axis=1))
        slope = 2.0 * components * residual @ jacobian / len(residual)
        loss = components * float(np.mean(residual**2))
        return Evaluation(
            parameters=at.copy(), loss=loss, seconds=seconds, slope=slope, residual=residual, jacobian=jacobian
        )

    return evaluate


def steps_of(problem: Problem) -> Vector:
    """Steps of the differences of a problem, shape [U]."""
    return np.array([STEPS[kind.unit] for kind in problem.kinds])


def methods(problem: Problem) -> list[By]:
    """Those that are compared on a problem."""
    few = len(problem.numbers) <= MOST_BY_DIFFERENCES
    applies = {By.PAPER: problem.name in PAPER, By.DIFFERENCES: few, By.OPTUNA: few}
    return [by for by in By if applies.get(by, True)]


def search(by: By, models: Models, limit: float) -> Searched:
    """One search of as many evaluations as fit into `limit` [s], and what the MPM shows at its answer."""
    problem, evaluate = models.problem, models.evaluate(by)
    # The first one compiles kernels; the second is timed.
    evaluate(problem.initial)
    once = evaluate(problem.initial)
    most = max(1, int(limit / once.seconds))
    walks = {By.PAPER: descend, By.OPTUNA: explore, By.DIFFERENCES: gauss_newton}
    records = walks.get(by, quasi_newton)(evaluate, problem, most)
    answer = min(records, key=lambda each: each.loss).parameters
    each_runs = {By.SURROGATE: 0, By.PAPER: 0, By.DIFFERENCES: 1 + 2 * len(problem.numbers)}.get(by, 1)
    return Searched(
        by=by,
        seconds=tuple(accumulate(each.seconds for each in records)),
        losses=tuple(each.loss for each in records),
        mpm_runs=each_runs * len(records),
        error=float(np.sqrt(np.mean((answer - models.truth) ** 2))),
        loss=models.checked(answer),
    )


def quasi_newton(evaluate: Evaluate, problem: Problem, most: int) -> list[Evaluation]:
    """L-BFGS-B (Byrd, Lu, Nocedal & Zhu 1995), at most so many evaluations.

    Its first model has curvature one: loss and parameters are scaled so that its first step is 2 f / |f'|, that of
    Gauss-Newton for a number that can be fitted, and no longer than half of the ranges.
    """
    box, start = problem.box, problem.initial
    found = [evaluate(start)]
    steep = found[0].slope * box.range
    length = min(2.0 * found[0].loss / float(np.linalg.norm(steep)), LONGEST_FIRST_STEP)
    unit, scale = box.range * length, float(np.linalg.norm(steep)) * length

    def scaled(x: Vector) -> tuple[float, Vector]:
        if x.any() or len(found) > 1:
            found.append(evaluate(box.clip(start + x * unit)))
        return found[-1].loss / scale, found[-1].slope * unit / scale

    bounds = list(zip((box.lower - start) / unit, (box.upper - start) / unit, strict=True))
    # One line search may pass the limit.
    options = {"maxfun": most - 1, "ftol": CHANGE}
    scipy.optimize.minimize(scaled, np.zeros_like(start), jac=True, method="L-BFGS-B", bounds=bounds, options=options)
    return found[:most]


def gauss_newton(evaluate: Evaluate, problem: Problem, most: int) -> list[Evaluation]:
    """Least squares by the Jacobian: the trust region reflective method (Branch, Coleman & Li 1999)."""
    # No difference leaves the bounds.
    steps = steps_of(problem)
    bounds, found = (problem.box.lower + steps, problem.box.upper - steps), list[Evaluation]()

    def residual(at: Vector) -> Values | None:
        found.append(evaluate(at))
        return found[-1].residual

    def jacobian(at: Vector) -> NDArray[np.float64] | None:
        return next(each.jacobian for each in reversed(found) if np.array_equal(each.parameters, at))

    scipy.optimize.least_squares(
        residual,
        np.clip(problem.initial, *bounds),
        jacobian,
        bounds=bounds,
        x_scale=problem.box.range,
        ftol=CHANGE,
        max_nfev=most,
    )
    return found


def descend(evaluate: Evaluate, problem: Problem, most: int) -> list[Evaluation]:
    """The paper's descent, projected onto the bounds."""
    at, found, descent = torch.tensor(problem.initial), list[Evaluation](), PAPER[problem.name]
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
