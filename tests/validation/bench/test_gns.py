"""`python -m validation.bench gns`: mounds that creep, and the price of an error."""

import math

import numpy as np
import pytest

from datasets import Mass, Scene, Trajectory
from datasets.scene.particles import initial_particles, released_volume
from tests.scenes import flow_of, scene_of
from validation.bench.gns import mpm_seconds
from validation.bench.held_out import MOUNDS, creep, mound

BLOCK = scene_of(Mass(lower=(0.1, 0.0), size=(0.2, 0.2)), size=(1.0, 0.4), duration=1.0, frame_dt=0.1)


def stretched(scene: Scene, by: float) -> Trajectory:
    """A block whose particles move away from its rear, evenly over the time, until it is `by` times as long."""
    particles = initial_particles(scene)
    time = np.arange(scene.frames) * scene.frame_dt
    factor = 1.0 + (by - 1.0) * time / time[-1]
    positions = np.repeat(particles.positions[None], len(time), axis=0)
    positions[..., 0] = 0.1 + factor[:, None] * (positions[..., 0] - 0.1)
    return flow_of(scene, positions, summary={"wall_s": 1.0})


def test_a_mound_that_creeps_is_measured_from_its_start_on() -> None:
    flow = stretched(BLOCK, 2.0)
    assert creep(flow, 1.0) == pytest.approx(creep(flow), rel=1e-4)
    assert creep(flow, 1.0) == pytest.approx(200.0, rel=0.03)
    for title, (friction_deg, slope_deg) in MOUNDS.items():
        scene, steepest = mound(title, 0), math.degrees(math.atan(0.5)) + slope_deg
        assert steepest < friction_deg
        assert released_volume(scene) == pytest.approx(0.08)


def test_the_price_of_an_error_is_read_off_the_curve() -> None:
    points = [(1.0, 0.02), (0.25, 0.04), (0.0625, 0.08)]
    assert mpm_seconds(points, 0.2) == pytest.approx(0.0625)
    assert mpm_seconds(points, 0.04) == pytest.approx(0.25)
    assert mpm_seconds(points, 0.04 / math.sqrt(2.0)) == pytest.approx(0.5)
    assert mpm_seconds(points, 0.001) is None
