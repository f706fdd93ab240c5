"""The rollout's gradient: right, and the same whatever is kept in memory."""

import dataclasses

import pytest
import torch
from torch import Tensor

from gns.simulator import Simulator
from gns.state import Conditions, State
from gns.unroll import step_activation_bytes, unroll
from tests.gns.conftest import Cloud

STEPS = 6


@pytest.fixture
def problem(lively: Simulator, cloud: Cloud) -> tuple[Simulator, State, Conditions]:
    """A frozen model in double precision and a block at the left wall."""
    state, conditions = (each.to(dtype=torch.float64) for each in cloud(lower=(0.0, 0.0)))
    return lively.double().requires_grad_(False), state, conditions


def front(problem: tuple[Simulator, State, Conditions], friction: Tensor, kept_steps: int = 0) -> Tensor:
    """The x [m] that 99.5 % of the points are behind after a rollout."""
    simulator, state, conditions = problem
    conditions = dataclasses.replace(conditions, friction=friction.expand(len(state.positions)))
    positions = unroll(simulator, state, conditions, STEPS, kept_steps=kept_steps)
    return torch.quantile(positions[-1, :, 0], 0.995)


@pytest.mark.parametrize("kept_steps", [1, 4, STEPS])
def test_what_is_kept_does_not_change_the_gradient(
    problem: tuple[Simulator, State, Conditions], kept_steps: int
) -> None:
    gradients = []
    for kept in (0, kept_steps):
        friction = torch.tensor(0.5, dtype=torch.float64, requires_grad=True)
        value = front(problem, friction, kept)
        gradients.append((value.item(), *torch.autograd.grad(value, friction)))
    assert gradients[0] == gradients[1]


def test_a_kept_step_costs_what_was_measured(problem: tuple[Simulator, State, Conditions]) -> None:
    def stored(kept_steps: int) -> int:
        storages: dict[int, Tensor] = {}

        def keep(tensor: Tensor) -> Tensor:
            # The tensor itself too: a freed address could be counted for another.
            storages[tensor.untyped_storage().data_ptr()] = tensor
            return tensor

        with torch.autograd.graph.saved_tensors_hooks(keep, lambda tensor: tensor):
            front(problem, torch.tensor(0.5, dtype=torch.float64, requires_grad=True), kept_steps)
        return sum(tensor.untyped_storage().nbytes() for tensor in storages.values())

    simulator, state, conditions = problem
    per_step = step_activation_bytes(simulator, state, conditions)
    assert per_step > 10 * state.displacements.nbytes
    assert stored(4) - stored(1) == pytest.approx(3 * per_step, rel=0.2)
