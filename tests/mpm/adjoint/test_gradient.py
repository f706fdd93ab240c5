"""Gradients of whole runs: against central differences in double precision, unknown by unknown."""

import dataclasses

import numpy as np
import pytest

from datasets.errors import InputError
from datasets.material import Material
from datasets.scene import Mass, Scene
from mpm.adjoint.gradient import Gradient, gradient
from tests.mpm.adjoint.flows import SOIL, Weighted, central, moved, plane, room, value_of

pytestmark = pytest.mark.double

DILATING = dataclasses.replace(SOIL, dilation_deg=10.0)
STIFF = dataclasses.replace(SOIL, young=8.0e6)
LEAVING = (
    Mass(lower=(0.785, 0.0), size=(0.2, 0.2), velocity=(2.0, 0.0)),
    Mass(lower=(0.01, 0.0), size=(0.1, 0.2), velocity=(-2.0, -0.3)),
)
SCENES = {
    "2D": plane(),
    "2D damped": plane(damping=0.05),
    "2D APIC, dilating": plane(DILATING, relaxation_time=0.0),
    "2D APIC, damped": plane(relaxation_time=0.0, damping=0.05),
    "2D stiff": plane(STIFF, duration=0.01),
    "2D tilted": plane(slope_deg=20.0),
    "2D open": plane(open_sides=("x-", "x+"), masses=LEAVING, slope_deg=20.0),
    "3D": room(),
    "3D dilating, damped": room(DILATING, damping=0.05),
    "3D APIC": room(relaxation_time=0.0),
}
CONSTANTS = {"friction_deg": 1e-2, "young": 1e3, "poisson": 1e-4, "density": 1.0, "cohesion": 1.0}
SETTINGS = {"floor_friction": 1e-3, "gravity": 1e-2, "slope_deg": 1e-2}


@pytest.fixture(params=SCENES, scope="module")
def flow(request: pytest.FixtureRequest) -> tuple[Scene, Weighted, Gradient]:
    """A scene, an objective of its end, and the gradient."""
    scene: Scene = SCENES[request.param]
    objective = Weighted(scene)
    value, slope = gradient(scene, objective, threads=1, exact=True)
    assert value == value_of(scene, objective)
    return scene, objective, slope


@pytest.mark.parametrize(("name", "step"), [("velocities", 1e-5), ("positions", 1e-7), ("velocity_gradients", 1e-4)])
def test_what_particles_begin_with(flow: tuple[Scene, Weighted, Gradient], name: str, step: float) -> None:
    """Along a random direction of all particles' velocities, positions, velocity gradients."""
    scene, objective, slope = flow
    ours = getattr(slope, name)
    direction = np.random.default_rng(1).normal(size=ours.shape)
    change = moved(name, direction)
    found = central(lambda h: value_of(scene, objective, change(h)), step)
    assert (ours * direction).sum() == pytest.approx(found, rel=5e-6)


@pytest.mark.parametrize(("name", "step"), CONSTANTS.items())
def test_constants_of_the_material(flow: tuple[Scene, Weighted, Gradient], name: str, step: float) -> None:
    scene, objective, slope = flow

    def value(h: float) -> float:
        material = dataclasses.replace(scene.material, **{name: getattr(scene.material, name) + h})
        return value_of(dataclasses.replace(scene, material=material), objective)

    assert slope.material(name).sum() == pytest.approx(central(value, step), rel=5e-6)


@pytest.mark.parametrize(("name", "step"), SETTINGS.items())
def test_numbers_of_the_scene(flow: tuple[Scene, Weighted, Gradient], name: str, step: float) -> None:
    scene, objective, slope = flow
    found = central(lambda h: value_of(dataclasses.replace(scene, **{name: getattr(scene, name) + h}), objective), step)
    assert slope.setting(name) == pytest.approx(found, rel=5e-6)


@pytest.mark.parametrize(("name", "step"), [("damping", 1e-4), ("wall_friction", 1e-3)])
def test_damping_and_the_friction_of_walls(name: str, step: float) -> None:
    """Of a body that is pressed against a wall and slides down it."""
    scene = plane(damping=0.05, slope_deg=-20.0)
    objective = Weighted(scene)
    _, slope = gradient(scene, objective, threads=1, exact=True)
    found = central(lambda h: value_of(dataclasses.replace(scene, **{name: getattr(scene, name) + h}), objective), step)
    assert found != 0.0
    assert slope.setting(name) == pytest.approx(found, rel=5e-6)


def test_the_tension_cutoff_and_dilation() -> None:
    scene = plane(dataclasses.replace(DILATING, tension_cutoff=5.0))
    objective = Weighted(scene)
    _, slope = gradient(scene, objective, threads=1)
    for name, step in (("tension_cutoff", 1e-1), ("dilation_deg", 1e-2)):

        def value(h: float, name: str = name) -> float:
            material = dataclasses.replace(scene.material, **{name: getattr(scene.material, name) + h})
            return value_of(dataclasses.replace(scene, material=material), objective)

        assert slope.material(name).sum() == pytest.approx(central(value, step), rel=1e-5), name


def test_peak_and_residual_strength_of_a_soil_that_softens() -> None:
    """Strength and dilation fall with the plastic strain, which carries the bars from step to step."""
    soil = Material(
        friction_deg=35.0,
        dilation_deg=8.0,
        cohesion=300.0,
        tension_cutoff=100.0,
        softening_length=4.0e-3,
        residual_friction_deg=25.0,
        residual_cohesion=100.0,
        residual_tension_cutoff=20.0,
    )
    for scene in (plane(soil, duration=0.03), room(soil)):
        objective = Weighted(scene)
        _, slope = gradient(scene, objective, threads=1, exact=True)
        names = {"friction_deg": 1e-2, "cohesion": 1.0, "residual_friction_deg": 1e-2, "residual_cohesion": 1.0}
        for name, step in (names | {"softening_length": 1e-6, "dilation_deg": 1e-2}).items():

            def value(h: float, name: str = name, scene: Scene = scene, objective: Weighted = objective) -> float:
                material = dataclasses.replace(soil, **{name: getattr(soil, name) + h})
                return value_of(dataclasses.replace(scene, material=material), objective)

            found = central(value, step)
            assert found != 0.0
            assert slope.material(name).sum() == pytest.approx(found, rel=2e-5), name


@pytest.mark.parametrize("release", [0.0125, "settled"])
def test_a_mass_behind_barriers(release: float | str) -> None:
    """Held at its sides until it is let go in the fifth frame, or damped until it has settled, which it has not yet."""
    held = Mass(lower=(0.1, 0.0), size=(0.2, 0.2), release=release)
    scene = plane(masses=(held, Mass(lower=(0.5, 0.0), size=(0.1, 0.2), velocity=(-0.5, 0.0))), duration=0.03)
    objective = Weighted(scene)
    _, slope = gradient(scene, objective, threads=1)

    def stiffer(h: float) -> float:
        material = dataclasses.replace(scene.material, young=scene.material.young + h)
        return value_of(dataclasses.replace(scene, material=material), objective)

    if release != "settled":
        # The damping behind the barriers follows the speed of waves, which is no unknown of the adjoint.
        assert slope.material("young").sum() == pytest.approx(central(stiffer, 1e3), rel=1e-5)
    found = central(lambda h: value_of(dataclasses.replace(scene, gravity=scene.gravity + h), objective), 1e-2)
    assert slope.setting("gravity") == pytest.approx(found, rel=1e-5)


def test_each_body_of_its_own_sand() -> None:
    """Sand without cohesion and two materials: friction of each, where a start without stress is at the cone's apex."""
    first, second = Material(friction_deg=25.0), Material(friction_deg=35.0, density=1500.0)
    masses = tuple(
        dataclasses.replace(mass, material=material)
        for mass, material in zip(plane().masses, (first, second), strict=True)
    )
    scene = plane(first, masses=masses)
    objective = Weighted(scene)
    _, slope = gradient(scene, objective, threads=1)
    ours = slope.of_mass(slope.material("friction_deg"))
    for index in range(2):

        def value(h: float, index: int = index) -> float:
            changed = list(masses)
            material = dataclasses.replace(scene.material_of(masses[index]), friction_deg=(25.0, 35.0)[index] + h)
            changed[index] = dataclasses.replace(masses[index], material=material)
            return value_of(dataclasses.replace(scene, masses=tuple(changed)), objective)

        assert ours[index] == pytest.approx(central(value, 1e-2), rel=5e-6)
    with pytest.raises(InputError, match="without any does not depend on cohesion"):
        slope.material("cohesion")


def test_half_a_cell_aside_is_as_exact() -> None:
    """Where masses lie on the grid does not matter: along a path that moves a body and speeds it up."""
    first, second = plane().masses
    low = (first.lower[0] + 0.01, first.lower[1] + 0.01)
    scene = plane(masses=(dataclasses.replace(first, lower=low), dataclasses.replace(second, lower=(0.25, 0.01))))
    objective = Weighted(scene)
    _, slope = gradient(scene, objective, threads=1)

    def scene_at(t: float) -> Scene:
        pushed = dataclasses.replace(first, lower=(low[0] + 0.1 * t, low[1]), velocity=(1.0 + t, 0.2 * t))
        return dataclasses.replace(scene, masses=(pushed, scene.masses[1]))

    found = central(lambda h: value_of(scene_at(h), objective), 1e-5)
    assert slope.along(scene_at, 0.0) == pytest.approx(found, rel=5e-6)


def test_the_remainder_falls_with_the_square_of_the_step() -> None:
    """Taylor: |J(u + h d) - J(u) - h J' d| falls with h^2 over four decades where the flow has no corners.

    A body that flies and swings, too strong to yield; u are the velocities of all particles.
    """
    strong = dataclasses.replace(SOIL, cohesion=1.0e6, tension_cutoff=1.0e6)
    body = Mass(lower=(0.41, 0.43), size=(0.2, 0.1), velocity=(1.0, 0.5), angular_velocity=5.0)
    scene = plane(strong, masses=(body,), volume_correction=False, duration=0.0125)
    objective = Weighted(scene)
    value, slope = gradient(scene, objective, threads=1)
    direction = np.random.default_rng(2).normal(size=slope.velocities.shape)
    change = moved("velocities", direction)
    steps = 10.0 ** np.arange(0.0, -4.5, -0.5)
    along = (slope.velocities * direction).sum()
    remainders = [abs(value_of(scene, objective, change(h)) - value - h * along) for h in steps]
    orders = np.diff(np.log(remainders)) / np.diff(np.log(steps))
    assert np.all(orders > 1.8), orders
    assert np.median(orders) == pytest.approx(2.0, abs=0.1)


def test_single_precision_is_double_to_its_digits() -> None:
    for scene in (plane(damping=0.05), room()):
        objective = Weighted(scene)
        _, double = gradient(scene, objective, threads=1)
        _, single = gradient(scene, objective, threads=1, precision="f32")
        for name in ("velocities", "positions", "settings"):
            exact, ours = getattr(double, name), getattr(single, name)
            assert np.linalg.norm(ours - exact) < 2e-2 * np.linalg.norm(exact), name
        exact, ours = double.of_mass(double.velocities), single.of_mass(single.velocities)
        np.testing.assert_allclose(ours, exact, rtol=1e-3, atol=1e-3 * np.abs(exact).max())
