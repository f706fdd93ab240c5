"""What a model learns of trajectories: cohesion, thinning that keeps volumes, statistics against NumPy."""

import dataclasses
from functools import reduce
from operator import add
from typing import Any

import numpy as np
import pytest

from datasets import InputError, Mass, Material, Scene, Solid
from datasets.definitions.definition import Entry, Split
from datasets.definitions.training import MOVING_SPEED, MotionStatistics, metadata, motion_statistics, thin
from datasets.scene.particles import initial_particles, observed_cohesion
from tests.scenes import scene_of

FRAME_DT = 0.0025


def test_cohesion_goes_with_the_particles_of_the_masses(scene: Scene) -> None:
    stiff = dataclasses.replace(scene.material, cohesion=500.0)
    masses = (*scene.masses, Mass(lower=(0.12, 0.0), size=(0.03, 0.03), material=stiff))
    two = dataclasses.replace(scene, masses=masses)
    points = initial_particles(two)
    cohesion = observed_cohesion(two, points.positions, None)
    assert np.array_equal(cohesion, points.cohesion)
    assert set(cohesion) == {0.0, 500.0}
    with pytest.raises(InputError, match="positions: expected the 68 particles of masses that differ in cohesion, got"):
        observed_cohesion(two, points.positions[:60], None)
    # A part of the particles, as it is stored: each says its mass.
    part = observed_cohesion(two, points.positions[:3], np.array([1, 0, 1], np.int32))
    assert part.tolist() == [500.0, 0.0, 500.0]
    # Where all are alike, any number of points will do: an imported trajectory has its own.
    alike = dataclasses.replace(scene, material=stiff)
    assert observed_cohesion(alike, points.positions[:3], None).tolist() == [500.0] * 3


def test_strength_that_grows_with_depth_is_that_of_the_particles() -> None:
    """Of a box, and of a layer on a slope, whose depth counts from its own top."""
    clay = Material(friction_deg=20.0, cohesion=100.0, strength_gradient=2.0e3)
    slope = Solid(kind="terrain", points=((0.0, 0.3), (1.0, 0.0)))
    layer = Mass(kind="layer", thickness=0.1, outline=((0.0,), (0.5,)))
    box = Mass(lower=(0.7, 0.3), size=(0.2, 0.2), material=dataclasses.replace(clay, strength_gradient=500.0))
    scene = scene_of(layer, box, size=(1.0, 0.6), cell=0.02, material=clay, solids=(slope,))
    particles = initial_particles(scene)
    assert 100.0 + 2.0e3 * 0.09 < particles.cohesion[particles.mass == 0].max() <= 100.0 + 2.0e3 * 0.1
    # Files keep positions in single precision.
    stored, part = particles.positions.astype(np.float32), slice(None, None, 3)
    for chosen, mass in ((slice(None), None), (part, particles.mass[part])):
        cohesion = observed_cohesion(scene, stored[chosen], mass)
        np.testing.assert_allclose(cohesion, particles.cohesion[chosen], rtol=1e-5)


def test_metadata_has_the_materials_of_all_masses_number_by_number(scene: Scene) -> None:
    """Constants of another law key by key; what no mass is made of is no part of it."""
    bars = [Material(law="von-mises", friction_deg=0.0, constants={"strength": strength}) for strength in (9.0, 5.0)]
    dense = dataclasses.replace(scene.material, friction_deg=40.0, density=2000.0)
    others = [(dataclasses.replace(scene.masses[0], material=material),) for material in (*bars, dense)]
    scenes = [dataclasses.replace(scene, masses=masses) for masses in others]

    def described(*members: Scene) -> dict[str, Any]:
        entries = [Entry(name=str(k), split=Split.TRAIN, scene=member) for k, member in enumerate(members)]
        statistics = MotionStatistics.from_samples(np.zeros((1, 2)), np.zeros((1, 2)))
        content = metadata("toy", entries, seed=0, statistics=statistics)
        return {**content["material"], "friction_deg": content["friction_deg"]}

    both = described(*scenes[:2])
    assert (both["law"], both["constants"], both["friction_deg"]) == ("von-mises", {"strength": [5.0, 9.0]}, [0.0, 0.0])
    mixed = described(scene, scenes[2])
    assert mixed["friction_deg"] == [scene.material.friction_deg, 40.0]
    assert mixed["density"] == [scene.material.density, 2000.0]


def test_moments_of_parts_are_those_of_the_whole() -> None:
    # A mean far above the spread: the sum of squares alone would lose every digit.
    samples = np.random.default_rng(0).normal([1.0e6, -3.0], [0.01, 2.0], (1000, 2))
    parts = np.split(samples, [1, 1, 300, 999])
    joint = reduce(add, (MotionStatistics.from_samples(part, part[:0]) for part in parts))
    assert joint.count.tolist() == [[1000], [0]]
    np.testing.assert_allclose(joint.mean, [samples.mean(axis=0), [0.0, 0.0]], rtol=1e-14)
    np.testing.assert_allclose(joint.std, [samples.std(axis=0), [0.0, 0.0]], rtol=1e-7)


def walk(seed: int, frames: int, points: int) -> np.ndarray:
    """Points that always move faster than the threshold; positions [m], shape [T, N, 2]."""
    return np.cumsum(np.random.default_rng(seed).uniform(0.001, 0.01, (frames, points, 2)), axis=0)


def test_statistics_of_moving_points_are_numpys_and_points_at_rest_do_not_count() -> None:
    sequences = [walk(0, 6, 40), walk(1, 9, 10)]
    joint = reduce(add, (motion_statistics(sequence, FRAME_DT) for sequence in sequences))
    velocities = np.concatenate([np.diff(sequence, axis=0).reshape(-1, 2) for sequence in sequences])
    accelerations = np.concatenate([np.diff(sequence, 2, axis=0).reshape(-1, 2) for sequence in sequences])
    for index, samples in enumerate((velocities, accelerations)):
        assert joint.count[index] == len(samples)
        np.testing.assert_allclose(joint.mean[index], samples.mean(axis=0), rtol=1e-12)
        np.testing.assert_allclose(joint.std[index], samples.std(axis=0), rtol=1e-12)
    moving, resting = sequences[0], np.broadcast_to([0.5, 0.1], (6, 1000, 2)).copy()
    resting[1:, :, 0] += 0.9 * MOVING_SPEED * FRAME_DT  # one step just below the threshold
    both = motion_statistics(np.concatenate([moving, resting], axis=1), FRAME_DT)
    alone = motion_statistics(moving, FRAME_DT)
    assert both.count.tolist() == [[5 * 40], [4 * 40]]
    np.testing.assert_array_equal([both.mean, both.std], [alone.mean, alone.std])


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("kept", [1, 2, 5])
def test_every_cell_keeps_its_volume(dimension: int, kept: int) -> None:
    positions = np.random.default_rng(0).uniform(-0.1, 0.3, (500, dimension))
    indices, volumes = thin(positions, 2.0, cell=0.1, kept=kept, rng=np.random.default_rng(1))
    cells = np.floor(positions / 0.1).astype(int)
    stays = cells[indices]
    assert len(np.unique(indices)) == len(indices)
    for cell, count in zip(*np.unique(cells, axis=0, return_counts=True), strict=True):
        chosen = (stays == cell).all(axis=1)
        assert chosen.sum() == min(count, kept)
        assert volumes[chosen].sum() == pytest.approx(2.0 * count)


def test_a_cell_keeps_its_particles_in_proportion_to_their_volume() -> None:
    # Three quarters of the volume of each cell are at its right end, in a quarter of the particles.
    positions = np.tile([[0.01, 0.05], [0.02, 0.05], [0.03, 0.05], [0.09, 0.05]], (2000, 1))
    positions[:, 1] += np.repeat(np.arange(2000), 4) * 0.1
    volume = np.tile([1.0, 1.0, 1.0, 9.0], 2000)
    indices, volumes = thin(positions, volume, cell=0.1, kept=1, rng=np.random.default_rng(0))
    assert np.mean(positions[indices, 0] > 0.05) == pytest.approx(0.75, abs=0.04)
    assert volumes.sum() == pytest.approx(volume.sum())
