"""A profile of the flow at a time: exact and smooth alike, between two frames, and apart from that of the end."""

import numpy as np
import pytest
import torch

from datasets.material import Material
from datasets.particles import initial_volumes
from datasets.scene import Domain, Mass, Scene
from datasets.trajectory import Trajectory
from inverse.observations import Rollout, build
from inverse.settings import ObservationSettings

SCENE = Scene(
    domain=Domain(size=(1.0, 0.5), cell=0.05),
    material=Material(friction_deg=30.0),
    masses=(Mass(lower=(0.1, 0.0), size=(0.3, 0.2)),),
    duration=0.02,
    frame_dt=0.01,
)


@pytest.fixture
def run() -> Trajectory:
    """A block that moves by 0.1 m in every frame."""
    from datasets.particles import initial_particles

    particles = initial_particles(SCENE)
    positions = particles.positions + np.array([0.1, 0.0]) * np.arange(3.0)[:, None, None]
    return Trajectory(
        positions=positions.astype(np.float32),
        time=np.array([0.0, 0.01, 0.02]),
        velocity0=particles.velocities.astype(np.float32),
        friction=particles.friction,
        scene=SCENE,
    )


@pytest.mark.parametrize(("time", "moved"), [(0.0, 0.0), (0.01, 0.1), (0.015, 0.15), (0.02, 0.2)])
def test_it_is_seen_at_its_time(run: Trajectory, time: float, moved: float) -> None:
    observation = build(ObservationSettings(kind="profile", times=(time,)), SCENE)
    at_end = build(ObservationSettings(kind="profile"), SCENE)
    assert observation.over_time
    assert not at_end.over_time
    np.testing.assert_allclose(observation.observe(run) + 0.2 - moved, at_end.observe(run), atol=0.01)
    rollout = Rollout(
        positions=torch.from_numpy(run.positions), times=run.time, volumes=torch.from_numpy(initial_volumes(SCENE))
    )
    np.testing.assert_allclose(observation.predict(rollout), observation.observe(run), atol=1e-6)
