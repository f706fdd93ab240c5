"""A block, and flows of it with a formula."""

import numpy as np

from datasets.material import Material
from datasets.particles import initial_particles, mass_counts
from datasets.scene import Domain, Mass, Scene
from datasets.trajectory import Trajectory
from validation.runs import SHARE

BLOCK = Scene(
    domain=Domain(size=(1.0, 0.4), cell=0.01),
    material=Material(friction_deg=30.0),
    masses=(Mass(lower=(0.1, 0.0), size=(0.1, 0.1)),),
    duration=0.2,
    frame_dt=0.01,
)


def sliding(scene: Scene, speed: float, *, every: int = 1, share: float = 1.0) -> Trajectory:
    """The masses of `scene` slide along x at `speed` [m/s] as one; one of `every` particles is there."""
    particles = initial_particles(scene)
    time = np.arange(scene.frames, dtype=np.float64) * scene.frame_dt
    along = np.eye(scene.dimension)[0]
    moved = particles.positions[::every] + along * speed * time[:, None, None]
    volume = np.broadcast_to(particles.volume, len(particles.friction))[::every] * every
    mass = np.repeat(np.arange(len(scene.masses)), mass_counts(scene))[::every]
    return Trajectory(
        positions=moved.astype(np.float32),
        time=time,
        velocity0=np.full(moved.shape[1:], speed * along, np.float32),
        friction=particles.friction[::every],
        volume=volume.astype(np.float32),
        mass=mass.astype(np.int32),
        scene=scene,
        summary={"wall_s": 0.5, SHARE: share, "rest_time": None if speed else 0.1},
    )
