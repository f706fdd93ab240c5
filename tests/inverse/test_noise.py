"""The predictive interval: as wide as noise, scatter and cells say, over seeds; what is beyond it is named."""

import math
from dataclasses import replace

import numpy as np
import pytest

from inverse.noise import Scatter, fit
from inverse.observations.errors import Covariance
from tests.inverse.flows import target_of


def scatter_of(rng: np.random.Generator, size: int, width: float, *, expected: float = 0.1) -> Scatter:
    """Of runs at three points, four at each."""
    points = np.repeat(np.arange(3.0), 4)[:, None]
    numbers = 10.0 * points + width * rng.normal(size=(12, size))
    return Scatter.of_runs(points, numbers, np.full(size, expected))


def test_a_number_that_no_run_moves_scatters_as_expected() -> None:
    """By as much less than the others as was expected of it, not by rounding."""
    deviations = np.random.default_rng(0).normal(size=(12, 20))
    deviations[:, 0] = 0.0
    covariance = Scatter(deviations=deviations, freedom=11, expected=np.ones(20)).covariance
    assert covariance[0, 0] == pytest.approx(2.0 / 13.0, rel=0.2)
    assert np.diag(covariance)[1:].mean() == pytest.approx(1.0, rel=0.2)
    assert np.linalg.eigvalsh(covariance).min() > 0.0


@pytest.mark.parametrize(("size", "noise", "width"), [(1, 0.0, 1.0), (1, 2.0, 0.2), (20, 0.0, 1.0), (20, 1.0, 1.0)])
def test_right_answers_lie_within_it_as_often_as_it_says(size: int, noise: float, width: float) -> None:
    """Of 400 at 99 % and at 95 %: 7 of the first are outside in fewer than one of fifty such tests."""
    rng, outside, wider = np.random.default_rng(1), 0, 0
    for _ in range(400):
        target = target_of(noise * rng.normal(size=size) + width * rng.normal(size=size), noise)
        fitted = fit(target, width * rng.normal(size=(4, size)), scatter_of(rng, size, width))
        outside, wider = outside + (not fitted.inside), wider + (fitted.probability < 0.05)
    assert outside <= 14
    assert wider <= 45


def test_the_noise_of_a_number_is_that_number_s() -> None:
    """A front 3 % off where 3 % are stated is no reason to refuse; without the noise it is."""
    rng = np.random.default_rng(2)
    scatter = scatter_of(rng, 1, 0.002, expected=0.0025)
    shown = np.full((4, 1), 0.515) + 0.002 * rng.normal(size=(4, 1))
    stated = fit(target_of(np.array([0.5]), 0.015), shown, scatter)
    assert stated.inside
    assert stated.noise == pytest.approx(0.015)
    assert 0.03 < stated.allowed < 0.06
    assert not fit(target_of(np.array([0.5]), 0.0), shown, scatter).inside
    assert fit(target_of(np.array([0.5]), 0.0), shown, scatter, cells=np.array([0.015])).inside


def test_errors_that_are_one_error_count_as_one_number() -> None:
    """Twenty numbers that are all off by the same: dependent errors, one degree of freedom."""
    size = 20
    scatter = scatter_of(np.random.default_rng(3), size, 0.001, expected=0.001)
    apart = target_of(np.full(size, 0.4), 0.2)
    together = replace(apart, errors=Covariance.of(0.04 * np.ones((size, size)) + 1e-6 * np.eye(size)))
    alone, shared = (fit(target, np.zeros((4, size)), scatter) for target in (apart, together))
    assert (alone.inside, shared.inside) == (False, True)
    assert shared.freedom[0] == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize("dependent", [False, True])
def test_the_degrees_of_freedom_are_those_of_the_whole_covariance(dependent: bool) -> None:
    """h = M^2 / |R|_F^2 of noise as large as the scatter, R written out."""
    rng, size, count = np.random.default_rng(5), 12, 4
    apart = np.arange(size)[:, None] - np.arange(size)
    matrix = np.exp(-0.5 * (apart / 3.0) ** 2) if dependent else np.eye(size)
    errors, scatter = Covariance.of(matrix), scatter_of(rng, size, 1.0, expected=1.0)
    share = 1.0 + 1.0 / count
    flows = scatter.deviations.T @ scatter.deviations * share / scatter.freedom
    variance = share * scatter.variance
    whole = matrix + flows + np.diag(np.maximum(variance - np.diag(flows), 0.0))
    scale = np.sqrt(1.0 + variance)
    target = target_of(np.zeros(size), errors if dependent else 1.0)
    fitted = fit(target, rng.normal(size=(count, size)), scatter)
    assert fitted.freedom[0] == pytest.approx(size**2 / np.sum((whole / np.outer(scale, scale)) ** 2), rel=1e-9)


def test_half_widths_grow_where_more_numbers_than_parameters_do_not_fit() -> None:
    rng = np.random.default_rng(4)
    target, scatter = target_of(np.array([-3.0, 0.0, 3.0]), 0.1), scatter_of(rng, 3, 0.05)
    shown = np.zeros((4, 3))
    assert fit(target, shown, scatter, parameters=1).factor > 10.0
    assert fit(target, shown, scatter, parameters=3).factor == 1.0


def test_the_error_of_the_cells_is_one_smooth_bias_and_hides_no_outlier() -> None:
    """Cells that change every number by seven times the noise: a bias of their shape fits, single numbers do not."""
    rng, size = np.random.default_rng(5), 10
    cells, scatter = np.full(size, 0.035), scatter_of(rng, size, 0.001, expected=0.001)
    slopes = 0.1 * np.linspace(1.0, 2.0, size)[None]
    outliers = np.zeros(size)
    outliers[[3, 7]] = 0.05, -0.06
    for off, inside, named in ((cells, True, []), (cells + outliers, False, [3, 7])):
        shown = np.zeros((4, size)) + off
        fitted = fit(target_of(np.zeros(size), 0.005), shown, scatter, cells=cells, parameters=1, slopes=slopes)
        assert (fitted.inside, list(fitted.outliers)) == (inside, named)


def test_what_is_too_small_is_all_or_noise_and_scatter_alone() -> None:
    """Beside an error of the cells: an outlier speaks for the noise, a misfit as smooth as that error for all."""
    rng, size = np.random.default_rng(6), 8
    scatter, cells, outlier = scatter_of(rng, size, 0.0005, expected=0.0005), np.full(size, 0.005), np.zeros(size)
    outlier[4] = 0.03
    fitted = fit(target_of(np.zeros(size), 0.005), outlier[None], scatter, cells=cells, parameters=1)
    # By hand, without the scatter: one residual off the mean, which the bias takes.
    around = outlier - outlier.mean()
    expected = math.sqrt(float(around @ around) / 0.005**2 / (size - 1))
    assert fitted.alone == pytest.approx(expected, rel=0.06)
    assert fitted.factor == fitted.alone
    smooth = fit(target_of(np.zeros(size), 0.005), 12.0 * cells[None], scatter, cells=cells, parameters=1)
    assert smooth.alone is None
    assert smooth.factor == pytest.approx(smooth.ratio * math.sqrt(size / (size - 1)))
    assert smooth.factor > 3.0
