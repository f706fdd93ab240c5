"""Runout, front, toe and height profile of deposits whose measures are known."""

import numpy as np
import pytest

from datasets.measures import front, height_profile, profile_stations, runout, toe
from datasets.scene import Scene

SPACING = 0.005


def block(length: float, height: float) -> np.ndarray:
    """Points at the centres of squares of `SPACING` that fill a box at the left wall; positions [m], shape [N, 2]."""
    x = np.arange(SPACING / 2, length, SPACING)
    y = np.arange(SPACING / 2, height, SPACING)
    return np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)


def test_front_of_a_uniform_block() -> None:
    # 99.5 % of a block's points lie behind 99.5 % of its length.
    assert front(block(1.0, 0.1)) == pytest.approx(0.995, abs=SPACING / 2)
    assert runout(block(1.0, 0.1)) == pytest.approx(1.0 - SPACING / 2)


def test_one_point_moves_the_runout_but_not_the_front() -> None:
    points = block(0.4, 0.2)
    before = front(points)
    points[0, 0] = 0.9
    assert runout(points) == pytest.approx(0.9)
    assert front(points) == pytest.approx(before, abs=1e-9)


def test_toe_of_a_uniform_block() -> None:
    # The last tenth of a block 0.4 m long is centred at 0.38 m, and at half its height.
    assert toe(block(0.4, 0.2)) == pytest.approx((0.38, 0.1))


def test_toe_has_as_many_axes_as_the_points() -> None:
    points = np.random.default_rng(0).random((50, 3))
    furthest = points[np.argsort(points[:, 0])[-5:]]
    assert toe(points) == pytest.approx(tuple(furthest.mean(axis=0)))


def test_stations_reach_from_wall_to_wall(scene: Scene) -> None:
    np.testing.assert_allclose(profile_stations(scene, 0.05), [0.0, 0.05, 0.1, 0.15, 0.2])


def test_profile_of_a_block() -> None:
    stations = np.linspace(0.0, 1.0, 21)
    profile = height_profile(block(0.5, 0.2), SPACING**2, stations)
    np.testing.assert_allclose(profile[stations < 0.49], 0.2, rtol=1e-9)
    np.testing.assert_allclose(profile[stations > 0.56], 0.0)


def trapezoid(profile: np.ndarray, stations: np.ndarray) -> float:
    return float(np.trapezoid(profile, stations))


def test_profile_conserves_volume() -> None:
    stream = np.random.default_rng(0)
    stations = np.linspace(0.0, 1.0, 21)
    points = stream.random((1000, 2))
    points[:3, 0] = [0.0, 1.0, 1.0 + 1e-7]
    assert trapezoid(height_profile(points, 2e-5, stations), stations) == pytest.approx(1000 * 2e-5)


def test_profile_is_continuous() -> None:
    # A point carries at most volume / spacing^2 of slope (twice that at a wall), also across a station.
    stations = np.linspace(0.0, 1.0, 11)
    x = np.linspace(0.0, 1.0, 2001)
    profiles = np.array([height_profile(np.array([[each, 0.0]]), 1.0, stations) for each in x])
    steepest = np.abs(np.diff(profiles, axis=0)).max() / (x[1] - x[0])
    assert steepest == pytest.approx(2.0 / 0.1**2, rel=1e-6)
