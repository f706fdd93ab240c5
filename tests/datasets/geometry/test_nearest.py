"""Signed distances against closed forms: boxes, turned boxes, polygons, ground lines, height fields, spheres."""

import math

import numpy as np
import pytest
import shapely
from numpy.typing import NDArray

from datasets.geometry.nearest import nearest
from datasets.scene import Solid
from tests.datasets.geometry.solids import as_rows, scene_of, sphere, surface

Floats = NDArray[np.float64]


def random_positions(count: int, low: tuple[float, ...], high: tuple[float, ...]) -> Floats:
    """Points at random in a box, shape [count, D]."""
    return np.random.default_rng(7).uniform(low, high, (count, len(low)))


def box_distance(points: Floats, centre: Floats, half: Floats) -> Floats:
    """Signed distance from a box (closed form)."""
    off = np.abs(points - centre) - half
    return np.linalg.norm(np.maximum(off, 0.0), axis=1) + np.minimum(off.max(axis=1), 0.0)


def consistent(points: Floats, found: object) -> None:
    """The foot, the normal and the distance say the same."""
    np.testing.assert_allclose(found.foot + found.distance[:, None] * found.normal, points, atol=1e-9)  # type: ignore[attr-defined]
    np.testing.assert_allclose(np.linalg.norm(found.normal, axis=1), 1.0, atol=1e-9)  # type: ignore[attr-defined]


@pytest.mark.parametrize("turned_deg", [0.0, 30.0, -101.0])
@pytest.mark.parametrize("dimension", [2, 3])
def test_a_box(dimension: int, turned_deg: float) -> None:
    low, size = (0.8, 0.4, 0.3)[:dimension], (0.4, 0.2, 0.3)[:dimension]
    scene = scene_of(Solid(lower=low, size=size, turned_deg=turned_deg), size=(2.0, 1.0, 1.0)[:dimension])
    points = random_positions(3000, (0.5, 0.1, 0.0)[:dimension], (1.5, 0.9, 0.9)[:dimension])
    centre, half = np.add(low, np.multiply(0.5, size)), np.multiply(0.5, size)
    plane = [0, 1] if dimension == 2 else [0, 2]
    c, s = math.cos(math.radians(turned_deg)), math.sin(math.radians(turned_deg))
    local = points.copy()
    local[:, plane] = (points - centre)[:, plane] @ np.array([[c, -s], [s, c]]) + centre[plane]
    found = nearest(surface(scene), points)
    np.testing.assert_allclose(found.distance, box_distance(local, centre, half), atol=1e-12)
    consistent(points, found)


def test_a_ground_line_with_a_kink_and_a_valley() -> None:
    points = random_positions(3000, (0.0, 0.0), (2.0, 1.0))
    valley = Solid(kind="terrain", points=((0.0, 0.6), (0.8, 0.1), (1.4, 0.3), (2.0, 0.3)))
    found = nearest(surface(scene_of(valley)), points)
    # It goes on straight beyond the sides.
    line = shapely.LineString([(-1.6, 1.6), (0.8, 0.1), (1.4, 0.3), (4.0, 0.3)])
    height = np.interp(points[:, 0], [0.0, 0.8, 1.4, 2.0], [0.6, 0.1, 0.3, 0.3])
    expected = np.where(points[:, 1] < height, -1.0, 1.0) * shapely.distance(shapely.points(points), line)
    # The line ends some cells beyond the box: what lies farther from it may see that.
    near = np.abs(expected) < 0.1
    assert near.sum() > 500
    np.testing.assert_allclose(found.distance[near], expected[near], atol=1e-12)
    np.testing.assert_array_equal(found.distance < 0.0, expected < 0.0)


def test_a_valley_on_a_height_field() -> None:
    z = np.linspace(0.0, 1.0, 21)
    rows = tuple(tuple(0.1 + 0.6 * np.abs(z - 0.5)) for _ in range(41))
    solid = Solid(kind="terrain", origin=(0.0, 0.0), spacing=(0.05, 0.05), heights=rows)
    scene = scene_of(solid, size=(2.0, 1.0, 1.0), cell=0.05)
    points = random_positions(2000, (0.3, 0.0, 0.2), (1.7, 0.4, 0.8))
    found = nearest(surface(scene), points)
    # A plane on either side; above the valley's line the nearer of both, below it the line itself where that is nearer.
    across = (points[:, 1] - 0.1 - 0.6 * np.abs(points[:, 2] - 0.5)) / math.hypot(1.0, 0.6)
    line = np.hypot(points[:, 1] - 0.1, points[:, 2] - 0.5)
    along = np.abs(points[:, 2] - 0.5) + 0.6 * (points[:, 1] - 0.1)
    expected = np.where(along >= 0.0, across, -line)
    np.testing.assert_allclose(found.distance, expected, atol=1e-12)
    consistent(points, found)


@pytest.mark.parametrize("flipped", [False, True])
def test_a_sphere(flipped: bool) -> None:
    vertices, triangles = sphere((1.0, 0.5, 0.5), 0.3, 64)
    triangles = triangles[:, ::-1] if flipped else triangles
    solid = Solid(kind="mesh", vertices=as_rows(vertices), triangles=as_rows(triangles))
    points = random_positions(1000, (0.6, 0.1, 0.1), (1.4, 0.9, 0.9))
    found = nearest(surface(scene_of(solid, size=(2.0, 1.0, 1.0))), points)
    expected = np.linalg.norm(points - [1.0, 0.5, 0.5], axis=1) - 0.3
    # Between a sphere and triangles on it lies h^2 / 8 r at most, for edges of h.
    assert np.abs(found.distance - expected).max() < 0.004
    consistent(points, found)
