"""`python -m validation.bench efficiency`: cuts of one column, gradients, searches, a page whose words are numbers."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from inverse.parameters import Vector
from inverse.problem import read_problem
from validation.bench.efficiency import Compared, Gradient, Method, draw_gradients, draw_searches, page
from validation.bench.searches import PAPER, By, Evaluation, Searched, by_runs, descend, explore
from validation.report import plots


class Linear:
    """y = A u, of two numbers."""

    matrix = np.array([[1.0, 0.0], [0.0, 2.0], [1.0, 1.0]])

    def observe(self, numbers: list[Vector]) -> list[Vector]:
        return [self.matrix @ each for each in numbers]


def evaluation(at: Vector) -> Evaluation:
    """(u - 35)^2 of one number, with its slope."""
    off = at - 35.0
    return Evaluation(parameters=at, loss=float(np.mean(off**2)), slope=2.0 * off, seconds=0.1)


def test_differences_of_some_columns_are_those_of_the_whole_gradient() -> None:
    start = np.array([0.5, -1.0])
    target = np.array([0.1, -0.2, 0.3])
    forward = Linear()
    found = by_runs(forward, target, 1, 0.1 * np.eye(2))(start)
    residual = forward.observe([start])[0] - target
    np.testing.assert_allclose(found.slope, 2.0 * residual @ Linear.matrix / 3.0, rtol=1e-9)
    np.testing.assert_allclose(found.jacobian, Linear.matrix, rtol=1e-9)
    second = by_runs(forward, target, 1, 0.1 * np.eye(2)[1:])(start)
    np.testing.assert_allclose(second.slope, found.slope[1:])


def test_the_paper_s_descent_is_a_step_of_its_rate_within_the_bounds() -> None:
    problem = read_problem("friction-tall-42")

    def descended(**changes: float) -> list[float]:
        slow = replace(PAPER[problem.name], **{"rate": 0.1, "stop_below": 0.0} | changes)
        with pytest.MonkeyPatch.context() as patch:
            patch.setitem(PAPER, problem.name, slow)
            return [float(each.parameters[0]) for each in descend(evaluation, problem, 3)]

    assert descended() == pytest.approx([30.0, 31.0, 31.8])
    assert descended(rate=1e3)[1] == problem.box.upper[0]
    assert len(descended(stop_below=1e3)) == 1


def test_optuna_begins_at_the_start_and_finds_the_minimum() -> None:
    pytest.importorskip("optuna")
    problem = read_problem("friction-tall-42")
    found = explore(evaluation, problem, 40)
    assert len(found) == 40
    assert found[0].parameters == problem.initial
    assert min(each.loss for each in found) < 1.0


def searched(by: By, loss: float, losses: tuple[float, ...]) -> Searched:
    seconds = tuple(float(number) for number in range(1, len(losses) + 1))
    return Searched(by=by, seconds=seconds, losses=losses, mpm_runs=4, error=0.1, loss=loss)


def test_when_the_scatter_was_met() -> None:
    assert searched(By.ADJOINT, 1e-5, (1.0, 1e-3, 1e-6)).seconds_to(1e-3) == 2.0
    assert math.isinf(searched(By.ADJOINT, 1e-5, (1.0,)).seconds_to(1e-3))
    # What a surrogate finds counts by what the MPM shows there.
    assert math.isinf(searched(By.SURROGATE, 1e-2, (1.0, 1e-9)).seconds_to(1e-3))
    assert searched(By.SURROGATE, 1e-4, (1.0, 1e-9)).seconds_to(1e-3) == 2.0


def test_the_words_of_the_page_are_those_of_its_numbers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    values: dict[str, Any] = {"problem": "blocks", "cosine": 0.95, "length": 1.1, "scatter": 0.1}
    gradients = [
        Gradient(method=method, unknowns=number, seconds=seconds * number**power, columns=min(number, 10), **values)
        for number in (1, 100)
        for method, seconds, power in zip(Method, (0.5, 2.0, 0.9), (0, 0, 1), strict=True)
    ]
    both = (searched(By.ADJOINT, 2e-5, (1.0, 2e-5)), searched(By.SURROGATE, 1e-2, (1.0, 1e-9)))
    compared = [Compared(problem="it", limit=15.0, floor=2e-5, searches=both)]
    text = str(page(gradients, compared, quick=False))
    assert "surrogate 0.5 s / 0.5 s; adjoint of the MPM 2 s / 2 s; differences of the MPM 0.9 s / 90 s." in text
    assert "in 100: surrogate 0.95; adjoint of the MPM 0.95." in text
    assert "`it` to the MPM's own scatter: MPM by its adjoint, L-BFGS-B 2 s; not within 15 s: surrogate" in text
    assert "≈ 90.00" in text
    monkeypatch.setattr(plots, "DPI", 30)
    draw_gradients(tmp_path / "gradients.png", gradients)
    draw_searches(tmp_path / "searches.png", compared)
    assert len(list(tmp_path.glob("*.png"))) == 2
