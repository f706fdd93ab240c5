"""Where a rollout begins: what the conditions know of a scene, and which scenes a model refuses."""

import dataclasses

import numpy as np
import pytest
import torch

from datasets.errors import InputError
from datasets.geometry.solid import Solid
from datasets.material import Material
from datasets.particles import initial_particles
from datasets.scene import Baffle, Domain, Mass, Scene
from gns.model.settings import ModelSettings
from gns.start import after_frames, at_rest
from tests.gns.conftest import spreading

SETTINGS = ModelSettings(baffles=True)
SOIL = Material(friction_deg=30.0, cohesion=500.0)
SCENE = Scene(
    domain=Domain(size=(0.6, 0.4), cell=0.01),
    material=Material(friction_deg=35.0),
    masses=(
        Mass(lower=(0.0, 0.0), size=(0.1, 0.1), velocity=(1.0, 0.0)),
        Mass(lower=(0.0, 0.1), size=(0.1, 0.06), material=SOIL),
    ),
    baffles=(Baffle(lower=(0.3, 0.0), size=(0.05, 0.1)), Baffle(lower=(0.5, 0.02), size=(0.04, 0.2))),
    duration=0.25,
)


def test_the_conditions_are_those_of_the_scene() -> None:
    problem = at_rest(SCENE, SETTINGS, np.random.default_rng(0))
    conditions, points = problem.conditions, initial_particles(SCENE)
    assert conditions.size == (0.6, 0.4)
    upper = points.positions[problem.indices, 1] > 0.1
    assert 0 < upper.sum() < len(upper)
    expected = np.where(upper, np.float32(500.0), np.float32(0.0))
    np.testing.assert_array_equal(conditions.cohesion.numpy(), expected)
    friction = np.tan(np.radians(np.where(upper, 30.0, 35.0)))
    np.testing.assert_allclose(conditions.friction.numpy(), friction, rtol=1e-6)
    assert float(conditions.volume.sum()) == pytest.approx(0.1 * 0.16, rel=1e-5)
    np.testing.assert_array_equal(problem.velocity0[:, 0], np.where(upper, np.float32(0.0), np.float32(1.0)))
    assert conditions.baffles is not None
    corners = torch.tensor([[[[0.3, 0.0], [0.35, 0.1]], [[0.5, 0.02], [0.54, 0.22]]]])
    torch.testing.assert_close(conditions.baffles, corners)
    assert (problem.steps, len(problem.known)) == (25, 1)


def test_without_baffles_there_are_none() -> None:
    bare = dataclasses.replace(SCENE, baffles=())
    for settings in (SETTINGS, ModelSettings()):
        problem = at_rest(bare, settings, np.random.default_rng(0))
        assert problem.conditions.baffles is None
        assert problem.to("cpu").conditions.baffles is None


def test_after_frames_the_baffles_are_there_too() -> None:
    flow = spreading(30.0)
    baffled = dataclasses.replace(flow.scene, baffles=(Baffle(lower=(0.5, 0.0), size=(0.05, 0.1)),))
    start = dataclasses.replace(flow, positions=flow.positions[:21], time=flow.time[:21], scene=baffled)
    problem = after_frames(start, baffled, SETTINGS, np.random.default_rng(0))
    assert problem.conditions.baffles is not None
    assert problem.conditions.baffles.shape == (1, 1, 2, 2)
    assert not problem.conditions.cohesion.any()
    assert (problem.steps, len(problem.known)) == (20, 6)
    torch.testing.assert_close(problem.state.positions, torch.from_numpy(problem.known[-1]))


def test_moved_to_a_device_it_is_the_same_problem() -> None:
    problem = at_rest(SCENE, SETTINGS, np.random.default_rng(0))
    there = problem.to("meta")
    for part, original in ((there.state, problem.state), (there.conditions, problem.conditions)):
        for field in dataclasses.fields(part):
            value, before = getattr(part, field.name), getattr(original, field.name)
            if isinstance(before, torch.Tensor):
                assert value.device.type == "meta", field.name
                assert value.shape == before.shape
            else:
                assert value == before


REFUSED = [
    (SCENE, ModelSettings(), "baffles: expected a scene without baffles"),
    (SCENE, ModelSettings(dimension=3), "expected a 3D scene"),
    (dataclasses.replace(SCENE, slope_deg=10.0), SETTINGS, "slope_deg: expected a level floor"),
    (
        dataclasses.replace(SCENE, solids=(Solid(lower=(0.4, 0.0), size=(0.02, 0.1)),)),
        SETTINGS,
        "solids: expected a scene without solids, the model knows baffles alone",
    ),
    (
        dataclasses.replace(SCENE, baffles=(dataclasses.replace(SCENE.baffles[0], turned_deg=5.0),)),
        SETTINGS,
        r"baffles\[0\].turned_deg: expected a baffle along the axes",
    ),
    (dataclasses.replace(SCENE, open_sides=("x+",)), SETTINGS, "open_sides: expected a closed box"),
    (
        dataclasses.replace(SCENE, masses=tuple(Mass(lower=m.lower, size=m.size, release=0.1) for m in SCENE.masses)),
        SETTINGS,
        "masses: expected masses that are free from the start",
    ),
    (
        dataclasses.replace(
            SCENE,
            masses=(
                SCENE.masses[0],
                dataclasses.replace(SCENE.masses[1], material=Material(friction_deg=30.0, density=900.0)),
            ),
        ),
        SETTINGS,
        "masses: expected masses of one density, the model knows no others, got 900 and 1800",
    ),
]


@pytest.mark.parametrize(("scene", "settings", "message"), REFUSED)
def test_scenes_that_a_model_cannot_know_are_refused(scene: Scene, settings: ModelSettings, message: str) -> None:
    with pytest.raises(InputError, match=message):
        at_rest(scene, settings, np.random.default_rng(0))
