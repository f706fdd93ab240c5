"""Materials: what may be combined, the constants that follow, and the stiffness that the speed of a scene asks for."""

import dataclasses
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from datasets import Mass, Material, Scene, Solid, read_scene, write_scene
from datasets.scene.material import TENSION_SHARE, USUAL_YOUNG
from datasets.scene.parts import SceneLayout
from datasets.scene.stiffness import greatest_speed
from datasets.schema import from_mapping
from tests.refusals import refused
from tests.scenes import SAND, box, scene_of

SCENE = {"domain": {"size": [1.0, 1.0], "cell": 0.1}, "material": {"friction_deg": 30.0}, "masses": [], "duration": 1.0}
CUT_OFF = {"residual_tension_cutoff": 3.1, "softening_length": 1.0}
SNOW = Material(friction_deg=30.0, density=400.0)
PLANE = Solid(kind="terrain", points=((0.0, 116.0), (200.0, 16.0)), friction=0.2)
"""Of 1 in 2."""


def test_a_share_of_the_cohesion_is_the_default_cutoff() -> None:
    assert Material(friction_deg=30.0, cohesion=1.0e3).tension_limit == TENSION_SHARE * 1.0e3 == 3.0
    assert Material(friction_deg=0.0, cohesion=1.0e3).tension_limit == 3.0
    # Of Tresca's clay there is no apex.
    assert Material(friction_deg=0.0, cohesion=2.0e4, tension_cutoff=3.0e4).tension_limit == 3.0e4
    assert Material(friction_deg=30.0).tension_limit == 0.0
    steep = Material(friction_deg=89.9, cohesion=1.0e3)
    assert steep.tension_limit == pytest.approx(1.0e3 / math.tan(math.radians(89.9)))
    assert steep.tension_limit < 3.0


def test_the_default_cutoff_stays_after_softening_below_the_residual_apex() -> None:
    soft = {"friction_deg": 30.0, "cohesion": 1.0e3, "strength_gradient": 500.0, "softening_length": 0.1}
    depth = np.array([0.0, 2.0])
    half = Material(**soft, residual_cohesion=500.0)
    np.testing.assert_array_equal(half.residual_tension_limit_at(depth), half.tension_limit_at(depth))
    assert half.residual.tension_limit == half.tension_limit == 3.0
    nearly_none = Material(**soft, residual_cohesion=1.0)
    apex = np.array([1.0, 2.0]) / math.tan(math.radians(30.0))
    np.testing.assert_allclose(nearly_none.residual_tension_limit_at(depth), apex)
    assert Material(**soft, residual_cohesion=0.0).residual_tension_limit_at(2.0) == 0.0
    assert Material(**soft, residual_tension_cutoff=1.0).residual_tension_limit_at(2.0) == 1.0


def test_the_residual_material() -> None:
    """What is not given stays; what remains of the cohesion is the same share of it at every depth."""
    plain = Material(friction_deg=30.0, cohesion=1.0e3)
    assert plain.residual is plain
    peak = {"friction_deg": 40.0, "dilation_deg": 10.0, "cohesion": 4.0e3, "strength_gradient": 1.0e3}
    after = {"softening_length": 0.05, "residual_friction_deg": 30.0, "residual_cohesion": 1.0e3}
    soil = Material(**peak, tension_cutoff=500.0, **after)
    residual = soil.residual
    assert residual == Material(friction_deg=30.0, cohesion=1.0e3, strength_gradient=250.0, tension_cutoff=500.0)
    depth = np.array([0.0, 2.0])
    np.testing.assert_allclose(residual.cohesion_at(depth), 0.25 * soil.cohesion_at(depth))
    assert residual.residual is residual
    assert Material(friction_deg=40.0, softening_length=0.1).residual.friction_deg == 40.0


@pytest.mark.parametrize(
    ("key", "wrong"),
    [
        ("angle", {"angle": "table"}),
        ("friction_deg: expected an angle above 0 degrees where there is no", {"friction_deg": 0.0, "cohesion": 0.0}),
        ("friction_deg: expected an angle in [0, 90)", {"friction_deg": 90.0}),
        ("dilation_deg", {"friction_deg": 0.0, "dilation_deg": 1.0}),
        ("friction_deg", {"angle": "slope", "friction_deg": 45.0}),
        ("residual_friction_deg", {"residual_friction_deg": 31.0, "softening_length": 1.0}),
        ("residual_friction_deg", {"residual_friction_deg": 0.0, "residual_cohesion": 0.0, "softening_length": 1.0}),
        ("residual_tension_cutoff: expected a value in [0, tension_cutoff], at most 3, got 3.1", CUT_OFF),
        ("residual_cohesion", {"residual_cohesion": 10.0}),
        ("friction_limit_deg", {"friction_limit_deg": 29.0, "grain_diameter": 1e-3}),
        ("friction_limit_deg", {"friction_limit_deg": 45.0, "grain_diameter": 1e-3, "angle": "slope"}),
        ("grain_diameter", {"friction_limit_deg": 40.0}),
        ("grain_density", {"friction_limit_deg": 40.0, "grain_diameter": 1e-3, "grain_density": 0.0}),
        ("inertial_number", {"friction_limit_deg": 40.0, "grain_diameter": 1e-3, "inertial_number": 0.0}),
    ],
)
def test_what_cannot_be_is_named(key: str, wrong: dict[str, Any]) -> None:
    refused(Material, **{"friction_deg": 30.0, "cohesion": 1000.0, **wrong}, said=f"material.{key}")


def test_a_constant_of_another_law_stands_once() -> None:
    table = {"law": "von-mises", "strength": 200.0, "constants": {"strength": 100.0}}
    said = "material.strength: expected one value, another one stands in constants"
    refused(from_mapping, SceneLayout, {**SCENE, "material": table}, said=said)
    refused(from_mapping, SceneLayout, {**SCENE, "masses": [{"material": table}]}, said=f"masses[0].{said}")


def test_a_slopes_angle_is_daviss() -> None:
    """tan(angle) = sin phi cos psi / (1 - sin phi sin psi); 25.5 degrees of a table are 28.5 of phi."""
    assert Material(friction_deg=25.5, angle="slope").phi_deg == pytest.approx(28.49, abs=0.01)
    dense = Material(friction_deg=38.0, dilation_deg=12.0, angle="slope")
    phi, psi = math.radians(dense.phi_deg), math.radians(12.0)
    davis = math.sin(phi) * math.cos(psi) / (1.0 - math.sin(phi) * math.sin(psi))
    assert math.degrees(math.atan(davis)) == pytest.approx(38.0, abs=1e-9)
    assert (dense.slope_deg, dense.friction) == (pytest.approx(38.0), pytest.approx(math.tan(phi)))
    soft = dataclasses.replace(dense, softening_length=0.01, residual_friction_deg=30.0)
    assert soft.residual.phi_deg == pytest.approx(math.degrees(math.asin(math.tan(math.radians(30.0)))))
    assert dataclasses.replace(soft, residual_friction_deg=None).residual.phi_deg == pytest.approx(dense.phi_deg)


def sheet(thickness: float, **changes: object) -> Mass:
    return Mass(kind="layer", thickness=thickness, outline=((10.0,), (30.0,)), **changes)


def on_plane(mass: Mass, **changes: object) -> Scene:
    """A mass on the plane, in a box of 200 x 130 m."""
    return scene_of(mass, size=(200.0, 130.0), cell=1.0, material=SNOW, **({"solids": (PLANE,)} | changes))


def test_the_speed_of_a_block_on_a_plane() -> None:
    """v^2 = 2 g s (tan - mu) over 180 m, from a metre above the ground; bed, sand or floor, whichever is smoothest."""
    level, fallen = 180.0, 1.0
    for friction, mu in ((0.2, 0.2), (0.9, math.tan(math.radians(30.0)))):
        scene = on_plane(sheet(1.0), solids=(dataclasses.replace(PLANE, friction=friction),))
        expected = math.sqrt(2.0 * 9.81 * max(fallen, fallen + level * (0.5 - mu)))
        assert greatest_speed(scene) == pytest.approx(expected, rel=0.02)
    block = Mass(lower=(0.0, 0.0), size=(20.0, 1.0))
    tilted = scene_of(block, size=(200.0, 10.0), cell=1.0, slope_deg=20.0, floor_friction=0.2)
    slope = math.radians(20.0)
    exact = 2.0 * 9.81 * (190.0 * (math.sin(slope) - 0.2 * math.cos(slope)) + math.cos(slope))
    assert greatest_speed(tilted) == pytest.approx(math.sqrt(exact), rel=0.01)


def test_the_speed_of_what_is_thrown_turns_or_falls() -> None:
    still = box(Mass(lower=(0.0, 0.0), size=(0.2, 0.4)), gravity=0.0)
    assert greatest_speed(still) == 0.0
    moving = dataclasses.replace(still.masses[0], velocity=(3.0, 4.0))
    assert greatest_speed(dataclasses.replace(still, masses=(moving,))) == pytest.approx(5.0)
    turning = dataclasses.replace(still.masses[0], angular_velocity=2.0)
    assert greatest_speed(dataclasses.replace(still, masses=(turning,))) == pytest.approx(math.hypot(0.2, 0.4))
    assert greatest_speed(box(still.masses[0])) == pytest.approx(math.sqrt(2.0 * 9.81 * 0.4), rel=0.02)


def test_a_material_without_a_modulus_gets_what_its_flow_needs(tmp_path: Path) -> None:
    """2 MPa in the laboratory; 50 rho g h of a thick layer; rho v^2 of a fast one; its own where it has one."""
    assert box().material.young == USUAL_YOUNG
    thick, flat = Mass(lower=(0.0, 0.0), size=(20.0, 8.0)), (200.0, 130.0)
    layered = scene_of(thick, size=flat, cell=1.0, material=SNOW, floor_friction=0.5)
    assert layered.material.young == USUAL_YOUNG
    dense = dataclasses.replace(SNOW, density=2000.0)
    layered = scene_of(thick, size=flat, cell=1.0, material=dense, floor_friction=0.5)
    assert layered.material.young == pytest.approx(50.0 * 2000.0 * 9.81 * 8.0)
    fast = on_plane(sheet(1.0, velocity=(60.0, -30.0)))
    assert fast.material.young == pytest.approx(400.0 * greatest_speed(fast) ** 2)
    assert fast.material.modulus > USUAL_YOUNG
    write_scene(fast, tmp_path / "fast.toml")
    assert read_scene(tmp_path / "fast.toml") == fast
    specified = on_plane(sheet(1.0, velocity=(60.0, -30.0), material=dataclasses.replace(SAND, young=5.0e5)))
    assert (specified.masses[0].material or SAND).young == 5.0e5
    assert specified.material.young == fast.material.young
