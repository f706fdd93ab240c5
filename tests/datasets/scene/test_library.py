"""Scene files: what ships is right, and what is wrong, also at random, is one line with file and key."""

import copy
import dataclasses
import operator
import warnings
from collections.abc import Iterator
from functools import reduce
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomli_w
from hypothesis import given
from hypothesis import strategies as st

from datasets import Baffle, InputError, Mass, Material, Scene, Solid, Stage, read_scene, write_scene
from datasets.files import read_toml
from datasets.scene.checks import warn_if_unlikely
from datasets.scene.library import SCENES
from datasets.scene.particles import initial_particles
from datasets.scene.parts import Water
from tests.refusals import refused
from tests.scenes import SAND, scene_of

GOOD = """
duration = 1.0
domain = { size = [1.0, 0.5], cell = 0.01 }
material = { friction_deg = 30.0, cohesion = 100.0 }
[[masses]]
lower = [0.0, 0.0]
size = [0.2, 0.1]
velocity = [1, 0]
[[baffles]]
lower = [0.5, 0.0]
size = [0.1, 0.1]
"""

AT_BAFFLE, THIN = "[[baffles]]\nlower = [0.5, 0.0]", "[[solids]]\nsize = [5e-13, 0.1]\n[[baffles]]\nlower = [0.5, 0.0]"
MISTAKES = {
    "unknown key": ("duration = 1.0", "duratoin = 1.0", "duratoin", "did you mean 'duration'"),
    "missing key": (", cell = 0.01", "", "domain.cell", "missing"),
    "not TOML": ("domain = {", "domain = ", "", "readable TOML"),
    "mass outside the domain": ("lower = [0.0, 0.0]", "lower = [0.9, 0.0]", "masses[0]", "inside the domain"),
    "unknown initial stress": ("velocity = [1, 0]", "k0 = 'geostatic'", "masses[0].k0", "at least 0 or 'elastic'"),
    "release within a frame": ("velocity = [1, 0]", "release = 0.001", "masses[0].release", "whole number of frames"),
    "gate of a free mass": ("velocity = [1, 0]", "gate = { speed = 0.7 }", "masses[0].gate", "a release at which"),
    "thrown behind barriers": ("[1, 0]", "[1, 0]\nrelease = 0.5", "masses[0].velocity", "at rest"),
    "overlapping masses": (AT_BAFFLE, "[[masses]]\nlower = [0.1, 0.05]", "masses[1]", "clear of masses[0]"),
    "a baffle without thickness": ("size = [0.1, 0.1]", "size = [5e-13, 0.1]", "baffles[0].size", "above 1e-09"),
    "a solid without thickness": (AT_BAFFLE, THIN, "solids[0].size", "above 1e-09"),
    "baffle in a mass": ("lower = [0.5, 0.0]", "lower = [0.15, 0.05]", "baffles[0]", "clear of masses[0]"),
}
SCENE = scene_of(Mass(lower=(0.0, 0.0), size=(0.2, 0.4)), size=(1.0, 0.5), cell=0.05)
TEXTS = st.text(st.characters(codec="utf-8"), max_size=5) | st.sampled_from(("box", "mesh", "layer"))
NUMBERS = st.booleans() | st.integers() | st.floats() | st.sampled_from((10**9, 10**30, 1e-300, 1e300))
VALUES = st.recursive(
    NUMBERS | TEXTS, lambda inner: st.lists(inner, max_size=3) | st.dictionaries(TEXTS, inner, max_size=2), max_leaves=4
)


@pytest.mark.parametrize(("good", "bad", "key", "expected"), MISTAKES.values(), ids=MISTAKES.keys())
def test_a_mistake_names_file_key_and_what_was_expected(
    tmp_path: Path, good: str, bad: str, key: str, expected: str
) -> None:
    path = tmp_path / "scene.toml"
    assert good in GOOD
    path.write_text(GOOD.replace(good, bad, 1))
    error = refused(read_scene, str(path), said=expected)
    assert (error.where, error.key) == (str(path), key)


def test_no_such_file_no_such_name_and_a_problem(tmp_path: Path) -> None:
    refused(read_scene, str(tmp_path / "absent.toml"), said="there is no such file")
    refused(read_scene, "colum-tall-21", said="did you mean 'column-tall-21'")
    path = tmp_path / "problem.toml"
    path.write_text('scene = "column-tall-42"\n[[unknowns]]\nname = "friction_deg"\n')
    refused(read_scene, path, said="problem.toml: unknowns: expected a scene, got a problem: python")


@pytest.mark.parametrize("name", [path.stem for path in sorted(SCENES.glob("*.toml"))])
def test_a_scene_that_ships_is_likely_and_is_written_and_read_back_equal(tmp_path: Path, name: str) -> None:
    scene = read_scene(name)
    warn_if_unlikely(scene)
    write_scene(scene, tmp_path / "again.toml")
    assert read_scene(tmp_path / "again.toml") == scene


def test_shapes_stages_laws_and_numpy_numbers_that_are_written_read_back_equal(tmp_path: Path) -> None:
    triangle = ((0.0, 0.1), (0.3, 0.1), (0.0, 0.3))
    scene = scene_of(
        Mass(kind="polygon", vertices=triangle, material=Material(friction_deg=0.0, cohesion=50.0)),
        Mass(lower=(0.7, 0.2), size=(0.1, 0.1), k0="elastic", release="settled"),
        size=(1.0, 0.5),
        cell=0.05,
        material=Material(friction_deg=float(np.float64(30.0)), cohesion=np.float64(100.0)),
        baffles=(Baffle(lower=(0.9, 0.0), size=(0.05, 0.2), turned_deg=10.0),),
        solids=(Solid(kind="terrain", points=((0.0, 0.05), (1.0, 0.0))),),
        stages=(Stage(time=0.2, mass=1, lower=(0.6, 0.0), size=(0.4, 0.5), friction_deg=10.0),),
        open_sides=("x+",),
    )
    bar = Material(law="von-mises", friction_deg=0.0, constants={"strength": 2.0e4, "hardening": 3.0e4})
    for written in (scene, scene_of(material=bar)):
        write_scene(written, tmp_path / "again.toml")
        assert read_scene(tmp_path / "again.toml") == written == Scene.from_json(written.to_json())


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"friction_deg": 0.52}, r"material\.friction_deg = 0\.52 degrees .* in radians it would be 29\.8 degrees"),
        ({"density": 1.8}, r"material\.density = 1\.8 kg/m\^3 .* in g/cm\^3 it would be 1800 kg/m\^3"),
        ({"density": 18.0}, r"material\.density = 18 kg/m\^3 .* in kN/m\^3 it would be 1835 kg/m\^3"),
        ({"density": 900.0, "saturated": True}, r"density = 900 kg/m\^3, of grains and water, is no more"),
        ({"saturated": True, "water": Water(level=90.0)}, r"water\.level lies 89\.5 m above the top of the box"),
        ({"cohesion": 1.5}, r"cohesion = 1\.5 Pa is negligible compared with rho g h .* in kPa it would be 1500 Pa"),
        ({"consolidation": 30.0, "saturated": True}, r"consolidation = 30 .* in m\^2/year it would be 9\.5e-07 m\^2/s"),
        (
            {"permeability": 8.64, "young": 2.0e6, "saturated": True},
            r"permeability = 8\.64 m/s drains faster .* in m/day it would be 0\.0001 m/s",
        ),
        ({"saturated": True, "water": Water(pool=30.0, fixed=True)}, r"water\.pool lies 29\.5 m above .* the ground"),
        (
            {"saturated": True, "water": Water(table=((0.0, 30.0), (1.0, 28.0)))},
            r"water\.table lies 27\.5 m above the top of the box: all that is saturated is full",
        ),
        ({"saturated": True, "water": Water(level=-3.0)}, r"water\.level lies 3 m below all that is saturated"),
        ({"young": 200.0}, r"material\.young = 200 Pa is less than 10 rho g h = 7\.06e\+04 Pa"),
        ({"friction_limit_deg": 40.0, "grain_diameter": 0.7}, r"diameter = 0\.7 m .* in mm it would be 0\.0007 m"),
    ],
)
def test_numbers_of_another_unit_are_warned_of(changes: dict[str, Any], message: str) -> None:
    sand = dataclasses.replace(SAND, **{key: value for key, value in changes.items() if key != "water"})
    with pytest.warns(UserWarning, match=message):
        warn_if_unlikely(dataclasses.replace(SCENE, material=sand, water=changes.get("water")))


def test_usual_water_is_not_warned_of() -> None:
    clay = dataclasses.replace(SAND, saturated=True, permeability=1.0e-4, young=2.0e6)
    tables = ({"level": 0.0}, {"table": ((0.0, 0.9), (1.0, 0.1))}, {"level": -1.0, "pool": 0.2}, {"pool": 0.5})
    for table in tables:
        warn_if_unlikely(dataclasses.replace(SCENE, material=clay, water=Water(fixed=True, **table)))


@pytest.mark.parametrize(("end", "falls"), [(0.0, 0.0), (-0.2, 0.2)])
def test_terrain_below_the_floor_is_warned_of(end: float, falls: float) -> None:
    """There the floor of the box is the ground; not where the line goes on beyond a side."""
    slope = Solid(kind="terrain", points=((0.0, 0.2), (1.0, end)), friction=0.4)
    scene = scene_of(Mass(kind="layer", thickness=0.1, outline=((0.2,), (0.4,))), size=(1.0, 0.6), solids=(slope,))
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        warn_if_unlikely(scene)
    line = f"solids[0]: the terrain falls {falls:g} m below the floor of the box, which is the ground there"
    assert [str(each.message).split(", of floor")[0] for each in said] == [line] * bool(falls)


def test_a_friction_in_degrees_a_layer_in_centimetres_and_a_turbulence_in_another_unit_are_warned_of() -> None:
    layer, ground = Mass(kind="layer", thickness=5.0, outline=((0.2,), (0.8,))), ((0.0, 0.1), (1.0, 0.1))
    steep = Solid(kind="terrain", points=ground, friction=(25.0, 20.0), turbulence=2.0)
    scene = scene_of(layer, size=(1.0, 6.0), cell=0.05, solids=(steep,), floor_friction=10.0)
    with pytest.warns(UserWarning, match=r"thickness|friction|turbulence") as said:
        warn_if_unlikely(scene)
    assert [str(warning.message) for warning in said] == [
        "masses[0].thickness: 5 m is 8.3 times the length of the layer; in cm it would be 0.05 m",
        "solids[0]: a friction of 25 is a Coulomb coefficient; of an angle of 25 degrees it is 0.466",
        "solids[0]: a turbulence of 2 m/s^2 stops nearly any flow; "
        "of snow and debris it is between 100 and 8000 m/s^2, and less brakes more",
    ]


def places(data: Any, way: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """The keys that lead to each value in tables and lists."""
    for key, value in data.items() if isinstance(data, dict) else enumerate(data) if isinstance(data, list) else ():
        yield (*way, key)
        yield from places(value, (*way, key))


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("name", ["baffles-2", "layers-10", "slope-layers", "valley-3d"])
def test_strange_scenes(name: str, tmp_path: Path) -> None:
    """With another value somewhere, or one that is gone."""
    path, mistakes = tmp_path / "scene.toml", []
    (tmp_path / "valley-3d.asc").write_bytes((SCENES / "valley-3d.asc").read_bytes())
    good = read_toml(SCENES / f"{name}.toml")

    @given(place=st.sampled_from([*places(good)]), value=VALUES | st.none())
    def is_read_or_refused(place: tuple[Any, ...], value: Any) -> None:
        data = copy.deepcopy(good)
        inner = reduce(operator.getitem, place[:-1], data)
        inner[place[-1]] = value
        if value is None:
            del inner[place[-1]]
        path.write_text(tomli_w.dumps(data), encoding="utf-8")
        try:
            scene = read_scene(path)
            if scene.particle_volume * 1e6 > np.prod(scene.domain.size):
                assert np.isfinite(initial_particles(scene).positions).all()
        except InputError as error:
            line = str(error)
            assert str(tmp_path) in line  # of the scene, or of a file beside it
            assert "expected" in line
            assert "\n" not in line
            assert len(line) < 3000
            mistakes.append(line)

    is_read_or_refused()
    assert len(mistakes) > 5
