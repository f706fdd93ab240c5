"""The speed that an energy line allows, and the Young's modulus that a scene gives a material without one."""

import dataclasses
import math
from pathlib import Path

import pytest

from datasets import Mass, Material, Scene, Solid, read_scene, write_scene
from datasets.scene.material import USUAL_YOUNG
from datasets.scene.stiffness import greatest_speed
from tests.scenes import SAND, box, scene_of

SNOW = Material(friction_deg=30.0, density=400.0)
PLANE = Solid(kind="terrain", points=((0.0, 116.0), (200.0, 16.0)), friction=0.2)
"""Of 1 in 2."""


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
    tilted = scene_of(
        Mass(lower=(0.0, 0.0), size=(20.0, 1.0)), size=(200.0, 10.0), cell=1.0, slope_deg=20.0, floor_friction=0.2
    )
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
    found = scene_of(thick, size=flat, cell=1.0, material=SNOW, floor_friction=0.5)
    assert found.material.young == USUAL_YOUNG
    dense = dataclasses.replace(SNOW, density=2000.0)
    found = scene_of(thick, size=flat, cell=1.0, material=dense, floor_friction=0.5)
    assert found.material.young == pytest.approx(50.0 * 2000.0 * 9.81 * 8.0)
    fast = on_plane(sheet(1.0, velocity=(60.0, -30.0)))
    assert fast.material.young == pytest.approx(400.0 * greatest_speed(fast) ** 2)
    assert fast.material.modulus > USUAL_YOUNG
    write_scene(fast, tmp_path / "fast.toml")
    assert read_scene(tmp_path / "fast.toml") == fast
    own = on_plane(sheet(1.0, velocity=(60.0, -30.0), material=dataclasses.replace(SAND, young=5.0e5)))
    assert (own.masses[0].material or SAND).young == 5.0e5
    assert own.material.young == fast.material.young
