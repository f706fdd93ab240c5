"""The estimate and its half-widths: they hold the truth as often as stated, whatever the number of parameters."""

import numpy as np
import pytest
from numpy.typing import NDArray

from inverse.observations import Values
from inverse.parameters import Vector
from validation.loop.correct import Corrected
from validation.loop.estimate import Estimate, estimate

DISTANCE = 0.05


def experiment(
    stream: np.random.Generator,
    slope: NDArray[np.float64],
    *,
    scatter: float,
    noise: float,
    coupled: float,
    seeds: int = 16,
    replicates: int = 2,
) -> tuple[Estimate, Vector]:
    """Runs of a linear flow and a target of its own, and the truth; `coupled` of the scatter is the seed's."""
    numbers, parameters = slope.shape
    waves = scatter_waves(numbers)
    truth = stream.uniform(-DISTANCE, DISTANCE, size=parameters)

    def scattered() -> Values:
        return scatter * (stream.normal(size=len(waves)) @ waves)

    own = [scattered() for _ in range(seeds)]
    mix = np.sqrt(1.0 - coupled**2)

    def beside(seed: int, side: float, index: int) -> Values:
        return side * DISTANCE * slope[:, index] + coupled * own[seed] + mix * scattered()

    slopes = np.stack(
        [
            np.stack(
                [
                    (beside(seed, 1.0, index) - beside(seed, -1.0, index)) / (2.0 * DISTANCE)
                    for index in range(parameters)
                ],
                axis=1,
            )
            for seed in range(replicates)
        ]
    )
    target = slope @ truth + scattered() + noise * stream.normal(size=numbers)
    return estimate(np.stack(own), slopes, target, noise=noise, distance=DISTANCE), truth


def scatter_waves(numbers: int) -> NDArray[np.float64]:
    """Directions in which flows scatter."""
    return np.random.default_rng(8).normal(size=(20, numbers)) / np.sqrt(20.0)


def jacobian_of(numbers: int, parameters: int, weakest: float) -> NDArray[np.float64]:
    """Singular values that fall evenly in their logarithms, from 1 to `weakest`, times the root of the numbers."""
    stream = np.random.default_rng(7)
    left = np.linalg.qr(stream.normal(size=(numbers, parameters)))[0]
    right = np.linalg.qr(stream.normal(size=(parameters, parameters)))[0]
    return np.asarray(np.sqrt(numbers) * (left * np.geomspace(1.0, weakest, parameters)) @ right)


@pytest.mark.parametrize("coupled", [0.0, 0.9])
@pytest.mark.parametrize(
    ("numbers", "parameters", "weakest", "noise", "replicates"),
    [
        (1, 1, 1.0, 0.0, 8),
        (1, 1, 1.0, 0.02, 8),
        (21, 1, 1.0, 0.0, 8),
        (3, 2, 0.3, 0.0, 4),
        (21, 4, 0.1, 0.02, 2),
        (400, 10, 0.05, 0.0, 2),
        (400, 10, 0.2, 0.05, 2),
    ],
)
def test_the_truth_is_covered_95_times_in_100(
    numbers: int, parameters: int, weakest: float, noise: float, replicates: int, coupled: float
) -> None:
    stream = np.random.default_rng(1)
    slope = jacobian_of(numbers, parameters, weakest)
    covered, widths = [], []
    for _ in range(250):
        found, truth = experiment(stream, slope, scatter=0.01, noise=noise, coupled=coupled, replicates=replicates)
        covered.append(np.abs(found.values - truth) <= found.half_widths)
        widths.append(found.half_widths)
    assert 0.93 < np.mean(covered) <= 1.0
    # Less than the range where the weakest combination is well above the scatter.
    if weakest >= 0.2:
        assert np.mean(widths) < 0.5


def test_an_unknown_without_any_effect_is_as_wide_as_before() -> None:
    stream = np.random.default_rng(2)
    slope = jacobian_of(40, 3, 0.5)
    slope[:, 1] = 0.0
    narrow = []
    for _ in range(100):
        found, _ = experiment(stream, slope, scatter=0.01, noise=0.0, coupled=0.0)
        narrow.append(found.half_widths < 0.5)
    assert np.mean(narrow, axis=0)[1] < 0.15
    assert np.mean(narrow, axis=0)[0] > 0.9


def test_two_parameters_of_the_same_effect_are_one_combination() -> None:
    stream = np.random.default_rng(3)
    slope = jacobian_of(40, 3, 0.5)
    slope[:, 2] = slope[:, 1]
    found, _ = experiment(stream, slope, scatter=0.002, noise=0.0, coupled=1.0)
    values, vectors = np.linalg.eigh(found.spread)
    assert values[-1] > 100.0 * values[-2]
    np.testing.assert_allclose(np.abs(vectors[:, -1]), [0.0, np.sqrt(0.5), np.sqrt(0.5)], atol=0.05)
    assert found.half_widths[0] < 0.1 < 0.5 < found.half_widths[1]


def test_without_scatter_the_estimate_is_exact_and_the_box_is_kept() -> None:
    stream = np.random.default_rng(4)
    found, truth = experiment(stream, jacobian_of(12, 3, 0.3), scatter=0.0, noise=0.0, coupled=1.0)
    np.testing.assert_allclose(found.values, truth, atol=1e-9)
    np.testing.assert_allclose(found.half_widths, 0.0, atol=1e-9)
    inside = found.within(np.full(3, -0.01), np.full(3, 0.01))
    assert np.all(np.abs(inside) <= 0.01)


def test_noise_of_the_measurement_widens() -> None:
    slope = jacobian_of(21, 2, 0.3)
    quiet, noisy = (
        experiment(np.random.default_rng(5), slope, scatter=0.005, noise=noise, coupled=0.5)[0].half_widths.mean()
        for noise in (0.0, 0.05)
    )
    assert noisy > 2.0 * quiet


class Straight:
    """A surrogate that is a matrix."""

    def __init__(self, matrix: NDArray[np.float64]) -> None:
        self.matrix = matrix

    def observe(self, parameters: list[Vector]) -> list[Values]:
        return [self.matrix @ each for each in parameters]

    def select(self, target: Values) -> Values:
        return target


@pytest.mark.parametrize(("numbers", "parameters", "runs"), [(30, 4, 3), (30, 1, 2), (3, 2, 2)])
def test_a_response_of_low_rank_is_the_dense_one(numbers: int, parameters: int, runs: int) -> None:
    stream = np.random.default_rng(6)
    surrogate = Straight(stream.normal(size=(numbers, parameters)))
    truth = stream.normal(size=(numbers, parameters))
    anchor = stream.normal(size=parameters)
    points = [stream.normal(size=parameters) for _ in range(runs)]
    model = Corrected(surrogate, anchor, truth @ anchor)  # type: ignore[arg-type]
    model.fit(points, [truth @ each for each in points], 0.1, np.ones(parameters))
    predicted = np.stack([surrogate.matrix @ (each - anchor) for each in points], axis=1)
    measured = np.stack([truth @ (each - anchor) for each in points], axis=1)
    gram = predicted.T @ predicted + 0.5 * numbers * 0.1**2 * np.eye(runs)
    dense = np.eye(numbers) + (measured - predicted) @ np.linalg.inv(gram) @ predicted.T
    if parameters == 1:
        along = np.linalg.svd(predicted, full_matrices=False)[0][:, :1]
        dense = dense @ along @ along.T
    change = stream.normal(size=numbers)
    np.testing.assert_allclose(model.response(change), dense @ change)
    # It agrees with the MPM at the runs, but for what may be scatter.
    (there,) = model.observe([points[0]])
    np.testing.assert_allclose(there, truth @ points[0], atol=0.05 * np.abs(truth @ points[0] - truth @ anchor).max())


def test_a_slope_that_no_response_can_give_is_fitted_to_the_parameters() -> None:
    """One number of three parameters, of which the surrogate depends on the first alone."""
    surrogate = Straight(np.array([[1.0, 0.0, 0.0]]))
    truth = np.array([[1.0, 2.0, 0.0]])
    model = Corrected(surrogate, np.zeros(3), np.zeros(1))  # type: ignore[arg-type]
    point = np.array([0.0, 0.5, 0.0])
    model.fit([point], [truth @ point], 0.001, np.ones(3))
    (there,) = model.observe([np.array([0.1, 0.4, 0.0])])
    assert there[0] == pytest.approx(0.9, rel=0.01)
