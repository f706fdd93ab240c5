"""Errors of measured numbers: independent ones are those of their diagonal matrix, and drawn as they are stated."""

import numpy as np
import pytest

from inverse.observations.errors import Covariance, Noise

ROOT = np.random.default_rng(0).normal(size=(4, 4))
DEPENDENT = Covariance.of(ROOT @ ROOT.T)
INDEPENDENT = Covariance(np.array([0.5, 1.0, 0.0, 2.0]))


@pytest.mark.parametrize("errors", [DEPENDENT, INDEPENDENT])
def test_every_form_is_that_of_the_matrix(errors: Covariance) -> None:
    index, scale = np.array([2, 0]), np.array([1.0, 2.0, 3.0, 4.0])
    np.testing.assert_allclose(errors.deviation**2, np.diag(errors.matrix))
    np.testing.assert_allclose(errors.combined(ROOT), ROOT.T @ errors.matrix @ ROOT)
    np.testing.assert_allclose(errors.over(scale).matrix, errors.matrix / np.outer(scale, scale))
    np.testing.assert_allclose(errors.some(index).matrix, errors.matrix[index][:, index])
    both = Covariance.joined([errors, errors]).matrix
    np.testing.assert_allclose(both[4:, 4:], errors.matrix)
    assert not both[:4, 4:].any()


@pytest.mark.parametrize("errors", [DEPENDENT, INDEPENDENT])
def test_errors_are_drawn_as_they_are_stated(errors: Covariance) -> None:
    rng = np.random.default_rng(1)
    drawn = np.stack([errors.drawn(rng) for _ in range(20_000)])
    np.testing.assert_allclose(np.cov(drawn, rowvar=False), errors.matrix, atol=0.04 * errors.matrix.max())


def test_a_stated_noise_is_a_share_or_a_deviation() -> None:
    numbers = np.array([0.1, -2.0])
    np.testing.assert_allclose(Noise.stated("3%").of(numbers), [0.003, 0.06])
    np.testing.assert_allclose(Noise.stated(0.2).of(numbers), 0.2)
