"""The emulator: exact where it has to be, honest about what it does not know, and one with the textbook's formulas."""

from types import SimpleNamespace

import numpy as np
import pytest

from inverse.posterior import Matrix
from inverse.posterior.emulator import Emulator, correlation, fitted, linear


def spread(count: int, unknowns: int, seed: int = 0) -> Matrix:
    return np.random.default_rng(seed).random((count, unknowns))


def bent(points: Matrix) -> Matrix:
    """Two components of a smooth function."""
    wave = np.sin(2.5 * points[:, 0]) + points.sum(axis=1)
    return np.stack([wave, np.cos(2.0 * points[:, -1]) * points[:, 0]], axis=1)


@pytest.mark.parametrize("unknowns", [1, 10])
def test_a_linear_response_is_exact_and_its_scatter_is_found(unknowns: int) -> None:
    rng = np.random.default_rng(1)
    points, slopes = spread(12 * unknowns + 20, unknowns), rng.normal(size=(unknowns, 2))
    exact = fitted(points, 3.0 + points @ slopes, np.full(2, 1e-6))
    where = spread(50, unknowns, 2)
    np.testing.assert_allclose(exact.mean(where), 3.0 + where @ slopes, atol=1e-4)
    noisy = fitted(points, 3.0 + points @ slopes + 0.1 * rng.normal(size=(len(points), 2)), np.full(2, 0.05))
    np.testing.assert_allclose(np.sqrt(np.diag(noisy.scatter)), 0.1, rtol=0.4)
    mean, variance = noisy.predict(where)
    # What it does not know of the mean is the regression's: p / n of the scatter's variance on average.
    assert np.mean(variance) == pytest.approx(0.01 * (unknowns + 1) / len(points), rel=0.8)
    assert np.mean((mean - 3.0 - where @ slopes) ** 2 / variance) < 3.0


def test_it_is_the_textbooks_universal_kriging(monkeypatch: pytest.MonkeyPatch) -> None:
    """Rasmussen & Williams (2.41), (2.42), with a flat prior of the trend and a single nugget."""
    points, where, lengths, nugget = spread(14, 2), spread(6, 2, 1), np.array([0.5, 0.9]), 0.01
    numbers = bent(points)
    made = Emulator(points=points, numbers=numbers, expected_scatter=np.ones(2), lengths=lengths)
    whole = correlation(points, points, lengths) + nugget * np.eye(14)
    basis, near = linear(points), correlation(where, points, lengths)
    inverse = np.linalg.inv(whole)
    gram = basis.T @ inverse @ basis
    coefficients = np.linalg.solve(gram, basis.T @ inverse @ numbers)
    mean = linear(where) @ coefficients + near @ inverse @ (numbers - basis @ coefficients)
    rest = linear(where) - near @ inverse @ basis
    prior = 1.0 - np.sum((near @ inverse) * near, axis=1) + np.sum((rest @ np.linalg.inv(gram)) * rest, axis=1)
    residual = numbers - basis @ coefficients
    scale = np.einsum("nr,nm,mr->r", residual, inverse, residual) / (14 - 3)

    constants = SimpleNamespace(scatter_spread=1e6, length_scale=0.7, length_spread=0.8)
    monkeypatch.setattr("inverse.posterior.emulator.CONSTANTS", constants)
    monkeypatch.setattr("inverse.posterior.emulator.NUGGETS", np.array([nugget]))
    own_mean, own_variance = made.predict(where)
    covariance, scatter = made.covariance(where, 0)
    left_out, left_out_variance = made.left_out
    np.testing.assert_allclose(own_mean, mean, atol=1e-8)
    np.testing.assert_allclose(own_variance, prior[:, None] * scale, rtol=1e-6)
    np.testing.assert_allclose(np.diag(covariance), own_variance[:, 0], rtol=1e-6)
    assert scatter == pytest.approx(nugget * scale[0])
    # The run that is left out, by a fit without it.
    others = np.arange(14) != 5
    alone = np.linalg.inv(whole[np.ix_(others, others)])
    trend = np.linalg.solve(basis[others].T @ alone @ basis[others], basis[others].T @ alone @ numbers[others])
    expected = basis[5] @ trend + whole[5, others] @ alone @ (numbers[others] - basis[others] @ trend)
    np.testing.assert_allclose(left_out[5], numbers[5] - expected, atol=1e-8)
    short = basis[5] - whole[5, others] @ alone @ basis[others]
    gained = short @ np.linalg.solve(basis[others].T @ alone @ basis[others], short)
    unexplained = whole[5, 5] - whole[5, others] @ alone @ whole[others, 5] + gained
    np.testing.assert_allclose(left_out_variance[5], unexplained * scale, rtol=1e-6)


def test_its_intervals_hold_what_they_should() -> None:
    """Of bent functions with scatter, at new points: errors over stated deviations have a variance of about one."""
    ratios = []
    for seed in range(20):
        points, rng = spread(24, 2, seed), np.random.default_rng(100 + seed)
        made = fitted(points, bent(points) + 0.02 * rng.normal(size=(24, 2)), np.full(2, 0.02))
        where = 0.1 + 0.8 * spread(40, 2, 200 + seed)
        mean, variance = made.predict(where)
        ratios.append(np.mean((mean - bent(where)) ** 2 / variance))
    assert 0.3 < np.median(ratios) < 2.0


def test_where_it_errs_more_than_it_states_its_variance_grows() -> None:
    """Flat on one side, steps on the other."""
    points = np.linspace(0.0, 1.0, 40)[:, None]
    numbers = np.where(points > 0.6, np.sign(np.sin(60.0 * points)), 0.01 * np.sin(7.0 * points))
    made = fitted(points, numbers, np.array([0.05]))
    calm, wild = made.variance_ratio(np.array([[0.2], [0.8]]))[:, 0]
    assert calm == pytest.approx(0.9)
    assert wild > 1.3
    assert made.variance_ratio(np.array([[50.0]]))[0, 0] == pytest.approx(1.0)


@pytest.mark.parametrize("unknowns", [1, 10])
def test_the_last_digits_of_runs_do_not_move_its_lengths(unknowns: int) -> None:
    """Decompositions differ in their last digits from processor to processor: no sample and no run may depend on it."""
    points = spread(40, unknowns)
    numbers = np.sin(3.0 * points) @ np.random.default_rng(1).normal(size=(unknowns, 3))
    numbers += 0.05 * np.random.default_rng(2).normal(size=numbers.shape)
    one = fitted(points, numbers, np.full(3, 0.05))
    for seed in range(3):
        rounding = 1.0 + 1e-13 * np.random.default_rng(seed).normal(size=numbers.shape)
        other = fitted(points, numbers * rounding, np.full(3, 0.05))
        np.testing.assert_array_equal(one.lengths, other.lengths)
        np.testing.assert_allclose(one.mean(points), other.mean(points), rtol=1e-9, atol=1e-9)
