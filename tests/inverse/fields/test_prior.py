"""The prior: a symmetric positive precision, the stated deviation at every node, the Matern correlation inside."""

import numpy as np
import pytest

from datasets.field import Grid
from inverse.fields.prior import Prior, matern

GRIDS = {
    "2D": (Grid((0.0, 0.0), (0.02, 0.02), (21, 15)), (0.14, 0.14)),
    "2D, longer along x": (Grid((0.0, 0.0), (0.02, 0.01), (21, 15)), (0.16, 0.06)),
    "3D": (Grid((0.0, 0.0, 0.0), (0.1, 0.1, 0.1), (7, 6, 5)), (0.5, 0.5, 0.5)),
    "along x alone": (Grid((0.0, 0.0), (0.02, 1.0), (31, 1)), (0.12, 1.0)),
}


@pytest.fixture(params=GRIDS)
def prior(request: pytest.FixtureRequest) -> Prior:
    """A prior of deviation 2.5."""
    grid, lengths = GRIDS[request.param]
    return Prior(grid, 2.5, lengths)


def test_the_precision_is_symmetric_and_positive(prior: Prior) -> None:
    precision = prior.precision
    assert abs(precision - precision.T).max() <= 1e-12 * abs(precision).max()
    np.linalg.cholesky(precision.toarray())


def test_the_deviation_is_the_stated_one_at_every_node(prior: Prior) -> None:
    root = prior.field(np.eye(prior.size))
    np.testing.assert_allclose((root**2).sum(axis=1), 2.5**2, rtol=1e-9)
    # The root is one of the inverse of the precision.
    covariance = np.linalg.inv(prior.precision.toarray())[np.ix_(prior.inner, prior.inner)]
    np.testing.assert_allclose(root @ root.T, covariance * np.outer(prior.scale, prior.scale), atol=1e-8)


def test_the_correlation_is_that_of_matern(prior: Prior) -> None:
    """In the interior: the variance of the exact covariance is infinitely sharp, that between nodes is not."""
    root = prior.field(np.eye(prior.size)) / 2.5
    middle = prior.grid.count // 2
    middle = int(np.argmin(np.linalg.norm(prior.grid.positions - prior.grid.positions.mean(axis=0), axis=1)))
    varying = [axis for axis, count in enumerate(prior.grid.nodes) if count > 1]
    offsets = (prior.grid.positions - prior.grid.positions[middle])[:, varying]
    exact = matern(offsets, [prior.lengths[axis] for axis in varying])
    np.testing.assert_allclose(root @ root[middle], exact, atol=0.07)


def test_the_correlation_at_the_stated_length() -> None:
    assert matern(np.array([[0.14, 0.0]]), (0.14, 0.2)) == pytest.approx(0.14, abs=0.002)
    assert matern(np.array([[0.0, 0.2]]), (0.14, 0.2)) == pytest.approx(0.14, abs=0.002)
    assert matern(np.zeros((1, 3)), (1.0, 1.0, 1.0)) == pytest.approx(1.0)
    # In 3D it is exponential.
    assert matern(np.array([[0.5, 0.0, 0.0]]), (1.0, 1.0, 1.0)) == pytest.approx(np.exp(-1.0))


def test_the_transpose(prior: Prior) -> None:
    rng = np.random.default_rng(0)
    white, adjoint = rng.normal(size=prior.size), rng.normal(size=prior.grid.count)
    assert adjoint @ prior.field(white) == pytest.approx(white @ prior.white(adjoint), rel=1e-10)
    both = prior.field(np.stack([white, 2.0 * white], axis=1))
    np.testing.assert_allclose(both[:, 1], 2.0 * prior.field(white), rtol=1e-12)
