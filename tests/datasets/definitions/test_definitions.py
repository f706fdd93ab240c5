"""The dataset definitions: reproducible, divided as promised, blind to the test scenarios; those in TOML."""

import dataclasses
import hashlib
import json
import re
from collections import Counter
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from datasets import Baffle, Mass, Scene, read_scene
from datasets.definitions import FAMILIES, NAMES, read_definition
from datasets.definitions.definition import Definition, Entry, Split
from datasets.definitions.held_out import ASPECTS, is_held_out, neighbours
from datasets.geometry.placement import heights_above_ground, overlaps
from datasets.scene.particles import initial_particles, released_volume
from datasets.schema import changed
from tests.commands import DOCS, blocks
from tests.refusals import refused
from tests.scenes import scaled, scene_of

every = pytest.mark.parametrize("definition", [read_definition(name) for name in NAMES], ids=NAMES)
SMALL = 40
"""Scenes that are looked at where the whole dataset would tell no more."""
SAND = read_scene("column-short-21").material


@cache
def first_entries(definition: Definition, count: int = SMALL) -> tuple[Entry, ...]:
    """The beginning of the dataset of seed 0."""
    return definition.entries(seed=0, count=count)


@every
def test_seed_and_index_decide_and_a_smaller_dataset_is_a_prefix(definition: Definition) -> None:
    whole = first_entries(definition)
    assert definition.entries(seed=0, count=7) == whole[:7]
    assert all(a.scene != b.scene for a, b in zip(whole, definition.entries(seed=1, count=5), strict=False))
    assert len({entry.name for entry in whole}) == SMALL
    # A variant shares its shape and its jitter.
    distinct = {definition.stream(index): entry.scene for index, entry in enumerate(whole)}.values()
    assert len({scene.seed for scene in distinct}) == len({scene.masses for scene in distinct}) == len(distinct)
    for count, seed, key in ((0, 0, str(definition.size)), (1201, 0, str(definition.size)), (1, -1, "seed")):
        refused(definition.entries, seed=seed, count=count, said=key)


DRAWN = {
    "flow2d": "766fd32f07e7c27c",
    "columns2d": "7bf7332fa1d83a2e",
    "obstacle3d": "d42b8c509573d962",
    "baffles3d": "f9959c593b5daeb9",
    "terrain3d": "003c0550b1d3a74d",
    "cohesive3d": "ca675c8b50b4b276",
    "paper2d": "1b8d1079627b217c",
    "paper3d": "c62981929dceb48a",
}
"""Digest of the first 40 scenes of seed 0, their keys that are not at their defaults, to nine digits."""


@every
def test_the_shipped_definitions_draw_the_scenes_they_always_drew(definition: Definition) -> None:
    entries = first_entries(definition)
    lines = "\n".join(f"{entry.split} {entry.name} {json.dumps(changed(entry.scene))}" for entry in entries)
    # Processors differ in the last bits of a logarithm.
    lines = re.sub(r"-?\d+\.\d+(e-?\d+)?", lambda number: f"{float(number[0]):.9g}", lines)
    assert hashlib.sha256(lines.encode()).hexdigest()[:16] == DRAWN[definition.name]


def test_paper2d_is_the_paper_s() -> None:
    entries = first_entries(read_definition("paper2d"), 385)
    assert Counter(entry.split for entry in entries) == {Split.TRAIN: 343, Split.VALID: 21, Split.TEST: 21}
    assert {entry.scene.material.friction_deg for entry in entries} == {15.0, 22.5, 30.0, 37.5, 45.0}
    masses = [entry.scene.masses[0] for entry in entries]
    sizes, velocities = (np.array([getattr(mass, key) for mass in masses]) for key in ("size", "velocity"))
    np.testing.assert_array_equal(sizes[:, 0], sizes[:, 1])
    assert (sizes.min(), sizes.max()) == (0.2, 0.4)
    assert np.abs(velocities).max() < 2.0
    column = read_scene("column-short-21")
    for key in ("domain", "gravity", "floor_friction", "wall_friction", "damping", "step_fraction", "jitter"):
        assert getattr(entries[0].scene, key) == getattr(column, key)


def test_no_flow_is_a_neighbour_of_what_is_held_out() -> None:
    for name in FAMILIES:
        assert [entry.name for entry in first_entries(read_definition(name)) if is_held_out(entry.scene)] == []


def test_terrain3d_releases_layers_and_boxes_on_every_kind_of_ground() -> None:
    definition = read_definition("terrain3d")
    scenes = [entry.scene for entry in first_entries(definition, 60)]
    assert Counter(map(definition.split, range(600))) == {"train": 480, "valid": 60, "test": 60}
    for index, scene in enumerate(scenes):
        (mass,), (ground,) = scene.masses, scene.solids
        assert released_volume(scene) == pytest.approx(0.032, rel=1e-3)
        assert (mass.kind == "box") == (definition.kinds[index % 6] == "box")
        assert mass.thickness is None or 1.0 <= mass.thickness / scene.domain.cell <= 4.0
        heights = np.array(ground.heights)
        # The mean fall of a slope to its foot, and of rough ground.
        assert 0.1 < np.ptp(heights) < 2.2
    assert {bool(scene.solids[0].turbulence) for scene in scenes} == {True, False}
    rough = [np.abs(np.diff(np.array(scene.solids[0].heights), n=2, axis=0)).mean() for scene in scenes]
    assert max(rough) > 3.0 * min(rough)
    assert 0.0 < heights_above_ground(scenes[5]).min() < 0.1  # a box stands on the highest post beneath it


@pytest.mark.parametrize(("name", "count"), [("baffles-2", 11_010), ("baffles-5", 32_113)])
def test_the_paper_s_baffle_scenes(name: str, count: int) -> None:
    scene = read_scene(name)
    # Its counts are the volume over that of a particle; ours are whole numbers along each axis, of exactly that volume.
    placed = initial_particles(scene)
    assert len(placed.positions) == pytest.approx(count, rel=0.015)
    assert placed.volume.sum() == pytest.approx(count * scene.domain.cell**3 / 8, rel=2e-4)
    # The setting of the paper's training set, in another box.
    entry = first_entries(read_definition("paper3d"))[0].scene
    for key in ("material", "frame_dt", "floor_friction", "wall_friction", "baffle_friction", "damping", "jitter"):
        assert getattr(scene, key) == getattr(entry, key)


def mirrored(scene: Scene) -> Scene:
    """The scene in the mirror along x."""

    def box(block: Mass | Baffle) -> Any:
        left = scene.domain.size[0] - block.lower[0] - block.size[0]
        return dataclasses.replace(block, lower=(left, *block.lower[1:]))

    masses, baffles = (tuple(map(box, some)) for some in (scene.masses, scene.baffles))
    return dataclasses.replace(scene, masses=masses, baffles=baffles)


@pytest.mark.parametrize("name", ["column-tall-42", "layers-10", "baffles-5"])
def test_what_ships_is_held_out_scaled_mirrored_and_of_another_sand(name: str) -> None:
    scene = read_scene(name)
    softer = dataclasses.replace(scene.with_friction_deg(17.0), floor_friction=0.9)
    for same in (scene, scaled(scene, 3.0), mirrored(scaled(scene, 0.5)), softer):
        assert is_held_out(same)
    assert neighbours(mirrored(scaled(scene, 0.5)), scaled(scene, 3.0))


def column(length: float, height: float, left: float = 0.0) -> Scene:
    """A column in a box of two metres."""
    return scene_of(Mass(lower=(left, 0.0), size=(length, height)), size=(2.0, 1.0), cell=0.01, material=SAND)


@pytest.mark.parametrize("aspect", ASPECTS[1::2])
def test_a_column_of_a_held_out_aspect_at_a_wall_is_held_out(aspect: float) -> None:
    length, height = 0.3, 0.3 * aspect
    for same in (column(length, height), column(length, height, left=2.0 - length), column(length, 0.97 * height)):
        assert is_held_out(same)
    # Away from the walls its aspect is none of those that are tested, nor are those between.
    assert not is_held_out(column(length, height, left=0.5))
    assert not is_held_out(column(0.2, 0.48))


(EXAMPLE,) = (text for text in blocks(DOCS / "formats.md", "toml") if "[scene]" in text)
TEXT = """
[scene]
duration = 0.01
domain = { size = [0.4, 0.2], cell = 0.02 }
masses = [{ lower = [0.1, 0.0], size = [0.1, 0.1] }]
[scene.material]
friction_deg = {friction}
"""


BODIES = "[[scene.baffles]]\ncount = 199\nlower = [{ uniform = [0.3, 0.5] }, 0.0]\nsize = [0.1, 0.1]"


def definition(folder: Path, text: str = EXAMPLE) -> Definition:
    (folder / "steps.toml").write_text(text)
    return read_definition(folder / "steps.toml")


def test_the_definition_on_the_page(tmp_path: Path) -> None:
    entries = definition(tmp_path).entries(seed=0)
    assert len(entries) == 200
    assert [sum(entry.split is split for entry in entries) for split in Split] == [160, 20, 20]
    scenes = [entry.scene for entry in entries]
    assert {scene.domain.size for scene in scenes} == {(1.0, 0.5), (1.5, 0.5)}
    assert {scene.domain.cell for scene in scenes} == {0.02, 0.025}
    assert {scene.duration for scene in scenes} == {0.5, 0.75}
    assert {len(scene.masses) for scene in scenes} == {1, 2}
    assert {len(scene.baffles) for scene in scenes} == {0, 1, 2}
    assert len({scene.seed for scene in scenes}) == 200
    angles = np.array([scene.material.friction_deg for scene in scenes])
    assert 20.0 <= angles.min() < 21.5
    assert 38.5 < angles.max() <= 40.0
    for scene in scenes:
        assert scene.material.tension_cutoff == pytest.approx(0.5 * scene.material.cohesion)
        assert len({mass.size[1] for mass in scene.masses}) == 1
        assert all(0.0999 < mass.size[1] < 0.3001 for mass in scene.masses)
        boxes = (*scene.masses, *scene.baffles)
        assert not overlaps(boxes).any()
        for baffle in scene.baffles:
            others = [box for box in boxes if box is not baffle]
            gaps = [max(b.lower[0] - a.lower[0] - a.size[0] for a, b in ((baffle, o), (o, baffle))) for o in others]
            assert all(gap > 0.0399 for gap in gaps) or any(o.lower[1] > 0.0 for o in others)


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("{friction}", "{ uniform = [1.0] }", "scene.material.friction_deg.uniform: expected two numbers"),
        ("{friction}", "{ normal = [30, 2], step = 1 }", "no other key beside it than it, got step"),
        ("{friction}", "30.0\ncohesoin = 1", "scene.material.cohesoin: expected a known key, did you mean 'cohesion'"),
        ("{friction}", "{ choice = [20, 30], weights = [1] }", "weights, a positive whole number for each value"),
        ("{friction}", "{ uniform = [91, 95] }", "(in each of 1000 draws)"),
        ("{friction}", "{ variable = [30.0] }", "expected one of the variables [], got [30.0]"),
        ("{friction}", "{ variable = 'a', factor = 2 }\n[variables]\na = 'x'", "expected numbers, variable, factor"),
        ("[scene]", "count = 1000000000000\n[scene]", "count: expected at least 1, at most 1000000 scenes"),
        # A draw of 200 bodies takes ten times as long as one of 20: 1000 of them would take minutes.
        ("{friction}", f"30.0\n{BODIES}", "(in each of 100 draws)"),
    ],
)
def test_mistakes_name_file_and_key(tmp_path: Path, old: str, new: str, expected: str) -> None:
    text = TEXT.replace(old, new).replace("{friction}", "30.0")
    assert refused(definition, tmp_path, text, said=expected).where == str(tmp_path / "steps.toml")


def test_a_file_that_a_scene_lacks_is_named_itself(tmp_path: Path) -> None:
    text = TEXT.replace("{friction}", "30.0") + '[[scene.solids]]\nkind = "terrain"\nfile = "line.csv"\n'
    refused(definition, tmp_path, text, said="line.csv: solids[0].file: expected a CSV, there is no such file")
