"""The MPM as a layer of PyTorch: gradients against central differences, alone and under an observation."""

import dataclasses

import numpy as np
import pytest
import torch

from datasets import Baffle
from inverse import Parameter, Problem, TargetSettings
from inverse.forward.adjoint import AdjointForward, Run
from inverse.observations import ImpulseSettings
from mpm import simulate, simulate_many
from tests.mpm.adjoint.flows import plane

BOTH = ("friction_deg", "masses[0].velocity_x")
NAMES = (*BOTH, "masses[1].velocity_y", "floor_friction", "young", "masses[1].cohesion")
VALUES = np.array([30.0, 1.0, -0.3, 0.3, 2.0e6, 450.0])
STEPS = np.array([1e-4, 1e-6, 1e-6, 1e-5, 10.0, 1e-2])
# With its gaps remembered, a corner of this flow's path lies within the difference's step of friction_deg.
SCENE = plane(wall_friction=0.0, volume_correction=False)


def test_a_layer_is_ten_lines() -> None:
    """As its docstring has it: a loss of the deposit, backward, and the gradient of two parameters."""
    run = Run(SCENE, names=NAMES, precision="f64", threads=1)
    parameters = torch.tensor(VALUES, requires_grad=True)
    positions, velocities = run(parameters)
    (positions[-1, :, 0].mean() + 0.1 * velocities[-1, :, 1].square().mean()).backward()

    def loss(values: np.ndarray) -> float:
        moved, sped = Run(SCENE, names=NAMES, precision="f64", threads=1)(torch.tensor(values))
        return float(moved[-1, :, 0].mean() + 0.1 * sped[-1, :, 1].square().mean())

    for index, step in enumerate(STEPS):
        change = np.where(np.arange(len(VALUES)) == index, step, 0.0)
        found = (loss(VALUES + change) - loss(VALUES - change)) / (2.0 * step)
        assert float(parameters.grad[index]) == pytest.approx(found, rel=2e-4), NAMES[index]


def test_the_impulse_on_a_baffle() -> None:
    """At two times, as a function of the friction angle and of a velocity."""
    scene = dataclasses.replace(SCENE, baffles=(Baffle(lower=(0.313, 0.0), size=(0.05, 0.127)),), duration=0.03)
    settings, both = ImpulseSettings(times=(0.021, 0.03)), zip(BOTH, VALUES[:2], strict=True)
    parameters = tuple(Parameter(name=name, initial=at, lower=0.5 * at, upper=1.5 * at) for name, at in both)
    target = TargetSettings(twin=True)
    problem = Problem(name="slide", scene=scene, parameters=parameters, observations=(settings,), target=target)
    observation = settings.operator(scene)
    forward = AdjointForward(problem, observation, simulate_many, precision="f64", threads=1)
    exact = observation.observe(simulate(scene, precision="f64", threads=1))
    rows = torch.autograd.functional.jacobian(forward.predict, torch.tensor(VALUES[:2])).numpy()
    np.testing.assert_allclose(forward.observe([VALUES[:2]])[0], exact, rtol=1e-6)
    for index, step in enumerate(STEPS[:2]):
        change = np.where(np.arange(2) == index, step, 0.0)
        ahead, behind = forward.observe([VALUES[:2] + change, VALUES[:2] - change])
        np.testing.assert_allclose(rows[:, index], (ahead - behind) / (2.0 * step), rtol=1e-4)
