"""The learned simulator as a forward model: from the scene to the deposit, differentiably."""

from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from gns.initial import InitialState, initial_state
from gns.simulator import Simulator
from gns.unroll import step_activation_bytes, unroll
from inverse.observations import Observation, Rollout, Values
from inverse.parameters import Vector, in_order
from inverse.problem import Problem

MEMORY_GIB = 0.5
"""Activations that the backward pass may find ready, instead of computing them again [GiB]."""


class GnsForward:
    """A rollout of the surrogate from rest that is a differentiable function of the problem's parameters.

    State, conditions and positions are in SI units of the scene; `unroll` scales them to the model's.
    """

    def __init__(
        self, simulator: Simulator, problem: Problem, observation: Observation, memory_gib: float = MEMORY_GIB
    ) -> None:
        """The weights are frozen, which makes the backward pass much cheaper.

        Raises InputError as `gns.initial.check`.
        """
        self.simulator = simulator.requires_grad_(False)
        self.observation, self.kinds = observation, problem.kinds
        dtype = next(simulator.parameters()).dtype
        self.initial = initial_state(problem.scene, simulator.settings).to(dtype=dtype)
        self.indices, self.steps = self.initial.indices, self.initial.steps
        bytes_per_step = step_activation_bytes(simulator, self.initial.state, self.initial.conditions)
        self.kept_steps = min(self.steps, int(memory_gib * 2**30 / bytes_per_step))

    def predict(self, parameters: Tensor, /) -> Tensor:
        """The smooth observation, float64 of shape [m], of parameters, float64 of shape [U]."""
        positions, volumes = self._path(parameters), self.initial.conditions.volume
        return self.observation.predict(Rollout(positions=positions, times=self.initial.times, volumes=volumes))

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
        """Positions [m] at the times of the initial state, shape [T, n, D]."""
        initial = self.entered(parameters)
        return unroll(self.simulator, initial.state, initial.conditions, self.steps, kept_steps=self.kept_steps)
