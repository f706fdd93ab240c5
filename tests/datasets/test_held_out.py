"""Which scenes are too close to one that ships: in shape alone, at any scale and in the mirror."""

import dataclasses

import pytest

from datasets.definitions.held_out import ASPECTS, is_held_out, neighbours
from datasets.library import read_scene
from datasets.scene import Baffle, Domain, Mass, Scene


def scaled(scene: Scene, factor: float) -> Scene:
    """The scene with all lengths times `factor`."""

    def box(each: Mass | Baffle) -> dict[str, tuple[float, ...]]:
        return {key: tuple(factor * value for value in getattr(each, key)) for key in ("lower", "size")}

    return dataclasses.replace(
        scene,
        domain=Domain(size=tuple(factor * length for length in scene.domain.size), cell=factor * scene.domain.cell),
        masses=tuple(dataclasses.replace(mass, **box(mass)) for mass in scene.masses),
        baffles=tuple(dataclasses.replace(baffle, **box(baffle)) for baffle in scene.baffles),
    )


def mirrored(scene: Scene) -> Scene:
    """The scene in the mirror along x."""
    length = scene.domain.size[0]

    def box(each: Mass | Baffle) -> tuple[float, ...]:
        return (length - each.lower[0] - each.size[0], *each.lower[1:])

    return dataclasses.replace(
        scene,
        masses=tuple(
            dataclasses.replace(
                mass, lower=box(mass), velocity=mass.velocity and (-mass.velocity[0], *mass.velocity[1:])
            )
            for mass in scene.masses
        ),
        baffles=tuple(dataclasses.replace(baffle, lower=box(baffle)) for baffle in scene.baffles),
    )


SHIPPED = ("column-tall-42", "layers-10", "baffles-2", "baffles-5")


@pytest.mark.parametrize("name", SHIPPED)
def test_what_ships_is_held_out_scaled_mirrored_and_of_another_sand(name: str) -> None:
    scene = read_scene(name)
    softer = dataclasses.replace(scene.with_friction_deg(17.0), floor_friction=0.9)
    for same in (scene, mirrored(scene), scaled(scene, 3.0), mirrored(scaled(scene, 0.5)), softer):
        assert is_held_out(same)
        assert neighbours(same, scene)


COLUMN = Scene(
    domain=Domain(size=(2.0, 1.0), cell=0.01),
    material=read_scene("column-short-21").material,
    masses=(Mass(lower=(0.0, 0.0), size=(0.31, 0.4)),),
)


def column(length: float, height: float, left: float = 0.0) -> Scene:
    """A column in a box of two metres."""
    return dataclasses.replace(COLUMN, masses=(Mass(lower=(left, 0.0), size=(length, height)),))


@pytest.mark.parametrize("aspect", ASPECTS)
@pytest.mark.parametrize("length", [0.07, 0.3])
def test_a_column_of_a_held_out_aspect_at_a_wall_is_held_out_at_any_size(aspect: float, length: float) -> None:
    height = length * aspect
    assert is_held_out(column(length, height))
    assert is_held_out(column(length, height, left=2.0 - length))
    assert is_held_out(column(length, 0.97 * height))
    # Away from the walls its aspect is none of those that are tested, nor are those between.
    assert not is_held_out(column(length, height, left=0.5))
    assert not is_held_out(column(0.2, 0.48))


def test_a_scene_of_other_corners_walls_or_masses_is_no_neighbour() -> None:
    scene = read_scene("baffles-2")
    (mass,) = scene.masses
    side = (mass.size[0] * mass.size[1] * mass.size[2]) ** (1.0 / 3.0)
    near, far = (
        dataclasses.replace(
            scene,
            baffles=(
                dataclasses.replace(
                    scene.baffles[0], lower=(scene.baffles[0].lower[0] + share * side, *scene.baffles[0].lower[1:])
                ),
                *scene.baffles[1:],
            ),
        )
        for share in (0.05, 0.08)
    )
    assert neighbours(near, scene)
    assert not neighbours(far, scene)
    assert not neighbours(dataclasses.replace(scene, baffles=scene.baffles[:1]), scene)
    tall = read_scene("column-tall-42")
    assert neighbours(tall, read_scene("column-tall-21"))
    assert not neighbours(tall, read_scene("column-short-21"))
