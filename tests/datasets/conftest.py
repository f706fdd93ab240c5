"""Small things that several tests of `datasets` start from."""

import numpy as np
import pytest

from datasets.material import Material
from datasets.scene import Domain, Mass, Scene
from datasets.trajectory import Trajectory


@pytest.fixture
def scene() -> Scene:
    """A small block on the floor of a small box, watched for two frames."""
    return Scene(
        domain=Domain(size=(0.2, 0.1), cell=0.01),
        material=Material(friction_deg=30.0),
        masses=(Mass(lower=(0.05, 0.0), size=(0.04, 0.02), velocity=(0.1, -0.2)),),
        duration=0.005,
    )


@pytest.fixture
def trajectory(scene: Scene) -> Trajectory:
    """Three frames of five points."""
    stream = np.random.default_rng(0)
    return Trajectory(
        positions=stream.random((3, 5, 2), np.float32),
        time=np.array([0.0, 0.0025, 0.005]),
        velocity0=stream.random((5, 2), np.float32),
        friction=np.full(5, 0.5, np.float32),
        scene=scene,
        summary={"steps": 7},
    )
