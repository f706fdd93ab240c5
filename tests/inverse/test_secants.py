"""Gauss-Newton by secants on forwards that are formulas."""

from collections.abc import Sequence

import numpy as np
import pytest
from numpy.typing import NDArray

from inverse.forward.interface import Evaluation
from inverse.jacobian import observed
from inverse.optimise import minimise
from inverse.problem import Bounds
from inverse.secants import MORE, fitted, lowest, sample
from inverse.settings import Method, OptimiserSettings

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
