"""Particles: exactly the volume of their masses, inside them, each mass from its own stream; fields at their nodes."""

import dataclasses
import math

import numpy as np
import pytest

from datasets import Mass, Material, Scene
from datasets.scene.grid_field import Field, Grid
from datasets.scene.particles import initial_particles, particle_count, particle_volumes, warn_if_unresolved
from tests.refusals import refused
from tests.scenes import scene_of

GRIDS = {
    "2D": Grid((0.1, -0.2), (0.3, 0.2), (4, 3)),
    "3D": Grid((0.0, 0.1, 0.2), (0.5, 0.2, 0.1), (3, 4, 5)),
    "one node along y": Grid((0.0, 0.5), (0.25, 1.0), (5, 1)),
}
MASSES = Mass(lower=(0.0, 0.0), size=(0.3, 0.2)), Mass(lower=(0.5, 0.0), size=(0.2, 0.2), velocity=(1.0, 0.0))
SAND = Material(friction_deg=30.0, cohesion=100.0)
SCENE = scene_of(*MASSES, size=(1.0, 0.5), cell=0.05, material=SAND)
FRICTION = Field(quantity="friction_deg", origin=(0.0, 0.0), spacing=(1.0, 0.5), nodes=(2, 2), values=(20, 30, 40, 50))


@pytest.mark.parametrize("dimension", [2, 3])
def test_the_mass_of_random_thin_boxes_is_exact(dimension: int) -> None:
    stream = np.random.default_rng(3)
    for _ in range(40):
        # From a fiftieth of a cell to ten cells along each axis, two boxes of different density side by side.
        sizes = 0.05 * np.exp(stream.uniform(np.log(0.02), np.log(8.0), (2, dimension)))
        masses = []
        for number, size in enumerate(sizes.tolist()):
            sand = Material(friction_deg=30.0, density=1000.0 + 700.0 * number)
            masses.append(Mass(lower=(0.5 * number, *[0.0] * (dimension - 1)), size=tuple(size), material=sand))
        scene = scene_of(*masses, size=(1.0,) * dimension, cell=0.05)
        points = initial_particles(scene)
        assert len(points.volume) == len(points.positions) == particle_count(scene)
        for number, mass in enumerate(masses):
            mine = points.mass == number
            total = math.fsum(points.volume[mine] * points.density[mine])
            assert total == pytest.approx(math.prod(mass.size) * (1000.0 + 700.0 * number), rel=1e-12)
        np.testing.assert_array_equal(particle_volumes(scene, len(points.volume)), points.volume)


def test_volumes_equal_to_rounding_are_one_number(scene: Scene) -> None:
    # 0.03 / 6 and 0.07 / 14 are not the same double.
    masses = tuple(Mass(lower=(x, 0.0), size=(size, 0.03)) for x, size in ((0.0, 0.03), (0.03, 0.07), (0.1, 0.09)))
    points = initial_particles(dataclasses.replace(scene, masses=masses))
    assert set(points.volume) == {scene.particle_volume}
    odd = Mass(lower=(0.0, 0.0), size=(0.031, 0.03))
    twins = (odd, dataclasses.replace(odd, lower=(0.1, 0.0)))
    points = initial_particles(dataclasses.replace(scene, masses=twins))
    assert set(points.volume) == {0.031 * 0.03 / 36}
    points = initial_particles(dataclasses.replace(scene, masses=(twins[0], masses[2])))
    assert len(set(points.volume)) == 2


def test_a_mass_thinner_than_a_cell_is_warned_of(scene: Scene) -> None:
    thin = Mass(lower=(0.1, 0.0), size=(0.05, 0.001))
    with pytest.warns(UserWarning, match=r"masses\[1\]: 0.001 m thick in cells of 0.01 m.*0.00025 to 0.00033 m would"):
        warn_if_unresolved(dataclasses.replace(scene, masses=(*scene.masses, thin)))
    # Two half cells of one material on top of each other are a whole one; of two materials they are not.
    half = (Mass(lower=(0.1, 0.0), size=(0.05, 0.005)), Mass(lower=(0.1, 0.005), size=(0.05, 0.005)))
    one_point = Mass(lower=(0.0, 0.05), size=(0.005, 0.005))
    warn_if_unresolved(dataclasses.replace(scene, masses=(*scene.masses, *half, one_point)))
    other = dataclasses.replace(half[1], material=Material(friction_deg=20.0))
    with pytest.warns(UserWarning, match=r"masses\[0\], masses\[1\]: 0.005 m thick"):
        warn_if_unresolved(dataclasses.replace(scene, masses=(half[0], other)))


def test_another_mass_leaves_the_particles_of_the_first(scene: Scene) -> None:
    second = Mass(lower=(0.1, 0.0), size=(0.02, 0.02), material=Material(friction_deg=20.0))
    alone, other = initial_particles(scene), initial_particles(dataclasses.replace(scene, seed=1))
    together = initial_particles(dataclasses.replace(scene, masses=(*scene.masses, second)))
    np.testing.assert_array_equal(together.positions[: len(alone.positions)], alone.positions)
    assert [material.friction_deg for material in together.materials] == [30.0, 20.0]
    np.testing.assert_allclose(together.friction[[0, -1]], np.tan(np.radians([30.0, 20.0])), rtol=1e-6)
    assert 0.0 < np.abs(other.positions - alone.positions).max() <= 0.8 * 0.005


@pytest.mark.parametrize(("turn", "omega"), [(2.0, (0, 0, 2)), ((1.0, -2.0, 0.5), (1.0, -2.0, 0.5)), (None, (0, 0, 0))])
def test_a_mass_that_turns_in_3d(turn: float | tuple[float, ...] | None, omega: tuple[float, ...]) -> None:
    mass = Mass(lower=(0.1, 0.0, 0.1), size=(0.1, 0.1, 0.2), angular_velocity=turn)
    scene = scene_of(mass, size=(0.4, 0.4, 0.4), cell=0.05)
    particles = initial_particles(scene)
    arm = particles.positions - [0.15, 0.05, 0.2]
    np.testing.assert_allclose(particles.velocities, np.cross(omega, arm), atol=1e-15)
    np.testing.assert_allclose(np.einsum("nij, nj -> ni", particles.velocity_gradients, arm), np.cross(omega, arm))
    assert Scene.from_json(scene.to_json()) == scene


@pytest.mark.parametrize("grid", GRIDS.values(), ids=GRIDS)
def test_linear_fields_are_exact_inside_and_constant_beyond(grid: Grid) -> None:
    rng = np.random.default_rng(0)
    extent = np.array(grid.spacing) * (np.array(grid.nodes) - 1)
    slope = rng.normal(size=len(grid.nodes))
    inside = np.array(grid.origin) + rng.random((50, len(slope))) * extent
    values = grid.weights(inside) @ (3.0 + grid.positions @ slope)
    np.testing.assert_allclose(values, 3.0 + inside @ slope, rtol=1e-12)
    beyond = inside + 10.0
    moved = np.minimum(beyond, np.array(grid.origin) + extent)
    np.testing.assert_allclose(grid.weights(beyond) @ (grid.positions @ slope), moved @ slope, rtol=1e-12)


def test_particles_have_a_field_at_their_positions_and_one_of_a_mass_leaves_the_others() -> None:
    particles = initial_particles(dataclasses.replace(SCENE, fields=(FRICTION,)))
    x, y = particles.positions.T
    np.testing.assert_allclose(particles.friction_deg, 20.0 + 20.0 * x + 20.0 * y, rtol=1e-12)
    np.testing.assert_allclose(particles.friction, np.tan(np.radians(20.0 + 20.0 * x + 20.0 * y)), rtol=1e-6)
    assert np.unique(particles.velocities[:, 0]).tolist() == [0.0, 1.0]
    still = dataclasses.replace(FRICTION, quantity="velocity_y", values=(-1.0,) * 4, mass=1)
    particles = initial_particles(dataclasses.replace(SCENE, fields=(dataclasses.replace(FRICTION, mass=0), still)))
    assert set(particles.friction_deg[particles.mass == 1]) == {30.0}
    assert set(particles.velocities[particles.mass == 0, 1]) == {0.0}
    np.testing.assert_allclose(particles.velocities[particles.mass == 1, 1], -1.0, rtol=1e-12)
    assert set(particles.velocities[particles.mass == 1, 0]) == {1.0}


def test_a_field_of_velocity_brings_its_slope() -> None:
    """In place of that of the mass's spin: a field at rest rests, and a rotation given by fields is that of a spin."""
    spin, middle = 5.0, (0.5, 0.25)
    body = Mass(lower=(0.4, 0.2), size=(0.2, 0.1), angular_velocity=spin)
    scene = dataclasses.replace(SCENE, masses=(body,), fields=())
    grid = {"origin": (0.4, 0.2), "spacing": (0.2, 0.1), "nodes": (2, 2)}
    corners = np.array([(0.4, 0.2), (0.4, 0.3), (0.6, 0.2), (0.6, 0.3)]) - middle

    def given(factor: float) -> Scene:
        parts = {"velocity_x": -spin * factor * corners[:, 1], "velocity_y": spin * factor * corners[:, 0]}
        fields = (Field(quantity=name, values=tuple(values.tolist()), **grid) for name, values in parts.items())
        return dataclasses.replace(scene, fields=tuple(fields))

    exact, same, still = map(initial_particles, (scene, given(1.0), given(0.0)))
    np.testing.assert_allclose(same.velocities, exact.velocities, atol=1e-12)
    np.testing.assert_allclose(same.velocity_gradients, exact.velocity_gradients, atol=1e-8)
    assert not still.velocity_gradients.any()


@pytest.mark.parametrize(
    ("changes", "key"),
    [
        ({"quantity": "porosity"}, "fields[0].quantity"),
        ({"spacing": (0.1, 0.0)}, "spacing"),
        ({"values": (30.0,)}, "fields[0].values"),
        ({"mass": 2}, "fields[0].mass"),
    ],
)
def test_bad_fields_are_named(changes: dict[str, object], key: str) -> None:
    assert refused(lambda: dataclasses.replace(SCENE, fields=(dataclasses.replace(FRICTION, **changes),))).key == key


def test_on_other_cells_the_box_is_higher_if_need_be() -> None:
    scene = scene_of(Mass(lower=(0.0, 0.0), size=(0.2, 0.2)), size=(0.8, 0.21), cell=0.01)
    assert scene.with_cell(0.02).domain.size == pytest.approx((0.8, 0.22))
    assert scene.with_cell(0.005).domain.size == scene.domain.size
    refused(scene.with_cell, 0.03, said="domain.size")
