"""Observations: the smooth forms against the exact ones; errors of measured numbers: forms, draws and statements."""

import numpy as np
import pytest
import torch

from datasets.flow import measures
from datasets.scene import Mass
from inverse.observations import KINDS, Observation
from inverse.observations.errors import Covariance, Noise
from inverse.observations.observation import fitted_tail
from tests.scenes import scene_of

SCENE = scene_of(Mass(lower=(0.0, 0.0), size=(0.2, 0.4)), size=(1.0, 0.5), cell=0.01)


def deposit(points: int, seed: int = 0) -> np.ndarray:
    """A wedge 0.6 m long [m], shape [points, 2]."""
    stream = np.random.default_rng(seed)
    return np.stack([0.6 * (1.0 - np.sqrt(stream.random(points))), 0.1 * stream.random(points)], axis=1)


def made(kind: str) -> Observation:
    return KINDS[kind](**({"line": 0.3} if kind == "passed" else {})).operator(SCENE)


@pytest.mark.parametrize(("kind", "within"), [("front", 1e-12), ("runout", 0.01), ("toe", 0.003), ("passed", 0.005)])
def test_the_smooth_form_of_all_points_is_near_the_exact_one(kind: str, within: float) -> None:
    positions = deposit(3200)
    smooth = made(kind).smooth(torch.from_numpy(positions), torch.ones(3200)).numpy()
    assert smooth == pytest.approx(made(kind).exact(positions), abs=within)
    # The fit through the tail is that of arrays, whatever the volumes.
    volumes = np.random.default_rng(1).uniform(0.5, 1.5, 3200)
    tail = fitted_tail(torch.from_numpy(positions[:, 0]), torch.from_numpy(volumes)).item()
    assert tail == pytest.approx(measures.front(positions, volumes), rel=1e-12)


def test_a_profile_weighs_points_by_their_volume() -> None:
    x = torch.from_numpy(np.random.default_rng(3).random((400, 2)) * 0.6)
    volumes = torch.ones(400)
    volumes[:100] = 2.0
    profile = made("profile")
    twice = profile.smooth(torch.cat([x, x[:100]]), torch.ones(500)).numpy()
    np.testing.assert_allclose(profile.smooth(x, volumes).numpy(), twice, rtol=1e-9)


def test_the_smooth_toe_is_a_tenth_of_the_volume() -> None:
    """Two piles of equal points, the further one a tenth of the volume: the toe is its centroid, whatever it weighs."""
    toe = made("toe")
    far = torch.rand(50, 2, dtype=torch.float64) * 0.01 + torch.tensor([0.8, 0.2])
    near = torch.rand(100, 2, dtype=torch.float64) * 0.01
    volumes = torch.cat([torch.full((50,), 1.0), torch.full((100,), 4.5)])
    seen = toe.smooth(torch.cat([far, near]), volumes)
    torch.testing.assert_close(seen, far.mean(dim=0), rtol=0.0, atol=1e-6)


def test_the_loss_of_points_is_their_mean_squared_distance() -> None:
    required, found = deposit(200, seed=0), deposit(200, seed=1)
    whole = made("deposit")
    expected = np.mean(np.sum((found - required) ** 2, axis=1))
    assert whole.misfit(whole.exact(found), whole.exact(required)) == pytest.approx(expected)
    some = np.array([3, 17, 90])
    part = whole.of_particles(whole.exact(required), some)
    np.testing.assert_array_equal(part, required[some].ravel())
    toe = made("toe")
    apart = toe.exact(found) - toe.exact(required)
    assert toe.misfit(toe.exact(found), toe.exact(required)) == pytest.approx(float(apart @ apart))


ROOT = np.random.default_rng(0).normal(size=(4, 4))
FORMS = pytest.mark.parametrize("errors", [Covariance.of(ROOT @ ROOT.T), Covariance(np.array([0.5, 1.0, 0.0, 2.0]))])
"""Dependent errors, and independent ones."""


@FORMS
def test_every_form_is_that_of_the_matrix(errors: Covariance) -> None:
    index, scale = np.array([2, 0]), np.array([1.0, 2.0, 3.0, 4.0])
    np.testing.assert_allclose(errors.deviation**2, np.diag(errors.matrix))
    np.testing.assert_allclose(errors.combined(ROOT), ROOT.T @ errors.matrix @ ROOT)
    np.testing.assert_allclose(errors.over(scale).matrix, errors.matrix / np.outer(scale, scale))
    np.testing.assert_allclose(errors.some(index).matrix, errors.matrix[index][:, index])
    both = Covariance.joined([errors, errors]).matrix
    np.testing.assert_allclose(both[4:, 4:], errors.matrix)
    assert not both[:4, 4:].any()


@FORMS
def test_errors_are_drawn_as_they_are_stated(errors: Covariance) -> None:
    rng = np.random.default_rng(1)
    drawn = np.stack([errors.drawn(rng) for _ in range(20_000)])
    np.testing.assert_allclose(np.cov(drawn, rowvar=False), errors.matrix, atol=0.04 * errors.matrix.max())


def test_a_stated_noise_is_a_share_or_a_deviation() -> None:
    numbers = np.array([0.1, -2.0])
    np.testing.assert_allclose(Noise.stated("3%").of(numbers), [0.003, 0.06])
    np.testing.assert_allclose(Noise.stated(0.2).of(numbers), 0.2)
