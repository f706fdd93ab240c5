"""Gradients of flows that fly, crack and close: volume correction backwards, against central differences."""

import dataclasses

import numpy as np
import pytest

from datasets.geometry.placement import remembers_gaps
from datasets.material import Material
from datasets.particles import Particles, initial_particles
from datasets.scene import Baffle, Mass, Scene
from mpm.adjoint.gradient import Gradient, gradient
from tests.mpm.adjoint.flows import Weighted, central, moved, parameters, plane, room, value_of

pytestmark = pytest.mark.double

SAND = Material(friction_deg=30.0)
DILATING = Material(friction_deg=30.0, dilation_deg=10.0)
WEAK = Material(friction_deg=30.0, cohesion=200.0, tension_cutoff=20.0)
FALLING = (
    Mass(lower=(0.013, 0.05), size=(0.2, 0.1), velocity=(0.5, -1.5), angular_velocity=8.0),
    Mass(lower=(0.3, 0.013), size=(0.1, 0.1), velocity=(-1.0, 0.3)),
)
THROWN = (Mass(lower=(0.013, 0.05, 0.12), size=(0.2, 0.16, 0.16), velocity=(1.0, -1.5, 0.2)),)
BEHIND = Baffle(lower=(0.413, 0.0), size=(0.05, 0.127))
SCENES = {
    "sand": plane(SAND, masses=FALLING, duration=0.04),
    "sand, APIC": plane(SAND, masses=FALLING, duration=0.04, relaxation_time=0.0),
    "dilating sand": plane(DILATING, masses=FALLING, duration=0.04),
    "weak soil": plane(WEAK, masses=FALLING, duration=0.04),
    "sand before a baffle": plane(SAND, masses=FALLING, baffles=(BEHIND,), duration=0.04),
    "sand in 3D": room(SAND, masses=THROWN, duration=0.03),
    "weak soil in 3D": room(WEAK, masses=THROWN, duration=0.03),
}

SLOW = ("dilating sand", "sand before a baffle", "sand in 3D", "weak soil in 3D")


def shaken(particles: Particles) -> Particles:
    """Particles that move at random as well: a rigid flight without stress is a corner, the apex of the cone."""
    random = np.random.default_rng(4).normal(size=particles.velocities.shape)
    return dataclasses.replace(particles, velocities=particles.velocities + 0.1 * random)


@pytest.fixture(params=parameters(SCENES, SLOW), scope="module")
def flow(request: pytest.FixtureRequest) -> tuple[Scene, Weighted, Gradient]:
    """A scene, an objective of its end, and the gradient."""
    scene: Scene = SCENES[request.param]
    assert remembers_gaps(scene)
    objective = Weighted(scene)
    _, slope = gradient(scene, objective, threads=1, exact=True, particles=[shaken(initial_particles(scene))])
    return scene, objective, slope


@pytest.mark.parametrize(("name", "step"), [("velocities", 1e-7), ("positions", 1e-8)])
def test_what_particles_begin_with(flow: tuple[Scene, Weighted, Gradient], name: str, step: float) -> None:
    scene, objective, slope = flow
    ours = getattr(slope, name)
    direction = np.random.default_rng(1).normal(size=ours.shape)
    change = moved(name, direction)
    found = central(lambda h: value_of(scene, objective, lambda particles: change(h)(shaken(particles))), step)
    # A random direction may lie nearly across the gradient.
    assert (ours * direction).sum() == pytest.approx(found, rel=2e-5, abs=1e-6 * float(np.linalg.norm(ours)))


@pytest.mark.parametrize(("name", "step"), [("friction_deg", 1e-2), ("young", 1e3), ("density", 1.0)])
def test_constants_of_the_material(flow: tuple[Scene, Weighted, Gradient], name: str, step: float) -> None:
    scene, objective, slope = flow

    def value(h: float) -> float:
        material = dataclasses.replace(scene.material, **{name: getattr(scene.material, name) + h})
        return value_of(dataclasses.replace(scene, material=material), objective, shaken)

    assert slope.material(name).sum() == pytest.approx(central(value, step), rel=2e-5)


def test_gravity(flow: tuple[Scene, Weighted, Gradient]) -> None:
    """It also sets the rate at which gaps follow the grid."""
    scene, objective, slope = flow

    def value(h: float) -> float:
        return value_of(dataclasses.replace(scene, gravity=scene.gravity + h), objective, shaken)

    found = central(value, 1e-2)
    assert slope.setting("gravity") == pytest.approx(found, rel=2e-5)
