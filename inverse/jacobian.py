"""Gradient of the misfit and Jacobian of the observation: by automatic differentiation, or by differences.

| symbol | variable | meaning |
|---|---|---|
| y, y* | `observation`, `target` | predicted and observed numbers, shape [M] |
| c | `components` | numbers that make up one point (`inverse.observations.observation.Observation`) |
| J | `jacobian` | dy/du, shape [M, U] |

    misfit = c/M |y - y*|^2,    d(misfit)/du = 2 c/M (y - y*) J
"""

import dataclasses
import time
from collections.abc import Callable, Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from inverse.forward.interface import Differentiable, Evaluation, Forward
from inverse.observations import Values
from inverse.parameters import Vector

Evaluate = Callable[[Vector], Evaluation]
"""Misfit and gradient at a vector of parameters."""


def automatic(forward: Differentiable, target: Values, *, components: int = 1, with_jacobian: bool = False) -> Evaluate:
    """Misfit and gradient of `forward` against `target` [M] by one backward pass, however many parameters.

    with_jacobian: a backward pass for each of the M numbers instead, which Gauss-Newton requires.
    """

    def evaluate(values: Vector) -> Evaluation:
        start = time.perf_counter()
        point = torch.tensor(values, dtype=torch.float64, requires_grad=True)
        prediction = forward.predict(point)
        observation: Values = prediction.detach().numpy()
        middle = time.perf_counter()
        weights = 2.0 * components / len(target) * (observation - target)
        jacobian = _rows(prediction, point) if with_jacobian else None
        if jacobian is None:
            gradient = torch.autograd.grad(prediction, point, torch.from_numpy(weights))[0].numpy()
        else:
            gradient = weights @ jacobian
        return Evaluation(
            parameters=values.copy(),
            observation=observation,
            residual=observation - target,
            components=components,
            gradient=gradient,
            jacobian=jacobian,
            forward_s=middle - start,
            backward_s=time.perf_counter() - middle,
        )

    return evaluate


def central(forward: Forward, target: Values, steps: Vector, *, components: int = 1) -> Evaluate:
    """Misfit, gradient and Jacobian of `forward` against `target` [M] by central differences of `steps` [U].

    Differences of y, not of its square: they lose fewer digits.
    """

    def evaluate(values: Vector) -> Evaluation:
        (found,) = observed(forward, target, [values], components=components)
        start = time.perf_counter()
        jacobian = by_differences(forward, values, steps)
        return dataclasses.replace(
            found,
            gradient=2.0 * components * found.residual @ jacobian / len(target),
            jacobian=jacobian,
            backward_s=time.perf_counter() - start,
        )

    return evaluate


def observed(forward: Forward, target: Values, points: Sequence[Vector], *, components: int = 1) -> list[Evaluation]:
    """Misfit of `forward` from `target` [M] at each point [U], without a gradient."""
    start = time.perf_counter()
    observations = forward.observe(points)
    seconds = (time.perf_counter() - start) / len(points)
    return [
        Evaluation(
            parameters=point.copy(),
            observation=observation,
            residual=observation - target,
            components=components,
            forward_s=seconds,
        )
        for point, observation in zip(points, observations, strict=True)
    ]


def by_differences(forward: Forward, values: Vector, steps: Vector) -> NDArray[np.float64]:
    """d(observation)/d(parameters) by central differences of `steps`, shape [M, U]; all predictions in one call."""
    moves = np.diag(steps)
    numbers = forward.observe([values + move for move in moves] + [values - move for move in moves])
    ahead, behind = numbers[: len(steps)], numbers[len(steps) :]
    return np.stack([(a - b) / (2.0 * h) for a, b, h in zip(ahead, behind, steps, strict=True)], axis=1)


def _rows(prediction: Tensor, point: Tensor) -> NDArray[np.float64]:
    """d(prediction)/d(point), shape [M, U], row by row by M backward passes."""
    last = len(prediction) - 1
    rows = [torch.autograd.grad(each, point, retain_graph=row < last)[0].numpy() for row, each in enumerate(prediction)]
    return np.stack(rows)
