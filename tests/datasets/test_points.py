"""Material points: as many as the volume asks for, inside their masses, each mass from its own stream."""

import dataclasses

import numpy as np
import pytest

from datasets.library import read_scene
from datasets.material import Material
from datasets.particles import initial_particles, particle_count
from datasets.scene import Domain, Mass, Scene


@pytest.mark.parametrize("name", ["column-tall-21", "layers-10"])
def test_points_lie_inside_their_masses(name: str) -> None:
    scene = read_scene(name)
    points = initial_particles(scene)
    inside = np.zeros(len(points.positions), int)
    for mass in scene.masses:
        lower = np.array(mass.lower)
        inside += np.all((points.positions > lower) & (points.positions < lower + mass.size), axis=1)
    assert np.all(inside == 1)


@pytest.mark.parametrize("size", [(0.04, 0.02), (0.043, 0.028), (0.1, 0.0024)])
def test_points_stand_for_the_volume_of_the_mass(scene: Scene, size: tuple[float, float]) -> None:
    scene = dataclasses.replace(scene, masses=(Mass(lower=(0.05, 0.0), size=size),))
    points = initial_particles(scene)
    # To the nearest row of points across the longest axis.
    row = points.volume * max(1, round(min(size) / 0.005))
    assert abs(points.volume * len(points.positions) - size[0] * size[1]) <= 0.51 * row


def test_another_mass_leaves_the_points_of_the_first(scene: Scene) -> None:
    second = Mass(lower=(0.1, 0.0), size=(0.02, 0.02), material=Material(friction_deg=20.0))
    alone = initial_particles(scene)
    together = initial_particles(dataclasses.replace(scene, masses=(*scene.masses, second)))
    count = len(alone.positions)
    np.testing.assert_array_equal(together.positions[:count], alone.positions)
    np.testing.assert_array_equal(together.velocities[count:], 0.0)
    assert [material.friction_deg for material in together.materials] == [30.0, 20.0]
    np.testing.assert_allclose(together.friction[[0, -1]], np.tan(np.radians([30.0, 20.0])), rtol=1e-6)


def test_masses_of_the_same_shape_are_jittered_differently(scene: Scene) -> None:
    twin = dataclasses.replace(scene.masses[0], lower=(0.1, 0.0))
    points = initial_particles(dataclasses.replace(scene, masses=(scene.masses[0], twin))).positions
    first, second = np.split(points, 2)
    assert np.abs(second - first - [0.05, 0.0]).max() > 1e-4


def test_the_seed_decides_the_jitter(scene: Scene) -> None:
    again = initial_particles(scene).positions
    np.testing.assert_array_equal(initial_particles(scene).positions, again)
    other = initial_particles(dataclasses.replace(scene, seed=1)).positions
    assert 0.0 < np.abs(other - again).max() <= 0.8 * 0.005


def test_without_jitter_points_form_a_lattice(scene: Scene) -> None:
    points = initial_particles(dataclasses.replace(scene, jitter=0.0))
    np.testing.assert_allclose(np.unique(points.positions[:, 1].round(9)), [0.0025, 0.0075, 0.0125, 0.0175])
    assert points.velocities.shape == points.positions.shape == (32, 2)
    np.testing.assert_array_equal(points.velocities[0], [0.1, -0.2])


def test_the_count_is_known_beforehand() -> None:
    for name in ("column-tall-42", "layers-10", "baffles-2"):
        scene = read_scene(name)
        assert particle_count(scene) == len(initial_particles(scene).positions)


def test_a_mass_that_turns(scene: Scene) -> None:
    """v = v0 + omega (-(y - yc), x - xc); sum over a lattice is v0, and the velocity gradient is the spin."""
    mass = dataclasses.replace(scene.masses[0], angular_velocity=3.0)
    particles = initial_particles(dataclasses.replace(scene, masses=(mass,)))
    x, y = (particles.positions - [0.07, 0.01]).T
    np.testing.assert_allclose(particles.velocities, np.stack([0.1 - 3.0 * y, -0.2 + 3.0 * x], axis=1), atol=1e-15)
    np.testing.assert_array_equal(particles.velocity_gradients[0], [[0.0, -3.0], [3.0, 0.0]])


@pytest.mark.parametrize(
    ("given", "omega"), [(2.0, (0.0, 0.0, 2.0)), ((1.0, -2.0, 0.5), (1.0, -2.0, 0.5)), (None, (0.0, 0.0, 0.0))]
)
def test_a_mass_that_turns_in_3d(given: float | tuple[float, ...] | None, omega: tuple[float, ...]) -> None:
    mass = Mass(lower=(0.1, 0.0, 0.1), size=(0.1, 0.1, 0.2), angular_velocity=given)
    scene = Scene(domain=Domain(size=(0.4, 0.4, 0.4), cell=0.05), material=Material(friction_deg=30.0), masses=(mass,))
    particles = initial_particles(scene)
    arm = particles.positions - [0.15, 0.05, 0.2]
    np.testing.assert_allclose(particles.velocities, np.cross(omega, arm), atol=1e-15)
    np.testing.assert_allclose(np.einsum("nij, nj -> ni", particles.velocity_gradients, arm), np.cross(omega, arm))
    assert Scene.from_json(scene.to_json()) == scene
