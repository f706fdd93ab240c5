"""The inversion with one forward model: gradient steps from several starts in one batch, with its errors as noise.

    L(v) = r^T C^-1 r - 2 ln p(v),    r = y(v) - y*,    C = N + S + E

| symbol | variable | meaning |
|---|---|---|
| v | `points` | parameters in fractions of their ranges, shape [s, U] |
| y | `numbers` | prediction of the forward model, m numbers, shape [s, m] |
| N, S | `Target.errors` | errors of the measurement, scatter of one flow of the MPM |
| E | - | error of a surrogate from its band (`inverse.forward.gns`) |
| J | - | dy/dv by an emulator of all predictions so far |
| p, P | `Problem.prior` | a stated prior over the uniform one, and the inverse of its covariance |

Predictions that fill the box make the first emulator (`inverse.posterior`); the starts are the separate parts of its
posterior. Steps from all starts are made in lockstep. Each minimises, within the box and a trust region,

    g^T s + s^T (J^T C^-1 J + P) s

with the exact g = dL/dv, for all starts from one backward pass through one batch. These are Gauss-Newton steps in which
only the metric is an estimate, so that they end where the model's own misfit is stationary. Without a derivative (the
MPM without its adjoint, a parameter that changes the particles) the slopes of the same emulator give g, and each
prediction corrects them. All predictions give the posterior.
"""

import dataclasses
import math
import sys
import time

import numpy as np
import torch
from scipy.optimize import lsq_linear
from scipy.stats import chi2

from inverse.forward import Differentiable, Forward
from inverse.observations import Values
from inverse.observations.errors import Covariance
from inverse.observations.target import Target
from inverse.posterior import Matrix
from inverse.posterior.emulator import fewest_runs, fitted
from inverse.posterior.posterior import Region, next_points
from inverse.posterior.reduction import reduction
from inverse.posterior.settings import CONSTANTS
from inverse.problem import Problem
from inverse.search.inference import EXCLUDED, Inference, Inversion
from inverse.search.waves import ModelRun, filling, runs_of

FIRST, PER_UNKNOWN = 6, 4  # predictions that fill the box, including the problem's start
STARTS = 6  # largest number of starts
STEPS = 6  # largest number of steps from each start
RADIUS = 0.1  # first radius of the trust region, in ranges of the box
NEGLIGIBLE = 0.02  # decrease of L too small for a further step: a seventh of a standard deviation of one number
ROUNDS = 3  # most searches for minima
KNOWN = 0.3  # share of the emulator in the variance, above which further predictions are made
ROUGH = 0.05  # expected roughness of a surrogate's numbers, over their standard deviations from C


def inverted(forward: Forward, problem: Problem, target: Target, scatter: Values, *, rough: float = ROUGH) -> Inversion:
    """Find the answers of `forward`; scatter: standard deviation of each number of `target` per flow of the MPM [M]."""
    began, unknowns, box = time.perf_counter(), len(problem.names), problem.box
    rng = np.random.default_rng([problem.optimiser.seed, 0])

    def predict(points: Matrix, first: int) -> list[ModelRun]:
        return runs_of(points, forward.observe(list(box.at(points))))

    cube = filling(unknowns, FIRST + PER_UNKNOWN * unknowns - 1, rng)
    points = np.concatenate([box.shares(problem.initial)[None], cube])
    runs = predict(points, 0)
    squares = [((run.numbers - forward.select(target.values)) ** 2).mean() for run in runs]
    seen = as_predicted(forward, target, scatter, forward.errors(box.at(points[int(np.argmin(squares))])))
    state = Inversion(
        model=predict,
        knowledge=Inference(problem=problem, target=seen, scatter=rough * seen.deviation),
        seed=problem.optimiser.seed,
        budget=sys.maxsize,
        runs=tuple(runs),
        forward=forward,
        minima=points[:0],
        settled=np.zeros(0, bool),
        rough=rough,
    ).refined()
    for _ in range(ROUNDS):
        state = with_minima(state)
        if state.posterior.emulator_share < KNOWN:
            break
        state = filled(state, rng)
    return dataclasses.replace(state, seconds=time.perf_counter() - began)


def with_minima(state: Inversion) -> Inversion:
    """The search with the minima that its answers lead to; its region widens by the misfit of the lowest (Birge)."""
    starts = [answer.point for answer in state.answers[:STARTS]]
    starts = [start for start in starts if not (state.minima[state.settled] == start).all(axis=1).any()]
    if starts:
        state = descended(state, np.stack(starts))
    free = len(state.target.values) - state.minima.shape[1]
    ratio = math.sqrt(float(state.misfits(state.minima).min()) / free) if free > 0 else 0.0
    return state.refined(factor=max(1.0, ratio))


def filled(state: Inversion, rng: np.random.Generator) -> Inversion:
    """The search with further predictions where its emulator knows too little; for many parameters, in a new region."""
    unknowns = state.minima.shape[1]
    if unknowns <= CONSTANTS.few_parameters:
        return state.ran(next_points(state.posterior, PER_UNKNOWN, rng)).refined()
    region = around_minima(state)
    return dataclasses.replace(state.ran(region.filled(fewest_runs(unknowns), rng)), region=region).refined()


def as_predicted(forward: Forward, target: Target, scatter: Values, errors: Matrix) -> Target:
    """The part of `target` that the surrogate predicts, with the surrogate's errors added."""
    index = forward.select(np.arange(len(target.values), dtype=np.float64)).astype(np.int64)
    covariance = target.errors.some(index).matrix + np.diag(scatter[index] ** 2) + errors.T @ errors
    dof = None if target.dof is None else target.dof[index]
    return dataclasses.replace(target, values=target.values[index], errors=Covariance.of(covariance), dof=dof)


def differentiated(state: Inversion, points: Matrix) -> tuple[Inversion, Matrix, Matrix]:
    """The search with predictions at points [k, U]; these predictions, shape [k, m]; and dL/dv, shape [k, U]."""
    box, prior = state.knowledge.box, state.knowledge.problem.prior
    steepness = np.zeros_like(points) if prior is None else -2.0 * prior.slope(points)
    if not isinstance(state.forward, Differentiable):
        state = state.ran(points)
        numbers = state.numbers[-len(points) :]
        return state, numbers, sloped(state, points, numbers) + steepness
    parameters = torch.tensor(box.at(points), dtype=torch.float64, requires_grad=True)
    predicted = state.forward.predict(parameters)
    numbers = predicted.detach().numpy()
    weights = 2.0 * (numbers - state.target.values) @ state.precision
    # The gradient of a sum: with a tensor of weights torch would load sympy.
    (gradient,) = torch.autograd.grad((predicted * torch.from_numpy(weights)).sum(), parameters)
    state = dataclasses.replace(state, runs=(*state.runs, *runs_of(points, numbers)))
    slopes = gradient.numpy() * box.range
    # Autograd finds no gradient for a parameter that changes the particles.
    without = ~slopes.any(axis=0)
    if without.any():
        slopes[:, without] = sloped(state, points, numbers)[:, without]
    return state, numbers, slopes + steepness


def descended(state: Inversion, starts: Matrix) -> Inversion:
    """The search with further minima of L, from steps in lockstep from `starts` [k, U]."""
    count = len(starts)
    best, lowest, slopes = starts.copy(), np.full(count, np.inf), np.zeros_like(starts)
    radius, moving, trial = np.full(count, RADIUS), np.arange(count), starts
    for _ in range(STEPS):
        state, numbers, gradients = differentiated(state, trial)
        losses = state.losses(trial, numbers)
        better = losses < lowest[moving]
        length = np.abs(trial - best[moving]).max(axis=1)
        radius[moving] = np.where(better, 2.0 * radius[moving], 0.25 * length)
        best[moving[better]], lowest[moving[better]] = trial[better], losses[better]
        slopes[moving[better]] = gradients[better]
        steps, gains = stepped(state, best[moving], slopes[moving], radius[moving])
        going = gains > NEGLIGIBLE
        moving, trial = moving[going], (best[moving] + steps)[going]
        if not len(moving):
            break
    settled = np.concatenate([state.settled, ~np.isin(np.arange(count), moving)])
    return dataclasses.replace(state, minima=np.concatenate([state.minima, best]), settled=settled)


def stepped(state: Inversion, points: Matrix, slopes: Matrix, radius: Values) -> tuple[Matrix, Values]:
    """Steps [k, U] from points [k, U] with dL/dv [k, U], and the predicted decrease of L for each, shape [k]."""
    steps, gains = np.zeros_like(points), np.zeros(len(points))
    for index, (point, slope, metric) in enumerate(zip(points, slopes, metrics(state, points), strict=True)):
        lower = np.linalg.cholesky(metric + 1e-9 * max(float(np.trace(metric)), 1e-300) * np.eye(len(point)))
        low, high = np.maximum(-point, -radius[index]) - 1e-12, np.minimum(1.0 - point, radius[index]) + 1e-12
        step = lsq_linear(lower.T, np.linalg.solve(lower, -0.5 * slope), bounds=(low, high)).x
        steps[index] = np.clip(point + step, 0.0, 1.0) - point
        gains[index] = -float(slope @ steps[index] + steps[index] @ metric @ steps[index])
    return steps, gains


def metrics(state: Inversion, points: Matrix) -> Matrix:
    """J^T C^-1 J + P at points [k, U], shape [k, U, U]."""
    rises, outward = emulated_slopes(state, points)
    inner, prior = outward @ state.precision @ outward.T, state.knowledge.problem.prior
    return np.stack([rise @ inner @ rise.T + (0.0 if prior is None else prior.precision) for rise in rises])


def sloped(state: Inversion, points: Matrix, numbers: Matrix) -> Matrix:
    """d(r^T C^-1 r)/dv, [k, U], from the emulator's slopes, at points [k, U] with predictions `numbers` [k, m]."""
    rises, outward = emulated_slopes(state, points)
    weights = 2.0 * (numbers - state.target.values) @ state.precision @ outward.T
    return np.stack([rise @ weight for rise, weight in zip(rises, weights, strict=True)])


def emulated_slopes(state: Inversion, points: Matrix) -> tuple[list[Matrix], Matrix]:
    """J^T = A B at points [k, U], from an emulator of all predictions: A of r components, each [U, r], and B [r, m]."""
    made = state.points
    reduced = reduction(state.numbers, made, state.target, scatter=state.knowledge.scatter)
    emulator = fitted(made, reduced.components, np.maximum(state.rough * reduced.expected_scatter, 1e-12))
    width = 1e-4 * np.eye(points.shape[1])
    rises = [(emulator.mean(point + width) - emulator.mean(point - width)) / 2e-4 for point in points]
    return rises, reduced.basis.T / reduced.weights


def around_minima(state: Inversion) -> Region:
    """Three standard deviations around each minimum of L within the region, from the curvature of L at the minimum."""
    losses, factor = state.losses(state.minima), state.knowledge.factor
    fall = chi2.isf(EXCLUDED, state.minima.shape[1]) * factor**2
    minima = state.minima[losses <= losses.min() + fall]
    prior = 12.0 * np.eye(minima.shape[1])
    inverse = np.linalg.inv(metrics(state, minima) / factor**2 + prior)
    wide = 3.0 * np.sqrt(np.diagonal(inverse, axis1=1, axis2=2))
    low, high = (minima - wide).min(axis=0), (minima + wide).max(axis=0)
    return Region(low=np.maximum(low, 0.0), high=np.minimum(high, 1.0))
