"""The surrogate as a forward: from the MPM's first frames, differentiable in the angle, whatever memory it may use."""

import dataclasses

import numpy as np
import pytest
import torch

from datasets.particles import initial_particles
from datasets.scene import Domain, Mass, Scene
from datasets.trajectory import Trajectory
from gns.initial import MPM_SECONDS
from gns.model.settings import ModelSettings
from gns.model.simulator import Normalisation, Simulator
from inverse.forward.gns import GnsForward, GnsSource
from inverse.jacobian import automatic, by_differences
from inverse.observations import build
from inverse.problem import Problem, read_problem
from inverse.settings import ObservationSettings, TargetSettings


@pytest.fixture(scope="module")
def problem() -> Problem:
    shipped = read_problem("friction-tall-42")
    scene = Scene(
        domain=Domain(size=(0.4, 0.2), cell=0.01),
        material=shipped.scene.material,
        masses=(Mass(lower=(0.0, 0.0), size=(0.06, 0.08)),),
        duration=0.15,
    )
    return dataclasses.replace(shipped, scene=scene, target=TargetSettings(value=0.1))


@pytest.fixture(scope="module")
def beginning(problem: Problem) -> Trajectory:
    """Frames of a free fall, longer than a surrogate needs."""
    scene = problem.scene.with_friction_deg(30.0)
    points = initial_particles(scene)
    time = np.arange(scene.frames) * scene.frame_dt
    positions = np.broadcast_to(points.positions, (len(time), *points.positions.shape)).copy()
    positions[:, :, 0] *= 1.0 + time[:, None]
    return Trajectory(
        positions=positions.astype(np.float32),
        time=time,
        velocity0=points.velocities.astype(np.float32),
        friction=points.friction,
        scene=scene,
    )


def source(problem: Problem, kind: str = "front", memory_gib: float = 1.0) -> GnsSource:
    torch.manual_seed(0)
    settings = ModelSettings(width=16, layers=2, rounds=1, grid_channels=8)
    scales = Normalisation(displacement=0.003, acceleration=0.01, friction_mean=0.6, friction_std=0.2)
    observation = build(ObservationSettings(kind=kind), problem.scene)
    return GnsSource(Simulator(settings, scales), problem, observation, memory_gib)


def test_it_goes_on_from_a_twentieth_of_a_second_to_the_end(problem: Problem, beginning: Trajectory) -> None:
    maker = source(problem)
    frames = maker.first_frames(problem.scene)
    assert frames is not None
    assert frames.duration == MPM_SECONDS
    forward = maker.start(beginning)
    step = maker.simulator.settings.step
    assert forward.steps == round((problem.scene.duration - MPM_SECONDS) / step)
    # What comes after the first frames is not looked at.
    short = dataclasses.replace(beginning, positions=beginning.positions[:21], time=beginning.time[:21])
    np.testing.assert_array_equal(maker.start(short).deposit(np.array([30.0])), forward.deposit(np.array([30.0])))


@pytest.mark.parametrize("kind", ["front", "runout", "profile", "toe"])
def test_the_gradient_agrees_with_differences(problem: Problem, beginning: Trajectory, kind: str) -> None:
    forward = source(problem, kind).start(beginning)
    point = np.array([33.0])
    observed = forward.observe([point])[0]
    evaluation = automatic(forward, observed - 0.01 * np.arange(1, len(observed) + 1))(point)
    slope = by_differences(forward, point, np.array([1.0]))[:, 0]
    expected = 2.0 * np.mean(0.01 * np.arange(1, len(observed) + 1) * slope)
    assert abs(expected) > 1e-9
    # The rollout is in single precision and its neighbours change from step to step.
    assert evaluation.gradient[0] == pytest.approx(expected, rel=0.1)


def test_memory_changes_nothing_but_memory(problem: Problem, beginning: Trajectory) -> None:
    evaluations = []
    kept = []
    for memory_gib in (0.0, 0.0005, 1.0):
        forward = source(problem, memory_gib=memory_gib).start(beginning)
        kept.append(forward.kept_steps)
        evaluations.append(automatic(forward, np.array([0.1]))(np.array([33.0])))
    assert kept[0] == 0 < kept[1] < kept[2] == forward.steps
    for evaluation in evaluations[1:]:
        np.testing.assert_allclose(evaluation.observation, evaluations[0].observation, rtol=1e-6)
        np.testing.assert_allclose(evaluation.gradient, evaluations[0].gradient, rtol=1e-3)


def test_the_scenes_own_angle_does_not_matter(problem: Problem, beginning: Trajectory) -> None:
    """The angle of the scene that holds the answer must not enter the prediction."""
    honest = source(problem).start(beginning)
    another = dataclasses.replace(problem, scene=problem.scene.with_friction_deg(15.0))
    other: GnsForward = source(another).start(beginning)
    np.testing.assert_array_equal(honest.observe([np.array([33.0])]), other.observe([np.array([33.0])]))
    assert honest.observe([np.array([33.0])]) != honest.observe([np.array([20.0])])
