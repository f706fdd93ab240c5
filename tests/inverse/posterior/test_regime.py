"""A response that jumps: which runs are of the target's regime, and a posterior that keeps to it."""

import numpy as np
import pytest

from inverse.observations import build
from inverse.posterior.emulator import Matrix
from inverse.posterior.posterior import Posterior, posterior
from inverse.posterior.regime import Regime, of_target
from inverse.problem import read_problem
from inverse.settings import ObservationSettings
from inverse.target import Target

SCATTER = 0.05
EDGE = 0.6


def jumping(points: Matrix) -> Matrix:
    """Nearly steady below the edge, where a column stands; far above it, where it has fallen, and rough there."""
    fallen = 40.0 + 30.0 * np.sin(9.0 * points[:, 1]) + 60.0 * points[:, 0]
    return np.where(points[:, 0] < EDGE, points[:, 1], fallen)[:, None] * np.array([[1.0, 0.7]])


def inferred(truth: tuple[float, float], seed: int = 0) -> Posterior:
    rng = np.random.default_rng(seed)
    points = rng.random((40, 2))
    numbers = jumping(points) + SCATTER * rng.standard_normal((40, 2))
    values = jumping(np.array([truth]))[0] + SCATTER * rng.standard_normal(2)
    front = build(ObservationSettings(kind="front"), read_problem("friction-tall-42").scene)
    target = Target(observation=front, values=values, deviation=np.zeros(len(values)))
    return posterior(points, numbers, target, scatter=np.full(2, SCATTER), rng=rng)


@pytest.mark.parametrize("seed", range(4))
def test_a_column_that_stands_may_have_all_parameters_at_which_it_does(seed: int) -> None:
    found = inferred((0.3, 0.4), seed)
    regime = found.likelihood.regime
    assert regime is not None
    assert np.all(regime.inside[:, 0] < EDGE)
    assert np.all(regime.outside[:, 0] > EDGE)
    samples = found.samples
    # The second parameter by two numbers of slopes 1 and 0.7; of the first that it is below the edge.
    assert samples.mean[1] == pytest.approx(0.4, abs=0.12)
    assert np.sqrt(samples.covariance[1, 1]) == pytest.approx(SCATTER / np.hypot(1.0, 0.7), rel=0.5)
    assert np.sqrt(samples.covariance[0, 0]) == pytest.approx(EDGE / np.sqrt(12.0), rel=0.3)
    assert np.mean(samples.points[:, 0] < EDGE + 0.1) > 0.95


def test_the_nearest_runs_decide() -> None:
    regime = Regime(inside=np.array([[0.2, 0.5], [0.1, 0.4]]), outside=np.array([[0.8, 0.5]]))
    inside, between, outside = np.exp(regime(np.array([[0.21, 0.5], [0.5, 0.5], [0.79, 0.5]])))
    assert inside > 0.999
    assert 0.4 < between < 0.7
    assert outside < 0.001


def test_a_steady_response_is_one_regime() -> None:
    points = np.linspace(0.0, 1.0, 20)[:, None]
    near = np.ones(20, bool)
    assert of_target(50.0 * points, points, near, np.array([25.3])) is None
    # A target between two regimes is of neither.
    values = np.where(points < 0.5, points, 50.0 + points)
    assert of_target(values, points, near, np.array([25.0])) is None
    assert np.array_equal(of_target(values, points, near, np.array([0.2])), points[:, 0] < 0.5)
