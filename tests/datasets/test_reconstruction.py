"""The scene of a foreign trajectory: spacing, domain, masses, baffles and friction, each from its points."""

import math
from dataclasses import replace

import numpy as np
import pytest

from datasets.errors import InputError
from datasets.exchange.baffle_particles import obstacle_particles
from datasets.exchange.cloud import Cloud, cloud_of
from datasets.exchange.reconstruction import Known, estimated_spacing, fitted_domain, overlap, reconstruct, without
from datasets.scene import Baffle, Domain
from datasets.trajectory import Trajectory
from tests.datasets.toys import FRAMES, strewn, toy

KNOWN = Known(
    bounds=((0.1, 0.9), (0.1, 0.9)), frame_dt=0.0025, spacing=0.01, spacing_from="--spacing", friction_deg=None
)


def cloud(sand: np.ndarray, obstacles: np.ndarray | None = None, velocity: tuple[float, float] = (1.0, 0.0)) -> Cloud:
    """Sand that moves at `velocity` [m/s] past obstacles that stand."""
    obstacles = np.empty((0, 2)) if obstacles is None else obstacles
    still = np.repeat([False, True], [len(sand), len(obstacles)])
    step = np.where(still[:, None], 0.0, np.array(velocity) * KNOWN.frame_dt)
    return Cloud(
        name="some",
        positions=np.concatenate([sand, obstacles]) + step * np.arange(FRAMES)[:, None, None],
        stationary=still,
        friction=np.where(still, 0.0, 0.5).astype(np.float32),
    )


def lattice(lower: tuple[float, float], size: tuple[float, float], spacing: float = 0.01) -> np.ndarray:
    return obstacle_particles(Baffle(lower=lower, size=size), spacing)


@pytest.mark.parametrize(("dimension", "known_spacing"), [(2, 0.005), (2, None), (3, 0.01)])
def test_a_trajectory_of_talus(dimension: int, known_spacing: float | None) -> None:
    trajectory = toy(dimension)
    scene = trajectory.scene
    known = Known(
        bounds=tuple((0.0, length) for length in scene.domain.size),
        frame_dt=scene.frame_dt,
        spacing=known_spacing,
        spacing_from="",
        friction_deg=None,
    )
    again = reconstruct(cloud_of(trajectory, "some"), known)
    np.testing.assert_array_equal(again.positions, trajectory.positions)
    np.testing.assert_array_equal(again.friction, trajectory.friction)
    np.testing.assert_allclose(again.time, trajectory.time, rtol=1e-12)
    np.testing.assert_allclose(again.velocity0, trajectory.velocity0, atol=0.03)
    assert again.scene.domain.size == scene.domain.size
    assert again.scene.frames == scene.frames
    assert again.scene.frame_dt == scene.frame_dt
    if known_spacing is not None:
        assert again.scene.domain.cell == scene.domain.cell
        assert again.scene.baffles == scene.baffles
    assert again.scene.domain.cell == pytest.approx(scene.domain.cell, rel=0.1)
    assert again.scene.material.friction_deg == scene.material.friction_deg
    (mass,), (truth,) = again.scene.masses, scene.masses
    np.testing.assert_allclose(mass.lower, truth.lower, atol=0.25 * scene.domain.cell)
    np.testing.assert_allclose(mass.size, truth.size, atol=0.5 * scene.domain.cell)
    assert truth.velocity is not None
    np.testing.assert_allclose(mass.velocity or 0.0, truth.velocity, atol=1e-2)


def reconstructed_scene(particles: Cloud, known: Known = KNOWN) -> Trajectory:
    return reconstruct(particles, known)


def test_the_box_is_moved_to_the_origin() -> None:
    again = reconstructed_scene(cloud(lattice((0.2, 0.1), (0.3, 0.2)), lattice((0.6, 0.1), (0.1, 0.3))))
    assert again.scene.domain == Domain(size=(0.8, 0.8), cell=0.02)
    assert again.scene.baffles == (Baffle(lower=(0.5, 0.0), size=(0.1, 0.3)),)
    (mass,) = again.scene.masses
    np.testing.assert_allclose([*mass.lower, *mass.size, *(mass.velocity or ())], [0.1, 0.0, 0.3, 0.2, 1.0, 0.0])
    assert again.positions.shape == (FRAMES, 600, 2)
    assert again.positions[0, :, 0].min() == np.float32(0.105)
    reconstructed = again.summary["reconstructed"]
    assert (reconstructed["origin"], reconstructed["outside"], reconstructed["obstacle_particles"]) == (
        [0.1, 0.1],
        0,
        300,
    )
    assert reconstructed["filled"] == pytest.approx(1.0)
    assert any("defaults" in each for each in reconstructed["assumed"])


def test_masses_apart_have_their_own_velocity_and_friction() -> None:
    a, b = lattice((0.2, 0.1), (0.1, 0.1)), lattice((0.5, 0.3), (0.2, 0.1))
    particles = cloud(np.concatenate([b, a]))
    positions = particles.positions.copy()
    positions[:, len(b) :] = a
    friction = np.repeat([0.5, 0.7], [len(b), len(a)]).astype(np.float32)
    scene = reconstructed_scene(replace(particles, positions=positions, friction=friction)).scene
    assert [mass.velocity for mass in scene.masses] == [None, (1.0, 0.0)]
    angles = [scene.material_of(mass).friction_deg for mass in scene.masses]
    np.testing.assert_allclose(angles, np.degrees(np.arctan([0.7, 0.5])), atol=1e-4)
    assert scene.masses[0].material is None


def test_boxes_that_overlap_become_one() -> None:
    around = lattice((0.2, 0.1), (0.3, 0.3))
    ring = around[((around < [0.25, 0.0]) | (around > [0.45, 0.2])).any(axis=1)]
    inner = lattice((0.33, 0.12), (0.04, 0.04))
    scene = reconstructed_scene(cloud(np.concatenate([ring, inner]))).scene
    assert len(scene.masses) == 1


def test_a_mass_leaves_room_for_a_baffle() -> None:
    sand = lattice((0.2, 0.1), (0.4, 0.2))
    clear = sand[(abs(sand - [0.4, 0.15]) > 0.05).any(axis=1)]
    again = reconstructed_scene(cloud(clear, lattice((0.36, 0.1), (0.08, 0.1))))
    boxes = [(np.array(mass.lower), np.array(mass.lower) + mass.size) for mass in again.scene.masses]
    assert len(boxes) == 3
    # The sand's box from its outermost points, less what the baffle takes of it.
    assert sum(math.prod(mass.size) for mass in again.scene.masses) == pytest.approx(0.39 * 0.19 - 0.08 * 0.095)
    assert again.summary["reconstructed"]["filled"] == pytest.approx(len(clear) * 0.01**2 / 0.0665)
    assert not any(overlap(a, b) for a in boxes for b in boxes if a is not b)


def test_what_is_left_of_a_box() -> None:
    box = np.zeros(3), np.ones(3)
    solid = np.array([0.2, -1.0, 0.4]), np.array([0.6, 0.5, 2.0])
    parts = without(box, solid)
    assert sum(float(np.prod(high - low)) for low, high in parts) == pytest.approx(1.0 - 0.4 * 0.5 * 0.6)
    assert not any(overlap(part, solid) for part in parts)
    assert not any(overlap(a, b) for a in parts for b in parts if a is not b)


@pytest.mark.parametrize(("dimension", "side", "within"), [(2, 20, 0.02), (2, 60, 0.01), (3, 8, 0.03), (3, 20, 0.03)])
def test_the_spacing_of_jittered_points(dimension: int, side: int, within: float) -> None:
    grid = np.stack(np.meshgrid(*[np.arange(side)] * dimension, indexing="ij"), axis=-1).reshape(-1, dimension)
    jitter = np.random.default_rng(0).uniform(-0.4, 0.4, grid.shape)
    assert estimated_spacing(0.01 * (grid + jitter)) == pytest.approx(0.01, rel=within)
    assert estimated_spacing(0.01 * grid) == pytest.approx(0.01, rel=within)


@pytest.mark.parametrize(("dimension", "side"), [(2, 20), (2, 40), (3, 8), (3, 20)])
def test_the_spacing_of_points_at_random(dimension: int, side: int) -> None:
    points = strewn(np.random.default_rng(0), (0.0,) * dimension, (0.01 * side,) * dimension, 0.01)
    assert estimated_spacing(points) == pytest.approx(0.01, rel=0.06)


@pytest.mark.parametrize(
    ("lengths", "spacing", "expected"),
    [
        ((1.0, 0.5), 0.005, (Domain(size=(1.0, 0.5), cell=0.01), 2)),
        ((1.0, 0.41), 0.01 / 3, (Domain(size=(1.0, 0.41), cell=0.01), 3)),
        ((0.8, 0.8), 0.00512, (Domain(size=(0.8, 0.8), cell=round(0.8 / 78, 12)), 2)),
        ((5.366, 2.0), 0.02, (Domain(size=(5.4, 2.0), cell=0.04), 2)),
    ],
)
def test_the_domain(lengths: tuple[float, ...], spacing: float, expected: tuple[Domain, int]) -> None:
    assert fitted_domain(lengths, spacing) == expected


SAND = lattice((0.2, 0.1), (0.3, 0.2))


@pytest.mark.parametrize(
    ("particles", "known", "expected"),
    [
        (cloud(SAND), replace(KNOWN, friction_deg=30.0), "no --friction-deg"),
        (replace(cloud(SAND), friction=None), KNOWN, "expected --friction-deg"),
        (replace(cloud(SAND), friction=np.zeros(600, np.float32)), KNOWN, "friction_deg"),
        (cloud(SAND), replace(KNOWN, bounds=((0.0, 1.0),) * 3), "3D positions"),
        (cloud(SAND[:20]), replace(KNOWN, spacing=None), "--spacing"),
        (cloud(SAND + 3.0), KNOWN, "inside the bounds"),
        (cloud(np.full((100, 2), 0.3)), replace(KNOWN, spacing=None), "on top of others"),
        (cloud(SAND), replace(KNOWN, spacing=1e-7), "cells a side"),
        (replace(cloud(SAND, SAND + 0.4), stationary=np.repeat([True, False], 600)), KNOWN, "to stay where they are"),
    ],
)
def test_what_cannot_be_reconstructed(particles: Cloud, known: Known, expected: str) -> None:
    with pytest.raises(InputError) as caught:
        reconstructed_scene(particles, known)
    assert expected in str(caught.value)
    assert caught.value.key.startswith("some")


def test_an_angle_for_a_set_without_one() -> None:
    again = reconstructed_scene(replace(cloud(SAND), friction=None), replace(KNOWN, friction_deg=30.0))
    np.testing.assert_allclose(again.friction, math.tan(math.radians(30.0)), rtol=1e-6)
    assert again.scene.material.friction_deg == 30.0
