"""The learned simulator as a forward: from the scene or the MPM's first frames to the deposit, differentiably."""

import dataclasses
from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from datasets.scene import Scene
from datasets.trajectory import Trajectory
from gns.initial import MPM_SECONDS, InitialState, Start, first_frames, initial_state
from gns.model.simulator import Simulator
from gns.unroll import step_activation_bytes, unroll
from inverse.observations.deposit import Observation, Rollout, Values
from inverse.parameters.parameters import Vector, launched
from inverse.problem import Problem

MEMORY_GIB = 0.5
"""Activations that the backward pass may find ready, instead of computing them again [GiB]."""
THINNING_SEED = 0
"""Which points of a cell the surrogate follows: always the same, so that predictions differ by the unknowns alone."""


class GnsForward:
    """A rollout of the surrogate in which every unknown of the problem is free."""

    def __init__(
        self,
        simulator: Simulator,
        beginning: Trajectory | None,
        problem: Problem,
        observation: Observation,
        memory_gib: float = MEMORY_GIB,
    ) -> None:
        dtype = next(simulator.parameters()).dtype
        self.simulator, self.problem, self.observation = simulator, problem, observation
        self.initial = initial = beginning_of(beginning, problem, simulator).to(dtype=dtype)
        self.indices, self.steps = initial.indices, initial.steps
        # What an observation over time sees before the rollout begins; others are spared it.
        self.before = torch.from_numpy(initial.known[:-1])
        self.times = initial.times[0 if observation.over_time else len(self.before) :]
        bytes_per_step = step_activation_bytes(simulator, self.initial.state, self.initial.conditions)
        self.kept_steps = min(self.steps, int(memory_gib * 2**30 / bytes_per_step))

    def predict(self, unknowns: Tensor) -> Tensor:
        """The smooth observation, float64 of shape [m], of unknowns, float64 of shape [U]."""
        return self.observation.predict(
            Rollout(positions=self._path(unknowns), times=self.times, volumes=self.initial.conditions.volume)
        )

    def observe(self, unknowns: Sequence[Vector]) -> list[Values]:
        """The smooth observation [m] of each vector of unknowns [U], one after the other."""
        with torch.no_grad():
            return [self.predict(torch.from_numpy(values)).numpy() for values in unknowns]

    def deposit(self, unknowns: Vector) -> NDArray[np.floating]:
        """Where the points come to rest [m], shape [n, D]."""
        with torch.no_grad():
            return self._path(torch.from_numpy(unknowns))[-1].numpy()

    def wanted(self, target: Values) -> Values:
        """What of an exact `target` [M] the predictions [m] are held against: that of the points followed here."""
        return self.observation.of_points(target, self.indices)

    def _path(self, unknowns: Tensor) -> Tensor:
        """Positions [m] at `times`, shape [T, n, D]."""
        initial = launched(self.initial, self.problem.names, unknowns)
        moved = unroll(self.simulator, initial.state, initial.conditions, self.steps, kept_steps=self.kept_steps)
        return torch.cat((self.before.to(moved.dtype), moved)) if self.observation.over_time else moved


def beginning_of(beginning: Trajectory | None, problem: Problem, simulator: Simulator) -> InitialState:
    """Where the rollout begins: at the scene, or after the first frames of `beginning`."""
    settings, scene = simulator.settings, problem.scene
    if problem.start is Start.FROM_REST:
        seed = scene.seed if beginning is None else beginning.scene.seed
        return initial_state(dataclasses.replace(scene, seed=seed), settings, seed=THINNING_SEED)
    assert beginning is not None, "`GnsSource.first_frames` asked for them"
    return initial_state(scene, settings, first_frames(beginning), seed=THINNING_SEED)


class GnsSource:
    """Starts surrogates of one problem; the weights are frozen, which makes the backward pass much cheaper."""

    def __init__(
        self, simulator: Simulator, problem: Problem, observation: Observation, memory_gib: float = MEMORY_GIB
    ) -> None:
        self.simulator = simulator.requires_grad_(False)
        self.problem, self.observation, self.memory_gib = problem, observation, memory_gib

    def first_frames(self, scene: Scene) -> Scene | None:
        """`scene`, cut to a twentieth of a second: all that the surrogate needs of the MPM, if it needs any."""
        return None if self.problem.start is Start.FROM_REST else dataclasses.replace(scene, duration=MPM_SECONDS)

    def start(self, beginning: Trajectory | None) -> GnsForward:
        """The surrogate that goes on from the first frames of `beginning`."""
        return GnsForward(self.simulator, beginning, self.problem, self.observation, self.memory_gib)
