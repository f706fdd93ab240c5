"""AD through the unrolled surrogate against central differences in double precision: all unknowns, all observations."""

from types import SimpleNamespace

import numpy as np
import pytest
import torch

from inverse.forward.gns import GnsForward
from inverse.observations import KINDS
from tests.inverse.flows import problem_of, simulator_of

MATERIAL = ("friction_deg", "cohesion", "masses[0].velocity_x")
BAFFLE = ("baffles[0].x", "baffles[0].length", "baffles[0].height", "baffle_friction")
ROUGH = ("floor_friction", "wall_friction", "damping")
OTHER = ("masses[1].friction_deg", "masses[1].cohesion", "masses[1].velocity_y")
NAMES: dict[int | str, tuple[str, ...]] = {
    2: (*MATERIAL, *BAFFLE, *ROUGH, *OTHER),
    3: (*MATERIAL, *BAFFLE, "masses[0].velocity_z", "baffles[1].z", "baffles[1].width"),
    "terrain": (*MATERIAL, *ROUGH, "solids[0].friction", "solids[1].friction"),
}
STEPS = {"deg": 1e-3, "cohesion": 0.01, "velocity": 1e-6, "baffles": 1e-7, "friction": 1e-4, "damping": 1e-4}
"""Short, because a profile has a kink wherever a point passes a station."""


@pytest.fixture(scope="module", params=list(NAMES))
def rollouts(request: pytest.FixtureRequest) -> SimpleNamespace:
    """One rollout that autograd looks through, from unknowns with a gradient (`point`), and two beside it for each."""
    problem = problem_of(request.param, *NAMES[request.param])
    observation = problem.operators[0]
    forward = GnsForward(simulator_of(problem.scene.dimension), problem, observation)
    assert forward.kept_steps >= forward.initial.steps
    assert forward.initial.conditions.units.length != 1.0
    assert forward.initial.times[-1] == pytest.approx(problem.scene.duration)
    point = torch.tensor(problem.initial, requires_grad=True)
    steps = np.array([next(step for part, step in STEPS.items() if part in name) for name in problem.names])
    return SimpleNamespace(
        problem=problem,
        volumes=forward.initial.conditions.volume,
        point=point,
        deposit=forward.predict(point).view(-1, problem.scene.dimension),
        steps=steps,
        ahead=[torch.from_numpy(forward.deposit(problem.initial + move)) for move in np.diag(steps)],
        behind=[torch.from_numpy(forward.deposit(problem.initial - move)) for move in np.diag(steps)],
    )


@pytest.mark.parametrize("kind", ["front", "runout", "profile", "toe", "deposit", "passed"])
def test_every_parameter_through_every_observation(rollouts: SimpleNamespace, kind: str) -> None:
    settings = KINDS[kind](**({"line": 0.15} if kind == "passed" else {}))
    observation = settings.operator(rollouts.problem.scene)
    seen = observation.smooth(rollouts.deposit, rollouts.volumes)
    weights = torch.from_numpy(np.random.default_rng(3).normal(size=len(seen)))
    (by_ad,) = torch.autograd.grad(weights @ seen, rollouts.point, retain_graph=True)

    def total(deposit: torch.Tensor) -> float:
        return float(weights @ observation.smooth(deposit, rollouts.volumes))

    pairs = zip(rollouts.ahead, rollouts.behind, rollouts.steps, strict=True)
    by_differences = np.array([(total(ahead) - total(behind)) / (2.0 * step) for ahead, behind, step in pairs])
    assert np.abs(by_differences).min() > 0.0
    # Rounding of a length of some 0.3 m, over a step of 1e-7 m.
    np.testing.assert_allclose(by_ad.numpy(), by_differences, rtol=1e-4, atol=2e-9)
