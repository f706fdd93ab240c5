"""Flat masses on inclined ground begin in the stress of an infinite slope: they slide as a block or stay at rest."""

import dataclasses
import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from datasets import Mass, Material, Scene, Solid
from datasets.scene.particles import initial_particles
from mpm import simulate
from mpm.initial.slope import begins_as_slope
from mpm.initial.stress import initial_tractions
from tests.mpm.element import tensor
from tests.scenes import scene_of
from validation.bench.stability.exact_solutions import SlidingBlock
from validation.bench.stability.quantities import middle_displacement

SLOPE, MU = math.radians(22.0), math.tan(math.radians(21.0))
SOIL = Material(friction_deg=35.0, young=2.7e6)


def layer(how: str = "slope_deg", friction: float = MU, **changes: Any) -> Scene:
    """40 x 1 m, free at its ends, on 22 degrees: by gravity in 2D and 3D, and on a terrain line."""
    settings: dict[str, Any] = {
        "cell": 0.25,
        "material": SOIL,
        "duration": 2.0,
        "frame_dt": 0.25,
        "open_sides": ("x-", "x+"),
    } | changes
    if how == "terrain":
        fall = math.tan(SLOPE)
        ground = Solid(kind="terrain", points=((0.0, 60.0 * fall + 1.0), (60.0, 1.0)), friction=friction)
        mass = Mass(kind="layer", thickness=1.0 / math.cos(SLOPE), outline=((10.0,), (10.0 + 40.0 * math.cos(SLOPE),)))
        return scene_of(mass, size=(60.0, 30.0), solids=(ground,), **settings)
    wide = () if how == "slope_deg" else (0.5,)
    mass = Mass(lower=(10.0, 0.0, *(0.0 * z for z in wide)), size=(40.0, 1.0, *wide))
    return scene_of(mass, size=(60.0, 3.0, *wide), slope_deg=22.0, floor_friction=friction, **settings)


def downhill(scene: Scene) -> NDArray[np.float64]:
    """Unit vector, shape [D]."""
    return np.array([math.cos(SLOPE), -math.sin(SLOPE)]) if scene.solids else np.eye(scene.dimension)[0]


VARIANTS = {
    "slope_deg": layer(),
    "stiff": layer(material=dataclasses.replace(SOIL, young=1.0e7)),
    "terrain": layer("terrain"),
    "3D": layer("3D"),
}


@pytest.mark.parametrize(
    "name", ["slope_deg", *(pytest.param(name, marks=pytest.mark.slow) for name in ("stiff", "terrain"))]
)
def test_a_layer_slides_from_rest_as_a_block(name: str) -> None:
    """Away from its ends, which collapse and send waves; 120 m slid 1.19 times that in 5 s from no stress."""
    scene = VARIANTS[name]
    moved = middle_displacement(simulate(scene, threads=1)) @ downhill(scene)
    exact = SlidingBlock.of_scene(layer()).displacement(scene.duration)
    assert moved.mean() == pytest.approx(exact, rel=0.05)


@pytest.mark.parametrize("how", ["slope_deg", pytest.param("terrain", marks=pytest.mark.slow)])
def test_a_layer_that_friction_holds_stays_at_rest(how: str) -> None:
    flow = simulate(layer(how, friction=0.6), threads=1)
    assert np.linalg.norm(middle_displacement(flow), axis=1).mean() < 1.0e-3


@pytest.mark.parametrize("name", ["slope_deg", "terrain", "3D"])
def test_the_stress_is_that_of_an_infinite_slope_within_yield(name: str) -> None:
    scene = VARIANTS[name]
    particles = initial_particles(scene)
    stress, traction = initial_tractions(scene, particles)
    full, down = tensor(stress), np.pad(downhill(scene), (0, 3 - scene.dimension))
    up = np.array([-down[1], down[0], 0.0])
    depth = particles.depth * (math.cos(SLOPE) if scene.solids else 1.0)
    weight = SOIL.density * 9.81 * math.cos(SLOPE) * depth
    np.testing.assert_allclose(np.einsum("i,nij,j->n", up, full, up), -weight, atol=1e-6 * weight.max())
    np.testing.assert_allclose(np.einsum("i,nij,j->n", up, full, down), MU * weight, atol=1e-6 * weight.max())
    np.testing.assert_allclose(traction @ down[: scene.dimension], -MU * weight, atol=1e-6 * weight.max())
    principal, sine = np.linalg.eigvalsh(full), math.sin(math.radians(SOIL.phi_deg))
    assert (principal[:, 2] * (1.0 + sine) - principal[:, 0] * (1.0 - sine)).max() <= 1e-9 * weight.max()


def test_columns_and_level_floors_begin_free_of_stress() -> None:
    flat, column = Mass(lower=(0.0, 0.0), size=(4.0, 0.4)), Mass(lower=(0.0, 0.0), size=(0.4, 0.4))
    stacked = Mass(lower=(0.0, 0.4), size=(4.0, 0.2))
    settings: dict[str, Any] = {"size": (5.0, 1.0), "cell": 0.1}
    assert not begins_as_slope(scene_of(flat, **settings), flat)
    assert not begins_as_slope(scene_of(column, slope_deg=10.0, **settings), column)
    assert not begins_as_slope(scene_of(flat, stacked, slope_deg=10.0, **settings), flat)
    assert begins_as_slope(scene_of(flat, slope_deg=10.0, **settings), flat)
