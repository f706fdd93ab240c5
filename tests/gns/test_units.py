"""A scene in other units of length, time and stress is the same scene: Froude similarity."""

import dataclasses
import math

import numpy as np
import pytest

from datasets.errors import InputError
from datasets.material import Material
from datasets.particles import released_volume
from datasets.scene import Baffle, Mass, Solid
from gns.inference import simulate
from gns.settings import GRAVITY, ModelSettings
from gns.simulator import Simulator
from gns.units import Units
from tests.scenes import scaled, scene_of

SCENE = scene_of(
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
    "level": SCENE,
    "slope": dataclasses.replace(SCENE, slope_deg=20.0),
    "baffle": dataclasses.replace(SCENE, baffles=(Baffle(lower=(0.15, 0.0), size=(0.03, 0.08), friction=0.3),)),
    "terrain": dataclasses.replace(
        SCENE,
        masses=tuple(dataclasses.replace(mass, lower=(0.0, mass.lower[1] + 0.1)) for mass in SCENE.masses),
        solids=(Solid(kind="terrain", points=((0.0, 0.1), (0.12, 0.1), (0.3, 0.02), (0.6, 0.02)), friction=0.5),),
    ),
}


@pytest.mark.parametrize("name", VARIANTS)
def test_a_similar_scene_has_the_scaled_rollout(lively: Simulator, name: str) -> None:
    lively.settings = dataclasses.replace(lively.settings, body_length=0.13)
    scene, length = VARIANTS[name], 36.0
    other = scaled(scene, length, gravity=3.71, density=2600.0)
    flow, larger = (simulate(each, model=lively) for each in (scene, other))
    time = math.sqrt(length * scene.gravity / 3.71)
    np.testing.assert_allclose(larger.time, time * flow.time, rtol=1e-6)
    assert np.abs(flow.positions[-1] - flow.positions[0]).max() > 0.05
    # A ten-thousandth of the body: single precision, carried through twenty steps.
    np.testing.assert_allclose(larger.positions / length, flow.positions, rtol=0.0, atol=1.5e-5)
    np.testing.assert_allclose(larger.volumes, length**2 * flow.volumes, rtol=1e-5)


@pytest.mark.parametrize("duration", [0.0025, 0.05, 0.2, 1.0, 7.3])
@pytest.mark.parametrize("side", [0.07, 0.4])
def test_a_scene_lasts_a_whole_number_of_steps_under_the_gravity_of_the_model(duration: float, side: float) -> None:
    settings = ModelSettings(body_length=0.28)
    scene = dataclasses.replace(
        SCENE, masses=(Mass(lower=(0.0, 0.0), size=(side, 0.3)),), duration=duration, gravity=3.71
    )
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


def test_without_a_body_length_a_scene_is_run_as_it_is_and_without_gravity_not_at_all() -> None:
    assert Units.of_model(SCENE, ModelSettings()) == Units()
    with pytest.raises(InputError, match="gravity: expected gravity"):
        Units.of_model(dataclasses.replace(SCENE, gravity=0.0), ModelSettings(body_length=0.28))
