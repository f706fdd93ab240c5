"""The most probable parameters, fields among them, and what the observation tells of each: Laplace's approximation.

    2 J(w) = |L^-1 (F(w) - y)|^2 + |w|^2,    R = N + (1 + 1/n) C = L L^T
    G = L^-1 dF/dw = U S V^T,    covariance of w = I - V diag(s^2 / (1 + s^2)) V^T

| symbol | variable | meaning |
|---|---|---|
| w | `white` | independent normal numbers of the prior, of which fields and numbers are functions |
| F | `numbers` | what runs of the MPM show, mean over n jitter seeds |
| N, C | `noise` | covariance of the measurement; of flows that differ in their jitter seed alone |

A field is u = S A w (`inverse.parameters.field`), a number lower + (upper - lower) Phi(w), Phi the normal distribution:
uniform between its bounds. Observations are exact; derivatives are the adjoint's, through the smooth operator: one
reverse pass for each combination of the numbers, one replay of the run for all. Both are averaged over jitter seeds.

Gauss-Newton steps solve the problem that is linear about w; a step is halved until runs show that J has fallen.
Derivatives are taken of those combinations of the numbers alone that the prior moves by more than their errors. The
posterior is a low-rank update of the prior by the eigenpairs of the Hessian of the misfit, preconditioned by the prior
(Bui-Thanh, Ghattas, Martin & Stadler, A computational framework for infinite-dimensional Bayesian inverse problems,
SIAM J. Sci. Comput. 35 (2013) A2494-A2523): along V_k the observation tells s_k^2 times as much as the prior.
"""

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
import scipy.linalg
import torch
from scipy.special import ndtr
from tqdm import tqdm

from datasets.flow.trajectory import brackets
from datasets.processes import processors
from datasets.scene import Scene
from datasets.scene.grid_field import Floats
from inverse.answer import Answer, MpmRun, Purpose, judge
from inverse.field_posterior import FieldPosterior
from inverse.forward.adjoint import derivatives
from inverse.noise import Scatter, fit, shrunk
from inverse.observations import Observation, Rollout
from inverse.parameters.field import BAND
from inverse.problem import Problem
from inverse.result import Result
from inverse.target import read_target
from mpm import simulate, simulate_many
from mpm.adjoint.gradient import Gradient, pull_back_all
from mpm.adjoint.tape import FlowAdjoints, Tape, check, steady
from mpm.arrays.features import features_of

MEMORY_MIB = 512.0
"""For the checkpoints of the runs that are reversed side by side [MiB]."""
SHORTEST = 0.25
"""Of the steps of the line search, over a whole one."""
DECREASE = 0.1
"""Of J, over that of the linear problem, with which a step is accepted."""
CONVERGED = 0.5
"""Decrease of J below which there is nothing left to gain: that of one standard deviation along one direction."""
SMALL = 0.2
"""Variance of a combination over draws of the prior, over that of its errors, below which it is left out."""
FIRST_SEEDS, FIRST_CONVERGED = 2, 2.0
"""Jitter seeds of the first search, and how far from its minimum it ends."""
DRAWS = 100
"""Samples of a field that are kept."""
LEFT = 2.0
"""Promised decrease of the objective beyond which the report says so: two standard deviations along one direction."""


def of_fields(problem: Problem) -> Result:
    """The most probable fields and numbers by the MPM's adjoint, their posterior, and a run of the solver there."""
    began, used = time.perf_counter(), time.process_time()
    target = read_target(problem, simulate)
    flow = WhiteFlow(problem, target.observation)
    measured = target.errors.matrix
    iterations, seed = problem.optimiser.max_iterations, problem.scene.seed
    rng, start = np.random.default_rng(seed), np.zeros(flow.size)
    runs = flow.observe([start] * len(problem.scatter_seeds), problem.scatter_seeds)
    draws = flow.observe(list(rng.standard_normal((len(runs), flow.size))), [seed] * len(runs))

    def objective(runs: Floats, seeds: Sequence[int]) -> "Objective":
        return Objective(flow, target.values, measured + (1.0 + 1.0 / len(seeds)) * shrunk(runs), draws, seeds)

    first = objective(runs, problem.seeds[:FIRST_SEEDS])
    nearest = first.minimise(start, iterations, FIRST_CONVERGED)
    # Again with the scatter of the fields that were found, and more seeds.
    runs = flow.observe([nearest.mean] * len(runs), problem.scatter_seeds)
    second = objective(runs, problem.seeds)
    posterior = second.minimise(nearest.mean, iterations)
    scene = flow.scene_at(posterior.mean, problem.scatter_seeds[-1] + 1)
    (shown,) = simulate_many([scene])
    values = flow.values(posterior.mean)
    spread = np.sqrt(np.maximum(1.0 - (posterior.removed[flow.of_numbers] ** 2).sum(axis=1), 0.0))
    ends = [ndtr(posterior.mean[flow.of_numbers] + sign * BAND * spread) for sign in (1.0, -1.0)]
    check = MpmRun(
        purpose=Purpose.CHECK,
        parameters=values,
        point=problem.box.shares(values),
        numbers=target.observation.observe(shown),
        trajectory=shown,
        file="check.npz",
    )
    expected = target.observation.prior_scatter(target.values)
    scatter = Scatter(deviations=runs - runs.mean(axis=0), freedom=len(runs) - 1, expected=expected)
    answer = Answer(
        parameters=values,
        interval=problem.box.at(np.stack(ends[::-1])),
        checks=(check,),
        fit=fit(target, check.numbers[None], scatter, parameters=posterior.informative),
    )
    flow.bar.close()
    fields = field_posteriors(flow, posterior)
    unknowns = sum(int(each.unknown.inside.sum()) for each in fields) + len(problem.numbers)
    notes = [
        f"{unknowns} values from {len(target.values)} numbers: {posterior.informative} directions in which the "
        "observation tells more than the prior, by the Gaussian approximation about the most probable values."
    ]
    if posterior.promised > LEFT:
        notes.append(
            f"**The search ended where its derivatives promise {posterior.promised:.1f} more of the objective, which "
            "no step brought: the fields are known less well than their widths say. More `optimiser.seeds` make "
            "derivatives smoother.**"
        )
    total = time.perf_counter() - began
    cost = {"flows": flow.runs + 1 + int(problem.target.twin), "reverse_passes": flow.reverses}
    return Result(
        problem=problem,
        target=target,
        verdict=judge(problem, (answer,)),
        answers=(answer,),
        forward="MPM",
        predicted=check.numbers,
        deposit=shown.positions[-1],
        iterations=[*first.iterates, *second.iterates],
        mpm_runs=(check,),
        fields=tuple(fields),
        notes=tuple(notes),
        seconds={"total": total, "processors": time.process_time() - used},
        record=cost | {"combinations": len(posterior.jacobian), "eigenvalues": posterior.decomposition[0].tolist()},
    )


def field_posteriors(flow: "WhiteFlow", posterior: "Gaussian") -> list[FieldPosterior]:
    """Each field with its widths at the nodes."""
    problem, draws = flow.problem, posterior.draws(DRAWS)
    posteriors = []
    for unknown, part, latent in zip(problem.fields, flow.parts, flow.latents(posterior.mean), strict=True):
        removed = (unknown.prior.field(posterior.removed[part]) ** 2).sum(axis=1)
        posteriors.append(
            FieldPosterior(
                unknown=unknown,
                latent=latent,
                width=np.sqrt(np.maximum(unknown.prior.deviation**2 - removed, 0.0)),
                draws=unknown.values(unknown.prior.field(draws[:, part].T).T),
                truth=unknown.truth(problem.scene) if problem.target.twin else None,
            )
        )
    return posteriors


class WhiteFlow:
    """Runs at W white numbers, which show M numbers. Raises InputError for a scene that the adjoint does not know."""

    def __init__(self, problem: Problem, observation: Observation) -> None:
        self.problem, self.observation = problem, observation
        check(features_of([problem.scene], "f32"))
        self.runs = self.reverses = 0
        """MPM runs and reverse passes so far."""
        self.bar = tqdm(desc="adjoint", unit="run", leave=False, disable=None)
        ends = np.cumsum([0, *(each.prior.size for each in problem.fields), len(problem.numbers)])
        *self.parts, self.of_numbers = [slice(int(first), int(end)) for first, end in pairwise(ends)]
        """Which white numbers are those of each field; of all numbers."""
        self.size = int(ends[-1])
        scene = problem.scene
        observed = [part.observation.times for part in observation.parts if part.observation.times is not None]
        times = np.concatenate([[scene.duration], *observed])
        before, share = brackets(np.arange(scene.frames, dtype=np.float64) * scene.frame_dt, times)
        self.frames = sorted({*before.tolist(), *(before + np.ceil(share).astype(np.int64)).tolist()})
        """Frames that the observation looks at, and the last."""

    def latents(self, white: Floats) -> list[Floats]:
        """u [K] of each field."""
        return [each.prior.field(white[part]) for each, part in zip(self.problem.fields, self.parts, strict=True)]

    def values(self, white: Floats) -> Floats:
        """The numbers, shape [U]."""
        return self.problem.box.at(ndtr(white[self.of_numbers]))

    def scene_at(self, white: Floats, seed: int) -> Scene:
        """The scene at white numbers [W] with a jitter seed."""
        latents = zip(self.problem.fields, self.latents(white), strict=True)
        return self.problem.scene_at(self.values(white), seed, [each.values(latent) for each, latent in latents])

    def observe(self, points: Sequence[Floats], seeds: Sequence[int]) -> Floats:
        """The observed numbers [points, M] of runs at white numbers [W], each with its jitter seed."""
        scenes = [self.scene_at(each, seed) for each, seed in zip(points, seeds, strict=True)]
        together, numbers = 2 * processors(), []
        for first in range(0, len(scenes), together):
            runs = simulate_many(scenes[first : first + together])
            numbers += [self.observation.observe(run) for run in runs]
            self.bar.update(len(runs))
        self.runs += len(scenes)
        return np.stack(numbers)

    def mean(self, white: Floats, seeds: Sequence[int]) -> Floats:
        """The observed numbers [M] at white numbers [W], mean over jitter seeds."""
        return np.asarray(self.observe([white] * len(seeds), seeds).mean(axis=0))

    def jacobian(self, white: Floats, combinations: Floats, seeds: Sequence[int]) -> Floats:
        """Derivatives [r, W] of `combinations` [r, M] of the numbers at white numbers [W], mean over jitter seeds."""
        jacobian = np.zeros((len(combinations), self.size))
        for first in range(0, len(seeds), processors()):
            scenes = [steady(self.scene_at(white, seed)) for seed in seeds[first : first + processors()]]
            tape = Tape(scenes, self.frames, precision="f32", memory_mib=MEMORY_MIB, outputs=len(combinations))
            seen = [self.adjoints(tape, index, combinations) for index in range(len(scenes))]
            together = [[FlowAdjoints(by[number]) for by, _ in seen] for number in range(len(combinations))]
            slopes: list[dict[str, Floats]] = [{} for _ in scenes]
            for row, gradients in enumerate(pull_back_all(tape, together)):
                for index, gradient in enumerate(gradients):
                    explicit = seen[index][1][row]
                    jacobian[row] += self.pulled_back(gradient, white, explicit, slopes[index]) / len(seeds)
            self.runs += len(scenes)
            self.reverses += len(scenes) * len(combinations)
            self.bar.update(len(scenes) * (1 + len(combinations)))
        return jacobian

    def pulled_back(self, gradient: Gradient, white: Floats, explicit: Floats, known: dict[str, Floats]) -> Floats:
        """Derivatives with respect to the white numbers [W] from those with respect to what a run begins with.

        explicit: by the volumes that the observation sees itself, [N]; known: as `UnknownField.at_nodes`.
        """
        adjoint = np.zeros(self.size)
        for unknown, latent, part in zip(self.problem.fields, self.latents(white), self.parts, strict=True):
            adjoint[part] = unknown.prior.white(unknown.at_nodes(gradient, latent, explicit, known))
        if self.problem.numbers:
            density = np.exp(-0.5 * white[self.of_numbers] ** 2) / np.sqrt(2.0 * np.pi)
            slopes = derivatives(gradient, self.problem.kinds, self.values(white), self.problem.scene)
            adjoint[self.of_numbers] = slopes * self.problem.box.range * density
        return adjoint

    def adjoints(self, tape: Tape, index: int, combinations: Floats) -> tuple[Floats, Floats]:
        """Derivatives of the combinations [r, M] with respect to the observed positions, shape [r, T, N, D], and to the
        volumes of the particles, shape [r, N].
        """
        positions = torch.from_numpy(tape.positions(index)).requires_grad_()
        rollout = Rollout(
            positions=positions,
            times=np.array(self.frames) * self.problem.scene.frame_dt,
            volumes=torch.from_numpy(tape.batch.particles[index].volume).requires_grad_(),
        )
        numbers, seen = self.observation.predict(rollout), (positions, rollout.volumes)
        rows = [
            torch.autograd.grad(numbers, seen, torch.from_numpy(each), retain_graph=True, materialize_grads=True)
            for each in combinations
        ]
        by_positions, by_volumes = ([each.numpy() for each in column] for column in zip(*rows, strict=True))
        return np.stack(by_positions), np.stack(by_volumes)


@dataclass(frozen=True)
class Gaussian:
    """The posterior of W white numbers."""

    mean: Floats
    """The most probable ones, shape [W]."""
    jacobian: Floats
    """G of as many combinations of the numbers as matter, shape [r, W]."""
    promised: float
    """Decrease of J that another step would bring where the numbers are linear."""

    @cached_property
    def decomposition(self) -> tuple[Floats, Floats]:
        """s^2, shape [r], the largest first, and V, shape [W, r]."""
        _, singular, directions = np.linalg.svd(self.jacobian, full_matrices=False)
        return singular**2, directions.T

    @property
    def informative(self) -> int:
        """How many directions the observation tells more of than the prior."""
        return int((self.decomposition[0] > 1.0).sum())

    @property
    def removed(self) -> Floats:
        """V (s^2 / (1 + s^2))^(1/2), shape [W, r]: squares of its rows, or of their images, are removed variance."""
        values, directions = self.decomposition
        return np.asarray(directions * np.sqrt(values / (1.0 + values)))

    def draws(self, count: int) -> Floats:
        """Samples, shape [count, W]: mean + (I + V diag((1 + s^2)^(-1/2) - 1) V^T) times white noise."""
        values, directions = self.decomposition
        white = np.random.default_rng(0).standard_normal((count, len(self.mean)))
        return np.asarray(self.mean + white + (white @ directions * (1.0 / np.sqrt(1.0 + values) - 1.0)) @ directions.T)


class Objective:
    """J, its Gauss-Newton steps, and every iterate on the way."""

    def __init__(
        self, flow: WhiteFlow, target: Floats, covariance: Floats, draws: Floats, seeds: Sequence[int]
    ) -> None:
        """target: y [M]; covariance: R [M, M]; draws: numbers [n, M] of draws of the prior; seeds: n of F."""
        self.flow, self.target, self.seeds = flow, target, seeds
        self.root = scipy.linalg.cholesky(covariance, lower=True)
        basis, singular, _ = np.linalg.svd(self.whitened((draws - draws.mean(axis=0)).T), full_matrices=False)
        matter = int((singular**2 / (len(draws) - 1) > SMALL).sum())
        self.rows = np.asarray(basis[:, : max(1, matter)].T)
        """Orthonormal combinations of whitened numbers, in which draws vary by more than `SMALL`, shape [r, M]."""
        self.iterates: list[dict[str, float]] = []

    def whitened(self, numbers: Floats) -> Floats:
        """Numbers [M, ...] in units in which their errors are independent and 1."""
        return np.asarray(scipy.linalg.solve_triangular(self.root, numbers, lower=True))

    def evaluated(self, white: Floats, step: float) -> tuple[Floats, dict[str, float]]:
        """F [M] and the iterate at white numbers [W]; step: part of the Gauss-Newton step, 0 at the start."""
        numbers = self.flow.mean(white, self.seeds)
        residual = self.whitened(numbers - self.target)
        squares = float(residual @ residual)
        objective, misfit = 0.5 * (squares + float(white @ white)), math.sqrt(squares / len(residual))
        return numbers, {"objective": objective, "misfit": misfit, "step": step}

    def minimise(self, start: Floats, iterations: int, enough: float = CONVERGED) -> Gaussian:
        """From `start` [W] to the most probable white numbers; enough: decrease of J that a step must promise."""
        white, (numbers, iterate) = start, self.evaluated(start, 0.0)
        self.iterates.append(iterate)
        outer, decrease, first = self.whitened(np.eye(len(self.target))), math.inf, len(self.iterates)
        while True:
            jacobian = self.flow.jacobian(white, self.rows @ outer, self.seeds)
            residual = self.rows @ self.whitened(numbers - self.target)
            proposed = linear_mean(jacobian, white, residual)
            promised = gain(jacobian, residual, white, proposed - white)
            if min(promised, decrease) < enough or len(self.iterates) - first >= iterations:
                return Gaussian(white, jacobian, promised)
            step = 1.0
            while True:
                tried = white + step * (proposed - white)
                shown, iterate = self.evaluated(tried, step)
                decrease = self.iterates[-1]["objective"] - iterate["objective"]
                if decrease > DECREASE * gain(jacobian, residual, white, tried - white):
                    break
                if step <= SHORTEST:
                    return Gaussian(white, jacobian, promised)
                step *= 0.5
            white, numbers = tried, shown
            self.iterates.append(iterate)


def linear_mean(jacobian: Floats, white: Floats, residual: Floats) -> Floats:
    """The most probable w [W] of numbers that are linear about `white`, where they are off by `residual` [r].

    w = G^T (I + G G^T)^-1 (G w0 - residual): r equations in place of W.
    """
    inner = np.eye(len(residual)) + jacobian @ jacobian.T
    return np.asarray(jacobian.T @ np.linalg.solve(inner, jacobian @ white - residual))


def gain(jacobian: Floats, residual: Floats, white: Floats, step: Floats) -> float:
    """By how much J falls along `step` [W] where the numbers are linear."""
    after, moved = residual + jacobian @ step, white + step
    return float(0.5 * (residual @ residual + white @ white - after @ after - moved @ moved))
