"""Forward models: the surrogate, of any size and differentiable in all parameters; the MPM as a layer of PyTorch."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from datasets import Baffle, Mass, Material
from gns.network.correction import Correction
from gns.simulator import unroll
from inverse import Parameter, Problem, TargetSettings, read_problem
from inverse.forward.adjoint import AdjointForward, AdjointRun
from inverse.forward.gns import GnsForward
from inverse.observations import KINDS, FrontSettings, GaugesSettings, ImpulseSettings, Rollout
from mpm import simulate, simulate_many
from tests.inverse.flows import problem_of, simulator_of
from tests.mpm.adjoint.flows import plane
from tests.scenes import scene_of


@pytest.fixture(scope="module")
def problem() -> Problem:
    shipped = read_problem("friction-tall-42")
    column, material = Mass(lower=(0.0, 0.0), size=(0.06, 0.08)), shipped.scene.material
    scene = scene_of(column, size=(0.4, 0.2), cell=0.01, material=material, duration=0.15)
    front = FrontSettings(value=0.1)
    return dataclasses.replace(shipped, scene=scene, observations=(front,), target=TargetSettings())


def forward_of(problem: Problem) -> GnsForward:
    return GnsForward(simulator_of(2), problem, FrontSettings().operator(problem.scene))


def test_between_two_steps_particles_move_straight(problem: Problem) -> None:
    """Times are those of the scene, whatever the model's step."""
    maker, share = forward_of(problem), 0.37
    steps = maker.initial.times
    time = (1.0 - share) * steps[3] + share * steps[4]
    gauges = GaugesSettings(x=(0.03, 0.06), times=(time,))
    for settings in (FrontSettings(times=(time, steps[1])), gauges):
        observation = settings.operator(problem.scene)
        forward = GnsForward(maker.simulator, problem, observation)
        seen = forward.predict(torch.tensor([30.0], dtype=torch.float64))
        initial = forward.entered(torch.tensor([30.0], dtype=torch.float64))
        path = unroll(maker.simulator, initial.state, initial.conditions, 4)
        between = (1.0 - share) * path[3] + share * path[4]
        alone = Rollout(positions=between[None], times=np.array([time]), volumes=initial.conditions.volume)
        torch.testing.assert_close(seen[0], observation.predict(alone)[0], rtol=1e-5, atol=1e-7)


def test_the_gradient_of_a_corrected_front_before_the_end_is_that_of_differences(problem: Problem) -> None:
    simulator, moments = simulator_of(2), FrontSettings(times=(0.05, 0.1, 0.15))
    simulator.correction = Correction(simulator.settings).double().eval()
    with torch.no_grad():
        simulator.correction.network.decoder.mlp[-1].weight.normal_(std=0.3)
    forward, step = GnsForward(simulator, problem, moments.operator(problem.scene)), 1e-5
    point = torch.tensor([30.0], dtype=torch.float64, requires_grad=True)
    slopes = [torch.autograd.grad(front, point, retain_graph=True)[0].item() for front in forward.predict(point)]
    behind, ahead = forward.observe([np.array([30.0 - step]), np.array([30.0 + step])])
    np.testing.assert_allclose(slopes, (ahead - behind) / (2.0 * step), rtol=1e-4)


def test_a_thickness_makes_other_particles_and_has_no_derivative(problem: Problem) -> None:
    layer = Mass(kind="layer", thickness=0.06, outline=((0.0,), (0.08,)))
    thickness = Parameter(name="masses[0].thickness", initial=0.06, lower=0.025, upper=0.075)
    scene, parameters = dataclasses.replace(problem.scene, masses=(layer,)), (*problem.parameters, thickness)
    other = dataclasses.replace(problem, scene=scene, parameters=parameters)
    forward = forward_of(other)
    values = np.array([30.0, 0.05])
    assert len(forward.deposit(values)) != len(forward.deposit(np.array([30.0, 0.08])))
    asked = torch.from_numpy(np.array([values, values])).requires_grad_()
    (rows,) = torch.autograd.grad(forward.predict(asked).sum(), asked)
    alone = torch.tensor([30.0], dtype=torch.float64, requires_grad=True)
    fixed = forward_of(dataclasses.replace(other, scene=other.scene_at(values), parameters=problem.parameters))
    (slope,) = torch.autograd.grad(fixed.predict(alone).sum(), alone)
    np.testing.assert_allclose(rows.numpy(), [[slope.item(), 0.0]] * 2, rtol=1e-4)


MATERIAL = ("friction_deg", "cohesion", "masses[0].velocity_x")
BAFFLE = ("baffles[0].x", "baffles[0].length", "baffles[0].height", "baffle_friction")
ROUGH = ("floor_friction", "wall_friction", "damping")
OTHER = ("masses[1].friction_deg", "masses[1].cohesion", "masses[1].velocity_y")
NAMES: dict[int | str, tuple[str, ...]] = {
    2: (*MATERIAL, *BAFFLE, *ROUGH, *OTHER),
    3: ("friction_deg", "baffles[0].x", "masses[0].velocity_z", "baffles[1].z", "baffles[1].width"),
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


BOTH = ("friction_deg", "masses[0].velocity_x")
LAYERED = (*BOTH, "masses[1].velocity_y", "floor_friction", "young", "masses[1].cohesion")
VALUES = np.array([30.0, 1.0, -0.3, 0.3, 2.0e6, 450.0])
CHANGES = np.array([1e-4, 1e-6, 1e-6, 1e-5, 10.0, 1e-2])
# With its gaps remembered, a corner of this flow's path lies within the difference's step of friction_deg.
SCENE = plane(wall_friction=0.0, volume_correction=False)


def test_a_layer_is_ten_lines() -> None:
    """As its docstring has it: a loss of the deposit, backward, and the gradient of two parameters."""
    run = AdjointRun(SCENE, names=LAYERED, precision="f64", threads=1)
    parameters = torch.tensor(VALUES, requires_grad=True)
    positions, velocities = run(parameters)
    (positions[-1, :, 0].mean() + 0.1 * velocities[-1, :, 1].square().mean()).backward()

    def loss(values: np.ndarray) -> float:
        moved, sped = AdjointRun(SCENE, names=LAYERED, precision="f64", threads=1)(torch.tensor(values))
        return float(moved[-1, :, 0].mean() + 0.1 * sped[-1, :, 1].square().mean())

    for index, step in enumerate(CHANGES):
        change = np.where(np.arange(len(VALUES)) == index, step, 0.0)
        slope = (loss(VALUES + change) - loss(VALUES - change)) / (2.0 * step)
        assert float(parameters.grad[index]) == pytest.approx(slope, rel=2e-4), LAYERED[index]


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
    for index, step in enumerate(CHANGES[:2]):
        change = np.where(np.arange(2) == index, step, 0.0)
        ahead, behind = forward.observe([VALUES[:2] + change, VALUES[:2] - change])
        np.testing.assert_allclose(rows[:, index], (ahead - behind) / (2.0 * step), rtol=1e-4)


@pytest.mark.slow
def test_the_adjoint_of_a_damped_flow_is_near_its_slope() -> None:
    """Damping turns on nodes that jump to and fro, and the adjoint spreads its step over the jump."""
    column = scene_of(Mass(lower=(0.1, 0.0), size=(0.2, 0.2), velocity=(1.0, 0.0)), size=(1.2, 0.4), floor_friction=0.3)
    scene = dataclasses.replace(column, material=Material(friction_deg=30.0), damping=0.1, duration=0.04, frame_dt=0.01)
    run = AdjointRun(scene, names=("friction_deg", "young"), precision="f64", threads=1)

    def objective(values: torch.Tensor) -> torch.Tensor:
        positions, _ = run(values)
        return positions[-1, :, 0].mean() + 0.5 * positions[-1, :, 1].mean()

    values = torch.tensor([30.0, scene.material.young], dtype=torch.float64, requires_grad=True)
    (slope,) = torch.autograd.grad(objective(values), values)
    ratios = []
    for index, step in enumerate((3.0e-4, 2.0)):
        change = torch.zeros_like(values)
        change[index] = step
        ahead, behind = (objective(values.detach() + side * change) for side in (1.0, -1.0))
        ratios.append(float(slope[index] * 2.0 * step / (ahead - behind)))
    assert ratios[0] == pytest.approx(1.0, abs=0.1)
    assert 0.5 < ratios[1] < 1.0
