"""Which scenes are too close to one that ships: in shape alone, at any scale and in the mirror."""

import dataclasses
from typing import Any

import pytest

from datasets.definitions.held_out import ASPECTS, is_held_out, neighbours
from datasets.library import read_scene
from datasets.scene import Baffle, Mass, Scene
from tests.scenes import scaled, scene_of


def mirrored(scene: Scene) -> Scene:
    """The scene in the mirror along x."""

    def box(each: Mass | Baffle) -> Any:
        left = scene.domain.size[0] - each.lower[0] - each.size[0]
        return dataclasses.replace(each, lower=(left, *each.lower[1:]))

    masses, baffles = (tuple(map(box, some)) for some in (scene.masses, scene.baffles))
    return dataclasses.replace(scene, masses=masses, baffles=baffles)


@pytest.mark.parametrize("name", ["column-tall-42", "layers-10", "baffles-5"])
def test_what_ships_is_held_out_scaled_mirrored_and_of_another_sand(name: str) -> None:
    scene = read_scene(name)
    softer = dataclasses.replace(scene.with_friction_deg(17.0), floor_friction=0.9)
    for same in (scene, scaled(scene, 3.0), mirrored(scaled(scene, 0.5)), softer):
        assert is_held_out(same)
    assert neighbours(mirrored(scaled(scene, 0.5)), scaled(scene, 3.0))


COLUMN = scene_of(
    Mass(lower=(0.0, 0.0), size=(0.31, 0.4)),
    size=(2.0, 1.0),
    cell=0.01,
    material=read_scene("column-short-21").material,
)


def column(length: float, height: float, left: float = 0.0) -> Scene:
    """A column in a box of two metres."""
    return dataclasses.replace(COLUMN, masses=(Mass(lower=(left, 0.0), size=(length, height)),))


@pytest.mark.parametrize("aspect", ASPECTS[1::2])
def test_a_column_of_a_held_out_aspect_at_a_wall_is_held_out(aspect: float) -> None:
    length = 0.3
    height = length * aspect
    assert is_held_out(column(length, height))
    assert is_held_out(column(length, height, left=2.0 - length))
    assert is_held_out(column(length, 0.97 * height))
    # Away from the walls its aspect is none of those that are tested, nor are those between.
    assert not is_held_out(column(length, height, left=0.5))
    assert not is_held_out(column(0.2, 0.48))
