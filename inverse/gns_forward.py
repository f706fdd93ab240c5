"""The learned simulator as a forward: from the MPM's first frames to the deposit, differentiable in the unknowns."""

import dataclasses
from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from datasets.scene import Scene
from datasets.trajectory import Trajectory
from gns.score import START
from gns.simulator import Simulator
from gns.start import after_frames
from gns.unroll import step_activation_bytes, unroll
from inverse.observations import Observation, Values
from inverse.problem import Problem
from inverse.unknowns import KINDS, Vector

MEMORY_GIB = 0.5
"""Activations that the backward pass may find ready, instead of computing them again [GiB]."""
THINNING_SEED = 0
"""Which points of a cell the surrogate follows: always the same, so that predictions differ by the unknowns alone."""


class GnsForward:
    """A rollout of the surrogate from given first frames."""

    def __init__(
        self,
        simulator: Simulator,
        beginning: Trajectory,
        problem: Problem,
        observation: Observation,
        memory_gib: float = MEMORY_GIB,
    ) -> None:
        frames = round(START / beginning.scene.frame_dt) + 1
        start = dataclasses.replace(beginning, positions=beginning.positions[:frames], time=beginning.time[:frames])
        flow = after_frames(start, problem.scene, simulator.settings, np.random.default_rng(THINNING_SEED))
        self.simulator, self.state, self.conditions = simulator, flow.state, flow.conditions
        self.problem, self.observation, self.scene = problem, observation, beginning.scene
        self.steps = flow.steps
        bytes_per_step = step_activation_bytes(simulator, self.state, self.conditions)
        self.kept_steps = min(self.steps, int(memory_gib * 2**30 / bytes_per_step))

    def predict(self, unknowns: Tensor) -> Tensor:
        """The smooth observation [m], float64 of shape [M], of unknowns, float64 of shape [U]."""
        return self.observation.smooth(self._final(unknowns), self.conditions.volume)

    def observe(self, unknowns: Sequence[Vector]) -> list[Values]:
        """The smooth observation [M] of each vector of unknowns [U], one after the other."""
        with torch.no_grad():
            return [self.predict(torch.from_numpy(values)).numpy() for values in unknowns]

    def deposit(self, unknowns: Vector) -> NDArray[np.floating]:
        """Where the points come to rest [m], shape [n, D]."""
        with torch.no_grad():
            return self._final(torch.from_numpy(unknowns)).numpy()

    def _final(self, unknowns: Tensor) -> Tensor:
        friction = self.conditions.friction
        for unknown, value in zip(self.problem.unknowns, unknowns, strict=True):
            friction = KINDS[unknown.name].condition(friction, self.scene, value)
        conditions = dataclasses.replace(self.conditions, friction=friction)
        return unroll(self.simulator, self.state, conditions, self.steps, kept_steps=self.kept_steps)[-1]


class GnsSource:
    """Starts surrogates of one problem; the weights are frozen, which makes the backward pass much cheaper."""

    def __init__(
        self, simulator: Simulator, problem: Problem, observation: Observation, memory_gib: float = MEMORY_GIB
    ) -> None:
        self.simulator = simulator.requires_grad_(False)
        self.problem, self.observation, self.memory_gib = problem, observation, memory_gib

    def first_frames(self, scene: Scene) -> Scene:
        """`scene`, cut to a twentieth of a second: all that the surrogate needs of the MPM."""
        return dataclasses.replace(scene, duration=START)

    def start(self, beginning: Trajectory) -> GnsForward:
        """The surrogate that goes on from the first frames of `beginning`."""
        return GnsForward(self.simulator, beginning, self.problem, self.observation, self.memory_gib)
