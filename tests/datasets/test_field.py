"""Fields: linear between nodes, constant beyond, in place of what a mass or its material has; bad ones are named."""

import dataclasses

import numpy as np
import pytest

from datasets.errors import InputError
from datasets.field import Field, Grid
from datasets.material import Material
from datasets.particles import initial_particles
from datasets.scene import Domain, Mass, Scene

GRIDS = {
    "2D": Grid((0.1, -0.2), (0.3, 0.2), (4, 3)),
    "3D": Grid((0.0, 0.1, 0.2), (0.5, 0.2, 0.1), (3, 4, 5)),
    "one node along y": Grid((0.0, 0.5), (0.25, 1.0), (5, 1)),
}
SCENE = Scene(
    domain=Domain(size=(1.0, 0.5), cell=0.05),
    material=Material(friction_deg=30.0, cohesion=100.0),
    masses=(Mass(lower=(0.0, 0.0), size=(0.3, 0.2)), Mass(lower=(0.5, 0.0), size=(0.2, 0.2), velocity=(1.0, 0.0))),
)
FRICTION = Field(
    quantity="friction_deg", origin=(0.0, 0.0), spacing=(1.0, 0.5), nodes=(2, 2), values=(20.0, 30.0, 40.0, 50.0)
)


@pytest.mark.parametrize("grid", GRIDS.values(), ids=GRIDS)
def test_linear_fields_are_exact_inside_and_constant_beyond(grid: Grid) -> None:
    rng = np.random.default_rng(0)
    extent = np.array(grid.spacing) * (np.array(grid.nodes) - 1)
    slope = rng.normal(size=len(grid.nodes))
    inside = np.array(grid.origin) + rng.random((50, len(slope))) * extent
    found = grid.weights(inside) @ (3.0 + grid.positions @ slope)
    np.testing.assert_allclose(found, 3.0 + inside @ slope, rtol=1e-12)
    beyond = inside + 10.0
    moved = np.minimum(beyond, np.array(grid.origin) + extent)
    np.testing.assert_allclose(grid.weights(beyond) @ (grid.positions @ slope), moved @ slope, rtol=1e-12)


def test_particles_have_it_at_their_positions() -> None:
    particles = initial_particles(dataclasses.replace(SCENE, fields=(FRICTION,)))
    x, y = particles.positions.T
    assert particles.friction_deg is not None
    np.testing.assert_allclose(particles.friction_deg, 20.0 + 20.0 * x + 20.0 * y, rtol=1e-12)
    np.testing.assert_allclose(particles.friction, np.tan(np.radians(20.0 + 20.0 * x + 20.0 * y)), rtol=1e-6)
    assert np.unique(particles.velocities[:, 0]).tolist() == [0.0, 1.0]


def test_a_field_of_one_mass_leaves_the_others() -> None:
    still = dataclasses.replace(FRICTION, quantity="velocity_y", values=(-1.0,) * 4, mass=1)
    particles = initial_particles(dataclasses.replace(SCENE, fields=(dataclasses.replace(FRICTION, mass=0), still)))
    assert particles.friction_deg is not None
    assert set(particles.friction_deg[particles.mass == 1]) == {30.0}
    assert set(particles.velocities[particles.mass == 0, 1]) == {0.0}
    np.testing.assert_allclose(particles.velocities[particles.mass == 1, 1], -1.0, rtol=1e-12)
    assert set(particles.velocities[particles.mass == 1, 0]) == {1.0}


@pytest.mark.parametrize(
    ("changes", "key"),
    [
        ({"quantity": "porosity"}, "fields[0].quantity"),
        ({"spacing": (0.1, 0.0)}, "fields[0].spacing"),
        ({"values": (30.0,)}, "fields[0].values"),
        ({"mass": 2}, "fields[0].mass"),
    ],
)
def test_bad_fields_are_named(changes: dict[str, object], key: str) -> None:
    with pytest.raises(InputError) as error:
        dataclasses.replace(SCENE, fields=(dataclasses.replace(FRICTION, **changes),))
    assert error.value.key == key
