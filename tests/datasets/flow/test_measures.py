"""Runout, front, toe and profile of known deposits."""

import math

import numpy as np
import pytest

from datasets import Mass, Solid
from datasets.flow import measures
from tests.scenes import scene_of

SPACING = 0.005


def block(length: float, height: float) -> np.ndarray:
    """Points at the centres of squares of `SPACING` that fill a box at the left wall; positions [m], shape [N, 2]."""
    x = np.arange(SPACING / 2, length, SPACING)
    y = np.arange(SPACING / 2, height, SPACING)
    return np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)


@pytest.mark.parametrize("power", [1.0, 2.0, 3.0])
def test_of_few_particles_the_front_is_nearer_to_that_of_all_than_their_quantile(power: float) -> None:
    # Of deposits whose volume ahead of x falls with this power of the distance to the tip, at x = 1.
    stream, exact = np.random.default_rng(0), 1.0 - 0.005 ** (1.0 / power)
    fitted, plain = [], []
    for _ in range(400):
        points = 1.0 - stream.random((400, 2)) ** (1.0 / power)
        # Half of the particles stand for three quarters of the volume: each of those is there three times.
        volume = np.where(np.arange(400) < 200, 1.0, 3.0)
        fitted.append(measures.front(points, volume) - exact)
        plain.append(float(np.quantile(np.repeat(points[:, 0], volume.astype(int)), 0.995)) - exact)
    assert abs(np.mean(fitted)) < 0.9 * abs(np.mean(plain)) < 0.02
    assert np.std(fitted) < 0.95 * np.std(plain)


def test_the_front_of_a_tail_of_the_fitted_form_is_exact() -> None:
    ahead = 1.0 - (np.arange(40000) + 0.5) / 40000
    points = (2.0 - 0.7 * np.sqrt(ahead) - 3.0 * ahead)[:, None]
    assert measures.front(points) == pytest.approx(2.0 - 0.7 * math.sqrt(0.005) - 0.015, abs=1e-6)
    # What lies behind the tail or flies ahead of it does not count.
    points[ahead > 0.021], points[ahead < 0.0009] = -5.0, 9.0
    assert measures.front(points) == pytest.approx(2.0 - 0.7 * math.sqrt(0.005) - 0.015, abs=1e-6)


def test_the_front_is_behind_the_last_particle() -> None:
    """Six of 400 far ahead: by the fit alone it was 3.27 m."""
    fronts = []
    for count in (1, 2, 4, 6, 8):
        x = np.append(np.linspace(0.5, 1.0, 400 - count), np.full(count, 2.98))
        fronts.append(measures.front(np.stack([x, 0.0 * x], axis=1)))
    assert fronts[0] > 1.0
    assert fronts[-1] <= 2.98
    assert np.diff(fronts).min() > -1.0e-9


def test_the_front_moves_with_the_deposit_and_is_continuous() -> None:
    stream = np.random.default_rng(0)
    points, volume = stream.random((500, 3)), stream.uniform(0.5, 2.0, 500)
    assert measures.front(points + 0.1, 3.0 * volume) == pytest.approx(measures.front(points, volume) + 0.1, abs=1e-12)
    order = stream.permutation(500)
    assert measures.front(points[order], volume[order]) == pytest.approx(measures.front(points, volume), abs=1e-12)
    # A particle that overtakes those of other volumes one by one.
    fronts = []
    for points[0, 0] in np.linspace(0.95, 1.0, 20001):
        fronts.append(measures.front(points, volume))
    assert np.ptp(fronts) > 2e-4
    assert np.abs(np.diff(fronts)).max() < 2.5e-6
    # One of few particles is the furthest.
    assert measures.front(points[:1], volume[:1]) == pytest.approx(points[0, 0])
    assert measures.front(points[:30]) == pytest.approx(measures.runout(points[:30]))


def test_profile_conserves_volume() -> None:
    stream = np.random.default_rng(0)
    stations = np.linspace(0.0, 1.0, 21)
    points = stream.random((1000, 2))
    points[:3, 0] = [0.0, 1.0, 1.0 + 1e-7]
    assert np.trapezoid(measures.height_profile(points, 2e-5, stations), stations) == pytest.approx(1000 * 2e-5)


def test_the_distance_of_deposits_is_that_of_their_parts() -> None:
    deposit = block(0.4, 0.1)
    one = np.ones(len(deposit))
    assert measures.transport_distance(deposit, one, deposit + np.array([0.03, 0.0]), one) == pytest.approx(0.03)
    # Twice as long: each part is as far again from the wall, rms 0.4 / sqrt(3).
    long = deposit * np.array([2.0, 0.5])
    assert measures.transport_distance(long, one, deposit, one) == pytest.approx(0.4 / np.sqrt(3.0), rel=0.02)
    # Each second column of particles, of twice the volume, is the same deposit to half a spacing; heights do not count.
    some = deposit[np.isin((deposit[:, 0] / SPACING).astype(int) % 2, 0)]
    assert measures.transport_distance(some * np.array([1.0, 3.0]), np.full(len(some), 2.0), deposit, one) < SPACING
    # A quarter of the volume that flew on by 0.2 m.
    ahead = deposit.copy()
    ahead[deposit[:, 0] > 0.3, 0] += 0.2
    assert measures.transport_distance(ahead, one, deposit, one) == pytest.approx(0.1, rel=0.02)


def test_toe_thickness_and_bulk_of_a_block_are_its_own() -> None:
    points = block(0.4, 0.2)
    # The last tenth of a block 0.4 m long is centred at 0.38 m, and at half its height.
    assert measures.toe(points) == pytest.approx((0.38, 0.1))
    heights = measures.thickness(points, SPACING, 0.02, (1.0,))
    np.testing.assert_allclose(heights, np.repeat([0.2, 0.0], [20, 30]), atol=1e-12)
    assert measures.bulk(points + np.array([0.3, 0.0]), SPACING, 0.08, 0.02) == pytest.approx(1.0)
    assert measures.bulk(points * np.array([1.0, 2.0]), 2.0 * SPACING, 0.08, 0.02) == pytest.approx(2.0)
    cube = np.insert(np.repeat(block(0.1, 0.1), 20, axis=0), 2, np.tile(SPACING * (np.arange(20) + 0.5), 400), axis=1)
    assert measures.bulk(cube, SPACING, 0.001, 0.02) == pytest.approx(1.0)
    assert measures.thickness(cube, SPACING, 0.02, (0.2, 0.3)).shape == (10, 15)
    # Sand beyond the box does not count.
    assert measures.thickness(cube - 1.0, SPACING, 0.02, (0.2, 0.3)).max() == 0.0
    # Half of the plan apart: a third in common.
    moved = measures.thickness(points + np.array([0.2, 0.0]), SPACING, 0.02, (1.0,))
    assert measures.overlap(heights, moved) == pytest.approx(1.0 / 3.0)
    assert measures.overlap(heights, 0.05 * moved) == 0.0


def test_heights_are_counted_from_the_terrain() -> None:
    ramp = Solid(kind="terrain", points=((0.0, 0.5), (1.0, 0.0)))
    scene = scene_of(Mass(lower=(0.0, 0.6), size=(0.4, 0.2)), solids=(ramp,))
    points = block(0.4, 0.2)
    raised = points + np.stack([0.0 * points[:, 0], 0.5 - 0.5 * points[:, 0]], axis=1)
    np.testing.assert_allclose(measures.above(raised, measures.ground_of(scene)), points, atol=1e-12)
    volume = np.full(len(points), SPACING**2)
    deposit = measures.Deposit.of_positions(raised - 0.1, raised, volume, scene.domain.size, measures.ground_of(scene))
    errors = deposit.errors(raised - points * np.array([0.0, 0.5]), volume)
    assert (errors.front, errors.profile, errors.overlap) == pytest.approx((0.0, 0.0, 1.0))
    assert errors.height == pytest.approx(-0.5)
    assert errors.thickness == pytest.approx(0.5, rel=0.05)
    assert measures.mean_height(points, volume) == pytest.approx(0.1)
    assert not deposit.at_wall
