"""The posterior of responses that are known: exact where they are linear; reduction, information; what jumps.

Samples of densities that are known exactly, and their separate parts.
"""

import numpy as np
import pytest

from inverse.posterior import Matrix
from inverse.posterior.answers import parts, quantiles
from inverse.posterior.emulator import linear
from inverse.posterior.information import information
from inverse.posterior.posterior import Posterior, Regime, Region, next_points, posterior, regime_of, repeated_scatter
from inverse.posterior.reduction import cross_fitted, directions, reduction
from inverse.posterior.sampling import sample
from tests.inverse.flows import target_of

SLOPES = np.array([[3.0, 0.2, 0.0, -1.0], [0.0, 1.5, 0.4, 1.0]])
SCATTER = 0.02


def inferred(*, truth: tuple[float, float] = (0.4, 0.7), seed: int = 0, **changes: object) -> Posterior:
    """Of four numbers that depend linearly on two parameters, each with a scatter of its own."""
    rng = np.random.default_rng(seed)
    region = changes.get("region")
    points = np.concatenate([rng.random((54, 2)), np.full((6, 2), 0.5)])
    if isinstance(region, Region):
        points = region.low + (region.high - region.low) * points
    numbers = points @ SLOPES + SCATTER * rng.standard_normal((60, 4))
    target = target_of(np.array(truth) @ SLOPES + SCATTER * rng.standard_normal(4))
    return posterior(points, numbers, target, scatter=np.full(4, SCATTER), rng=rng, **changes)


def exact_deviations() -> Matrix:
    return np.sqrt(np.diag(np.linalg.inv(SLOPES @ SLOPES.T / SCATTER**2)))


def test_a_linear_response_has_the_exact_posterior() -> None:
    """Least squares by one observation: (J^T J)^-1 s^2."""
    inferences = [inferred(truth=(0.4, 0.7), seed=seed) for seed in range(6)]
    deviations = np.array([np.sqrt(np.diag(inference.samples.covariance)) for inference in inferences])
    np.testing.assert_allclose(np.median(deviations, axis=0), exact_deviations(), rtol=0.25)
    off = np.array([inference.samples.mean - (0.4, 0.7) for inference in inferences]) / deviations
    assert 0.4 < np.sqrt(np.mean(off**2)) < 1.6
    assert all(inference.emulator_share < 0.15 for inference in inferences)


def test_errors_that_are_counted_larger_widen_it_in_proportion() -> None:
    plain, wide = inferred(), inferred(factor=4.0)
    ratio = np.sqrt(np.diag(wide.samples.covariance) / np.diag(plain.samples.covariance))
    np.testing.assert_allclose(ratio, 4.0, rtol=0.25)
    shift = inferred(discretisation=0.2 * SLOPES[0])
    # Of two components: half of its square along the change, a quarter in either.
    along, across = np.sqrt(np.diag(shift.samples.covariance))
    assert along == pytest.approx(0.2 * 0.75**0.5, rel=0.25)
    assert across > 2.0 * np.sqrt(plain.samples.covariance[1, 1])
    shown = inferred(discretisation=0.2 * SLOPES[0], extrapolated=0.0)
    along, across = np.sqrt(np.diag(shown.samples.covariance) / (0.2**2, plain.samples.covariance[1, 1]))
    assert (along, across) == pytest.approx((1.0, 1.0), rel=0.25)


def test_a_posterior_wider_than_its_region_leaves_it() -> None:
    """The region of an earlier wave, too narrow: the bounds of the prior alone cut a posterior off."""
    mean, deviation = np.array([0.4, 0.7]), exact_deviations()
    narrow = Region(low=mean - 1.5 * deviation, high=mean + 1.5 * deviation)
    inference = inferred(region=narrow)
    assert np.all(np.sqrt(np.diag(inference.samples.covariance)) > 0.8 * deviation)
    assert np.all(inference.region.low < narrow.low)
    assert np.all(inference.region.high > narrow.high)
    # Samples of many parameters lie beyond their runs.
    for unknowns, edge in ((6, 0.6), (7, 0.62)):
        region = Region(low=np.full(unknowns, 0.4), high=np.full(unknowns, 0.6))
        np.testing.assert_allclose(region.sampled.high, edge)
        assert not Region.whole(unknowns).sampled.inside(np.full((1, unknowns), 1.01))[0]


def test_a_weak_parameter_has_a_direction_of_its_own() -> None:
    """One moves 400 numbers by less than the others curve them: principal components alone would lose it."""
    rng = np.random.default_rng(0)
    points, waves = rng.random((50, 6)), rng.normal(size=(6, 400))
    waves[5] *= 0.1
    numbers = points @ waves + (points[:, :5] ** 2) @ rng.normal(size=(5, 400))
    reduced = reduction(numbers, points, target_of(numbers[0]), scatter=np.full(400, 1e-4))
    assert np.linalg.norm(reduced.basis.T @ waves[5]) > 0.6 * np.linalg.norm(waves[5])
    shifted = numbers - numbers.mean(axis=0)
    principal = np.linalg.svd(shifted)[2][: reduced.basis.shape[1]]
    assert np.linalg.norm(principal @ waves[5]) < 0.5 * np.linalg.norm(waves[5])
    np.testing.assert_allclose(reduced.basis.T @ reduced.basis, np.eye(reduced.basis.shape[1]), atol=1e-10)
    np.testing.assert_allclose(reduced(reduced.numbers(reduced(numbers))), reduced(numbers))


@pytest.mark.parametrize("seed", range(6))
def test_a_parameter_that_moves_nothing_keeps_its_prior(seed: int) -> None:
    """Its slope is curvature and scatter; scaled to a slope of 1 in some seeds it halved the variance."""
    rng, times = np.random.default_rng(seed), np.linspace(0.1, 1.0, 8)
    points = np.concatenate([rng.random((11, 2)), np.full((2, 2), 0.5)])

    def shown(place: Matrix) -> Matrix:
        return np.minimum(times * (0.5 + 1.7 * place), 0.13 * (0.5 + 1.7 * place) ** 2)

    numbers = shown(points[:, :1]) + 3e-4 * rng.standard_normal((13, 8))
    target = target_of(shown(np.array([0.6])), 5e-3)
    samples = posterior(points, numbers, target, scatter=np.full(8, 5e-3), rng=rng).samples
    assert 0.85 < np.sqrt(12.0 * samples.covariance[1, 1]) < 1.1


def test_repeated_runs_show_the_scatter_alone() -> None:
    rng = np.random.default_rng(0)
    locations = np.repeat(rng.random((30, 2)), 4, axis=0)
    components = 100.0 * locations + np.array([0.5, 2.0]) * rng.standard_normal((120, 2))
    deviation, freedom = repeated_scatter(locations, components, np.ones(2))
    np.testing.assert_allclose(deviation, [0.5, 2.0], rtol=0.15)
    assert freedom == 90
    alone = np.unique(locations, axis=0)
    np.testing.assert_array_equal(repeated_scatter(alone, alone, np.full(2, 0.3))[0], 0.3)
    # No flow is known better than to rounding.
    np.testing.assert_allclose(repeated_scatter(locations, 100.0 * locations, np.ones(2))[0], 0.02)


def test_runs_go_where_the_emulator_knows_least() -> None:
    """No run lies between 0.45 and 0.75 of the first parameter, which the target does not constrain."""
    rng = np.random.default_rng(0)
    points = rng.random((40, 2))
    points[:, 0] = np.where(points[:, 0] < 0.7, points[:, 0] * 0.45 / 0.7, 0.75 + (points[:, 0] - 0.7) * 0.25 / 0.3)
    numbers = np.sin(4.0 * points[:, 1:]) + 0.3 * np.sin(9.0 * points[:, :1]) * 0.02
    inference = posterior(points, numbers, target_of(np.array([0.9])), scatter=np.array([0.02]), rng=rng)
    chosen = next_points(inference, 3, np.random.default_rng(1))
    assert len(np.unique(chosen, axis=0)) == 3
    _, at_runs = inference.emulator.predict(points)
    _, at_chosen = inference.emulator.predict(chosen)
    assert np.median(at_chosen) > np.median(at_runs)


def test_information_is_that_of_a_gaussian() -> None:
    rng = np.random.default_rng(0)
    points = rng.random((80, 1))
    samples = sample(lambda where: np.zeros(len(where)), rng, low=np.zeros(1), high=np.ones(1))
    shown = {"clear": points[:, 0] + 0.05 * rng.standard_normal(80), "blind": rng.standard_normal(80)}
    gains = information(points, shown, samples, cell=1e-6, rng=rng)
    assert list(gains) == ["clear", "blind"]
    assert gains["clear"] == pytest.approx(0.5 * np.log1p(1.0 / 12.0 / 0.05**2), rel=0.15)
    assert gains["blind"] < 0.15


UNKNOWNS, NUMBERS, RUNS = 10, 4000, 27


def residuals(*, crossed: bool) -> tuple[float, float]:
    """Of a linear fit to the components of few runs: their own, and those of further runs, root mean square."""
    rng = np.random.default_rng(0)
    slopes = 20.0 * rng.standard_normal((UNKNOWNS, NUMBERS))
    points, further = rng.random((RUNS, UNKNOWNS)), rng.random((200, UNKNOWNS))
    points[:3] = 0.5
    runs, others = (batch @ slopes + 5.0 * rng.standard_normal((len(batch), NUMBERS)) for batch in (points, further))
    mean = runs.mean(axis=0)
    runs, others = runs - mean, others - mean
    coefficients = np.linalg.lstsq(points - points.mean(axis=0), runs, rcond=None)[0]
    first = directions(coefficients, UNKNOWNS, 0.0)
    components = cross_fitted(runs, points, first) if crossed else runs @ first
    fit = np.linalg.lstsq(linear(points), components, rcond=None)[0]
    variance = ((components - linear(points) @ fit) ** 2).sum() / (RUNS - UNKNOWNS - 1) / UNKNOWNS
    return float(np.sqrt(variance)), float(np.sqrt(((others @ first - linear(further) @ fit) ** 2).mean()))


def test_components_by_the_directions_of_other_runs_lie_no_closer_to_a_line_than_further_runs() -> None:
    fitted, others = residuals(crossed=True)
    # A prediction by eleven coefficients from 27 runs: its own error besides the scatter.
    assert others < 1.7 * fitted
    fitted, others = residuals(crossed=False)
    assert others > 3.0 * fitted


ROUGHNESS = 0.05
EDGE = 0.6


def jumping(points: Matrix) -> Matrix:
    """Nearly steady below the edge, where a column stands; far above it, where it has fallen, and rough there."""
    fallen = 40.0 + 30.0 * np.sin(9.0 * points[:, 1]) + 60.0 * points[:, 0]
    return np.where(points[:, 0] < EDGE, points[:, 1], fallen)[:, None] * np.array([[1.0, 0.7]])


@pytest.mark.parametrize("seed", range(4))
def test_a_column_that_stands_may_have_all_parameters_at_which_it_does(seed: int) -> None:
    rng = np.random.default_rng(seed)
    points = rng.random((40, 2))
    numbers = jumping(points) + ROUGHNESS * rng.standard_normal((40, 2))
    values = jumping(np.array([[0.3, 0.4]]))[0] + ROUGHNESS * rng.standard_normal(2)
    inference = posterior(points, numbers, target_of(values), scatter=np.full(2, ROUGHNESS), rng=rng)
    regime = inference.likelihood.regime
    assert np.all(regime.inside[:, 0] < EDGE)
    assert np.all(regime.outside[:, 0] > EDGE)
    samples = inference.samples
    # The second parameter by two numbers of slopes 1 and 0.7; of the first that it is below the edge.
    assert samples.mean[1] == pytest.approx(0.4, abs=0.12)
    assert np.sqrt(samples.covariance[1, 1]) == pytest.approx(ROUGHNESS / np.hypot(1.0, 0.7), rel=0.5)
    assert np.sqrt(samples.covariance[0, 0]) == pytest.approx(EDGE / np.sqrt(12.0), rel=0.3)
    assert np.mean(samples.points[:, 0] < EDGE + 0.1) > 0.95


def test_the_nearest_runs_decide_and_a_steady_response_is_one_regime() -> None:
    regime = Regime(inside=np.array([[0.2, 0.5], [0.1, 0.4]]), outside=np.array([[0.8, 0.5]]))
    inside, between, outside = np.exp(regime(np.array([[0.21, 0.5], [0.5, 0.5], [0.79, 0.5]])))
    assert inside > 0.999
    assert 0.4 < between < 0.7
    assert outside < 0.001
    points = np.linspace(0.0, 1.0, 20)[:, None]
    near = np.ones(20, bool)
    assert regime_of(50.0 * points, points, near, np.array([25.3])) is None
    # A target between two regimes is of neither.
    values = np.where(points < 0.5, points, 50.0 + points)
    assert regime_of(values, points, near, np.array([25.0])) is None
    assert np.array_equal(regime_of(values, points, near, np.array([0.2])), points[:, 0] < 0.5)


def whole(unknowns: int) -> dict[str, Matrix]:
    """The bounds of the unit box."""
    return {"low": np.zeros(unknowns), "high": np.ones(unknowns)}


def gaussian(points: Matrix, centre: Matrix, deviation: float) -> Matrix:
    return np.asarray(-0.5 * np.sum((points - centre) ** 2, axis=1) / deviation**2)


@pytest.mark.parametrize("unknowns", [1, 2, 10])
def test_a_gaussian_has_its_moments_and_its_evidence(unknowns: int) -> None:
    centre, deviation = np.linspace(0.4, 0.6, unknowns), 0.02
    samples = sample(lambda points: gaussian(points, centre, deviation), np.random.default_rng(0), **whole(unknowns))
    np.testing.assert_allclose(samples.mean, centre, atol=0.15 * deviation)
    np.testing.assert_allclose(np.sqrt(np.diag(samples.covariance)), deviation, rtol=0.12)
    assert samples.evidence == pytest.approx(unknowns * np.log(deviation * np.sqrt(2.0 * np.pi)), abs=0.15 * unknowns)
    assert samples.difference < 0.25
    assert samples.acceptance > 0.05
    (part,) = parts(samples, lambda points: gaussian(points, centre, deviation), np.random.default_rng(1))
    np.testing.assert_allclose(part.half_widths, 1.96 * deviation, rtol=0.15)
    assert part.weight == pytest.approx(1.0)


def test_two_maxima_keep_their_shares() -> None:
    """One three times as heavy as the other, forty standard deviations apart."""
    one, other = np.array([0.2, 0.3]), np.array([0.8, 0.7])

    def density(points: Matrix) -> Matrix:
        return np.logaddexp(np.log(3.0) + gaussian(points, one, 0.015), gaussian(points, other, 0.015))

    samples = sample(density, np.random.default_rng(0), **whole(2))
    heavy, light = parts(samples, density, np.random.default_rng(1))
    np.testing.assert_allclose(heavy.point, one, atol=0.003)
    np.testing.assert_allclose(light.point, other, atol=0.003)
    assert heavy.weight == pytest.approx(0.75, abs=0.08)


def test_a_curved_ridge_is_one_part_and_a_ring_has_no_answer_in_its_middle() -> None:
    def ring(points: Matrix) -> Matrix:
        return np.asarray(-0.5 * ((np.linalg.norm(points - 0.5, axis=1) - 0.3) / 0.02) ** 2)

    samples = sample(ring, np.random.default_rng(0), **whole(2))
    (part,) = parts(samples, ring, np.random.default_rng(1))
    assert np.linalg.norm(part.point - 0.5) == pytest.approx(0.3, abs=0.05)
    assert min(part.half_widths) > 0.3


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
        samples = sample(ridge, np.random.default_rng(seed), **whole(2))
        shown.append(quantiles(samples.points, samples.weights))
    np.testing.assert_allclose(np.mean(shown, axis=0), exact, atol=0.01)
