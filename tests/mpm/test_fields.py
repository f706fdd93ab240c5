"""A field of friction in the solver: constant it is the material's own, varying it has the adjoint's derivative."""

import dataclasses

import numpy as np
import pytest

from datasets import Material, Scene
from datasets.scene.grid_field import Field
from datasets.scene.particles import initial_particles
from mpm import LAST, simulate
from mpm.adjoint.gradient import gradient
from mpm.arrays.properties import properties_of
from tests.mpm.adjoint.flows import SOIL, Weighted, central, plane, value_of
from tests.mpm.adjoint.test_gradient import raised

SOFTENING = dataclasses.replace(SOIL, softening_length=0.1, residual_cohesion=100.0, residual_tension_cutoff=20.0)
MATERIALS = {
    "cohesive": SOIL,
    "dry": Material(friction_deg=30.0),
    "softens": SOFTENING,
    "softens to its own angle": dataclasses.replace(SOFTENING, residual_friction_deg=15.0),
    "stronger below": dataclasses.replace(SOIL, strength_gradient=500.0, tension_cutoff=None),
}


def with_friction(scene: Scene, values: np.ndarray) -> Scene:
    """`scene` with angles at the nodes of a grid of 4 by 3 over its bodies."""
    grid = {"origin": (0.0, 0.0), "spacing": (0.1, 0.1), "nodes": (4, 3)}
    return dataclasses.replace(scene, fields=(Field(quantity="friction_deg", values=values, **grid),))


@pytest.mark.parametrize("material", MATERIALS.values(), ids=MATERIALS)
def test_properties_of_a_constant_field_are_those_of_the_material(material: Material) -> None:
    scene = plane(material)
    field = properties_of(initial_particles(with_friction(scene, np.full(12, 24.0))))
    softer = dataclasses.replace(material, friction_deg=24.0)
    np.testing.assert_allclose(field, properties_of(initial_particles(plane(softer))), rtol=1e-12)


def test_a_constant_field_makes_the_flow_of_its_angle() -> None:
    changes = {"duration": 0.1, "volume_correction": False}
    scene = plane(Material(friction_deg=30.0), **changes)
    uniform = simulate(with_friction(scene, np.full(12, 24.0)), record=LAST)
    expected = simulate(plane(Material(friction_deg=24.0), **changes), record=LAST)
    np.testing.assert_allclose(uniform.positions[-1], expected.positions[-1], atol=1e-6)
    assert uniform.friction == pytest.approx(expected.friction, rel=1e-6)
    varied = simulate(with_friction(scene, np.linspace(15.0, 40.0, 12)), record=LAST)
    assert np.abs(varied.positions[-1] - expected.positions[-1]).max() > 1e-4


@pytest.mark.double
@pytest.mark.slow
@pytest.mark.parametrize("material", [SOIL, MATERIALS["stronger below"]], ids=["cohesive", "stronger below"])
def test_the_adjoint_of_a_field_of_friction(material: Material) -> None:
    """Along a random direction of the angles at the nodes; and one constant at the angle of each particle."""
    values = np.linspace(22.0, 38.0, 12)
    scene = with_friction(plane(material), values)
    objective = Weighted(scene)
    _, slope = gradient(scene, objective, threads=1, exact=True)
    (field,) = scene.fields
    at_nodes = field.weights(slope.particles.positions).T @ slope.material("friction_deg")
    direction = np.random.default_rng(2).normal(size=12)
    derivative = central(lambda h: value_of(with_friction(scene, values + h * direction), objective), 1e-2)
    assert at_nodes @ direction == pytest.approx(derivative, rel=5e-6)
    way = ("material", "cohesion")
    derivative = central(lambda h: value_of(raised(scene, way, h), objective), 0.1)
    assert slope.material("cohesion").sum() == pytest.approx(derivative, rel=5e-6)


@pytest.mark.double
@pytest.mark.slow
def test_the_adjoint_of_a_field_of_velocity() -> None:
    """Its slope is in the affine motion of the particles, too."""
    scene, values = plane(SOIL), np.linspace(0.2, 0.9, 12)

    def with_velocity(values: np.ndarray) -> Scene:
        (field,) = with_friction(scene, values).fields
        return dataclasses.replace(scene, fields=(dataclasses.replace(field, quantity="velocity_x"),))

    moving = with_velocity(values)
    objective = Weighted(moving)
    _, slope = gradient(moving, objective, threads=1, exact=True)
    (field,), places = moving.fields, slope.particles.positions
    at_nodes = field.weights(places).T @ slope.velocities[:, 0]
    affine = sum(rows.T @ by for rows, by in zip(field.slopes(places), slope.velocity_gradients[:, 0].T, strict=True))
    direction = np.random.default_rng(2).normal(size=12)
    derivative = central(lambda h: value_of(with_velocity(values + h * direction), objective), 1e-4)
    assert (at_nodes + affine) @ direction == pytest.approx(derivative, rel=1e-5)
    assert abs(affine @ direction) > 1e-3 * abs(derivative)
