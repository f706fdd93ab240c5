"""Certainty: the stated half-width covers the truth as often as it says."""

import math

import numpy as np
import pytest

from validation.loop.calibration import calibrate


def draw(
    stream: np.random.Generator, *, slope: float, scatter: float, noise: float, truth: float
) -> tuple[bool, float]:
    """One experiment: eight runs of a line with scatter, a target of its own; whether the truth was covered."""
    angles = np.array([30.0, 30.0, 30.0, 30.0, 28.0, 28.0, 32.0, 32.0])
    seen = 0.6 + slope * (angles - 30.0) + stream.normal(size=8) * scatter
    target = 0.6 + slope * (truth - 30.0) + stream.normal() * math.hypot(scatter, noise)
    result = calibrate(angles, seen, target, noise)
    return abs(result.estimate - truth) <= result.half_width


@pytest.mark.parametrize(
    ("slope", "scatter", "noise", "truth"),
    [(-0.02, 0.002, 0.0, 30.0), (-0.008, 0.003, 0.0, 30.5), (-0.002, 0.003, 0.0, 30.0), (-0.008, 0.002, 0.01, 30.0)],
)
def test_the_truth_is_covered_95_times_in_100(slope: float, scatter: float, noise: float, truth: float) -> None:
    stream = np.random.default_rng(1)
    covered = [draw(stream, slope=slope, scatter=scatter, noise=noise, truth=truth) for _ in range(2000)]
    # 0.95 within three standard errors of 2,000 draws; never far too wide where the slope is known.
    assert np.mean(covered) > 0.935
    if abs(slope) > 3.0 * scatter and noise == 0.0:
        assert np.mean(covered) < 0.965


def test_a_bend_does_not_mislead() -> None:
    """The front of the tall column at 33 degrees: -11 mm a degree, 2.7 mm off the chord in the middle."""
    stream = np.random.default_rng(2)
    angles = np.array([33.0] * 4 + [31.0] * 2 + [35.0] * 2) - 33.0

    def front(angle: np.ndarray) -> np.ndarray:
        return 0.64 - 0.011 * angle + 0.00135 * angle**2

    errors, covered = [], []
    for _ in range(2000):
        seen = front(angles) + 0.0032 * stream.normal(size=8)
        truth = stream.uniform(-0.5, 0.5)
        result = calibrate(angles, seen, float(front(np.array(truth))) + 0.0032 * stream.normal(), 0.0)
        errors.append(result.estimate - truth)
        covered.append(abs(errors[-1]) <= result.half_width)
    assert abs(np.mean(errors)) < 0.04
    assert 0.935 < np.mean(covered) < 0.975


def test_a_line_without_scatter_is_inverted_exactly() -> None:
    angles = np.array([20.0, 21.0, 23.0])
    result = calibrate(angles, 1.0 - 0.01 * angles, 0.785, 0.0)
    assert result.estimate == pytest.approx(21.5)
    assert result.half_width == pytest.approx(0.0, abs=1e-6)
    assert result.slope == pytest.approx(-0.01)


def test_an_observation_that_does_not_know_the_angle_says_so() -> None:
    stream = np.random.default_rng(0)
    angles = np.repeat([28.0, 30.0, 32.0], 3)
    assert calibrate(angles, stream.normal(size=9), 0.0, 0.0).half_width == math.inf
    assert calibrate(angles, np.ones(9), 1.0, 0.0).half_width == math.inf


def test_measurement_noise_widens() -> None:
    stream = np.random.default_rng(0)
    angles = np.repeat([28.0, 30.0, 32.0], 3)
    seen = 1.0 - 0.01 * angles + 0.001 * stream.normal(size=9)
    quiet, noisy = (calibrate(angles, seen, 0.7, noise).half_width for noise in (0.0, 0.01))
    assert noisy > 5.0 * quiet
