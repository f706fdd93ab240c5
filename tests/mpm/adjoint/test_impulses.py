"""Gradients of the momentum that solids take of a flow: against central differences in double precision."""

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest

from datasets.particles import Particles, initial_particles
from datasets.scene import Baffle, Mass, Scene, Solid
from mpm.adjoint.gradient import Gradient, pull_back
from mpm.adjoint.tape import Tape
from tests.mpm.adjoint.flows import Floats, central, moved, parameters
from tests.mpm.adjoint.test_contact import SCENES, rougher, shifted, taller

pytestmark = pytest.mark.double

BEHIND = Baffle(lower=(0.413, 0.0), size=(0.05, 0.127))
# So fast that particles reach the ground, which puts them back onto it.
THROWN = (Mass(lower=(0.35, 0.036), size=(0.2, 0.1), velocity=(1.0, -6.0)),)
SLOPE = Solid(kind="terrain", points=((0.0, 0.02), (1.0, 0.03)), friction=0.4)
FLOWS = {
    **{name: SCENES[name] for name in ("2D", "2D APIC, damped", "3D")},
    "baffle on ground": dataclasses.replace(SCENES["ground"], baffles=(BEHIND,)),
    "thrown": dataclasses.replace(SCENES["ground"], masses=THROWN, solids=(SLOPE,)),
}

SLOW = ("2D APIC, damped", "3D")


def impulse_tape(scene: Scene, change: Callable[[Particles], Particles] | None = None) -> Tape:
    """A run of which impulses are observed at half time and at the end."""
    particles = initial_particles(scene)
    frames = [scene.frames // 2, scene.frames - 1]
    return Tape([scene], frames, threads=1, particles=[particles if change is None else change(particles)], exact=True)


def weights_of(tape: Tape) -> Floats:
    return np.random.default_rng(5).normal(size=tape.impulses().shape)


def weighted(scene: Scene, change: Callable[[Particles], Particles] | None = None) -> float:
    tape = impulse_tape(scene, change)
    return float((weights_of(tape) * tape.impulses()).sum())


@pytest.fixture(params=parameters(FLOWS, SLOW), scope="module")
def flow(request: pytest.FixtureRequest) -> tuple[Scene, Gradient]:
    scene = FLOWS[request.param]
    tape = impulse_tape(scene)
    assert np.abs(tape.impulses()[-1]).max() > 0.0
    (slope,) = pull_back(tape, [np.zeros(tape.positions().shape)], impulses=[weights_of(tape)])
    return scene, slope


@pytest.mark.parametrize(("name", "step"), [("velocities", 1e-5), ("positions", 1e-7)])
def test_what_particles_begin_with(flow: tuple[Scene, Gradient], name: str, step: float) -> None:
    scene, slope = flow
    ours = getattr(slope, name)
    direction = np.random.default_rng(3).normal(size=ours.shape)
    change = moved(name, direction)
    found = central(lambda h: weighted(scene, change(h)), step)
    assert (ours * direction).sum() == pytest.approx(found, rel=1e-5)


@pytest.mark.parametrize(("name", "step"), [("density", 1.0), ("young", 1e3), ("friction_deg", 1e-2)])
def test_constants_of_the_material(flow: tuple[Scene, Gradient], name: str, step: float) -> None:
    """Of the density: heavier sand gives more momentum, also where a node or a particle is stopped."""
    scene, slope = flow

    def value(h: float) -> float:
        material = dataclasses.replace(scene.material, **{name: getattr(scene.material, name) + h})
        return weighted(dataclasses.replace(scene, material=material))

    assert slope.material(name).sum() == pytest.approx(central(value, step), rel=1e-5)


@pytest.mark.parametrize(
    ("change", "step"), [(shifted, 1e-5), (taller, 1e-5), (rougher, 1e-3)], ids=["x", "height", "friction"]
)
@pytest.mark.parametrize("flow", parameters(("2D", *SLOW), SLOW), indirect=True)
def test_a_baffle(flow: tuple[Scene, Gradient], change: Callable[[Scene, float], Scene], step: float) -> None:
    scene, slope = flow
    found = central(lambda h: weighted(change(scene, h)), step)
    assert found != 0.0
    assert slope.along(lambda h: change(scene, h), 0.0, 1e-6) == pytest.approx(found, rel=2e-5)
