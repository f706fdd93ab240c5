"""Samples of densities that are known exactly, and their separate parts."""

import numpy as np
import pytest

from inverse.posterior import Matrix
from inverse.posterior.answers import parts, quantiles
from inverse.posterior.sampling import sample


def whole(unknowns: int) -> dict[str, Matrix]:
    """The bounds of the unit box."""
    return {"low": np.zeros(unknowns), "high": np.ones(unknowns)}


def gaussian(points: Matrix, centre: Matrix, deviation: float) -> Matrix:
    return np.asarray(-0.5 * np.sum((points - centre) ** 2, axis=1) / deviation**2)


@pytest.mark.parametrize("unknowns", [1, 2, 10])
def test_a_gaussian_has_its_moments_and_its_evidence(unknowns: int) -> None:
    centre, deviation = np.linspace(0.4, 0.6, unknowns), 0.02
    found = sample(lambda points: gaussian(points, centre, deviation), np.random.default_rng(0), **whole(unknowns))
    np.testing.assert_allclose(found.mean, centre, atol=0.15 * deviation)
    np.testing.assert_allclose(np.sqrt(np.diag(found.covariance)), deviation, rtol=0.12)
    assert found.evidence == pytest.approx(unknowns * np.log(deviation * np.sqrt(2.0 * np.pi)), abs=0.15 * unknowns)
    assert found.difference < 0.25
    assert found.acceptance > 0.05
    (part,) = parts(found, lambda points: gaussian(points, centre, deviation), np.random.default_rng(1))
    np.testing.assert_allclose(part.half_widths, 1.96 * deviation, rtol=0.15)
    assert part.weight == pytest.approx(1.0)


def test_two_maxima_keep_their_shares() -> None:
    """One three times as heavy as the other, forty standard deviations apart."""
    one, other = np.array([0.2, 0.3]), np.array([0.8, 0.7])

    def density(points: Matrix) -> Matrix:
        return np.logaddexp(np.log(3.0) + gaussian(points, one, 0.015), gaussian(points, other, 0.015))

    found = sample(density, np.random.default_rng(0), **whole(2))
    heavy, light = parts(found, density, np.random.default_rng(1))
    np.testing.assert_allclose(heavy.point, one, atol=0.003)
    np.testing.assert_allclose(light.point, other, atol=0.003)
    assert heavy.weight == pytest.approx(0.75, abs=0.08)


def test_a_curved_ridge_is_one_part_and_a_ring_has_no_answer_in_its_middle() -> None:
    def ring(points: Matrix) -> Matrix:
        return np.asarray(-0.5 * ((np.linalg.norm(points - 0.5, axis=1) - 0.3) / 0.02) ** 2)

    found = sample(ring, np.random.default_rng(0), **whole(2))
    (part,) = parts(found, ring, np.random.default_rng(1))
    assert np.linalg.norm(part.point - 0.5) == pytest.approx(0.3, abs=0.05)
    assert min(part.half_widths) > 0.3


def test_what_is_not_constrained_has_the_prior() -> None:
    found = sample(lambda points: gaussian(points[:, :1], np.array([0.5]), 0.05), np.random.default_rng(0), **whole(2))
    assert np.sqrt(found.covariance[1, 1]) == pytest.approx(np.sqrt(1.0 / 12.0), rel=0.05)


def test_a_ridge_that_ends_at_a_bound_has_its_quantiles() -> None:
    """Steps along a ridge that are mirrored at a face, and not those back, would draw samples towards it."""

    def ridge(points: Matrix) -> Matrix:
        along, across = points[:, 0] - 0.7, points[:, 1] - 0.6 - 1.1 * (points[:, 0] - 0.7)
        return np.asarray(-0.5 * ((along / 0.3) ** 2 + (across / 0.05) ** 2))

    middles = (np.arange(500) + 0.5) / 500
    cells = np.stack(np.meshgrid(middles, middles, indexing="ij"), axis=-1).reshape(-1, 2)
    exact = quantiles(cells, np.exp(ridge(cells)) / np.exp(ridge(cells)).sum())
    shown = []
    for seed in range(4):
        found = sample(ridge, np.random.default_rng(seed), **whole(2))
        shown.append(quantiles(found.points, found.weights))
    np.testing.assert_allclose(np.mean(shown, axis=0), exact, atol=0.01)
