"""The gradient of a rollout in everything that may be an unknown is that of central differences."""

import dataclasses

import pytest
import torch
from torch import Tensor

from gns.simulator import Simulator
from gns.state import Conditions, Ground, State
from gns.units import Units
from gns.unroll import unroll
from tests.gns.conftest import Cloud

STEPS = 6
UNITS = Units(length=1.21, time=1.1, stress=2.0)
INPUTS = {
    "friction": 1e-2,
    "cohesion": 100.0,
    "volume": 1e-5,
    "gravity": 1.0,
    "floor_friction": 1e-1,
    "wall_friction": 1e-1,
    "damping": 1e-1,
    "baffles": 1e-2,
    "baffle_friction": 1e-1,
    "ground.elevation": 1e-2,
    "ground.friction": 1.0,
}
"""What may be an unknown, and a typical change of it; of a raster's friction more, because changes cancel."""


@pytest.fixture
def problem(lively: Simulator, cloud: Cloud) -> tuple[Simulator, State, Conditions]:
    """A frozen model in double precision, in units of a scene, and a block thrown at rough ground and a baffle."""
    with torch.no_grad():
        for name, weight in lively.named_parameters():
            if "film" in name:
                weight.normal_(std=0.2)
    state, conditions = (each.to(dtype=torch.float64) for each in cloud(lower=(0.1003, 0.0951), velocity=(1.5, -0.6)))
    x = 0.01 * torch.arange(101, dtype=torch.float64)
    ground = Ground(
        elevation=(0.08 + 0.01 * torch.sin(20.0 * x)).unsqueeze(0),
        friction=(0.4 + 0.1 * torch.cos(9.0 * x)).unsqueeze(0),
        spacing=0.01,
    )
    conditions = dataclasses.replace(
        conditions,
        baffles=torch.tensor([[[[0.2402, 0.05], [0.2801, 0.1603]]]], dtype=torch.float64),
        baffle_friction=torch.tensor([[0.3]], dtype=torch.float64),
        ground=ground,
        units=UNITS,
    )
    return lively.double().requires_grad_(False), state, conditions


def changed(conditions: Conditions, name: str, change: Tensor) -> Conditions:
    """The conditions with a value of them changed."""
    if name.startswith("ground."):
        assert conditions.ground is not None
        field = name.removeprefix("ground.")
        value = getattr(conditions.ground, field) + change
        return dataclasses.replace(conditions, ground=dataclasses.replace(conditions.ground, **{field: value}))
    return dataclasses.replace(conditions, **{name: getattr(conditions, name) + change})


@pytest.mark.parametrize("name", INPUTS)
def test_the_gradient_is_that_of_central_differences(problem: tuple[Simulator, State, Conditions], name: str) -> None:
    simulator, state, conditions = problem
    value = getattr(conditions.ground, name.removeprefix("ground.")) if "." in name else getattr(conditions, name)
    direction = torch.randn(value.shape, generator=torch.Generator().manual_seed(2), dtype=torch.float64)
    direction = INPUTS[name] * direction

    def end(length: Tensor) -> Tensor:
        """A number that depends on where each particle ends, along the direction."""
        last = unroll(simulator, state, changed(conditions, name, length * direction), STEPS)[-1]
        return (last * torch.linspace(0.5, 1.5, last.numel(), dtype=torch.float64).view_as(last)).sum()

    length = torch.zeros((), dtype=torch.float64, requires_grad=True)
    (slope,) = torch.autograd.grad(end(length), length)
    # Small: the slope of the ground jumps from one elevation to the next, and a particle may cross there.
    step = torch.tensor(1.0e-5, dtype=torch.float64)
    with torch.no_grad():
        difference = (end(step) - end(-step)) / (2.0 * step)
    assert abs(difference) > 1e-5
    torch.testing.assert_close(slope, difference, rtol=1e-4, atol=0.0)
