"""Components of runs that made their directions, beside those of runs that did not."""

import numpy as np

from inverse.posterior.emulator import linear
from inverse.posterior.reduction import cross_fitted, directions

UNKNOWNS, NUMBERS, RUNS = 10, 4000, 27
SLOPE, SCATTER = 20.0, 5.0


def residuals(*, crossed: bool) -> tuple[float, float]:
    """Of a linear fit to the components of few runs: their own, and those of further runs, root mean square."""
    rng = np.random.default_rng(0)
    slopes = SLOPE * rng.standard_normal((UNKNOWNS, NUMBERS))
    points, further = rng.random((RUNS, UNKNOWNS)), rng.random((200, UNKNOWNS))
    points[:3] = 0.5
    runs, others = (each @ slopes + SCATTER * rng.standard_normal((len(each), NUMBERS)) for each in (points, further))
    mean = runs.mean(axis=0)
    runs, others = runs - mean, others - mean
    found = np.linalg.lstsq(points - points.mean(axis=0), runs, rcond=None)[0]
    first = directions(found, UNKNOWNS, 0.0)
    components = cross_fitted(runs, points, first) if crossed else runs @ first
    fit = np.linalg.lstsq(linear(points), components, rcond=None)[0]
    own = ((components - linear(points) @ fit) ** 2).sum() / (RUNS - UNKNOWNS - 1) / UNKNOWNS
    return float(np.sqrt(own)), float(np.sqrt(((others @ first - linear(further) @ fit) ** 2).mean()))


def test_components_by_the_directions_of_other_runs_lie_no_closer_to_a_line_than_further_runs() -> None:
    own, others = residuals(crossed=True)
    # A prediction by eleven coefficients from 27 runs: its own error besides the scatter.
    assert others < 1.7 * own
    own, others = residuals(crossed=False)
    assert others > 3.0 * own


def test_too_few_other_runs_leave_the_directions_as_they_are() -> None:
    rng = np.random.default_rng(2)
    points, runs = rng.random((4, 3)), rng.standard_normal((4, 9))
    first = directions(rng.standard_normal((3, 9)), 3, 0.0)
    np.testing.assert_array_equal(cross_fitted(runs, points, first), runs @ first)
