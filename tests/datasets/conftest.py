"""Small things that several tests of `datasets` start from; datasets made by hand: sand that slides past baffles."""

from pathlib import Path

import numpy as np
import pytest

from datasets import Baffle, Mass, Material, Scene, Trajectory
from datasets.definitions.definition import Entry, Split
from datasets.definitions.training import metadata, motion_statistics
from datasets.files import write_json
from datasets.scene.particles import initial_particles
from tests.scenes import flow_of, scene_of

FRAMES = 6
SPLITS = (Split.TRAIN, Split.TRAIN, Split.VALID, Split.TEST)


@pytest.fixture
def scene() -> Scene:
    """A small block on the floor of a small box, watched for two frames."""
    mass = Mass(lower=(0.05, 0.0), size=(0.04, 0.02), velocity=(0.1, -0.2))
    return scene_of(mass, size=(0.2, 0.1), cell=0.01, duration=0.005)


@pytest.fixture
def trajectory(scene: Scene) -> Trajectory:
    """Three frames of five points."""
    stream = np.random.default_rng(0)
    positions, velocity0 = stream.random((3, 5, 2), np.float32), stream.random((5, 2), np.float32)
    friction = np.full(5, 0.5, np.float32)
    return flow_of(scene, positions, velocity0=velocity0, friction=friction, summary={"steps": 7})


def toy_scene(dimension: int, seed: int) -> Scene:
    """A block that slides at 1 m/s towards two baffles."""
    if dimension == 2:
        size, cell, body = (0.5, 0.25), 0.01, ((0.05, 0.0), (0.1, 0.08))
        boxes = ((0.3, 0.0), (0.05, 0.1)), ((0.373, 0.01), (0.004, 0.08))
    else:
        size, cell, body = (0.4, 0.2, 0.16), 0.02, ((0.0, 0.0, 0.02), (0.1, 0.08, 0.12))
        boxes = ((0.2, 0.0, 0.02), (0.033, 0.1, 0.04)), ((0.3, 0.0, 0.1), (0.05, 0.1, 0.041))
    mass = Mass(lower=body[0], size=body[1], velocity=(1.0, 0.0, 0.0)[:dimension])
    baffles = tuple(Baffle(lower=lower, size=extent) for lower, extent in boxes)
    sand, duration = Material(friction_deg=30.0 + seed), (FRAMES - 1) * 0.0025
    return scene_of(mass, size=size, cell=cell, material=sand, baffles=baffles, duration=duration, seed=seed)


def toy(dimension: int, seed: int = 0) -> Trajectory:
    """The block's trajectory; each point wanders a little."""
    scene = toy_scene(dimension, seed)
    points = initial_particles(scene)
    time = np.arange(FRAMES) * scene.frame_dt
    wander = np.random.default_rng(seed).normal(0.0, 1.0e-5, (FRAMES, *points.positions.shape))
    wander[0] = 0.0
    positions = points.positions + points.velocities * time[:, None, None] + wander
    return flow_of(scene, positions, velocity0=points.velocities.astype(np.float32))


def toy_dataset(folder: Path, dimension: int) -> Path:
    """A dataset of Talus with two trajectories to train on and one each to validate and to test."""
    entries, motions = [], []
    for seed, split in enumerate(SPLITS):
        trajectory = toy(dimension, seed)
        trajectory.save(folder / split.value / f"toy-{seed:04d}.npz")
        entries.append(Entry(split=split, name=f"toy-{seed:04d}", scene=trajectory.scene))
        if split is Split.TRAIN:
            motions.append(motion_statistics(trajectory.positions, trajectory.scene.frame_dt))
    write_json(folder / "metadata.json", metadata("toy", entries, seed=0, statistics=sum(motions[1:], motions[0])))
    return folder
