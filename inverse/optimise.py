"""Minimising the misfit inside bounds: the paper's gradient descent and Adam, L-BFGS-B, Gauss-Newton, secants; Optuna.

Every evaluation is kept. A method is a function of `evaluate`, the start and the bounds, and reads like its equation.
"""

import time
from collections.abc import Callable, Sequence
from importlib.util import find_spec

import numpy as np
import optuna
import scipy.optimize
import torch
from numpy.typing import NDArray
from optuna.distributions import BaseDistribution, FloatDistribution
from optuna.samplers import BaseSampler, CmaEsSampler, TPESampler
from optuna.trial import TrialState
from tqdm import tqdm

from datasets.errors import InputError
from inverse.bounds import Bounds
from inverse.forward.interface import Evaluation, Forward
from inverse.jacobian import Evaluate
from inverse.observations import Values
from inverse.parameters import Vector
from inverse.problem import Problem
from inverse.secants import lowest, secants
from inverse.settings import Method, OptimiserSettings, Sampler

RESOLUTION = 5.0e-4
"""A step shorter than this fraction of every parameter's range ends the search."""
LONGEST_FIRST_STEP = 0.5
"""Of L-BFGS-B, as a fraction of the range: one gradient at the start says little of the rest of the range."""
STATIONARY = 0.25
"""Where the gradient at the start promises less than this part of the loss in the whole box, it shows no way down."""
DESCENT_RATE = 500.0
"""Learning rate of gradient descent where none is given: the paper's [deg^2/m^2]."""
ADAM_SHARE = 0.02
"""Learning rate of Adam where none is given, as a fraction of a parameter's range."""


class _Finished(Exception):
    """The search is over."""


class _Recorder:
    """Evaluates, keeps every evaluation and ends the search."""

    def __init__(self, evaluate: Evaluate, settings: OptimiserSettings, bounds: Bounds, progress: str) -> None:
        self.evaluate, self.settings, self.bounds = evaluate, settings, bounds
        self.records: list[Evaluation] = []
        self.bar = tqdm(total=settings.max_iterations, desc=progress, unit="it", leave=False, disable=None)

    def __call__(self, parameters: Vector) -> Evaluation:
        # Adam runs its course: it turns where it overshoots, and its steps grow short there.
        near = (0.0 if self.settings.method is Method.ADAM else RESOLUTION) * self.bounds.range
        for record in self.records:
            if np.all(np.abs(record.parameters - parameters) <= 1e-12 * self.bounds.range):
                return record
            if np.all(np.abs(record.parameters - parameters) < near):
                raise _Finished
        if len(self.records) >= self.settings.max_iterations:
            raise _Finished
        record = self.evaluate(parameters)
        self.records.append(record)
        self.bar.set_postfix_str(f"loss {record.loss:.2e} at {np.array2string(parameters, precision=2)}")
        self.bar.update()
        if record.loss < self.settings.stop_below or not np.isfinite(record.loss):
            raise _Finished
        return record


def minimise(
    evaluate: Evaluate,
    start: Vector,
    bounds: Bounds,
    settings: OptimiserSettings,
    progress: str = "inversion",
    rates: Sequence[float | None] | None = None,
    sample: Sequence[Evaluation] = (),
) -> list[Evaluation]:
    """Every evaluation from `start` to the end, in order; the answer is the one of minimum loss (`best`).

    It ends below `stop_below`, after `max_iterations` evaluations, or when the method itself finds a minimum.
    rates: learning rate of each parameter that has its own; sample: of the secants (`inverse.secants.sample`), which
    start at its best. Gauss-Newton requires evaluations with their Jacobian.
    """
    recorder = _Recorder(evaluate, settings, bounds, progress)
    start = bounds.clip(start)
    try:
        match settings.method:
            case Method.GRADIENT_DESCENT:
                _gradient_descent(recorder, start, bounds, _rates(settings, bounds, rates))
            case Method.ADAM:
                _adam(recorder, start, bounds, _rates(settings, bounds, rates), settings.max_iterations)
            case Method.LBFGSB:
                _lbfgsb(recorder, start, bounds)
            case Method.GAUSS_NEWTON:
                _gauss_newton(recorder, start, bounds)
            case Method.SECANTS:
                secants(recorder, sample, bounds)
    except _Finished:
        pass
    finally:
        recorder.bar.close()
    return recorder.records


def best(records: Sequence[Evaluation]) -> Evaluation:
    """The evaluation of minimum loss."""
    return lowest(records)


def _rates(settings: OptimiserSettings, bounds: Bounds, own: Sequence[float | None] | None) -> Vector:
    """Learning rate of each parameter, shape [U]."""
    if settings.learning_rate is not None:
        shared = np.full_like(bounds.range, settings.learning_rate)
    elif settings.method is Method.ADAM:
        shared = ADAM_SHARE * bounds.range
    else:
        shared = np.full_like(bounds.range, DESCENT_RATE)
    return np.array([rate or other for rate, other in zip(own or [None] * len(shared), shared, strict=True)])


def _gradient_descent(evaluate: Evaluate, start: Vector, bounds: Bounds, rates: Vector) -> None:
    """u <- u - rate * d(loss)/du, projected onto the bounds (the paper, section "Inverse problem")."""
    before, u = None, start
    while before is None or np.any(u != before):
        before, u = u, bounds.clip(u - rates * evaluate(u).slope)


def _adam(evaluate: Evaluate, start: Vector, bounds: Bounds, rates: Vector, steps: int) -> None:
    """Adam (Kingma & Ba 2015) as torch has it, projected onto the bounds after each step; a step per evaluation."""
    values = [torch.tensor(value, dtype=torch.float64) for value in start]
    groups = [{"params": [value], "lr": float(rate)} for value, rate in zip(values, rates, strict=True)]
    adam = torch.optim.Adam(groups)
    for _ in range(steps):
        record = evaluate(np.array([value.item() for value in values]))
        for value, slope in zip(values, record.slope, strict=True):
            value.grad = torch.tensor(slope, dtype=torch.float64)
        adam.step()
        for value, lower, upper in zip(values, bounds.lower, bounds.upper, strict=True):
            value.clamp_(float(lower), float(upper))


def _lbfgsb(evaluate: Evaluate, start: Vector, bounds: Bounds) -> None:
    """L-BFGS-B (Byrd, Lu, Nocedal & Zhu 1995) in variables scaled so that its first step is a sensible one.

    Its first model has curvature one: the first trial goes as far as the gradient is long. Loss and parameters
    are scaled so that this is 2 f / |f'|, which for a single number that can be fitted is the Gauss-Newton step.
    A start on a ridge or a plateau, such as sand at rest against a wall of which neither velocity is downhill, is left
    for the middle of the box.
    """
    first = evaluate(start)
    promised = np.maximum(first.slope * (start - bounds.lower), first.slope * (start - bounds.upper)).sum()
    if promised < STATIONARY * first.loss:
        start = bounds.middle
        first = evaluate(start)
    # Steepest descent in fractions of the range, so that parameters of different units count alike.
    slope = first.slope * bounds.range
    steepness = float(np.linalg.norm(slope))
    if steepness == 0.0:
        return
    length = min(2.0 * first.loss / steepness, LONGEST_FIRST_STEP)
    unit, scale = bounds.range * length, steepness * length

    def scaled(x: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]]:
        record = evaluate(bounds.clip(start + x * unit))
        return record.loss / scale, record.slope * unit / scale

    scipy.optimize.minimize(
        scaled,
        np.zeros_like(start),
        jac=True,
        method="L-BFGS-B",
        bounds=list(zip((bounds.lower - start) / unit, (bounds.upper - start) / unit, strict=True)),
        options={"ftol": 1e-12, "gtol": 1e-6},
    )


def _gauss_newton(evaluate: Evaluate, start: Vector, bounds: Bounds) -> None:
    """Least squares by the Jacobian: SciPy's trust region reflective method (Branch, Coleman & Li 1999)."""

    def part(name: str) -> Callable[[Vector], NDArray[np.float64]]:
        return lambda parameters: np.asarray(getattr(evaluate(bounds.clip(parameters)), name))

    scipy.optimize.least_squares(
        part("residual"),
        start,
        part("jacobian"),
        bounds=(bounds.lower, bounds.upper),
        x_scale=bounds.range,
        method="trf",
    )


def explore(
    forward: Forward, target: Values, problem: Problem, *, components: int = 1, at_once: int = 1
) -> list[Evaluation]:
    """The baseline without gradients: Optuna proposes, the forward model predicts. Every prediction, in order.

    It begins at the problem's start and ends below `stop_below` or after `max_trials` predictions, `at_once` of which
    are asked for together. components: see `Observation`.
    """
    settings, names = problem.optimiser, problem.names
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    study = optuna.create_study(sampler=_sampler(settings, at_once, problem.named(problem.initial)))
    study.enqueue_trial(problem.named(problem.initial))
    ranges: dict[str, BaseDistribution] = {
        name: FloatDistribution(*bounds) for name, bounds in zip(names, problem.bounds, strict=True)
    }
    records: list[Evaluation] = []
    with tqdm(total=settings.max_trials, desc=settings.sampler, unit="run", leave=False, disable=None) as bar:
        while len(records) < settings.max_trials:
            count = min(at_once, settings.max_trials - len(records))
            trials = [study.ask(ranges) for _ in range(count)]
            points = [np.array([trial.params[name] for name in names]) for trial in trials]
            start = time.perf_counter()
            observations = forward.observe(points)
            seconds = (time.perf_counter() - start) / count
            for trial, point, observation in zip(trials, points, observations, strict=True):
                loss = components * float(np.mean((observation - target) ** 2))
                finite = bool(np.isfinite(loss))
                study.tell(trial, loss if finite else None, state=None if finite else TrialState.FAIL)
                records.append(
                    Evaluation(
                        parameters=point,
                        observation=observation,
                        loss=loss,
                        gradient=None,
                        forward_s=seconds,
                        backward_s=0.0,
                    )
                )
            bar.update(count)
            minimum = best(records).loss
            bar.set_postfix_str(f"loss {minimum:.2e}")
            if minimum < settings.stop_below:
                break
    return records


def _sampler(settings: OptimiserSettings, at_once: int, initial: dict[str, float]) -> BaseSampler:
    """What proposes the next points. Raises InputError."""
    if settings.sampler is Sampler.TPE:
        # Points that are asked for together must not be the same one.
        return TPESampler(seed=settings.seed, constant_liar=at_once > 1)
    if find_spec("cmaes") is None:
        raise InputError("expected tpe, cma-es requires the package cmaes", key="optimiser.sampler")
    return CmaEsSampler(seed=settings.seed, x0=initial)
