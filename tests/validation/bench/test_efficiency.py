"""`python -m validation.bench efficiency`: cuts of one column, gradients, a page whose words are numbers."""

from dataclasses import replace

import numpy as np

from datasets.scene.particles import initial_particles
from inverse.parameters import Vector
from validation.bench.efficiency import blocks, by_runs


class Linear:
    """y = A u, of two numbers."""

    matrix = np.array([[1.0, 0.0], [0.0, 2.0], [1.0, 1.0]])

    def observe(self, numbers: list[Vector]) -> list[Vector]:
        return [self.matrix @ each for each in numbers]


def test_differences_of_some_columns_are_those_of_the_whole_gradient() -> None:
    start = np.array([0.5, -1.0])
    target = np.array([0.1, -0.2, 0.3])
    forward = Linear()
    _, slope = by_runs(forward, target, 1, start, 0.1 * np.eye(2))
    residual = forward.observe([start])[0] - target
    np.testing.assert_allclose(slope, 2.0 * residual @ Linear.matrix / 3.0, rtol=1e-9)
    _, second = by_runs(forward, target, 1, start, 0.1 * np.eye(2)[1:])
    np.testing.assert_allclose(second, slope[1:])


def test_cuts_leave_the_particles_as_they_are() -> None:
    one, many = (blocks(*cut) for cut in ((1, 1), (10, 10)))
    assert (len(one.names), len(many.names)) == (1, 100)
    whole, parts = (initial_particles(replace(each.scene, jitter=0.0)).positions for each in (one, many))
    np.testing.assert_allclose(np.sort(parts, axis=0), np.sort(whole, axis=0), atol=1e-6)
