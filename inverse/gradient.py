"""The gradient of the loss by reverse-mode automatic differentiation: one backward pass, however many unknowns."""

import time
from collections.abc import Callable

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from inverse.forward.interface import Differentiable, Evaluation
from inverse.observations.deposit import Values, loss
from inverse.parameters.parameters import Vector

Evaluate = Callable[[Vector], Evaluation]


def automatic(forward: Differentiable, target: Values, *, components: int = 1, with_jacobian: bool = False) -> Evaluate:
    """Loss and gradient of `forward` against `target`, shape [M]; memory is the forward's affair.

    components: of the observation, see `inverse.observations.deposit.loss`. with_jacobian: one backward pass for each of the M
    numbers instead of one for all, which a Gauss-Newton search wants.
    """
    wanted = torch.from_numpy(target)

    def evaluate(unknowns: Vector) -> Evaluation:
        point = torch.tensor(unknowns, dtype=torch.float64, requires_grad=True)
        start = time.perf_counter()
        observation = forward.predict(point)
        residual = observation.detach() - wanted
        middle = time.perf_counter()
        slopes = rows(observation, point) if with_jacobian else None
        # d/du of the loss: the derivative of each number, weighed by twice its miss.
        weights = 2.0 * components / len(target) * residual
        if slopes is None:
            (gradient,) = torch.autograd.grad(observation, point, weights)
            total: Vector = gradient.numpy()
        else:
            total = weights.numpy() @ slopes
        end = time.perf_counter()
        seen: Values = observation.detach().numpy()
        return Evaluation(
            unknowns=unknowns.copy(),
            observation=seen,
            loss=loss(seen, target, components),
            gradient=total,
            forward_s=middle - start,
            backward_s=end - middle,
            residual=residual.numpy() if with_jacobian else None,
            jacobian=slopes,
        )

    return evaluate


def rows(observation: Tensor, point: Tensor) -> NDArray[np.float64]:
    """d(observation)/d(point), shape [M, U], row by row by M backward passes."""
    last = len(observation) - 1
    return np.stack(
        [
            torch.autograd.grad(number, point, retain_graph=place < last)[0].numpy()
            for place, number in enumerate(observation)
        ]
    )


def jacobian(forward: Differentiable, unknowns: Vector) -> NDArray[np.float64]:
    """d(observation)/d(unknowns) by automatic differentiation, shape [M, U]: for few numbers M."""
    point = torch.tensor(unknowns, dtype=torch.float64, requires_grad=True)
    return rows(forward.predict(point), point)
