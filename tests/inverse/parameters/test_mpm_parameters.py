"""Parameters that few scenes have: into a scene and out again, and never where there is no such thing."""

import dataclasses

import pytest

from datasets.errors import InputError
from datasets.particles import released_volume
from datasets.scene import Baffle, Mass, Solid
from inverse.parameters import kind, with_parameters
from inverse.problem import read_problem

COLUMN = read_problem("friction-tall-42").scene
SOFT = dataclasses.replace(
    COLUMN,
    material=dataclasses.replace(
        COLUMN.material, softening_length=0.05, friction_limit_deg=50.0, grain_diameter=1.0e-3
    ),
    masses=(dataclasses.replace(COLUMN.masses[0], k0=0.5, size=(0.2, 0.4)),),
    baffles=(Baffle(lower=(0.6, 0.0), size=(0.05, 0.1)),),
)


@pytest.mark.parametrize(
    ("name", "value", "unit"),
    [
        ("young", 5.0e6, "Pa"),
        ("residual_friction_deg", 25.0, "deg"),
        ("residual_cohesion", 20.0, "Pa"),
        ("friction_limit_deg", 55.0, "deg"),
        ("inertial_number", 0.4, "-"),
        ("masses[0].k0", 0.8, "-"),
        ("masses[0].height", 0.3, "m"),
    ],
)
def test_a_value_enters_the_scene_and_comes_out_again(name: str, value: float, unit: str) -> None:
    one = kind(name)
    one.check(SOFT)
    assert one.read(SOFT) != value
    changed = with_parameters(SOFT, [name], [value])
    assert (one.read(changed), one.unit, one.differentiable) == (value, unit, False)
    # Nothing else has changed.
    back = with_parameters(changed, [name], [one.read(SOFT)])
    assert (one.read(back), back.domain, back.baffles) == (one.read(SOFT), SOFT.domain, SOFT.baffles)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("baffle_friction", "there are none"),
        ("residual_cohesion", "softening_length"),
        ("inertial_number", "friction_limit_deg"),
        ("masses[0].k0", "k0 is a number"),
    ],
)
def test_what_a_scene_has_not_is_refused(name: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        kind(name).check(COLUMN)


def test_a_solid_and_a_layer() -> None:
    ground = Solid(name="slope", kind="terrain", points=((0.0, 0.4), (1.0, 0.1)), friction=0.3)
    layer = Mass(kind="layer", thickness=0.1, outline=((0.1,), (0.3,)))
    scene = dataclasses.replace(COLUMN, masses=(layer,), solids=(ground,))
    changed = with_parameters(scene, ["solids[0].friction", "masses[0].thickness"], [0.6, 0.15])
    assert changed.solids[0].friction == 0.6
    assert kind("masses[0].thickness").read(changed) == 0.15
    assert released_volume(changed) == pytest.approx(1.5 * released_volume(scene))
    for name, where, message in (
        ("masses[0].thickness", COLUMN, "kind layer"),
        ("masses[0].height", scene, "kind box, got a layer"),
        ("solids[0].friction", COLUMN, "index below 0"),
    ):
        with pytest.raises(InputError, match=message):
            kind(name).check(where)
