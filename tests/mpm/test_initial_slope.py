"""Flat masses on inclined ground begin in the stress of an infinite slope: they slide as a block or stay at rest."""

import dataclasses
import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from datasets import Baffle, Mass, Material, Scene, Solid
from datasets.geometry.ground import elevation
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
SETTINGS = {"cell": 0.25, "material": SOIL, "duration": 2.0, "frame_dt": 0.25, "open_sides": ("x-", "x+")}


def layer(how: str = "slope_deg", friction: float = MU, **changes: Any) -> Scene:
    """40 x 1 m, free at its ends, on 22 degrees: by gravity, on a slab, in two parts, or on a terrain line."""
    settings: dict[str, Any] = SETTINGS | changes
    if how in ("terrain", "polygon"):
        fall = math.tan(SLOPE)
        ground = Solid(kind="terrain", points=((0.0, 60.0 * fall + 1.0), (60.0, 1.0)), friction=friction)
        thickness, end = 1.0 / math.cos(SLOPE), 10.0 + 40.0 * math.cos(SLOPE)
        mass = Mass(kind="layer", thickness=thickness, outline=((10.0,), (end,)))
        if how == "polygon":
            low, high = (60.0 * fall + 1.0 - fall * x for x in (end, 10.0))
            corners = (10.0, high), (end, low), (end, low + thickness), (10.0, high + thickness)
            mass = Mass(kind="polygon", vertices=corners)
        return scene_of(mass, size=(60.0, 30.0), solids=(ground,), **settings)
    if how in ("slab", "baffle", "stack"):
        below: dict[str, Any] = {"size": (60.0, 0.3), "friction": friction}
        solid: dict[str, Any] = {"solids": (Solid(lower=(0.0, 0.0), **below),)}
        if how == "baffle":
            solid = {"baffles": (Baffle(lower=(0.0, 0.0), **below),)}
        parts = (0.4, 0.6) if how == "stack" else (1.0,)
        masses = [Mass(lower=(10.0, 0.3 + y), size=(40.0, h)) for h, y in zip(parts, (0.0, parts[0]), strict=False)]
        return scene_of(*masses, size=(60.0, 3.0), slope_deg=22.0, **solid, **settings)
    wide = () if how == "slope_deg" else (0.5,)
    mass = Mass(lower=(10.0, 0.0, *(0.0 * z for z in wide)), size=(40.0, 1.0, *wide))
    return scene_of(mass, size=(60.0, 3.0, *wide), slope_deg=22.0, floor_friction=friction, **settings)


def downhill(scene: Scene) -> NDArray[np.float64]:
    """Unit vector, shape [D]."""
    return np.eye(scene.dimension)[0] if scene.slope_deg else np.array([math.cos(SLOPE), -math.sin(SLOPE)])


VARIANTS = {
    "slope_deg": layer(),
    "stiff": layer(material=dataclasses.replace(SOIL, young=1.0e7)),
    "terrain": layer("terrain"),
    "3D": layer("3D"),
    **{how: layer(how) for how in ("slab", "baffle", "stack", "polygon")},
}


@pytest.mark.parametrize(
    "name", ["slope_deg", *(pytest.param(name, marks=pytest.mark.slow) for name in VARIANTS if name != "slope_deg")]
)
def test_a_layer_slides_from_rest_as_a_block(name: str) -> None:
    """Away from its ends, which collapse and send waves; 120 m slid 1.19 times that in 5 s from no stress."""
    scene = VARIANTS[name]
    moved = middle_displacement(simulate(scene, threads=1)) @ downhill(scene)
    exact = SlidingBlock.of_scene(layer()).displacement(scene.duration)
    assert moved.mean() == pytest.approx(exact, rel=0.05)


@pytest.mark.parametrize(
    "how", ["slope_deg", *(pytest.param(how, marks=pytest.mark.slow) for how in ("terrain", "3D"))]
)
def test_an_elastic_layer_slides_from_the_stress_of_a_slope(how: str) -> None:
    """From no stress 0.1 of the weight was unbalanced, and a layer had slid by 1.28 times the exact way in 1 s."""
    scene = layer(how, material=dataclasses.replace(SOIL, friction_deg=25.0), duration=1.0)
    scene = dataclasses.replace(scene, masses=(dataclasses.replace(scene.masses[0], k0="elastic"),))
    with pytest.warns(UserWarning, match=r"0\.0\d+ of the weight is unbalanced"):
        flow = simulate(scene, threads=1)
    moved = middle_displacement(flow) @ downhill(scene)
    assert moved.mean() == pytest.approx(SlidingBlock.of_scene(layer()).displacement(scene.duration), rel=0.15)


@pytest.mark.parametrize(("k0", "slides", "rises"), [("elastic", 1.0e-5, 1.0e-5), (None, 0.03, 0.01)])
def test_a_cohesive_block_that_friction_holds(k0: str | None, slides: float, rises: float) -> None:
    """From equilibrium it stays; free of stress it shakes, and comes off its ground a little more with each swing."""
    soil = Material(friction_deg=40.0, cohesion=1.0e5, tension_cutoff=1.0e4, young=5.0e6)
    block = Mass(lower=(0.5, 0.0), size=(0.4, 0.1), k0=k0)
    flow = simulate(scene_of(block, size=(3.0, 0.6), slope_deg=30.0, floor_friction=0.9, material=soil, duration=1.0))
    moved = (flow.positions[-1] - flow.positions[0]).mean(axis=0)
    assert 0.0 <= moved[0] < slides
    assert abs(moved[1]) < rises


@pytest.mark.slow
@pytest.mark.parametrize("foot", [0.0, 0.3])
def test_between_smooth_solids_the_ground_rubs_nearly_whole(foot: float) -> None:
    """A layer two cells wide on the floor between baffles, or on a slab between boxes; a layer's own error is 0.2 %."""
    walls = [{"lower": (0.0, 0.0, z), "size": (60.0, 3.0, 0.5)} for z in (0.0, 1.0)]
    solids: dict[str, Any] = {"baffles": tuple(Baffle(**wall) for wall in walls), "floor_friction": MU}
    if foot:
        slab = Solid(lower=(0.0, 0.0, 0.0), size=(60.0, foot, 1.5), friction=MU)
        solids = {"solids": (slab, *(Solid(**wall) for wall in walls))}
    mass = Mass(lower=(10.0, foot, 0.5), size=(40.0, 1.0, 0.5))
    scene = scene_of(mass, size=(60.0, 3.0, 1.5), slope_deg=22.0, **solids, **SETTINGS)
    moved = float((middle_displacement(simulate(scene, threads=1)) @ downhill(scene)).mean())
    friction = (math.sin(SLOPE) - 2.0 * moved / (9.81 * scene.duration**2)) / math.cos(SLOPE)
    assert 0.955 * MU < friction < 1.005 * MU


@pytest.mark.parametrize("how", ["slope_deg", pytest.param("terrain", marks=pytest.mark.slow)])
def test_a_layer_that_friction_holds_stays_at_rest(how: str) -> None:
    flow = simulate(layer(how, friction=0.6), threads=1)
    assert np.linalg.norm(middle_displacement(flow), axis=1).mean() < 1.0e-3


@pytest.mark.parametrize("name", ["slope_deg", "terrain", "3D", "slab", "baffle", "stack", "polygon"])
def test_the_stress_is_that_of_an_infinite_slope_within_yield(name: str) -> None:
    scene = VARIANTS[name]
    particles = initial_particles(scene)
    stress, traction = initial_tractions(scene, particles)
    full, down = tensor(stress), np.pad(downhill(scene), (0, 3 - scene.dimension))
    up = np.array([-down[1], down[0], 0.0])
    # Normal to the ground, below the top of all that lies there.
    top = np.max([mass.lower[1] + mass.size[1] for mass in scene.masses])
    depth = top - particles.positions[:, 1]
    if scene.slope_deg == 0.0:
        ground = elevation(scene.solids, scene.domain, particles.positions[:, :1])
        depth = 1.0 - (particles.positions[:, 1] - ground) * math.cos(SLOPE)
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
    settings["slope_deg"] = 10.0
    assert not begins_as_slope(scene_of(column, **settings), column)
    assert begins_as_slope(scene_of(flat, **settings), flat)
    for mass in (flat, stacked):
        assert begins_as_slope(scene_of(flat, stacked, **settings), mass)
    pile, far = Mass(lower=(0.0, 0.4), size=(0.2, 0.2)), Mass(lower=(0.0, 0.7), size=(4.0, 0.2))
    for other in (pile, far):
        assert not begins_as_slope(scene_of(flat, other, **settings), flat)
    short = Solid(lower=(0.0, 0.0), size=(3.0, 0.4))
    assert not begins_as_slope(scene_of(stacked, solids=(short,), **settings), stacked)
    above = Mass(kind="polygon", vertices=((0.0, 0.1), (4.0, 0.1), (4.0, 0.4), (0.0, 0.4)))
    scene = scene_of(above, **settings)
    assert not begins_as_slope(scene, scene.masses[0])
