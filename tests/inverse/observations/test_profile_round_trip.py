"""What `datasets.maps` writes of a deposit in 2D is a measured profile: `[target] csv` reads back the same heights."""

from pathlib import Path

import numpy as np
import pytest

from datasets.maps.__main__ import write_profile
from datasets.maps.plan import maps_of
from datasets.material import Material
from datasets.particles import initial_particles
from datasets.scene import Domain, Mass, Scene
from datasets.trajectory import Trajectory
from inverse.observations.measured_profile import profile_of
from inverse.observations.table import Context
from inverse.settings import Heights, ObservationSettings


@pytest.mark.parametrize("heights", list(Heights))
@pytest.mark.parametrize("spacing", [0.03])
def test_a_profile_read_back_as_a_target(tmp_path: Path, heights: Heights, spacing: float) -> None:
    """A column that has slumped into a wedge against the left wall."""
    scene = Scene(
        domain=Domain(size=(1.0, 0.5), cell=0.02),
        material=Material(friction_deg=30.0),
        masses=(Mass(lower=(0.0, 0.0), size=(0.2, 0.4)),),
    )
    start = initial_particles(scene)
    wedge = start.positions * [1.0, 0.5]
    wedge[:, 0] = 0.8 * (1.0 - np.sqrt(1.0 - start.positions[:, 0] / 0.2))
    flow = Trajectory(
        positions=wedge[None].astype(np.float32),
        time=np.array([1.0]),
        velocity0=np.zeros_like(wedge, np.float32),
        friction=start.friction,
        scene=scene,
    )
    maps = maps_of(flow, spacing)
    write_profile(maps, tmp_path)
    settings = ObservationSettings(kind="profile", csv="profile.csv", heights=heights)
    profile = profile_of(settings, Context(scene=scene, folder=tmp_path, released=0.08))
    np.testing.assert_allclose(profile.at(maps.grid.axes[0]), maps.thickness, rtol=1e-8, atol=1e-9)
    assert np.trapezoid(profile.height, profile.x) == pytest.approx(0.08, rel=1e-8)
