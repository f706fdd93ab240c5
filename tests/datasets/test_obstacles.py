"""Baffles become points and come back as the same baffles; points that are no boxes are refused."""

import numpy as np
import pytest

from datasets.errors import InputError
from datasets.exchange.baffle_particles import baffles_in, clusters, obstacle_particles
from datasets.scene import Baffle
from tests.datasets.toys import strewn, toy_scene


@pytest.mark.parametrize("dimension", [2, 3])
def test_baffles_survive_single_precision(dimension: int) -> None:
    scene = toy_scene(dimension, seed=0)
    share = scene.particle_spacing
    points = np.concatenate([obstacle_particles(baffle, share) for baffle in scene.baffles])
    again = baffles_in(points.astype(np.float32).astype(np.float64), share)
    assert sorted(again, key=lambda baffle: baffle.lower) == sorted(scene.baffles, key=lambda baffle: baffle.lower)


def test_the_lattice_fills_the_box() -> None:
    points = obstacle_particles(Baffle(lower=(0.3, 0.0), size=(0.05, 0.1)), 0.005)
    assert len(points) == 10 * 20
    np.testing.assert_allclose(points.min(axis=0), [0.3025, 0.0025])
    np.testing.assert_allclose(points.max(axis=0), [0.3475, 0.0975])


def test_a_baffle_thinner_than_the_spacing_keeps_its_thickness() -> None:
    thin = Baffle(lower=(0.3, 0.0), size=(0.001, 0.1))
    assert baffles_in(obstacle_particles(thin, 0.005), 0.005) == (thin,)


def test_a_single_layer_is_a_spacing_thick() -> None:
    points = np.stack([np.full(20, 0.3), 0.0025 + 0.005 * np.arange(20)], axis=1)
    assert baffles_in(points, 0.005) == (Baffle(lower=(0.2975, 0.0), size=(0.005, 0.1)),)


@pytest.mark.parametrize(("dimension", "spacing"), [(2, 0.005), (3, 0.01)])
def test_points_strewn_at_random(dimension: int, spacing: float) -> None:
    stream = np.random.default_rng(0)
    boxes = [((0.3, 0.0, 0.1), (0.1, 0.3, 0.1)), ((0.5, 0.1, 0.0), (0.1, 0.3, 0.1))]
    points = np.concatenate([strewn(stream, low[:dimension], size[:dimension], spacing) for low, size in boxes])
    found = sorted(baffles_in(points, spacing), key=lambda baffle: baffle.lower)
    assert len(found) == 2
    for baffle, (low, size) in zip(found, boxes, strict=True):
        np.testing.assert_allclose(baffle.lower, low[:dimension], atol=spacing)
        np.testing.assert_allclose(baffle.size, size[:dimension], atol=spacing)


def ball(dimension: int) -> np.ndarray:
    points = strewn(np.random.default_rng(0), (0.0,) * dimension, (0.4,) * dimension, 0.01)
    return points[np.linalg.norm(points - 0.2, axis=1) < 0.2]


def corner() -> np.ndarray:
    points = obstacle_particles(Baffle(lower=(0.0, 0.0), size=(0.2, 0.2)), 0.01)
    return points[(points > 0.1).any(axis=1)]


def ramp() -> np.ndarray:
    along = np.arange(50) * 0.005
    return np.stack([along, 0.5 * along], axis=1)


@pytest.mark.parametrize("points", [ball(2), ball(3), corner(), ramp()], ids=["disc", "ball", "corner", "ramp"])
def test_what_is_no_box(points: np.ndarray) -> None:
    with pytest.raises(InputError, match="fill boxes along the axes"):
        baffles_in(points, 0.01)


def test_dense_points_cost_little() -> None:
    points = np.concatenate([np.random.default_rng(0).random((50_000, 3)) * 1e-3, [[0.5, 0.5, 0.5]]])
    assert sorted(map(len, clusters(points, 0.01))) == [1, 50_000]


def test_clusters() -> None:
    points = np.array([[0.0, 0.0], [1.0, 0.0], [0.015, 0.0], [1.0, 0.019], [0.5, 0.5]])
    assert sorted(sorted(cluster.tolist()) for cluster in clusters(points, 0.01)) == [[0, 2], [1, 3], [4]]
    assert clusters(np.empty((0, 2)), 0.01) == []
