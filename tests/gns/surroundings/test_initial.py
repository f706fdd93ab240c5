"""What a rollout begins with: conditions of a scene, at any size the same ones, and the scenes that a model refuses."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch

from datasets import Baffle, Mass, Material, Solid, Stage
from datasets.scene.particles import initial_particles, released_volume
from gns.inference import simulate
from gns.settings import GRAVITY, ModelSettings
from gns.simulator import Simulator
from gns.surroundings.forces import Moment
from gns.surroundings.initial import initial_state
from gns.surroundings.state import Conditions, State, in_model_units
from gns.surroundings.units import Units
from tests.gns.conftest import NORMALISATION
from tests.refusals import refused
from tests.scenes import scaled, scene_of

SETTINGS = ModelSettings()
SOIL = Material(friction_deg=30.0, cohesion=500.0)
SCENE = scene_of(
    Mass(lower=(0.0, 0.0), size=(0.1, 0.1), velocity=(1.0, 0.0)),
    Mass(lower=(0.0, 0.1), size=(0.1, 0.06), material=SOIL),
    size=(0.6, 0.4),
    cell=0.01,
    material=Material(friction_deg=35.0),
    baffles=(Baffle(lower=(0.3, 0.0), size=(0.05, 0.1)), Baffle(lower=(0.5, 0.02), size=(0.04, 0.2), friction=0.7)),
    duration=0.25,
    slope_deg=30.0,
    floor_friction=0.4,
    wall_friction=0.2,
    baffle_friction=0.3,
    damping=0.1,
)
HELD = tuple(Mass(lower=mass.lower, size=mass.size, release=0.1) for mass in SCENE.masses)
CLAY = Material(law="von-mises", friction_deg=0.0, constants={"strength": 2.0e4})


def test_the_conditions_are_those_of_the_scene() -> None:
    initial = initial_state(SCENE, SETTINGS)
    conditions, particles = initial.conditions, initial_particles(SCENE)
    assert (conditions.batch, conditions.ground, conditions.units) == (None, None, Units())
    torch.testing.assert_close(conditions.size, torch.tensor([[0.6, 0.4]]))
    torch.testing.assert_close(conditions.gravity, 9.81 * torch.tensor([[0.5, -(0.75**0.5)]]))
    constants = conditions.floor_friction, conditions.wall_friction, conditions.damping
    torch.testing.assert_close(torch.cat(constants), torch.tensor([0.4, 0.2, 0.1]))
    torch.testing.assert_close(conditions.baffle_friction, torch.tensor([[0.3, 0.7]]))
    upper = particles.positions[initial.indices, 1] > 0.1
    assert 0 < upper.sum() < len(upper)
    np.testing.assert_array_equal(conditions.cohesion.numpy(), np.where(upper, np.float32(500.0), np.float32(0.0)))
    friction = np.tan(np.radians(np.where(upper, 30.0, 35.0)))
    np.testing.assert_allclose(conditions.friction.numpy(), friction, rtol=1e-6)
    assert float(conditions.volume.sum()) == pytest.approx(0.1 * 0.16, rel=1e-5)
    np.testing.assert_array_equal(initial.velocity0[:, 0], np.where(upper, np.float32(0.0), np.float32(1.0)))
    corners = torch.tensor([[[[0.3, 0.0], [0.35, 0.1]], [[0.5, 0.02], [0.54, 0.22]]]])
    torch.testing.assert_close(conditions.baffles, corners)
    assert (initial.steps, len(initial.known)) == (25, 1)
    np.testing.assert_array_equal(initial.mass, upper.astype(np.int32))
    np.testing.assert_array_equal(initial.of_mass(1).numpy(), upper)
    # The first mass alone is of the scene's shared material.
    np.testing.assert_array_equal(initial.of_mass(None).numpy(), ~upper)


def test_terrain_is_a_raster_as_fine_as_the_particles() -> None:
    ramp = Solid(kind="terrain", points=((0.0, 0.0), (0.25, 0.0), (0.6, 0.07)), friction=0.5)
    ground = initial_state(replace(SCENE, baffles=(), solids=(ramp,)), SETTINGS).conditions.ground
    assert (ground.spacing, ground.elevation.shape) == (SETTINGS.cell, (1, 61))
    x = SETTINGS.cell * torch.arange(61)
    torch.testing.assert_close(ground.elevation[0], (0.2 * (x - 0.25)).clamp(min=0.0), atol=1e-6, rtol=0.0)
    torch.testing.assert_close(ground.friction, torch.full((1, 61), 0.5))


def test_a_model_of_bodies_of_one_size_gets_its_units_and_its_spacing() -> None:
    settings = ModelSettings(body_length=0.28)
    initial = initial_state(SCENE, settings)
    units = initial.conditions.units
    assert units.length == pytest.approx((0.1 * 0.16) ** 0.5 / 0.28, rel=0.1)
    assert initial.step == units.time * settings.step
    assert initial.times[-1] == pytest.approx(SCENE.duration)
    assert len(initial.indices) > 2 * len(initial_state(SCENE, SETTINGS).indices)
    assert float(initial.conditions.volume.sum()) == pytest.approx(0.1 * 0.16, rel=1e-5)


@pytest.mark.parametrize(
    ("changes", "settings", "said"),
    [
        ({}, ModelSettings(dimension=3), "expected a 3D scene"),
        ({"gravity": 0.0}, ModelSettings(body_length=0.28), "gravity: expected gravity"),
        ({"solids": (Solid(lower=(0.4, 0.0), size=(0.02, 0.1)),)}, SETTINGS, "solids[0].kind: expected only"),
        ({"stages": (Stage(time=0.1, cohesion=0.5),)}, SETTINGS, "stages: expected a material that does not change"),
        ({"masses": HELD}, SETTINGS, "masses: expected masses free from the start, the model supports no other"),
        ({"masses": SCENE.masses[:1], "material": CLAY}, SETTINGS, "material.law: expected 'mohr-coulomb'"),
    ],
)
def test_what_a_model_cannot_know_is_refused(changes: dict[str, Any], settings: ModelSettings, said: str) -> None:
    refused(initial_state, replace(SCENE, **changes), settings, said=said)


LEVEL = scene_of(
    Mass(lower=(0.0, 0.0), size=(0.1, 0.1), velocity=(1.2, 0.3)),
    Mass(lower=(0.0, 0.1), size=(0.1, 0.06)),
    size=(0.6, 0.4),
    cell=0.01,
    material=Material(friction_deg=35.0, cohesion=80.0, tension_cutoff=40.0),
    duration=0.2,
    floor_friction=0.4,
    damping=0.1,
)
VARIANTS = {
    "level": LEVEL,
    "slope": replace(LEVEL, slope_deg=20.0),
    "baffle": replace(LEVEL, baffles=(Baffle(lower=(0.15, 0.0), size=(0.03, 0.08), friction=0.3),)),
    "terrain": replace(
        LEVEL,
        masses=tuple(replace(mass, lower=(0.0, mass.lower[1] + 0.1)) for mass in LEVEL.masses),
        solids=(Solid(kind="terrain", points=((0.0, 0.1), (0.12, 0.1), (0.3, 0.02), (0.6, 0.02)), friction=0.5),),
    ),
}


@pytest.mark.parametrize("name", VARIANTS)
def test_a_similar_scene_has_the_scaled_rollout(lively: Simulator, name: str) -> None:
    lively.settings = replace(lively.settings, body_length=0.13)
    scene, length = VARIANTS[name], 36.0
    other = scaled(scene, length, gravity=3.71, density=2600.0)
    flow, larger = (simulate(variant, model=lively) for variant in (scene, other))
    np.testing.assert_allclose(larger.time, math.sqrt(length * scene.gravity / 3.71) * flow.time, rtol=1e-6)
    assert np.abs(flow.positions[-1] - flow.positions[0]).max() > 0.05
    # A ten-thousandth of the body: single precision, carried through twenty steps.
    np.testing.assert_allclose(larger.positions / length, flow.positions, rtol=0.0, atol=1.5e-5)
    np.testing.assert_allclose(larger.volumes, length**2 * flow.volumes, rtol=1e-5)


@pytest.mark.parametrize("duration", [0.0025, 0.05, 0.2, 1.0, 7.3])
@pytest.mark.parametrize("side", [0.07, 0.4])
def test_a_scene_lasts_a_whole_number_of_steps_under_the_gravity_of_the_model(duration: float, side: float) -> None:
    settings = ModelSettings(body_length=0.28)
    scene = replace(LEVEL, masses=(Mass(lower=(0.0, 0.0), size=(side, 0.3)),), duration=duration, gravity=3.71)
    units = Units.of_model(scene, settings)
    assert scene.gravity * units.time**2 / units.length == pytest.approx(GRAVITY)
    steps = scene.duration / (units.time * settings.step)
    body = math.sqrt(released_volume(scene)) / units.length
    if steps > 1.5:
        assert steps == pytest.approx(round(steps))
        # Half a step at most is missing or too many: the body is as much larger or smaller, twice.
        assert abs(body / 0.28 - 1.0) < 1.1 / (steps - 0.5)
    else:
        assert body == pytest.approx(0.28)
    assert units.stress == pytest.approx(scene.material.density / settings.density * 3.71 / GRAVITY * units.length)


def test_below_a_terrain_the_floor_has_the_friction_of_the_terrain(lively: Simulator) -> None:
    scene, rough = VARIANTS["terrain"], VARIANTS["terrain"].solids[0]
    expected = simulate(scene, model=lively).positions
    np.testing.assert_array_equal(simulate(replace(scene, floor_friction=0.05), model=lively).positions, expected)
    # A flow over a bed of one friction has the inputs of the training data, where the floor has it too.
    smooth = replace(scene, solids=(replace(rough, friction=0.1),))
    both = [simulate(replace(smooth, floor_friction=mu), model=lively).positions for mu in (0.4, 0.1)]
    np.testing.assert_array_equal(*both)
    assert np.abs(both[0] - expected).max() > 1e-4
    # Beside a terrain and in samples without any it is that of the floor.
    partial = replace(rough, points=((0.0, 0.1), (0.05, 0.1), (0.06, -0.1), (0.6, -0.1)))
    starts = [initial_state(other, SETTINGS) for other in (replace(scene, solids=(partial,)), LEVEL)]
    state = State.joined([start.state for start in starts])
    conditions = Conditions.joined([start.conditions for start in starts])
    bed, count = Moment(state, conditions, SETTINGS, NORMALISATION).bed, len(starts[0].indices)
    behind = state.positions[:count, 0] < 0.05
    assert 0 < behind.sum() < count
    torch.testing.assert_close(bed[:count][behind], torch.full((int(behind.sum()),), 0.5))
    assert (bed[:count][state.positions[:count, 0] > 0.07] == 0.4).all()
    assert (bed[count:] == 0.4).all()


DEEP = replace(SETTINGS, dimension=3, cell=0.02, radius=0.05, grid_cell=0.04, body_length=0.252)


def test_turbulence_of_the_ground_brakes_as_friction_that_grows_with_the_speed() -> None:
    side = tuple(0.4 * step for step in range(4))
    bed = Solid(kind="terrain", origin=(0.0, 0.0), spacing=(0.4, 0.4), heights=((0.1,) * 4,) * 4, friction=0.3)
    varied = tuple(tuple(100.0 / (1.0 + x) for _ in side) for x in side)
    mass = Mass(lower=(0.4, 0.1, 0.4), size=(0.4, 0.1, 0.4), velocity=(2.0, 0.0, 0.0))
    scene = scene_of(mass, size=(1.2, 0.4, 1.2), cell=0.02, solids=(bed,), duration=0.1)
    friction = {}
    for name, xi in (("none", None), ("even", 100.0), ("varied", varied)):
        turbulent = replace(scene, solids=(replace(bed, turbulence=xi),))
        for scale in (1.0, 9.0):
            initial = initial_state(scaled(turbulent, scale), DEEP)
            state, conditions = in_model_units(initial.state, initial.conditions)
            moment = Moment(state, conditions, DEEP, NORMALISATION)
            friction[name, scale] = moment.solids[:, -1] / (1.0 - moment.solids[:, 6]).clamp(min=1e-6)
    lowest = friction["none", 1.0] > 0.0
    assert 0 < lowest.sum() < len(lowest)
    torch.testing.assert_close(friction["none", 1.0][lowest], torch.full((int(lowest.sum()),), 0.3))
    # The column of 0.1 m has, on nodes of the grid, about its height and a cell more for the particle.
    drag = (friction["even", 1.0] - 0.3)[lowest]
    assert float(drag.median()) == pytest.approx(2.0**2 / (100.0 * (0.1 + 0.02)), rel=0.2)
    x = initial_state(scene, DEEP).state.positions[lowest, 0]
    torch.testing.assert_close((friction["varied", 1.0] - 0.3)[lowest], drag * (1.0 + x), rtol=1e-3, atol=0.0)
    # A flow of any size is braked alike.
    torch.testing.assert_close(friction["even", 9.0], friction["even", 1.0], rtol=1e-3, atol=1e-4)


@pytest.mark.parametrize(("bed", "expected"), [(0.3, 0.3), (0.9, math.tan(math.radians(35.0)))])
def test_a_layer_on_a_slope_rubs_along_it_with_the_friction_of_the_ground(bed: float, expected: float) -> None:
    slope = 0.5
    heights = tuple((0.7 - slope * 0.4 * row,) * 4 for row in range(4))
    ground = Solid(kind="terrain", origin=(0.0, 0.0), spacing=(0.4, 0.4), heights=heights, friction=bed)
    mass = Mass(lower=(0.4, 0.55, 0.4), size=(0.4, 0.1, 0.4), velocity=(2.0, 0.0, 0.5))
    # The floor of the box lies below the ground: its friction does not count.
    around = {"material": Material(friction_deg=35.0), "solids": (ground,), "floor_friction": 0.05}
    scene = scene_of(mass, size=(1.2, 1.0, 1.2), cell=0.02, duration=0.1, **around)
    initial = initial_state(scene, DEEP)
    state, conditions = in_model_units(initial.state, initial.conditions)
    basal = Moment(state, conditions, DEEP, NORMALISATION).basal
    normal = torch.tensor((slope, 1.0, 0.0)) / math.hypot(slope, 1.0)
    velocity = torch.tensor((2.0, 0.0, 0.5)) + torch.tensor((0.0, -GRAVITY * DEEP.step, 0.0))
    along = velocity - (velocity @ normal) * normal
    friction = -expected * normal[1] * along / along.norm()
    torch.testing.assert_close(basal, friction.expand_as(basal), rtol=0.02, atol=1e-3)
