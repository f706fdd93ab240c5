"""The MPM as a function of white numbers: independent normal numbers that determine unknown fields and numbers."""

import math
from collections.abc import Sequence
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
import torch
from scipy.special import ndtr
from tqdm import tqdm

from datasets.flow.trajectory import Trajectory, brackets
from datasets.processes import processors
from datasets.scene import Scene
from datasets.scene.grid_field import Floats
from inverse.forward.adjoint import derivatives
from inverse.observations import Observation, Rollout
from inverse.problem import Problem
from inverse.settings import Derivatives
from mpm import ALL, LAST, simulate_many
from mpm.adjoint.gradient import pull_back_all
from mpm.adjoint.tape import FlowAdjoints, Tape, steady

MEMORY_MIB = 512.0  # for the checkpoints of the runs that are reversed side by side [MiB]
KEPT, STEP = 0.05, 0.5
"""Smallest variance of a field along a direction of differences, over the largest; their step, root mean square over
the runs, in standard deviations of the prior."""
IDLE = 4  # columns in the design of differences that move nothing


class WhiteFlow:
    """Runs of the MPM at W white numbers, observed as M numbers."""

    def __init__(self, problem: Problem, observation: Observation) -> None:
        self.problem, self.observation = problem, observation
        self.runs = self.reverses = 0  # number of MPM runs and of reverse passes so far
        self.bar = tqdm(desc="adjoint", unit="run", leave=False, disable=None)
        ends = np.cumsum([0, *(unknown.prior.size for unknown in problem.fields), len(problem.numbers)])
        *self.parts, self.of_numbers = [slice(int(first), int(end)) for first, end in pairwise(ends)]
        """The white numbers of each field, and of all unknown numbers."""
        self.size = int(ends[-1])
        scene = problem.scene
        observed = [part.observation.times for part in observation.parts if part.observation.times is not None]
        times = np.concatenate([[scene.duration], *observed])
        before, share = brackets(np.arange(scene.frames, dtype=np.float64) * scene.frame_dt, times)
        self.frames = sorted({*before.tolist(), *(before + np.ceil(share).astype(np.int64)).tolist()})
        """Frames that the observation uses, and the last."""

    def latents(self, white: Floats) -> list[Floats]:
        """u [K] of each field."""
        return [unknown.prior.field(white[part]) for unknown, part in zip(self.problem.fields, self.parts, strict=True)]

    def fields(self, white: Floats) -> list[Floats]:
        """Values [K] of each field."""
        latents = zip(self.problem.fields, self.latents(white), strict=True)
        return [unknown.values(latent) for unknown, latent in latents]

    def values(self, white: Floats) -> Floats:
        return self.problem.box.at(ndtr(white[self.of_numbers]))

    def scene_at(self, white: Floats, seed: int) -> Scene:
        return self.problem.scene_at(self.values(white), seed, self.fields(white))

    def simulated(self, points: Sequence[Floats], seeds: Sequence[int]) -> list[Trajectory]:
        """Runs at white numbers [W], each with its jitter seed."""
        scenes, runs = list(map(self.scene_at, points, seeds)), list[Trajectory]()
        together, record = 2 * processors(), ALL if self.observation.over_time else LAST
        for first in range(0, len(scenes), together):
            runs += simulate_many(scenes[first : first + together], record=record)
            self.bar.update(len(scenes[first : first + together]))
        self.runs += len(scenes)
        return runs

    def observe(self, points: Sequence[Floats], seeds: Sequence[int]) -> Floats:
        """The observed numbers [points, M] of runs at white numbers [W], each with its jitter seed."""
        return np.stack([self.observation.observe(run) for run in self.simulated(points, seeds)])

    def mean(self, white: Floats, seeds: Sequence[int]) -> Floats:
        """Mean over jitter seeds of the observed numbers [M] at white numbers [W]."""
        return np.asarray(self.observe([white] * len(seeds), seeds).mean(axis=0))

    @property
    def reverses_combinations(self) -> bool:
        """Whether each combination of the numbers costs a reverse pass."""
        return self.problem.optimiser.derivatives is Derivatives.ADJOINT

    @cached_property
    def directions(self) -> Floats:
        """Orthonormal directions, [V, W]: those with at least `KEPT` of a field's largest variance, and each number."""
        rows = list[Floats]()
        for unknown, part in zip(self.problem.fields, self.parts, strict=True):
            _, spread, basis = np.linalg.svd(unknown.prior.field(np.eye(unknown.prior.size)), full_matrices=False)
            some = np.zeros((int((spread**2 > KEPT * spread[0] ** 2).sum()), self.size))
            some[:, part] = basis[: len(some)]
            rows.append(some)
        return np.concatenate([*rows, np.eye(self.size)[self.of_numbers]])

    def differences(self, white: Floats, combinations: Floats, seeds: Sequence[int]) -> Floats:
        """`jacobian` from V + 1 + `IDLE` runs for each seed, each of which moves along all V `directions` at once.
        Their steps are `STEP` times columns that are orthogonal to each other and to the constant. All runs contribute
        to every derivative (Plackett & Burman, The design of optimum multifactorial experiments, Biometrika 33 (1946)
        305-325); one direction at a time would need V times as many runs for the same noise in chaotic flows. Every
        second seed takes the opposite steps of the seed before it, so that terms of even order cancel. Apparent effects
        of the idle columns measure the noise, which is removed (`denoised`)."""
        count, rng = len(self.directions) + 1 + IDLE, np.random.default_rng(0)
        slope: Floats | float = 0.0
        for pair in range(0, len(seeds), 2):
            columns = np.column_stack([np.ones(count), rng.standard_normal((count, count - 1))])
            steps = STEP * math.sqrt(count) * np.linalg.qr(columns)[0][:, 1:]
            for seed, sign in zip(seeds[pair : pair + 2], (1.0, -1.0), strict=False):
                shown = self.observe(list(white + sign * steps[:, IDLE:] @ self.directions), [seed] * count)
                slope = slope + sign * steps.T @ shown / (count * STEP**2 * len(seeds))
        shown = combinations @ np.transpose(slope)
        return denoised(shown[:, IDLE:], float((shown[:, :IDLE] ** 2).mean())) @ self.directions

    def jacobian(self, white: Floats, combinations: Floats, seeds: Sequence[int]) -> Floats:
        """Mean over jitter seeds of the derivatives [r, W] of `combinations` [r, M] of the numbers at white [W]."""
        if not self.reverses_combinations:
            return self.differences(white, combinations, seeds)
        jacobian, fields = np.zeros((len(combinations), self.size)), self.fields(white)
        for first in range(0, len(seeds), processors()):
            scenes = [steady(self.scene_at(white, seed)) for seed in seeds[first : first + processors()]]
            tape = Tape(scenes, self.frames, precision="f32", memory_mib=MEMORY_MIB, outputs=len(combinations))
            seen = [self.adjoints(tape, index, combinations) for index in range(len(scenes))]
            together = [[FlowAdjoints(by[number]) for by, _ in seen] for number in range(len(combinations))]
            slopes: list[dict[str, Any]] = [{} for _ in scenes]
            for row, gradients in enumerate(pull_back_all(tape, together)):
                for index, gradient in enumerate(gradients):
                    explicit, both = seen[index][1][row], zip(self.problem.fields, fields, strict=True)
                    nodes = [unknown.at_nodes(gradient, values, explicit, slopes[index]) for unknown, values in both]
                    numbers = derivatives(gradient, self.problem.kinds, self.values(white), self.problem.scene)
                    jacobian[row] += self.pulled_back(nodes, numbers, white) / len(seeds)
            self.runs += len(scenes)
            self.reverses += len(scenes) * len(combinations)
            self.bar.update(len(scenes) * (1 + len(combinations)))
        return jacobian

    def pulled_back(self, by_nodes: Sequence[Floats], by_numbers: Floats, white: Floats) -> Floats:
        """Derivatives with respect to white numbers [W], from those with respect to fields [K] and numbers [U]."""
        adjoint = np.zeros(self.size)
        rows = zip(self.problem.fields, self.latents(white), self.parts, by_nodes, strict=True)
        for unknown, latent, part, nodes in rows:
            adjoint[part] = unknown.prior.white(nodes * unknown.slope(latent))
        density = np.exp(-0.5 * white[self.of_numbers] ** 2) / np.sqrt(2.0 * np.pi)
        adjoint[self.of_numbers] = by_numbers * self.problem.box.range * density
        return adjoint

    def adjoints(self, tape: Tape, index: int, combinations: Floats) -> tuple[Floats, Floats]:
        """Derivatives of combinations [r, M] with respect to positions [r, T, N, D] and particle volumes [r, N]."""
        positions = torch.from_numpy(tape.positions(index)).requires_grad_()
        rollout = Rollout(
            positions=positions,
            times=np.array(self.frames) * self.problem.scene.frame_dt,
            volumes=torch.from_numpy(tape.batch.particles[index].volume).requires_grad_(),
        )
        numbers, seen = self.observation.predict(rollout), (positions, rollout.volumes)
        kept = {"retain_graph": True, "materialize_grads": True}
        rows = [torch.autograd.grad(numbers, seen, row, **kept) for row in torch.from_numpy(combinations)]
        by_positions, by_volumes = ([gradient.numpy() for gradient in column] for column in zip(*rows, strict=True))
        return np.stack(by_positions), np.stack(by_volumes)


def denoised(matrix: Floats, variance: float) -> Floats:
    """The low-rank estimate of the matrix [r, V] behind the noisy `matrix`.
    variance: of the noise of an entry. In units of a random matrix with this noise, a singular value becomes
    ((s^2 - b - 1)^2 - 4 b)^(1/2) / s, 0 below 1 + b^(1/2), with the ratio b <= 1 of the sides (Gavish & Donoho, Optimal
    shrinkage of singular values, IEEE Trans. Inf. Theory 63 (2017) 2137-2152, eq. 7)."""
    left, values, right = np.linalg.svd(matrix, full_matrices=False)
    short, long = sorted(matrix.shape)
    unit, ratio = math.sqrt(long * variance), short / long
    above = values > (1.0 + math.sqrt(ratio)) * unit
    left, values, right = left[:, above], values[above], right[above]
    squares = (values**2 - (ratio + 1.0) * unit**2) ** 2 - 4.0 * ratio * unit**4
    return np.asarray(left * (np.sqrt(squares) / values) @ right)
