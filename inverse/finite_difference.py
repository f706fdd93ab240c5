"""The gradient of the loss by central differences: for any forward, two more predictions per unknown."""

import time

import numpy as np
from numpy.typing import NDArray

from inverse.forward.interface import Evaluation, Forward
from inverse.gradient import Evaluate
from inverse.observations.deposit import Values, loss
from inverse.parameters.parameters import Vector
from inverse.problem import Problem


def central(
    forward: Forward,
    target: Values,
    problem: Problem,
    *,
    components: int = 1,
    with_jacobian: bool = False,
    steps: Vector | None = None,
) -> Evaluate:
    """Loss and gradient of `forward` against `target`, shape [M]; each unknown moves by its own step.

    components: of the observation, see `inverse.observations.deposit.loss`. with_jacobian: keep it, for a Gauss-Newton search.
    steps: other steps than the problem's, shape [U].
    """
    moves = problem.steps if steps is None else steps

    def evaluate(unknowns: Vector) -> Evaluation:
        start = time.perf_counter()
        (observation,) = forward.observe([unknowns])
        middle = time.perf_counter()
        # d/du mean (y - y*)^2 = 2 mean (y - y*) dy/du: differences of y, not of its square, lose fewer digits.
        slopes = jacobian(forward, unknowns, moves)
        residual = observation - target
        gradient = 2.0 * components * residual @ slopes / len(target)
        end = time.perf_counter()
        return Evaluation(
            unknowns=unknowns.copy(),
            observation=observation,
            loss=loss(observation, target, components),
            gradient=gradient,
            forward_s=middle - start,
            backward_s=end - middle,
            residual=residual if with_jacobian else None,
            jacobian=slopes if with_jacobian else None,
        )

    return evaluate


def jacobian(forward: Forward, unknowns: Vector, steps: Vector) -> NDArray[np.float64]:
    """d(observation)/d(unknowns) by central differences of `steps`, shape [M, U]; all predictions in one call."""
    moves = np.diag(steps)
    values = forward.observe([unknowns + move for move in moves] + [unknowns - move for move in moves])
    ahead, behind = values[: len(steps)], values[len(steps) :]
    return np.stack([(a - b) / (2.0 * h) for a, b, h in zip(ahead, behind, steps, strict=True)], axis=1)


def one_sided(forward: Forward, unknowns: Vector, base: Values, steps: Vector) -> NDArray[np.float64]:
    """d(observation)/d(unknowns) by differences from `base` [M], the observation at `unknowns`, shape [M, U].

    Half the predictions of `jacobian`; steps: with their signs, so that none leaves the bounds.
    """
    values = forward.observe([unknowns + move for move in np.diag(steps)])
    return np.stack([(value - base) / step for value, step in zip(values, steps, strict=True)], axis=1)
