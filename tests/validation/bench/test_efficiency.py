"""`python -m validation.bench efficiency`: cuts of one column, gradients, a page whose words are numbers."""

import numpy as np

from inverse.parameters import Vector
from validation.bench.efficiency import by_runs


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
