"""Gradients of flows against solids: what particles begin with, and position, size and friction of what they hit."""

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest

from datasets.errors import InputError
from datasets.scene import Baffle, Mass, Scene, Solid
from mpm.adjoint.gradient import Gradient, gradient
from tests.mpm.adjoint.flows import Weighted, central, moved, parameters, plane, room, value_of

pytestmark = pytest.mark.double

NEAR = (
    Mass(lower=(0.0, 0.0), size=(0.2, 0.2), velocity=(1.0, 0.0)),
    Mass(lower=(0.2, 0.0), size=(0.1, 0.2), velocity=(1.5, -0.3)),
)
UPRIGHT = Baffle(lower=(0.313, 0.0), size=(0.05, 0.127))
GROUND = Solid(kind="terrain", points=((0.0, 0.02), (0.25, 0.03), (1.0, 0.013)), friction=0.4)
ABOVE = (
    Mass(lower=(0.1, 0.033), size=(0.2, 0.12), velocity=(1.0, -0.3)),
    Mass(lower=(0.3, 0.04), size=(0.1, 0.1), velocity=(0.5, -0.5)),
)
MAPPED = dataclasses.replace(GROUND, friction=(0.1, 0.7, 0.3))
HILL = Solid(
    kind="terrain",
    origin=(0.0, 0.0),
    spacing=(0.4, 0.4),
    heights=((0.05, 0.07, 0.05), (0.06, 0.05, 0.05), (0.05, 0.05, 0.06)),
    friction=((0.1, 0.6, 0.2), (0.5, 0.1, 0.4), (0.1, 0.5, 0.3)),
)
RAISED = (Mass(lower=(0.2, 0.08, 0.2), size=(0.24, 0.16, 0.16), velocity=(1.0, -1.0, 0.3)),)
CUBE = (Mass(lower=(0.0, 0.0, 0.12), size=(0.2, 0.2, 0.16), velocity=(2.0, 0.0, 0.2)),)
PILLAR = Baffle(lower=(0.225, 0.0, 0.1), size=(0.1, 0.127, 0.1), turned_deg=20.0)
SCENES = {
    "2D": plane(masses=NEAR, baffles=(UPRIGHT,), baffle_friction=0.3, duration=0.04),
    "2D APIC, damped": plane(masses=NEAR, baffles=(UPRIGHT,), baffle_friction=0.3, relaxation_time=0.0, damping=0.05),
    "ground": plane(masses=ABOVE, solids=(GROUND,), volume_correction=False, duration=0.03),
    "ground of two soils": plane(masses=ABOVE, solids=(MAPPED,), volume_correction=False, duration=0.03),
    "3D ground": room(masses=RAISED, solids=(HILL,), volume_correction=False, duration=0.015),
    "3D": room(masses=CUBE, baffles=(PILLAR,), baffle_friction=0.3, duration=0.015),
}


@pytest.fixture(params=parameters(SCENES, ("3D ground",)), scope="module")
def flow(request: pytest.FixtureRequest) -> tuple[Scene, Weighted, Gradient]:
    """A scene, an objective of its end, and the gradient."""
    scene: Scene = SCENES[request.param]
    objective = Weighted(scene)
    _, slope = gradient(scene, objective, threads=1, exact=True)
    return scene, objective, slope


@pytest.mark.parametrize(("name", "step"), [("velocities", 1e-5), ("positions", 1e-7)])
def test_what_particles_begin_with(flow: tuple[Scene, Weighted, Gradient], name: str, step: float) -> None:
    scene, objective, slope = flow
    ours = getattr(slope, name)
    direction = np.random.default_rng(3).normal(size=ours.shape)
    change = moved(name, direction)
    found = central(lambda h: value_of(scene, objective, change(h)), step)
    assert (ours * direction).sum() == pytest.approx(found, rel=5e-6)


def test_stiffness(flow: tuple[Scene, Weighted, Gradient]) -> None:
    """The shear traction of contact grows with the sand's shear modulus."""
    scene, objective, slope = flow

    def value(h: float) -> float:
        material = dataclasses.replace(scene.material, young=scene.material.young + h)
        return value_of(dataclasses.replace(scene, material=material), objective)

    assert slope.material("young").sum() == pytest.approx(central(value, 1e3), rel=1e-5)


def with_baffle(scene: Scene, **changes: object) -> Scene:
    baffle = dataclasses.replace(scene.baffles[0], **changes)  # type: ignore[arg-type]
    return dataclasses.replace(scene, baffles=(baffle,))


def shifted(scene: Scene, h: float) -> Scene:
    lower = scene.baffles[0].lower
    return with_baffle(scene, lower=(lower[0] + h, *lower[1:]))


def taller(scene: Scene, h: float) -> Scene:
    size = scene.baffles[0].size
    return with_baffle(scene, size=(size[0], size[1] + h, *size[2:]))


def turned(scene: Scene, h: float) -> Scene:
    return with_baffle(scene, turned_deg=scene.baffles[0].turned_deg + h)


def rougher(scene: Scene, h: float) -> Scene:
    return dataclasses.replace(scene, baffle_friction=scene.baffle_friction + h)


@pytest.mark.parametrize(
    ("change", "step"),
    [(shifted, 1e-5), (taller, 1e-5), (turned, 1e-2), (rougher, 1e-3)],
    ids=["x", "height", "turn", "friction"],
)
@pytest.mark.parametrize("flow", ["2D", "2D APIC, damped", "3D"], indirect=True)
def test_a_baffle(flow: tuple[Scene, Weighted, Gradient], change: Callable[[Scene, float], Scene], step: float) -> None:
    scene, objective, slope = flow
    found = central(lambda h: value_of(change(scene, h), objective), step)
    assert found != 0.0
    assert slope.along(lambda h: change(scene, h), 0.0, 1e-6) == pytest.approx(found, rel=2e-5)


@pytest.mark.parametrize("flow", ["ground"], indirect=True)
def test_the_height_and_the_friction_of_the_ground(flow: tuple[Scene, Weighted, Gradient]) -> None:
    """One vertex of a terrain moves up: its faces turn, and the particles begin where they did."""
    scene, objective, slope = flow

    def raised(h: float) -> Scene:
        ground = dataclasses.replace(GROUND, points=((0.0, 0.02), (0.25, 0.03 + h), (1.0, 0.013)))
        return dataclasses.replace(scene, solids=(ground,))

    def slippery(h: float) -> Scene:
        return dataclasses.replace(scene, solids=(dataclasses.replace(GROUND, friction=0.4 + h),))

    for path, step in ((raised, 1e-6), (slippery, 1e-3)):
        found = central(lambda h, path=path: value_of(path(h), objective), step)  # type: ignore[misc]
        assert found != 0.0
        assert slope.along(path, 0.0, 1e-7) == pytest.approx(found, rel=2e-5)


@pytest.mark.parametrize("flow", ["ground of two soils"], indirect=True)
def test_friction_along_the_ground(flow: tuple[Scene, Weighted, Gradient]) -> None:
    """One coefficient of a map, and the position of its point: between points it is linear."""
    scene, objective, slope = flow

    def rougher_there(h: float) -> Scene:
        return dataclasses.replace(scene, solids=(dataclasses.replace(MAPPED, friction=(0.1, 0.7 + h, 0.3)),))

    def further(h: float) -> Scene:
        points = ((0.0, 0.02), (0.25 + h, 0.03), (1.0, 0.013))
        return dataclasses.replace(scene, solids=(dataclasses.replace(MAPPED, points=points),))

    for path, step in ((rougher_there, 1e-3), (further, 1e-6)):
        found = central(lambda h, path=path: value_of(path(h), objective), step)  # type: ignore[misc]
        assert found != 0.0
        assert slope.along(path, 0.0, 1e-7) == pytest.approx(found, rel=2e-5)


def test_single_precision_is_double_to_its_digits() -> None:
    scene = SCENES["2D"]
    objective = Weighted(scene)
    _, double = gradient(scene, objective, threads=1)
    _, single = gradient(scene, objective, threads=1, precision="f32")
    for name in ("velocities", "faces"):
        exact, ours = getattr(double, name), getattr(single, name)
        assert np.linalg.norm(ours - exact) < 2e-2 * np.linalg.norm(exact), name


def test_other_faces_have_no_derivative(flow: tuple[Scene, Weighted, Gradient]) -> None:
    scene, _, slope = flow
    more = Solid(kind="box", lower=(0.6,) * scene.dimension, size=(0.1,) * scene.dimension)
    with pytest.raises(InputError, match="as many faces"):
        slope.along(lambda h: dataclasses.replace(scene, solids=(*scene.solids, more)), 0.0)
