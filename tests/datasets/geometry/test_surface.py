"""The union of solids is one solid, without inner walls, each face knows whose it is; signed distances from it.

Listed faces and a raster's triangles together are the surface of everything solid.
"""

import dataclasses
import math

import numpy as np
import pytest
import shapely

from datasets.geometry.contact_surface import contact_surface_in, has_faces, has_field
from datasets.geometry.nearest import inside, nearest
from datasets.geometry.surface import surface_in
from datasets.scene import Baffle, Domain, Solid
from datasets.scene.grid_field import Floats
from tests.datasets.geometry.solids import as_rows, scene_of, sphere, surface

SPACE = (2.0, 1.0, 1.0)
BOX = Domain(size=SPACE, cell=0.05)
SOLIDS = (
    Solid(lower=(0.93, 0.0, 0.33), size=(0.1, 0.6, 0.27), friction=0.2),
    Solid(lower=(1.5, 0.0, 0.0), size=(0.1, 0.7, 0.27), friction=0.2, turned_deg=20.0),
)


@pytest.mark.parametrize("dimension", [2, 3])
def test_touching_boxes_are_one(dimension: int) -> None:
    """They touch at 0.1 + 0.2, where decimals do not meet exactly."""
    first = Solid(lower=(0.1, 0.0, 0.2)[:dimension], size=(0.2, 0.3, 0.1)[:dimension], friction=0.1)
    second = Solid(lower=(0.3, 0.0, 0.2)[:dimension], size=(0.2, 0.1 + 0.2, 0.1)[:dimension], friction=0.7)
    faces = surface(scene_of(first, second, size=SPACE[:dimension]))
    points = np.array([[0.3, y, 0.25][:dimension] for y in np.linspace(0.01, 0.29, 29)])
    points[:, 0] += np.linspace(-1e-9, 1e-9, 29)
    whole = Solid(lower=(0.1, 0.0, 0.2)[:dimension], size=(0.4, 0.3, 0.1)[:dimension])
    expected = nearest(surface(scene_of(whole, size=SPACE[:dimension])), points).distance
    np.testing.assert_allclose(nearest(faces, points).distance, expected, atol=1e-7)
    above = np.array([[0.2, 0.31, 0.25], [0.4, 0.31, 0.25]])[:, :dimension]
    seen = nearest(faces, above)
    np.testing.assert_allclose(seen.distance, 0.01, atol=1e-7)
    assert faces.solid[seen.face].tolist() == [0, 1]
    np.testing.assert_allclose(faces.friction[seen.face], [[0.1] * dimension, [0.7] * dimension])


@pytest.mark.parametrize("dimension", [2, 3])
def test_no_face_lies_on_a_side_of_the_box(dimension: int) -> None:
    size = SPACE[:dimension]
    corner = Solid(lower=(1.7, 0.0, 0.9)[:dimension], size=(0.3, 0.3, 0.1)[:dimension])
    for turned_deg in (0.0, 20.0):
        faces = surface(scene_of(dataclasses.replace(corner, turned_deg=turned_deg), size=size))
        middles = faces.corners.mean(axis=1)
        for axis, length in enumerate(size):
            for side, out in ((0.0, -1.0), (length, 1.0)):
                assert not ((np.abs(middles[:, axis] - side) < 1e-6) & (faces.normals[:, axis] * out > 0.9)).any()
    straight = surface(scene_of(corner, size=size))
    beyond = np.array([[1.8, -0.05, 0.95], [2.05, 0.2, 0.95], [2.05, -0.05, 0.95], [1.8, 0.2, 1.05]])[:, :dimension]
    assert inside(straight, beyond).all()


@pytest.mark.parametrize("where", [-0.01, 0.0])
def test_a_mesh_that_stands_on_or_in_the_floor(where: float) -> None:
    vertices = ((0.8, where, 0.3), (1.2, where, 0.3), (1.2, where, 0.7), (0.8, where, 0.7), (1.0, 0.4, 0.5))
    triangles = ((0, 1, 2), (0, 2, 3), (1, 0, 4), (2, 1, 4), (3, 2, 4), (0, 3, 4))
    faces = surface(scene_of(Solid(kind="mesh", vertices=vertices, triangles=triangles), size=SPACE))
    assert inside(faces, np.array([[1.0, 0.001, 0.5], [1.0, -0.05, 0.5], [1.0, 0.39, 0.5]])).all()
    assert not inside(faces, np.array([[1.0, 0.41, 0.5], [0.7, -0.05, 0.5]])).any()
    assert not (faces.normals[:, 1] < -0.9).any()


def test_terrain_and_what_stands_on_it_are_one() -> None:
    ground = Solid(kind="terrain", points=((0.0, 0.5), (1.0, 0.2), (2.0, 0.2)), friction=(0.2, 0.4, 0.6))
    faces = surface(scene_of(ground, Solid(lower=(1.5, 0.1), size=(0.1, 0.3), friction=0.9)))
    seen = nearest(faces, np.array([[0.5, 0.36], [1.25, 0.21], [1.55, 0.41], [1.49, 0.3], [1.55, 0.2]]))
    assert faces.solid[seen.face].tolist()[:4] == [0, 0, 1, 1]
    assert seen.distance[4] < -0.04
    flat = (faces.solid == 0) & (faces.normals[:, 1] > 0.999)
    (face,) = np.flatnonzero(flat & (faces.corners[:, :, 0].max(axis=1) < 1.51))
    order = np.argsort(faces.corners[face, :, 0])
    np.testing.assert_allclose(faces.friction[face][order], [0.4, 0.5], atol=1e-6)


def test_friction_is_linear_over_a_height_field_under_a_box() -> None:
    x = np.linspace(0.0, 2.0, 21)
    rows = tuple((float(0.1 + 0.1 * a),) * 11 for a in x)
    friction = tuple((float(0.2 + 0.1 * a),) * 11 for a in x)
    ground = Solid(kind="terrain", origin=(0.0, 0.0), spacing=(0.1, 0.1), heights=rows, friction=friction)
    faces = surface(scene_of(ground, Solid(lower=(0.93, 0.0, 0.37), size=(0.2, 0.5, 0.2), friction=3.0), size=SPACE))
    along = faces.corners[:, :, 0]
    mine = (faces.solid == 0) & (along >= 0.0).all(axis=1) & (along <= 2.0).all(axis=1)
    np.testing.assert_allclose(faces.friction[mine], 0.2 + 0.1 * along[mine], atol=1e-6)
    np.testing.assert_allclose(faces.friction[faces.solid == 1], 3.0)


def test_baffles_come_first_with_their_own_friction_or_the_scenes() -> None:
    baffles = (Baffle(lower=(0.2, 0.0), size=(0.1, 0.2)), Baffle(lower=(0.5, 0.0), size=(0.1, 0.2), friction=0.8))
    scene = scene_of(Solid(lower=(1.0, 0.0), size=(0.1, 0.2)), baffles=baffles)
    faces = surface(dataclasses.replace(scene, baffle_friction=0.4))
    assert [set(faces.friction[faces.solid == number].ravel().tolist()) for number in range(3)] == [{0.4}, {0.8}, {0.0}]


def random_positions(count: int, low: tuple[float, ...], high: tuple[float, ...]) -> Floats:
    """Points at random in a box, shape [count, D]."""
    return np.random.default_rng(7).uniform(low, high, (count, len(low)))


def consistent(points: Floats, closest: object) -> None:
    """The foot, the normal and the distance say the same."""
    np.testing.assert_allclose(closest.foot + closest.distance[:, None] * closest.normal, points, atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(closest.normal, axis=1), 1.0, atol=1e-9)


@pytest.mark.parametrize("turned_deg", [0.0, 30.0, -101.0])
@pytest.mark.parametrize("dimension", [2, 3])
def test_a_box(dimension: int, turned_deg: float) -> None:
    low, size = (0.8, 0.4, 0.3)[:dimension], (0.4, 0.2, 0.3)[:dimension]
    scene = scene_of(Solid(lower=low, size=size, turned_deg=turned_deg), size=SPACE[:dimension])
    points = random_positions(3000, (0.5, 0.1, 0.0)[:dimension], (1.5, 0.9, 0.9)[:dimension])
    centre, half = np.add(low, np.multiply(0.5, size)), np.multiply(0.5, size)
    plane = [0, 1] if dimension == 2 else [0, 2]
    c, s = math.cos(math.radians(turned_deg)), math.sin(math.radians(turned_deg))
    local = points.copy()
    local[:, plane] = (points - centre)[:, plane] @ np.array([[c, -s], [s, c]]) + centre[plane]
    closest, off = nearest(surface(scene), points), np.abs(local - centre) - half
    exact = np.linalg.norm(np.maximum(off, 0.0), axis=1) + np.minimum(off.max(axis=1), 0.0)
    np.testing.assert_allclose(closest.distance, exact, atol=1e-12)
    consistent(points, closest)


def test_a_ground_line_with_a_kink_and_a_valley() -> None:
    points = random_positions(3000, (0.0, 0.0), (2.0, 1.0))
    valley = Solid(kind="terrain", points=((0.0, 0.6), (0.8, 0.1), (1.4, 0.3), (2.0, 0.3)))
    closest = nearest(surface(scene_of(valley)), points)
    # It goes on straight beyond the sides.
    line = shapely.LineString([(-1.6, 1.6), (0.8, 0.1), (1.4, 0.3), (4.0, 0.3)])
    height = np.interp(points[:, 0], [0.0, 0.8, 1.4, 2.0], [0.6, 0.1, 0.3, 0.3])
    expected = np.where(points[:, 1] < height, -1.0, 1.0) * shapely.distance(shapely.points(points), line)
    # The line ends some cells beyond the box: what lies farther from it may see that.
    near = np.abs(expected) < 0.1
    assert near.sum() > 500
    np.testing.assert_allclose(closest.distance[near], expected[near], atol=1e-12)
    np.testing.assert_array_equal(closest.distance < 0.0, expected < 0.0)


def test_a_valley_on_a_height_field() -> None:
    z = np.linspace(0.0, 1.0, 21)
    rows = tuple(tuple(0.1 + 0.6 * np.abs(z - 0.5)) for _ in range(41))
    solid = Solid(kind="terrain", origin=(0.0, 0.0), spacing=(0.05, 0.05), heights=rows)
    scene = scene_of(solid, size=SPACE, cell=0.05)
    points = random_positions(2000, (0.3, 0.0, 0.2), (1.7, 0.4, 0.8))
    closest = nearest(surface(scene), points)
    # A plane on either side; above the valley's line the nearer of both, below it the line itself where that is nearer.
    across = (points[:, 1] - 0.1 - 0.6 * np.abs(points[:, 2] - 0.5)) / math.hypot(1.0, 0.6)
    line = np.hypot(points[:, 1] - 0.1, points[:, 2] - 0.5)
    along = np.abs(points[:, 2] - 0.5) + 0.6 * (points[:, 1] - 0.1)
    np.testing.assert_allclose(closest.distance, np.where(along >= 0.0, across, -line), atol=1e-12)
    consistent(points, closest)


@pytest.mark.parametrize("flipped", [False, True])
def test_a_sphere(flipped: bool) -> None:
    vertices, triangles = sphere((1.0, 0.5, 0.5), 0.3, 64)
    triangles = triangles[:, ::-1] if flipped else triangles
    solid = Solid(kind="mesh", vertices=as_rows(vertices), triangles=as_rows(triangles))
    points = random_positions(1000, (0.6, 0.1, 0.1), (1.4, 0.9, 0.9))
    closest = nearest(surface(scene_of(solid, size=SPACE)), points)
    expected = np.linalg.norm(points - [1.0, 0.5, 0.5], axis=1) - 0.3
    # Between a sphere and triangles on it lies h^2 / 8 r at most, for edges of h.
    assert np.abs(closest.distance - expected).max() < 0.004
    consistent(points, closest)


def terrain(roughness: float) -> Solid:
    """An incline of 0.2 with posts 0.1 m apart, raised at random."""
    heights = 0.5 - 0.02 * np.arange(21)[:, None] + roughness * np.random.default_rng(0).random((21, 11))
    return Solid(kind="terrain", origin=(0.0, 0.0), spacing=(0.1, 0.1), heights=as_rows(heights))


@pytest.mark.parametrize("roughness", [0.0, 0.06])
def test_distances_by_faces_and_posts_are_those_of_the_whole_surface(roughness: float) -> None:
    solids, keys = (SOLIDS[0], terrain(roughness), SOLIDS[1]), ("a", "b", "c")
    whole, contact = surface_in(BOX, solids, keys), contact_surface_in(BOX, solids, keys)
    points = np.random.default_rng(1).uniform([-0.1, 0.1, -0.1], [2.1, 1.0, 1.1], (2000, 3))
    # Within a solid faces of another are near that their union has not.
    points = points[nearest(whole, points).distance > 0.0]
    near = contact.around(points, 0.2)
    ours, theirs = nearest(near, points), nearest(whole, points)
    np.testing.assert_allclose(ours.distance, theirs.distance, atol=1.0e-12)
    np.testing.assert_allclose(ours.foot, theirs.foot, atol=1.0e-12)
    assert (near.solid[ours.face] == whole.solid[theirs.face]).all()
    assert 0 < len(contact.faces.corners) < 0.3 * len(whole.corners)


def test_what_a_box_stands_on_is_no_surface_but_the_underside_of_a_bridge_is() -> None:
    """A box on the ground has no bottom; one across a gully, with both ends in the ground, has."""
    gully = Solid(kind="terrain", origin=(0.0, 0.0), spacing=(1.0, 0.5), heights=((0.5, 0.1, 0.5),) * 3)
    plain = Solid(kind="terrain", origin=(0.0, 0.0), spacing=(1.0, 0.5), heights=((0.4,) * 3,) * 3)
    beam = Solid(lower=(0.9, 0.4, 0.0), size=(0.1, 0.1, 1.0))
    for ground, downward in ((plain, 0), (gully, 2)):
        faces = contact_surface_in(BOX, (beam, ground), ("a", "b")).faces
        assert (faces.normals[:, 1] < -0.5).sum() == downward


def test_one_terrain_in_3d_is_a_height_field() -> None:
    baffle, one, two = Baffle(lower=(1.0, 0.0, 0.4), size=(0.1, 0.6, 0.2)), terrain(0.0), terrain(0.01)
    for solids, baffles, field, faces in (
        ((one,), (), True, False),
        ((one,), (baffle,), True, True),
        ((one, two), (), False, True),
    ):
        scene = scene_of(*solids, size=BOX.size, cell=BOX.cell, baffles=baffles)
        assert (has_field(scene), has_faces(scene)) == (field, faces)
