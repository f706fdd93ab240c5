"""The union of solids is one solid: no inner walls, no faces on the box's sides, every face knows whose it is."""

import dataclasses

import numpy as np
import pytest

from datasets.geometry.nearest import inside, nearest
from datasets.scene import Baffle, Solid
from tests.datasets.geometry.solids import scene_of, surface

SPACE = (2.0, 1.0, 1.0)


@pytest.mark.parametrize("dimension", [2, 3])
def test_touching_boxes_are_one(dimension: int) -> None:
    """They touch at 0.1 + 0.2, where decimals do not meet exactly."""
    first = Solid(lower=(0.1, 0.0, 0.2)[:dimension], size=(0.2, 0.3, 0.1)[:dimension], friction=0.1)
    second = Solid(lower=(0.3, 0.0, 0.2)[:dimension], size=(0.2, 0.1 + 0.2, 0.1)[:dimension], friction=0.7)
    scene = scene_of(first, second, size=SPACE[:dimension])
    found = surface(scene)
    points = np.array([[0.3, y, 0.25][:dimension] for y in np.linspace(0.01, 0.29, 29)])
    points[:, 0] += np.linspace(-1e-9, 1e-9, 29)
    whole = Solid(lower=(0.1, 0.0, 0.2)[:dimension], size=(0.4, 0.3, 0.1)[:dimension])
    expected = nearest(surface(scene_of(whole, size=SPACE[:dimension])), points).distance
    np.testing.assert_allclose(nearest(found, points).distance, expected, atol=1e-7)
    above = np.array([[0.2, 0.31, 0.25], [0.4, 0.31, 0.25]])[:, :dimension]
    seen = nearest(found, above)
    np.testing.assert_allclose(seen.distance, 0.01, atol=1e-7)
    assert found.solid[seen.face].tolist() == [0, 1]
    np.testing.assert_allclose(found.friction[seen.face], [[0.1] * dimension, [0.7] * dimension])


@pytest.mark.parametrize("dimension", [2, 3])
def test_no_face_lies_on_a_side_of_the_box(dimension: int) -> None:
    size = SPACE[:dimension]
    corner = Solid(lower=(1.7, 0.0, 0.9)[:dimension], size=(0.3, 0.3, 0.1)[:dimension])
    for turned_deg in (0.0, 20.0):
        found = surface(scene_of(dataclasses.replace(corner, turned_deg=turned_deg), size=size))
        middles = found.corners.mean(axis=1)
        for axis, length in enumerate(size):
            for side, out in ((0.0, -1.0), (length, 1.0)):
                assert not ((np.abs(middles[:, axis] - side) < 1e-6) & (found.normals[:, axis] * out > 0.9)).any()
    straight = surface(scene_of(corner, size=size))
    beyond = np.array([[1.8, -0.05, 0.95], [2.05, 0.2, 0.95], [2.05, -0.05, 0.95], [1.8, 0.2, 1.05]])[:, :dimension]
    assert inside(straight, beyond).all()


@pytest.mark.parametrize("where", [-0.01, 0.0])
def test_a_mesh_that_stands_on_or_in_the_floor(where: float) -> None:
    vertices = ((0.8, where, 0.3), (1.2, where, 0.3), (1.2, where, 0.7), (0.8, where, 0.7), (1.0, 0.4, 0.5))
    triangles = ((0, 1, 2), (0, 2, 3), (1, 0, 4), (2, 1, 4), (3, 2, 4), (0, 3, 4))
    found = surface(scene_of(Solid(kind="mesh", vertices=vertices, triangles=triangles), size=SPACE))
    assert inside(found, np.array([[1.0, 0.001, 0.5], [1.0, -0.05, 0.5], [1.0, 0.39, 0.5]])).all()
    assert not inside(found, np.array([[1.0, 0.41, 0.5], [0.7, -0.05, 0.5]])).any()
    assert not (found.normals[:, 1] < -0.9).any()


def test_terrain_and_what_stands_on_it_are_one() -> None:
    ground = Solid(kind="terrain", points=((0.0, 0.5), (1.0, 0.2), (2.0, 0.2)), friction=(0.2, 0.4, 0.6))
    wall = Solid(lower=(1.5, 0.1), size=(0.1, 0.3), friction=0.9)
    found = surface(scene_of(ground, wall))
    seen = nearest(found, np.array([[0.5, 0.36], [1.25, 0.21], [1.55, 0.41], [1.49, 0.3], [1.55, 0.2]]))
    assert found.solid[seen.face].tolist()[:4] == [0, 0, 1, 1]
    assert seen.distance[4] < -0.04
    flat = (found.solid == 0) & (found.normals[:, 1] > 0.999)
    (face,) = np.flatnonzero(flat & (found.corners[:, :, 0].max(axis=1) < 1.51))
    order = np.argsort(found.corners[face, :, 0])
    np.testing.assert_allclose(found.friction[face][order], [0.4, 0.5], atol=1e-6)


def test_friction_is_linear_over_a_height_field_under_a_box() -> None:
    x = np.linspace(0.0, 2.0, 21)
    rows = tuple((float(0.1 + 0.1 * a),) * 11 for a in x)
    friction = tuple((float(0.2 + 0.1 * a),) * 11 for a in x)
    ground = Solid(kind="terrain", origin=(0.0, 0.0), spacing=(0.1, 0.1), heights=rows, friction=friction)
    found = surface(scene_of(ground, Solid(lower=(0.93, 0.0, 0.37), size=(0.2, 0.5, 0.2), friction=3.0), size=SPACE))
    mine = (
        (found.solid == 0) & (found.corners[:, :, 0] >= 0.0).all(axis=1) & (found.corners[:, :, 0] <= 2.0).all(axis=1)
    )
    np.testing.assert_allclose(found.friction[mine], 0.2 + 0.1 * found.corners[mine][..., 0], atol=1e-6)
    np.testing.assert_allclose(found.friction[found.solid == 1], 3.0)


def test_baffles_come_first_with_their_own_friction_or_the_scenes() -> None:
    baffles = (Baffle(lower=(0.2, 0.0), size=(0.1, 0.2)), Baffle(lower=(0.5, 0.0), size=(0.1, 0.2), friction=0.8))
    scene = scene_of(Solid(lower=(1.0, 0.0), size=(0.1, 0.2)), baffles=baffles)
    found = surface(dataclasses.replace(scene, baffle_friction=0.4))
    assert [set(found.friction[found.solid == number].ravel().tolist()) for number in range(3)] == [{0.4}, {0.8}, {0.0}]
