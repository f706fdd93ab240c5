"""The posterior of a linear problem is the exact Gaussian one; the search finds its mean in a step."""

from typing import Any

import numpy as np
import pytest

from inverse.fields.noise import Noise, shrunk
from inverse.fields.posterior import Posterior, linear_mean
from inverse.fields.search import combinations, minimise

W, M = 30, 7


class Linear:
    """In place of a flow: numbers that are linear in the white ones, apart from a bend."""

    def __init__(self, bend: float = 0.0) -> None:
        rng = np.random.default_rng(0)
        self.matrix, self.bend = rng.normal(size=(M, W)), bend
        self.evaluations: list[Any] = []

    def mean(self, white: Any, seeds: Any) -> Any:
        self.evaluations.append(white)
        linear = self.matrix @ white
        return linear + self.bend * linear**3

    def jacobian(self, white: Any, rows: Any, seeds: Any) -> Any:
        return rows @ ((1.0 + 3.0 * self.bend * (self.matrix @ white) ** 2)[:, None] * self.matrix)


def noise() -> Noise:
    """Dependent errors."""
    root = np.random.default_rng(1).normal(size=(M, M))
    return Noise(measured=root @ root.T + 0.1 * np.eye(M), scatter=0.5 * np.eye(M), seeds=2)


def test_the_exact_gaussian_posterior() -> None:
    flow, errors = Linear(), noise()
    target = np.random.default_rng(2).normal(size=M) * 3.0
    found = minimise(flow, target, errors, np.eye(M), np.zeros(W), 5, range(2))  # type: ignore[arg-type]
    inverse = np.linalg.inv(errors.measured + 1.5 * errors.scatter)
    exact = np.linalg.inv(np.eye(W) + flow.matrix.T @ inverse @ flow.matrix)
    assert found.promised < 1e-9
    assert [each.step for each in found.iterates] == [0.0, 1.0]
    np.testing.assert_allclose(found.white, exact @ flow.matrix.T @ inverse @ target, atol=1e-10)
    posterior = Posterior(mean=found.white, jacobian=found.jacobian)
    np.testing.assert_allclose(np.eye(W) - posterior.removed @ posterior.removed.T, exact, atol=1e-10)
    eigenvalues = np.linalg.eigvalsh(flow.matrix.T @ inverse @ flow.matrix)[::-1]
    np.testing.assert_allclose(posterior.eigenvalues, eigenvalues[:M], rtol=1e-8)
    assert posterior.informative == int((eigenvalues > 1.0).sum())
    draws = posterior.draws(20_000)
    np.testing.assert_allclose(np.cov(draws.T), exact, atol=0.06)
    np.testing.assert_allclose(draws.mean(axis=0), found.white, atol=0.05)


def test_the_step_is_that_of_all_equations() -> None:
    rng = np.random.default_rng(3)
    jacobian, white, residual = rng.normal(size=(M, W)), rng.normal(size=W), rng.normal(size=M)
    found = linear_mean(jacobian, white, residual)
    exact = np.linalg.solve(np.eye(W) + jacobian.T @ jacobian, jacobian.T @ (jacobian @ white - residual))
    np.testing.assert_allclose(found, exact, atol=1e-10)


def test_a_step_is_halved_until_the_objective_falls() -> None:
    flow, errors = Linear(bend=0.05), noise()
    found = minimise(flow, np.full(M, 20.0), errors, np.eye(M), np.zeros(W), 30, range(2))  # type: ignore[arg-type]
    objectives = [each.objective for each in found.iterates]
    assert found.promised < 0.5
    assert sorted(objectives, reverse=True) == objectives
    assert min(each.step for each in found.iterates[1:]) < 1.0


def test_combinations_that_the_prior_does_not_move_are_left_out() -> None:
    rng = np.random.default_rng(4)
    errors = Noise(measured=np.eye(M), scatter=np.zeros((M, M)), seeds=1)
    draws = rng.normal(size=(40, 2)) @ np.array([[5.0, 0, 0, 0, 0, 0, 0], [0, 0.1, 0, 0, 0, 0, 0]])
    rows = combinations(draws, errors)
    np.testing.assert_allclose(np.abs(rows), np.eye(M)[:1], atol=0.01)


def test_the_shrunk_covariance_keeps_variances_and_is_positive() -> None:
    rng = np.random.default_rng(5)
    sample = rng.normal(size=(6, M)) * np.arange(1.0, M + 1.0)
    found = shrunk(sample)
    np.testing.assert_allclose(np.diag(found), sample.var(axis=0, ddof=1), rtol=1e-12)
    assert np.linalg.eigvalsh(found).min() > 0.0
    # Many flows of dependent numbers keep their correlation, a few independent ones hardly have any.
    common = rng.normal(size=(500, 1)) + 0.1 * rng.normal(size=(500, M))
    assert shrunk(common)[0, 1] > 0.9
    apart = found / np.sqrt(np.outer(np.diag(found), np.diag(found))) - np.eye(M)
    sampled = np.corrcoef(sample.T) - np.eye(M)
    assert np.abs(apart).max() < 0.6 * np.abs(sampled).max()
    assert shrunk(np.zeros((4, M)))[0, 0] == pytest.approx(1e-18)
