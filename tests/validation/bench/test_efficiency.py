"""`python -m validation.bench efficiency`: cuts of one column, gradients, a page whose words are numbers."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from inverse.parameters import Vector
from validation.bench.efficiency import Gradient, Method, by_runs, draw_gradients, page
from validation.report import plots


class Linear:
    """y = A u, of two numbers."""

    matrix = np.array([[1.0, 0.0], [0.0, 2.0], [1.0, 1.0]])

    def observe(self, numbers: list[Vector]) -> list[Vector]:
        return [self.matrix @ each for each in numbers]


def test_differences_of_some_columns_are_those_of_the_whole_gradient() -> None:
    start = np.array([0.5, -1.0])
    target = np.array([0.1, -0.2, 0.3])
    forward = Linear()
    found = by_runs(forward, target, 1, 0.1 * np.eye(2))(start)
    residual = forward.observe([start])[0] - target
    np.testing.assert_allclose(found.slope, 2.0 * residual @ Linear.matrix / 3.0, rtol=1e-9)
    second = by_runs(forward, target, 1, 0.1 * np.eye(2)[1:])(start)
    np.testing.assert_allclose(second.slope, found.slope[1:])


def test_the_words_of_the_page_are_those_of_its_numbers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    values: dict[str, Any] = {"problem": "blocks", "cosine": 0.95, "length": 1.1, "scatter": 0.1}
    gradients = [
        Gradient(method=method, unknowns=number, seconds=seconds * number**power, columns=min(number, 10), **values)
        for number in (1, 100)
        for method, seconds, power in zip(Method, (0.5, 2.0, 0.9), (0, 0, 1), strict=True)
    ]
    text = str(page(gradients, quick=False))
    assert "surrogate 0.5 s / 0.5 s; adjoint of the MPM 2 s / 2 s; differences of the MPM 0.9 s / 90 s." in text
    assert "in 100: surrogate 0.95; adjoint of the MPM 0.95." in text
    assert "≈ 90.00" in text
    assert "measured once" in text
    monkeypatch.setattr(plots, "DPI", 30)
    draw_gradients(tmp_path / "gradients.png", gradients)
    assert len(list(tmp_path.glob("*.png"))) == 1
