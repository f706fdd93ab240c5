"""The inversion by one forward model: by its gradient from several starts in one batch, with its errors as noise.

    L(v) = r^T C^-1 r - 2 ln p(v),    r = y(v) - y*,    C = N + S + E

| symbol | variable | meaning |
|---|---|---|
| v | `points` | parameters in fractions of their ranges, shape [s, U] |
| y | `numbers` | what the forward model predicts, m numbers, shape [s, m] |
| N, S | `Target.errors` | errors of the measurement, scatter of one flow of the MPM |
| E | - | error of a surrogate by its band (`inverse.forward.gns`) |
| J | - | dy/dv by an emulator of all predictions so far |
| p, P | `Problem.prior` | a stated prior over the uniform one, and the inverse of its covariance |

Predictions that fill the box are the first emulator (`inverse.posterior`); the separate parts of its posterior are the
starts. From all of them together steps are made in lockstep that minimise, within the box and a trust region,

    g^T s + s^T (J^T C^-1 J + P) s

with g = dL/dv, exact, of all starts by one backward pass through one batch: Gauss-Newton steps whose metric alone is an
estimate, so that they end where the model's own misfit is stationary. Where there is no derivative (the MPM without its
adjoint, a parameter that makes other particles) slopes of the same emulator make g: each prediction corrects them. All
predictions give the posterior.
"""

import dataclasses
import math
import time
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.optimize import lsq_linear
from scipy.spatial import cKDTree
from scipy.stats import chi2

from inverse.forward import Differentiable, Forward
from inverse.observations import Values
from inverse.observations.errors import Covariance
from inverse.observations.target import Target
from inverse.posterior import Matrix
from inverse.posterior.answers import Part, parts
from inverse.posterior.emulator import fewest_runs, fitted
from inverse.posterior.posterior import Posterior, Region, next_points, posterior
from inverse.posterior.reduction import reduction
from inverse.posterior.settings import CONSTANTS
from inverse.problem import Problem

FIRST, PER_UNKNOWN = 6, 4
"""Predictions that fill the box, the problem's start among them."""
STARTS = 6
"""At most."""
STEPS = 6
"""From each start, at most."""
RADIUS = 0.1
"""First radius of the trust region, in ranges of the box."""
NEGLIGIBLE = 0.02
"""Decrease of L that no further step is made for: a seventh of a standard deviation of one number."""
ROUNDS, KNOWN = 3, 0.3
"""Searches for minima at most, with further predictions between them while its emulator has more than this share of the
variance."""
ROUGH = 0.05
"""Expected roughness of a surrogate's own numbers, over their standard deviations by C."""
EXCLUDED = 1e-3
"""Probability of parameters beyond the surrogate's region, were its band right."""
STEEP = 4.0
"""By how much the logarithm of the probability falls beyond the region, for each that the likelihood falls."""


@dataclass(frozen=True, kw_only=True)
class Inversion:
    """What the forward model found."""

    forward: Forward
    problem: Problem
    target: Target
    """Its part of the target's numbers, with S and E in their covariance, shape [m]."""
    points: Matrix
    """Where it predicted, shape [s, U]."""
    numbers: Matrix
    """What it predicted there, shape [s, m]."""
    minima: Matrix
    """Where the steps from each start ended, shape [k, U]."""
    settled: NDArray[np.bool_]
    """Which of them no step leads on from, shape [k]."""
    seconds: float
    rough: float = ROUGH
    """Expected roughness of the numbers, over their standard deviations by C."""
    region: Region | None = None
    """What of the box its posterior is looked for in; all of it where absent."""
    factor: float = 1.0
    """By which the region is wider than the band says, for what the MPM showed."""

    @cached_property
    def posterior(self) -> Posterior:
        """By its emulator, in the units of the box."""
        rng = np.random.default_rng([self.problem.optimiser.seed, len(self.points)])
        scatter = self.rough * self.target.deviation
        return posterior(
            self.points,
            self.numbers,
            self.target,
            scatter=scatter,
            rng=rng,
            factor=self.factor,
            region=self.region,
            prior=self.problem.prior,
        )

    @cached_property
    def regions(self) -> list[Part]:
        """The separate parts of its 95 % region, each with its median."""
        rng = np.random.default_rng([self.problem.optimiser.seed, 1])
        return parts(self.posterior.samples, self.posterior.likelihood, rng)

    @cached_property
    def answers(self) -> list[Part]:
        """The same, each with its minimum of L: where runs of the MPM are led to."""
        answers = []
        for part in self.regions:
            low, high = part.points.min(axis=0), part.points.max(axis=0)
            # No sample lies at a bound.
            slack = 0.05 * (high - low)
            own = self.minima[np.all((self.minima >= low - slack) & (self.minima <= high + slack), axis=1)]
            point = own[int(np.argmin(self.misfits(own) + self.penalty(own)))] if len(own) else part.point
            answers.append(dataclasses.replace(part, point=point))
        return answers

    def asked(self, points: Matrix) -> "Inversion":
        """With predictions at further points [k, U]."""
        return self.seen(points, np.stack(self.forward.observe(list(self.problem.box.at(points)))))

    def seen(self, points: Matrix, numbers: Matrix) -> "Inversion":
        """With what was predicted at further points [k, U], shape [k, m]."""
        every = np.concatenate([self.points, points])
        return dataclasses.replace(self, points=every, numbers=np.concatenate([self.numbers, numbers]))

    def misfits(self, points: Matrix) -> Values:
        """r^T C^-1 r at some of `points` [k, U], shape [k]."""
        index = [int(np.argmin(np.abs(self.points - each).sum(axis=1))) for each in points]
        return misfits(self.numbers[index] - self.target.values, self.precision)

    def penalty(self, points: Matrix) -> Values:
        """-2 ln p at points [k, U], shape [k]."""
        prior = self.problem.prior
        return np.zeros(len(points)) if prior is None else -2.0 * prior(points)

    @cached_property
    def precision(self) -> Matrix:
        """C^-1, shape [m, m]."""
        return np.asarray(np.linalg.inv(self.target.errors.matrix))

    @property
    def fall(self) -> float:
        """By how much the logarithm of the likelihood falls from its top to the edge of the region."""
        return 0.5 * float(chi2.isf(EXCLUDED, self.points.shape[1]))

    def beyond(self, points: Matrix) -> Values:
        """By how much the logarithm of the likelihood at points [S, U] falls below that at the region's edge, [S]."""
        found, log_prior = self.posterior, self.posterior.likelihood.log_prior
        top = (found.samples.log_likelihood - log_prior(found.samples.points)).max()
        return np.asarray(top - self.fall - (found.likelihood(points) - log_prior(points)))

    def around(self, count: int, rng: np.random.Generator) -> Matrix:
        """Points of its 95 % region that lie far from its answers and from each other, shape [count, U].

        Of more than `few_parameters` points that fill the box around it evenly.
        """
        samples, unknowns = self.posterior.samples, self.points.shape[1]
        if unknowns > CONSTANTS.few_parameters:
            return Region.around(samples).filled(count, rng)
        threshold = np.quantile(samples.log_likelihood, 1.0 - CONSTANTS.credible)
        inside = samples.points[samples.log_likelihood >= threshold]
        chosen = [each.point for each in self.answers]
        scale = np.maximum(inside.std(axis=0), 1e-9)
        for _ in range(count):
            apart = cKDTree(np.stack(chosen) / scale).query(inside / scale)[0]
            chosen.append(inside[int(np.argmax(apart))])
        return np.stack(chosen[-count:])

    def within(self, points: Matrix) -> Values:
        """Logarithm of the probability that the region holds points [S, U]: 0 inside, steep beyond, shape [S]."""
        return -STEEP * np.maximum(self.beyond(points), 0.0)

    def trend(self, points: Matrix) -> Matrix:
        """1 and its first U components at points [S, U], shape [S, 1 + U]: the trend of an emulator of the MPM."""
        emulator, count = self.posterior.emulator, points.shape[1]
        # In units of their standard deviation over the predictions.
        spread = emulator.numbers[:, :count].std(axis=0)
        found = emulator.mean(points)[:, :count] / np.maximum(spread, 1e-300)
        return np.concatenate([np.ones((len(points), 1)), found], axis=1)

    def compared(self, points: Matrix, shown: Matrix) -> "Inversion":
        """Its region as wide as runs of the MPM at points [n, U] contradict it, that show numbers [n, M].

        Off by more than the band allows: the squared difference, in units of C, that has a mean of 1 for each number.
        """
        found = self.posterior
        every, label = np.unique(points, axis=0, return_inverse=True)
        own = np.stack([self.forward.select(each) for each in shown])
        means = found.reduction(np.stack([own[label == each].mean(axis=0) for each in range(len(every))]))
        residual = means - found.emulator.mean(every)
        fixed = found.likelihood.fixed / self.factor**2
        square = np.einsum("sr,rs->s", residual, np.linalg.solve(fixed, residual.T))
        factor = float(np.sqrt(square.max() / chi2.isf(0.05, residual.shape[1])))
        return self if factor <= self.factor else dataclasses.replace(self, factor=factor)


def inverted(forward: Forward, problem: Problem, target: Target, scatter: Values, *, rough: float = ROUGH) -> Inversion:
    """Find the answers of `forward`; scatter: standard deviation of each number of `target` per flow of the MPM [M]."""
    began, unknowns = time.perf_counter(), len(problem.names)
    rng = np.random.default_rng([problem.optimiser.seed, 0])
    box = problem.box
    cube = Region.whole(unknowns).filled(FIRST + PER_UNKNOWN * unknowns - 1, rng)
    points = np.concatenate([box.shares(problem.initial)[None], cube])
    numbers = np.stack(forward.observe(list(box.at(points))))
    nearest = int(np.argmin(((numbers - forward.select(target.values)) ** 2).mean(axis=1)))
    seen = as_predicted(forward, target, scatter, forward.errors(box.at(points[nearest])))
    state = Inversion(
        forward=forward,
        problem=problem,
        target=seen,
        points=points,
        numbers=numbers,
        minima=points[:0],
        settled=np.zeros(0, bool),
        seconds=0.0,
        rough=rough,
    )
    for _ in range(ROUNDS):
        state = with_minima(state)
        if state.posterior.emulator_share < KNOWN:
            break
        state = filled(state, rng)
    return dataclasses.replace(state, seconds=time.perf_counter() - began)


def with_minima(state: Inversion) -> Inversion:
    """With the minima that its answers lead to, and a region as wide as the lowest of them asks for.

    What the surrogate cannot fit it errs by: Birge's ratio, as in `inverse.noise`.
    """
    starts = [each.point for each in state.answers[:STARTS]]
    starts = [each for each in starts if not (state.minima[state.settled] == each).all(axis=1).any()]
    if starts:
        state = descended(state, np.stack(starts))
    free = len(state.target.values) - state.points.shape[1]
    ratio = math.sqrt(float(state.misfits(state.minima).min()) / free) if free > 0 else 0.0
    return dataclasses.replace(state, factor=max(1.0, ratio))


def filled(state: Inversion, rng: np.random.Generator) -> Inversion:
    """With further predictions where its emulator knows too little; of many parameters in a region of their own."""
    unknowns = state.points.shape[1]
    if unknowns <= CONSTANTS.few_parameters:
        return state.asked(next_points(state.posterior, PER_UNKNOWN, rng))
    region = around_minima(state)
    return dataclasses.replace(state.asked(region.filled(fewest_runs(unknowns), rng)), region=region)


def as_predicted(forward: Forward, target: Target, scatter: Values, errors: Matrix) -> Target:
    """What the surrogate predicts of `target`, with the errors that it may be off by."""
    index = forward.select(np.arange(len(target.values), dtype=np.float64)).astype(np.int64)
    covariance = target.errors.some(index).matrix + np.diag(scatter[index] ** 2) + errors.T @ errors
    return dataclasses.replace(target, values=target.values[index], errors=Covariance.of(covariance))


def misfits(residual: Matrix, precision: Matrix) -> Values:
    """r^T C^-1 r of residuals [k, m], shape [k]."""
    return np.asarray(((residual @ precision) * residual).sum(axis=1))


def differentiated(state: Inversion, points: Matrix) -> tuple[Inversion, Matrix, Matrix]:
    """With what the model predicts at points [k, U]; this, shape [k, m], and dL/dv there, shape [k, U]."""
    box = state.problem.box
    if not isinstance(state.forward, Differentiable):
        state = state.asked(points)
        numbers = state.numbers[-len(points) :]
        return state, numbers, sloped(state, points, numbers) + steepness(state, points)
    parameters = torch.tensor(box.at(points), dtype=torch.float64, requires_grad=True)
    predicted = state.forward.predict(parameters)
    numbers = predicted.detach().numpy()
    weights = 2.0 * (numbers - state.target.values) @ state.precision
    # Of a sum: a tensor of weights makes torch load sympy.
    (gradient,) = torch.autograd.grad((predicted * torch.from_numpy(weights)).sum(), parameters)
    state = state.seen(points, numbers)
    slopes = gradient.numpy() * box.range
    # In a parameter that makes other particles autograd finds none.
    without = ~slopes.any(axis=0)
    if without.any():
        slopes[:, without] = sloped(state, points, numbers)[:, without]
    return state, numbers, slopes + steepness(state, points)


def steepness(state: Inversion, points: Matrix) -> Matrix:
    """d(-2 ln p)/dv at points [k, U], shape [k, U]."""
    prior = state.problem.prior
    return np.zeros_like(points) if prior is None else -2.0 * prior.slope(points)


def descended(state: Inversion, starts: Matrix) -> Inversion:
    """With the minima of L besides that steps in lockstep from `starts` [k, U] lead to."""
    count = len(starts)
    best, lowest, slopes = starts.copy(), np.full(count, np.inf), np.zeros_like(starts)
    radius, moving, trial = np.full(count, RADIUS), np.arange(count), starts
    for _ in range(STEPS):
        state, numbers, gradients = differentiated(state, trial)
        found = misfits(numbers - state.target.values, state.precision) + state.penalty(trial)
        better = found < lowest[moving]
        length = np.abs(trial - best[moving]).max(axis=1)
        radius[moving] = np.where(better, 2.0 * radius[moving], 0.25 * length)
        best[moving[better]], lowest[moving[better]] = trial[better], found[better]
        slopes[moving[better]] = gradients[better]
        steps, gains = stepped(state, best[moving], slopes[moving], radius[moving])
        going = gains > NEGLIGIBLE
        moving, trial = moving[going], (best[moving] + steps)[going]
        if not len(moving):
            break
    settled = np.concatenate([state.settled, ~np.isin(np.arange(count), moving)])
    return dataclasses.replace(state, minima=np.concatenate([state.minima, best]), settled=settled)


def stepped(state: Inversion, points: Matrix, slopes: Matrix, radius: Values) -> tuple[Matrix, Values]:
    """Steps [k, U] from points [k, U] with dL/dv [k, U], and by how much L should fall with each, shape [k]."""
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
    inner = outward @ state.precision @ outward.T
    prior = state.problem.prior
    return np.stack([rise @ inner @ rise.T + (0.0 if prior is None else prior.precision) for rise in rises])


def sloped(state: Inversion, points: Matrix, numbers: Matrix) -> Matrix:
    """d(r^T C^-1 r)/dv at points [k, U] where the model predicts `numbers` [k, m], by the emulator's slopes, [k, U]."""
    rises, outward = emulated_slopes(state, points)
    weights = 2.0 * (numbers - state.target.values) @ state.precision @ outward.T
    return np.stack([rise @ each for rise, each in zip(rises, weights, strict=True)])


def emulated_slopes(state: Inversion, points: Matrix) -> tuple[list[Matrix], Matrix]:
    """J^T = A B at points [k, U] by an emulator of all predictions: A of r components, each [U, r], and B [r, m]."""
    reduced = reduction(state.numbers, state.points, state.target, scatter=state.rough * state.target.deviation)
    emulator = fitted(state.points, reduced.components, np.maximum(state.rough * reduced.expected_scatter, 1e-12))
    width = 1e-4 * np.eye(points.shape[1])
    rises = [(emulator.mean(each + width) - emulator.mean(each - width)) / 2e-4 for each in points]
    return rises, reduced.basis.T / reduced.weights


def around_minima(state: Inversion) -> Region:
    """Three standard deviations about each minimum of L that its region holds, by L as it curves there."""
    found = state.misfits(state.minima) + state.penalty(state.minima)
    fall = chi2.isf(EXCLUDED, state.points.shape[1]) * state.factor**2
    minima = state.minima[found <= found.min() + fall]
    prior = 12.0 * np.eye(minima.shape[1])
    inverse = np.linalg.inv(metrics(state, minima) / state.factor**2 + prior)
    wide = 3.0 * np.sqrt(np.diagonal(inverse, axis1=1, axis2=2))
    low, high = (minima - wide).min(axis=0), (minima + wide).max(axis=0)
    return Region(low=np.maximum(low, 0.0), high=np.minimum(high, 1.0))
