"""The factor of safety of slopes with published ones."""

import dataclasses
import json
import math
from pathlib import Path

import pytest

from datasets import Mass, Material, Solid, write_scene
from datasets.scene.grid_field import Field
from mpm import safety_factor
from mpm.run import command
from mpm.safety import reduced
from tests.refusals import refused
from tests.scenes import scene_of
from validation.bench.stability.slopes import HEIGHT, KNOWN, SAND, TAYLOR, WEIGHT, KnownSlope

UNDRAINED = dataclasses.replace(TAYLOR, cohesion=2.0 * TAYLOR.cohesion)  # twice as strong as it needs to be


def uniform(angle_deg: float) -> Field:
    """A field of one angle of friction."""
    place = {"origin": (0.0, 0.0), "spacing": (1.0, 1.0), "nodes": (1, 1)}
    return Field(quantity="friction_deg", values=(angle_deg,), **place)


@pytest.mark.slow
@pytest.mark.parametrize(("slope", "cells"), [*((slope, 20) for slope in KNOWN), (SAND, 10)])
def test_known_slopes_within_three_percent(slope: KnownSlope, cells: int) -> None:
    """Sand on ten cells creeps by thirty elastic settlements already where it stands."""
    safety = safety_factor(slope.scene(cells))
    assert safety.factor == pytest.approx(slope.factor, rel=0.03)
    assert safety.stands < safety.factor < safety.moves < 1.021 * safety.stands


def test_the_command_writes_what_it_says(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_scene(UNDRAINED.scene(8), tmp_path / "slope.toml")
    assert command(str(tmp_path / "slope.toml"), out=tmp_path, safety=True) == 0
    result = json.loads((tmp_path / "safety.json").read_text())
    assert result["factor"] == pytest.approx(2.0, rel=0.1)
    assert f"factor of safety {result['factor']:.3f}: stands at" in capsys.readouterr().out
    wrong = {"out": tmp_path, "safety": True, "vtk": True}
    refused(command, str(tmp_path / "slope.toml"), **wrong, said="--vtk: expected none beside --safety")


@pytest.mark.slow
def test_a_layer_that_inclined_terrain_does_not_hold_is_warned_of() -> None:
    """A layer 3 m thick on 1 to 2: tan(phi) / tan(beta) + c / (rho g t sin(beta) cos(beta)) = 1.82 by its material."""
    soil = Material(friction_deg=35.0, cohesion=1.0e4, dilation_deg=35.0, density=2000.0, tension_cutoff=1.0e6)
    layer = Mass(kind="polygon", vertices=((8.0, 22.0), (40.0, 6.0), (37.0, 10.5), (11.0, 23.5)))
    bed = Solid(kind="terrain", points=((0.0, 26.0), (50.0, 1.0)), friction=2.0)
    scene = scene_of(layer, size=(50.0, 34.0), cell=0.5, material=soil, solids=(bed,))
    with pytest.warns(UserWarning, match="even at half of this factor, which is far too low: model inclined ground as"):
        safety_factor(scene, tolerance=0.1)
    rock = dataclasses.replace(soil, cohesion=1.0e6)
    ground = Mass(kind="polygon", vertices=((0.0, 0.0), (50.0, 0.0), (50.0, 1.0), (0.0, 26.0)), material=rock)
    held = dataclasses.replace(scene, solids=(), masses=(ground, layer), floor_friction="rough")
    assert safety_factor(held, tolerance=0.02).factor == pytest.approx(1.82, rel=0.08)


def test_all_strength_is_reduced_and_nothing_else() -> None:
    residual = {"softening_length": 0.1, "residual_cohesion": 10.0, "residual_friction_deg": 20.0}
    soil = Material(friction_deg=30.0, cohesion=100.0, dilation_deg=25.0, tension_cutoff=9.0, **residual)
    scene = dataclasses.replace(SAND.scene(10), material=soil, fields=(uniform(45.0),))
    half = reduced(scene, 2.0)
    assert half.material.friction == pytest.approx(0.5 * soil.friction)
    assert half.material.residual.friction == pytest.approx(0.5 * soil.residual.friction)
    assert half.material.dilation_deg == half.material.friction_deg
    weak = half.material.cohesion, half.material.residual_cohesion, half.material.tension_cutoff
    assert weak == (50.0, 5.0, 4.5)
    assert math.tan(math.radians(half.fields[0].values[0])) == pytest.approx(0.5)
    assert half.masses[0].k0 == "elastic"
    tilted = dataclasses.replace(soil, angle="slope", friction_limit_deg=40.0, grain_diameter=0.001)
    steep = reduced(dataclasses.replace(scene, material=tilted, fields=()), 2.0).material
    assert steep.friction == pytest.approx(0.5 * tilted.friction)


def test_a_field_of_all_masses_is_of_the_angle_of_each() -> None:
    """And no dilation exceeds the friction that is left; a uniform field changes nothing."""
    tilted = Material(friction_deg=30.0, angle="slope", dilation_deg=20.0)
    first, second = Mass(lower=(0.0, 0.0), size=(1.0, 1.0)), Mass(lower=(1.0, 0.0), size=(1.0, 1.0), material=tilted)
    both = scene_of(first, second, size=(3.0, 2.0), cell=0.1, material=Material(friction_deg=30.0))
    halves = [reduced(dataclasses.replace(both, fields=fields), 2.0) for fields in ((), (uniform(30.0),))]
    alone, with_field = ([half.material_of(each) for each in half.masses] for half in halves)
    assert [field.mass for field in halves[1].fields] == [0, 1]
    for field, without, material in zip(halves[1].fields, alone, with_field, strict=True):
        assert field.values[0] == pytest.approx(without.friction_deg)
        assert material.dilation_deg <= field.values[0] + 1e-9


@pytest.mark.slow
def test_ground_behind_and_below_a_cut_does_not_make_it_safer() -> None:
    """Vertical cuts in undrained clay, c = rho g H / 3.78, whose factor is 1: on little and on much ground."""
    clay = dataclasses.replace(TAYLOR.scene(8).material, friction_deg=0.0, dilation_deg=0.0, cohesion=WEIGHT / 3.78)

    def factor(behind: float, below: float) -> float:
        top, end = below + HEIGHT, behind + HEIGHT
        front = ((end, 0.0), (end, below), (behind, below)) if below else ((behind, 0.0),)
        corners = ((0.0, 0.0), *front, (behind, top), (0.0, top))
        cut = Mass(kind="polygon", vertices=corners, material=clay)
        scene = scene_of(cut, size=(end, top + 2.5), cell=HEIGHT / 8, floor_friction="rough")
        found = safety_factor(scene, tolerance=0.03)
        assert found.cells == pytest.approx(8.0, abs=0.5)
        return found.factor

    near = factor(25.0, 0.0)
    assert near == pytest.approx(1.05, abs=0.05)
    assert factor(120.0, 0.0) == pytest.approx(near, rel=0.03)
    assert factor(50.0, 20.0) == pytest.approx(near, rel=0.06)


def test_soil_that_contracts_has_a_factor() -> None:
    """Its angle of dilation never lies beyond the friction that is left."""
    loose = Material(friction_deg=20.0, dilation_deg=-15.0, softening_length=1.0e6, saturated=True)
    weak = reduced(dataclasses.replace(SAND.scene(10), material=loose), 2.0).material
    assert weak.dilation_deg == pytest.approx(-weak.friction_deg)
    angles = Field(quantity="friction_deg", origin=(0.0, 0.0), spacing=(1.0, 1.0), nodes=(1, 1), values=(16.0,))
    varied = reduced(dataclasses.replace(SAND.scene(10), material=loose, fields=(angles,)), 2.0)
    assert varied.masses[0].material is not None
    assert varied.masses[0].material.dilation_deg == pytest.approx(-varied.fields[0].values[0])


def test_what_has_no_factor_of_safety_is_refused() -> None:
    scene = UNDRAINED.scene(4)
    refused(safety_factor, scene, tolerance=0.0, said="tolerance: expected a number above 0, got 0.0")
    thicker = Field(quantity="thickness", origin=(0.0,), spacing=(1.0,), nodes=(1,), values=(3.0,))
    sheet = Mass(kind="layer", thickness=2.0, outline=((0.0,), (10.0,)))
    said = "fields: expected no field of thickness beside --safety; give the layer its own thickness"
    refused(safety_factor, dataclasses.replace(scene, masses=(sheet,), fields=(thicker,)), said=said)
    refused(safety_factor, dataclasses.replace(scene, gravity=0.0), said="gravity: expected gravity above 0")
    level = dataclasses.replace(scene, masses=(Mass(lower=(0.0, 0.0), size=(scene.domain.size[0], 5.0)),))
    said = "masses: expected a scene with a factor of safety, this one stands at 81.92 times less"
    refused(safety_factor, level, said=said)
