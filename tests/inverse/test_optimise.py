"""Gradients and optimisers on a forward that is a formula."""

import dataclasses
from collections.abc import Sequence

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from torch import Tensor

from inverse.forward.interface import Evaluation
from inverse.jacobian import automatic, central, observed
from inverse.optimise import minimise
from inverse.problem import Bounds, Problem, read_problem
from inverse.secants import MORE, fitted, lowest, sample
from inverse.settings import Method, OptimiserSettings

BOUNDS = Bounds(np.array([12.0]), np.array([52.0]))
SCALE = torch.tensor([1.0, 0.7, 0.3], dtype=torch.float64)


class Formula:
    """Three lengths [m] that fall with the angle [deg]."""

    def __init__(self) -> None:
        self.predictions = 0

    def predict(self, parameters: Tensor) -> Tensor:
        self.predictions += 1
        return SCALE * (1.2 - 0.02 * parameters[0] + 0.00015 * parameters[0] ** 2)

    def observe(self, parameters: Sequence[NDArray[np.float64]]) -> list[NDArray[np.float64]]:
        return [self.predict(torch.from_numpy(values)).numpy() for values in parameters]


@pytest.fixture
def problem() -> Problem:
    return read_problem("friction-tall-42")


def at(angle: float) -> NDArray[np.float64]:
    return Formula().observe([np.array([angle])])[0]


@pytest.mark.parametrize("angle", [15.0, 50.0])
def test_both_gradients_agree(problem: Problem, angle: float) -> None:
    target, point = at(24.0), np.array([angle])
    exact = automatic(Formula(), target)(point)
    differences = central(Formula(), target, problem.steps)(point)
    assert exact.loss == pytest.approx(np.mean((at(angle) - target) ** 2), rel=1e-12)
    assert differences.loss == pytest.approx(exact.loss, rel=1e-12)
    # Exact for a quadratic but for rounding.
    np.testing.assert_allclose(differences.gradient, exact.gradient, rtol=1e-9)
    np.testing.assert_allclose(exact.observation, at(angle))


@pytest.mark.parametrize("truth", [12.5, 42.0])
@pytest.mark.parametrize("start", [12.0, 30.0])
def test_lbfgsb_finds_the_truth_in_few_gradients(truth: float, start: float) -> None:
    settings = OptimiserSettings(stop_below=1.0e-10)
    records = minimise(automatic(Formula(), at(truth)), np.array([start]), BOUNDS, settings)
    assert lowest(records).parameters[0] == pytest.approx(truth, abs=0.02)
    assert len(records) <= 10
    assert all(12.0 <= record.parameters[0] <= 52.0 for record in records)


def test_lbfgsb_leaves_a_ridge_for_the_middle_of_the_box() -> None:
    """y = (u - 30)^2, all but at its minimum where the target is far above: neither way is downhill."""

    class Ridge(Formula):
        def predict(self, parameters: Tensor) -> Tensor:
            return 1e-3 * (parameters - 30.0) ** 2

    evaluate = automatic(Ridge(), np.array([0.1]))
    settings = OptimiserSettings(stop_below=1e-10)
    records = minimise(evaluate, np.array([30.001]), BOUNDS, settings)
    assert records[1].parameters[0] == BOUNDS.middle[0]
    assert lowest(records).parameters[0] == pytest.approx(40.0, abs=0.05)
    # Downhill it stays where it is.
    assert minimise(evaluate, np.array([30.5]), BOUNDS, settings)[1].parameters[0] != BOUNDS.middle[0]


@pytest.mark.parametrize("method", [each for each in Method if each is not Method.SECANTS])
def test_an_optimum_beyond_the_bounds_ends_on_the_bound(method: Method) -> None:
    settings = OptimiserSettings(method=method, stop_below=1.0e-10, max_iterations=40)
    records = minimise(automatic(Formula(), at(8.0), with_jacobian=True), np.array([30.0]), BOUNDS, settings)
    assert lowest(records).parameters[0] == pytest.approx(12.0, abs=0.02)


def test_a_forward_gone_to_nan_ends_the_search_and_is_not_its_answer() -> None:
    evaluate = automatic(Formula(), at(42.0))

    def breaks(point: NDArray[np.float64]):  # type: ignore[no-untyped-def]
        record = evaluate(point)
        return dataclasses.replace(record, residual=np.nan * record.residual) if point[0] > 33.0 else record

    records = minimise(breaks, np.array([30.0]), BOUNDS, OptimiserSettings())
    assert lowest(records).parameters[0] == 30.0


@pytest.mark.parametrize("truth", [12.5, 51.0])
@pytest.mark.parametrize("differences", [False, True])
def test_gauss_newton_finds_the_truth_in_few_jacobians(problem: Problem, truth: float, differences: bool) -> None:
    settings = OptimiserSettings(method=Method.GAUSS_NEWTON, stop_below=1.0e-10)
    evaluate = automatic(Formula(), at(truth), with_jacobian=True)
    if differences:
        evaluate = central(Formula(), at(truth), problem.steps)
    records = minimise(evaluate, np.array([30.0]), BOUNDS, settings)
    assert lowest(records).parameters[0] == pytest.approx(truth, abs=0.02)
    assert len(records) <= 10


Floats = NDArray[np.float64]
SETTINGS = OptimiserSettings(method=Method.SECANTS, max_iterations=40, stop_below=1e-12)


class Curved:
    """Many numbers that are a matrix times the parameters, and some of their square."""

    def __init__(self, parameters: int, numbers: int = 60, curvature: float = 0.2) -> None:
        self.matrix = np.random.default_rng(0).normal(size=(numbers, parameters))
        self.curvature, self.runs = curvature, 0

    def observe(self, parameters: Sequence[Floats]) -> list[Floats]:
        self.runs += len(parameters)
        return [self.matrix @ (values + self.curvature * values**2) for values in parameters]


def box(parameters: int) -> Bounds:
    return Bounds(np.full(parameters, -1.0), np.full(parameters, 3.0))


@pytest.mark.parametrize("parameters", [1, 2, 10])
def test_the_truth_is_found_in_few_runs(parameters: int) -> None:
    forward, bounds = Curved(parameters), box(parameters)
    truth = np.linspace(1.5, 0.15, parameters)
    (target,) = forward.observe([truth])
    spread = sample(forward, target, np.zeros(parameters), bounds)
    assert len(spread) == parameters + MORE + 1

    def evaluate(at: Floats) -> Evaluation:
        return observed(forward, target, [at])[0]

    found = minimise(evaluate, np.zeros(parameters), bounds, SETTINGS, sample=spread)
    np.testing.assert_allclose(lowest([*spread, *found]).parameters, truth, atol=0.01)
    assert forward.runs == 1 + len(spread) + len(found) < 40


def test_the_sample_suffices_for_a_linear_forward() -> None:
    forward, bounds = Curved(4, curvature=0.0), box(4)
    truth = np.array([1.5, 1.0, 0.5, 0.2])
    (target,) = forward.observe([truth])
    spread = sample(forward, target, np.zeros(4), bounds)
    assert lowest(spread) is spread[-1]
    # The fit is damped.
    np.testing.assert_allclose(spread[-1].parameters, truth, atol=0.1)
    np.testing.assert_allclose(fitted(spread, spread[0], bounds), 4.0 * forward.matrix, atol=0.5)
