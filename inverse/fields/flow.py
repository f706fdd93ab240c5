"""The MPM as a function of white noise: w -> fields (`inverse.fields.prior`) -> runs -> observed numbers, and back.

Numbers are those of the solver itself, by the exact observation operator. Their derivatives are the adjoint's, through
the smooth one: each combination of the numbers costs one reverse pass, for any number of nodes, and all combinations
share one replay of the run. Both are averaged over jitter seeds: of a single run part of the derivative is what single
particles do.
"""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import torch
from numpy.typing import NDArray
from tqdm import tqdm

from datasets.particles import initial_volumes
from datasets.processes import processors
from inverse.fields.problem import FieldProblem
from inverse.observations import Observation, Rollout
from inverse.observations.sampling import brackets
from mpm import simulate_many
from mpm.adjoint.checks import check
from mpm.adjoint.gradient import pull_back_all
from mpm.adjoint.tape import FlowAdjoints, Tape
from mpm.arrays.batch import particles_of
from mpm.arrays.features import features_of

Floats = NDArray[np.float64]

MEMORY_MIB = 512.0
"""For the checkpoints of the runs that are reversed side by side [MiB]."""


class Flow:
    """Runs of a problem's scene; W white numbers for all unknown fields together, M observed numbers.

    Raises InputError for a scene that the adjoint does not know.
    """

    def __init__(self, problem: FieldProblem, observation: Observation) -> None:
        self.problem, self.observation = problem, observation
        check(features_of([problem.scene], particles_of([problem.scene]), "f32"))
        self.runs = self.reverses = 0
        """MPM runs and reverse passes so far."""
        self.bar = tqdm(desc="fields", unit="run", leave=False, disable=None)
        ends = np.cumsum([0, *(each.prior.size for each in problem.unknowns)])
        self.parts = [slice(int(first), int(end)) for first, end in pairwise(ends)]
        """Which white numbers are those of each field."""
        scene = problem.scene
        times = [np.array([scene.duration]), *times_of(observation)]
        before, share = brackets(np.arange(scene.frames, dtype=np.float64) * scene.frame_dt, np.concatenate(times))
        self.frames = sorted({*before.tolist(), *(before + np.ceil(share).astype(np.int64)).tolist()})
        """Frames that the observation looks at, and the last."""

    @property
    def size(self) -> int:
        """W."""
        return int(self.parts[-1].stop)

    def latents(self, white: Floats) -> list[Floats]:
        """u [K] of each field."""
        return [each.prior.field(white[part]) for each, part in zip(self.problem.unknowns, self.parts, strict=True)]

    def observe(self, points: Sequence[Floats], seeds: Sequence[int]) -> Floats:
        """The observed numbers [points, M] of runs at white numbers [W], each with its jitter seed."""
        scenes = [self.problem.scene_at(self.latents(each), seed) for each, seed in zip(points, seeds, strict=True)]
        together, found = 2 * processors(), []
        for first in range(0, len(scenes), together):
            runs = simulate_many(scenes[first : first + together])
            found += [self.observation.observe(run) for run in runs]
            self.bar.update(len(runs))
        self.runs += len(scenes)
        return np.stack(found)

    def mean(self, white: Floats, seeds: Sequence[int]) -> Floats:
        """The observed numbers [M] at white numbers [W], mean over jitter seeds."""
        return np.asarray(self.observe([white] * len(seeds), seeds).mean(axis=0))

    def jacobian(self, white: Floats, combinations: Floats, seeds: Sequence[int]) -> Floats:
        """Derivatives of `combinations` [r, M] of the numbers with respect to the white numbers [W]; [r, W].

        Mean over jitter seeds, as many side by side as there are cores.
        """
        latents = self.latents(white)
        found = np.zeros((len(combinations), self.size))
        for first in range(0, len(seeds), processors()):
            scenes = [self.problem.scene_at(latents, seed) for seed in seeds[first : first + processors()]]
            tape = Tape(scenes, self.frames, precision="f32", memory_mib=MEMORY_MIB, outputs=len(combinations))
            adjoints = [self.adjoints(tape, index, combinations) for index in range(len(scenes))]
            still = [np.zeros_like(each[0]) for each in adjoints]
            together = [
                [FlowAdjoints(own[number], rest) for own, rest in zip(adjoints, still, strict=True)]
                for number in range(len(combinations))
            ]
            for row, gradients in enumerate(pull_back_all(tape, together)):
                for gradient in gradients:
                    for unknown, latent, part in zip(self.problem.unknowns, latents, self.parts, strict=True):
                        found[row, part] += unknown.prior.white(unknown.at_nodes(gradient, latent)) / len(seeds)
            self.runs += len(scenes)
            self.reverses += len(scenes) * len(combinations)
            self.bar.update(len(scenes) * (1 + len(combinations)))
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


def times_of(observation: Observation) -> list[Floats]:
    """When an observation, or each of those that it joins, looks at the flow [s]."""
    parts = [part.observation for part in getattr(observation, "parts", ())] or [observation]
    return [part.times for part in parts if part.times is not None]
