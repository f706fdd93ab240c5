"""The MPM as a function of white noise: w -> fields and numbers -> runs -> observed numbers, and back.

    field: u = S A w (`inverse.parameters.field`),    number: lower + (upper - lower) Phi(w)

Phi is the normal distribution: a number is uniform between its bounds. Numbers are observed exactly; derivatives are
the adjoint's, through the smooth operator: one reverse pass for each combination of the numbers, and one replay of the
run for all of them. Both are averaged over jitter seeds: in a single run's derivative single particles count.
"""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.special import ndtr
from tqdm import tqdm

from datasets.particles import initial_volumes
from datasets.processes import processors
from datasets.scene import Scene
from inverse.forward.adjoint import derivatives
from inverse.observations import Observation, Rollout
from inverse.observations.observation import brackets
from inverse.problem import Problem
from mpm import simulate_many
from mpm.adjoint.gradient import Gradient, pull_back_all
from mpm.adjoint.tape import FlowAdjoints, Tape, check
from mpm.arrays.features import features_of

Floats = NDArray[np.float64]

MEMORY_MIB = 512.0
"""For the checkpoints of the runs that are reversed side by side [MiB]."""


class WhiteFlow:
    """Runs at W white numbers, which show M numbers. Raises InputError for a scene that the adjoint does not know."""

    def __init__(self, problem: Problem, observation: Observation) -> None:
        self.problem, self.observation = problem, observation
        check(features_of([problem.scene], "f32"))
        self.runs = self.reverses = 0
        """MPM runs and reverse passes so far."""
        self.bar = tqdm(desc="adjoint", unit="run", leave=False, disable=None)
        ends = np.cumsum([0, *(each.prior.size for each in problem.fields), len(problem.numbers)])
        *self.parts, self.own = [slice(int(first), int(end)) for first, end in pairwise(ends)]
        """Which white numbers are those of each field; of all numbers."""
        self.size = int(ends[-1])
        scene = problem.scene
        own = [part.observation.times for part in observation.parts if part.observation.times is not None]
        times = np.concatenate([[scene.duration], *own])
        before, share = brackets(np.arange(scene.frames, dtype=np.float64) * scene.frame_dt, times)
        self.frames = sorted({*before.tolist(), *(before + np.ceil(share).astype(np.int64)).tolist()})
        """Frames that the observation looks at, and the last."""

    def latents(self, white: Floats) -> list[Floats]:
        """u [K] of each field."""
        return [each.prior.field(white[part]) for each, part in zip(self.problem.fields, self.parts, strict=True)]

    def values(self, white: Floats) -> Floats:
        """The numbers, shape [U]."""
        box = self.problem.box
        return np.asarray(box.lower + box.range * ndtr(white[self.own]))

    def scene_at(self, white: Floats, seed: int) -> Scene:
        """The scene at white numbers [W] with a jitter seed."""
        latents = zip(self.problem.fields, self.latents(white), strict=True)
        return self.problem.scene_at(self.values(white), seed, [each.field(latent) for each, latent in latents])

    def observe(self, points: Sequence[Floats], seeds: Sequence[int]) -> Floats:
        """The observed numbers [points, M] of runs at white numbers [W], each with its jitter seed."""
        scenes = [self.scene_at(each, seed) for each, seed in zip(points, seeds, strict=True)]
        together, found = 2 * processors(), []
        for first in range(0, len(scenes), together):
            runs = simulate_many(scenes[first : first + together])
            found += [self.observation.observe(run) for run in runs]
            self.bar.update(len(runs))
        self.runs += len(scenes)
        return np.stack(found)

    def scattered(self, white: Floats) -> Floats:
        """The observed numbers [n, M] of runs at white numbers [W] that differ in their jitter seed."""
        seeds = self.problem.scatter_seeds
        return self.observe([white] * len(seeds), seeds)

    def mean(self, white: Floats, seeds: Sequence[int]) -> Floats:
        """The observed numbers [M] at white numbers [W], mean over jitter seeds."""
        return np.asarray(self.observe([white] * len(seeds), seeds).mean(axis=0))

    def jacobian(self, white: Floats, combinations: Floats, seeds: Sequence[int]) -> Floats:
        """Derivatives [r, W] of `combinations` [r, M] of the numbers at white numbers [W], mean over jitter seeds."""
        found = np.zeros((len(combinations), self.size))
        for first in range(0, len(seeds), processors()):
            scenes = [self.scene_at(white, seed) for seed in seeds[first : first + processors()]]
            tape = Tape(scenes, self.frames, precision="f32", memory_mib=MEMORY_MIB, outputs=len(combinations))
            adjoints = [self.adjoints(tape, index, combinations) for index in range(len(scenes))]
            together = [[FlowAdjoints(own[number]) for own in adjoints] for number in range(len(combinations))]
            for row, gradients in enumerate(pull_back_all(tape, together)):
                for gradient in gradients:
                    found[row] += self.pulled_back(gradient, white) / len(seeds)
            self.runs += len(scenes)
            self.reverses += len(scenes) * len(combinations)
            self.bar.update(len(scenes) * (1 + len(combinations)))
        return found

    def pulled_back(self, gradient: Gradient, white: Floats) -> Floats:
        """Derivatives with respect to the white numbers [W] from those with respect to what a run begins with."""
        found = np.zeros(self.size)
        for unknown, latent, part in zip(self.problem.fields, self.latents(white), self.parts, strict=True):
            found[part] = unknown.prior.white(unknown.at_nodes(gradient, latent))
        if self.problem.numbers:
            density = np.exp(-0.5 * white[self.own] ** 2) / np.sqrt(2.0 * np.pi)
            slopes = derivatives(gradient, self.problem.kinds, self.values(white))
            found[self.own] = slopes * self.problem.box.range * density
        return found

    def adjoints(self, tape: Tape, index: int, combinations: Floats) -> Floats:
        """Derivatives of the combinations [r, M] with respect to the observed positions, shape [r, T, N, D]."""
        positions = torch.from_numpy(tape.positions(index)).requires_grad_()
        rollout = Rollout(
            positions=positions,
            times=np.array(self.frames) * self.problem.scene.frame_dt,
            volumes=torch.from_numpy(initial_volumes(self.problem.scene)),
        )
        numbers = self.observation.predict(rollout)
        rows = [
            torch.autograd.grad(numbers, positions, torch.from_numpy(each), retain_graph=True)[0].numpy()
            for each in combinations
        ]
        return np.stack(rows)
