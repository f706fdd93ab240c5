"""The dataset definitions: reproducible, divided as promised, and blind to the test scenarios."""

import hashlib
import json
import re
from collections import Counter
from functools import cache

import numpy as np
import pytest

from datasets.definitions import NAMES, read_definition
from datasets.definitions.definition import Definition, Entry, Split
from datasets.definitions.flow2d import FLOW2D
from datasets.definitions.held_out import is_held_out
from datasets.definitions.obstacle3d import OBSTACLE3D
from datasets.definitions.paper_families import BAFFLES3D, COLUMNS2D
from datasets.errors import InputError
from datasets.library import read_scene
from datasets.particles import initial_particles
from datasets.records import changed

every = pytest.mark.parametrize("definition", [read_definition(name) for name in NAMES], ids=NAMES)
SMALL = 40
"""Scenes that are looked at where the whole dataset would tell no more."""


@cache
def first_entries(definition: Definition, count: int = SMALL) -> tuple[Entry, ...]:
    """The beginning of the dataset of seed 0."""
    return definition.entries(seed=0, count=count)


@every
def test_seed_and_index_decide_and_a_smaller_dataset_is_a_prefix(definition: Definition) -> None:
    whole = first_entries(definition)
    assert definition.entries(seed=0, count=7) == whole[:7]
    others = definition.entries(seed=1, count=5)
    assert all(a.scene != b.scene for a, b in zip(whole, others, strict=False))
    assert len({entry.name for entry in whole}) == SMALL
    # A variant shares its shape and its jitter.
    own = {definition.stream(index): entry for index, entry in enumerate(whole)}.values()
    assert len({entry.scene.seed for entry in own}) == len({entry.scene.masses for entry in own}) == len(own)
    for count, seed, key in ((0, 0, str(definition.size)), (1201, 0, str(definition.size)), (1, -1, "seed")):
        with pytest.raises(InputError, match=key):
            definition.entries(seed=seed, count=count)


DRAWN = {
    "flow2d": "73533c2aa86731ca",
    "columns2d": "7bdec34219e590bb",
    "obstacle3d": "522fc6919bf4bbcf",
    "baffles3d": "bc7349b04af4768a",
    "paper2d": "62360a30b7a9a7c1",
    "paper3d": "af7ce6a277a06008",
}
"""Digest of the first 40 scenes of seed 0, their keys that are not at their defaults, to nine digits."""


@every
def test_the_shipped_definitions_draw_the_scenes_they_always_drew(definition: Definition) -> None:
    entries = first_entries(definition)
    lines = "\n".join(f"{entry.split} {entry.name} {json.dumps(changed(entry.scene))}" for entry in entries)
    # Processors differ in the last bits of a logarithm.
    lines = re.sub(r"-?\d+\.\d+(e-?\d+)?", lambda found: f"{float(found[0]):.9g}", lines)
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
    for definition in (FLOW2D, COLUMNS2D, OBSTACLE3D, BAFFLES3D):
        assert [entry.name for entry in first_entries(definition) if is_held_out(entry.scene)] == []


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
