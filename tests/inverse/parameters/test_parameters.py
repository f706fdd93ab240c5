"""Parameters: into a scene and out again, into the surrogate's initial state, and never into an impossible scene."""

import dataclasses

import numpy as np
import pytest
import torch

from datasets import Baffle, Channel, Mass, Material, Scene, Solid
from datasets.scene.particles import released_volume
from inverse import Parameter, read_problem
from inverse.forward.gns import GnsForward
from inverse.parameters import check_parameters, kind, with_parameters
from tests.gns.training.test_samples import tensors
from tests.inverse.flows import FLOWS, problem_of, simulator_of
from tests.refusals import refused

SOIL = ("friction_deg", "cohesion", "masses[1].friction_deg")
NAMES: dict[int | str, tuple[str, ...]] = {
    2: (*SOIL, "masses[1].velocity_y", "baffles[0].x", "baffles[0].height", "wall_friction", "baffle_friction"),
    3: ("masses[0].velocity_z", "baffles[1].z", "baffles[1].width", "baffles[0].x", "baffles[0].length"),
    "terrain": ("floor_friction", "damping", "solids[0].friction", "solids[1].friction"),
}
MOVES = {"deg": 3.0, "Pa": 40.0, "m/s": 0.25, "m": 0.004, "-": 0.05, "m/s^2": 40.0}


@pytest.mark.parametrize("flow", list(NAMES))
def test_the_initial_state_is_that_of_the_scene(flow: int | str) -> None:
    """The initial state with parameters is that of the scene with these parameters, in whatever order they stand."""
    names = NAMES[flow][::-1]
    problem = problem_of(flow, *names)
    simulator = simulator_of(problem.scene.dimension)
    observation = problem.operators[0]
    values = np.array([kind(name).read(problem.scene) + MOVES[kind(name).unit] for name in names])
    scene = with_parameters(problem.scene, names, values)
    direct = GnsForward(simulator, dataclasses.replace(problem, scene=scene), observation).initial
    entered = GnsForward(simulator, problem, observation).entered(torch.from_numpy(values))
    inputs = tensors(entered.conditions)
    for name, required in tensors(direct.conditions).items():
        torch.testing.assert_close(inputs[name], required, rtol=1e-6, atol=1e-7, msg=name)
    torch.testing.assert_close(entered.state.displacements, direct.state.displacements, rtol=1e-6, atol=1e-9)


def test_the_cutoff_changes_with_the_cohesion() -> None:
    scene = problem_of(2, "cohesion").scene
    changed = with_parameters(scene, ["cohesion", "masses[1].cohesion"], [400.0, 900.0])
    assert (changed.material.cohesion, changed.material.tension_cutoff) == (400.0, 200.0)
    soil = changed.masses[1].material
    assert (soil.cohesion, soil.tension_cutoff) == (900.0, 150.0)
    none = dataclasses.replace(scene, material=Material(friction_deg=30.0))
    assert with_parameters(none, ["cohesion"], [50.0]).material.tension_limit == 0.003 * 50.0


def test_a_baffle_grows_about_its_centre_and_up_from_its_foot() -> None:
    scene = problem_of(3, "baffles[1].z").scene
    before = scene.baffles[1]
    names, values = ["baffles[1].width", "baffles[1].height", "baffles[1].z"], [0.06, 0.2, 0.2]
    after = with_parameters(scene, names, values).baffles[1]
    assert after.lower == pytest.approx((before.lower[0], before.lower[1], 0.17))
    assert after.size == pytest.approx((before.size[0], 0.2, 0.06))


@pytest.mark.parametrize(
    ("name", "lower", "upper", "key", "said"),
    [
        ("baffles[0].x", 0.1, 0.2, "unknowns[0].lower", "baffles[0]: expected a box clear of masses[0]"),
        ("baffles[0].x", 0.13, 0.39, "unknowns[0].upper", "inside the domain"),
        ("masses[1].friction_deg", 20.0, 90.0, "unknowns[0].upper", "[0, 90) degrees"),
    ],
)
def test_bounds_at_which_nothing_could_flow_are_refused(
    name: str, lower: float, upper: float, key: str, said: str
) -> None:
    scene = problem_of(2, "friction_deg").scene
    unknown = Parameter(name=name, initial=kind(name).read(scene), lower=lower, upper=upper)
    parameters = {"unknowns[0]": unknown}
    assert refused(check_parameters, scene, parameters, "unknowns", said=said).key == key


COLUMN = read_problem("friction-tall-42").scene
SOFTENS = {"softening_length": 0.05, "friction_limit_deg": 50.0, "grain_diameter": 1.0e-3}
SOFT = dataclasses.replace(
    COLUMN,
    material=dataclasses.replace(COLUMN.material, **SOFTENS),
    masses=(dataclasses.replace(COLUMN.masses[0], k0=0.5, size=(0.2, 0.4)),),
    baffles=(Baffle(lower=(0.6, 0.0), size=(0.05, 0.1)),),
)
GROUND = Solid(name="slope", kind="terrain", points=((0.0, 0.4), (1.0, 0.1)), friction=0.3)
LAYER = Mass(kind="layer", thickness=0.1, outline=((0.1,), (0.3,)))
COVERED = dataclasses.replace(COLUMN, masses=(LAYER,), solids=(GROUND,))
STUCK = dataclasses.replace(COVERED, solids=(dataclasses.replace(GROUND, contact="no-slip"),))
CHANNEL = dataclasses.replace(COLUMN, channel=Channel(width=0.1, friction_deg=20.0))
BRAKED = dataclasses.replace(COVERED, solids=(dataclasses.replace(GROUND, turbulence=500.0),))
INTO_MATERIAL = ("young", "residual_friction_deg", "residual_cohesion", "friction_limit_deg", "inertial_number")
"""No inputs of a surrogate."""


@pytest.mark.parametrize(
    ("scene", "names"),
    [
        *((FLOWS[flow], names) for flow, names in NAMES.items()),
        (SOFT, (*INTO_MATERIAL, "masses[0].k0", "masses[0].height")),
        (CHANNEL, ("channel.friction_deg", "friction_deg")),
        (BRAKED, ("solids[0].friction", "solids[0].turbulence", "masses[0].thickness")),
    ],
)
def test_what_is_written_is_read_and_nothing_else_changes(scene: Scene, names: tuple[str, ...]) -> None:
    for name in names:
        kind(name).check(scene)
        value = kind(name).read(scene) - MOVES[kind(name).unit]
        changed = with_parameters(scene, [name], [value])
        assert kind(name).read(changed) == pytest.approx(value)
        others = [other for other in names if other != name]
        np.testing.assert_allclose(*([kind(other).read(variant) for other in others] for variant in (changed, scene)))
    assert all(kind(name).input is None for name in INTO_MATERIAL)
    assert not kind("solids[0].turbulence").predicted
    thicker = with_parameters(COVERED, ["masses[0].thickness"], [0.15])
    assert released_volume(thicker) == pytest.approx(1.5 * released_volume(COVERED))


@pytest.mark.parametrize(
    ("name", "scene", "said"),
    [
        ("baffle_friction", COLUMN, "there are no baffles"),
        ("channel.friction_deg", COLUMN, "there is none"),
        ("residual_cohesion", COLUMN, "softening_length"),
        ("inertial_number", COLUMN, "friction_limit_deg"),
        ("masses[0].k0", COLUMN, "k0 is a number"),
        ("masses[0].thickness", COLUMN, "kind layer"),
        ("masses[0].height", COVERED, "kind box, got a layer"),
        ("solids[0].friction", COLUMN, "index below 0"),
        ("wall_friction", CHANNEL, "channel.friction_deg"),
        ("floor_friction", COVERED, "terrain covers the floor"),
        ("solids[0].friction", STUCK, "nothing slide"),
        ("solids[0].turbulence", COVERED, "whose turbulence is a number"),
        ("wall_friction", dataclasses.replace(COLUMN, open_sides=("x-", "x+", "y+")), "are open"),
        ("floor_friction", dataclasses.replace(COLUMN, open_sides=("y-",)), "floor is open"),
    ],
)
def test_what_a_scene_has_not_or_its_flow_does_not_depend_on_is_refused(name: str, scene: Scene, said: str) -> None:
    refused(kind(name).check, scene, said=said)
