"""The learned simulator as a forward model: from the scene or the MPM's first frames to the deposit, differentiably."""

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
from inverse.observations import Observation, Rollout, Values
from inverse.parameters import Vector, in_order
from inverse.problem import Problem

MEMORY_GIB = 0.5
"""Activations that the backward pass may find ready, instead of computing them again [GiB]."""
THINNING_SEED = 0
"""Which particles of a cell the surrogate follows: always the same, so that the parameters alone make a difference."""


class GnsForward:
    """A rollout of the surrogate that is a differentiable function of the problem's parameters."""

    def __init__(
        self,
        simulator: Simulator,
        beginning: Trajectory | None,
        problem: Problem,
        observation: Observation,
        memory_gib: float = MEMORY_GIB,
    ) -> None:
        self.simulator, self.observation, self.kinds = simulator, observation, problem.kinds
        dtype = next(simulator.parameters()).dtype
        self.initial = beginning_of(beginning, problem, simulator).to(dtype=dtype)
        self.indices, self.steps = self.initial.indices, self.initial.steps
        # Before the rollout begins: for an observation over time alone.
        self.before = torch.from_numpy(self.initial.known[:-1])
        self.times = self.initial.times[0 if observation.over_time else len(self.before) :]
        bytes_per_step = step_activation_bytes(simulator, self.initial.state, self.initial.conditions)
        self.kept_steps = min(self.steps, int(memory_gib * 2**30 / bytes_per_step))

    def predict(self, parameters: Tensor, /) -> Tensor:
        """The smooth observation, float64 of shape [m], of parameters, float64 of shape [U]."""
        volumes = self.initial.conditions.volume
        return self.observation.predict(Rollout(positions=self._path(parameters), times=self.times, volumes=volumes))

    def observe(self, parameters: Sequence[Vector], /) -> list[Values]:
        """The smooth observation [m] at each vector of parameters [U], one after the other."""
        with torch.no_grad():
            return [self.predict(torch.from_numpy(values)).numpy() for values in parameters]

    def deposit(self, parameters: Vector, /) -> NDArray[np.floating]:
        """Final positions of the particles [m], shape [n, D]."""
        with torch.no_grad():
            return self._path(torch.from_numpy(parameters))[-1].numpy()

    def select(self, target: Values, /) -> Values:
        """The part of an exact `target` [M] that is of the particles followed here, shape [m]."""
        return self.observation.of_particles(target, self.indices)

    def entered(self, parameters: Tensor) -> InitialState:
        """The initial state with parameters [U], differentiable in them."""
        initial = self.initial
        for index in in_order(self.kinds):
            initial = self.kinds[index].enter(initial, parameters[index])
        return initial

    def _path(self, parameters: Tensor) -> Tensor:
        """Positions [m] at `times`, shape [T, n, D]."""
        initial = self.entered(parameters)
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
