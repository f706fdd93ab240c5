"""The gradient of the loss by reverse-mode automatic differentiation: one backward pass, however many unknowns."""

import time
from collections.abc import Callable

import torch

from inverse.forward import Differentiable, Evaluation
from inverse.observations import Values
from inverse.unknowns import Vector

Evaluate = Callable[[Vector], Evaluation]


def automatic(forward: Differentiable, target: Values) -> Evaluate:
    """Loss and gradient of `forward` against `target` [m], shape [M]; memory is the forward's affair."""
    wanted = torch.from_numpy(target)

    def evaluate(unknowns: Vector) -> Evaluation:
        point = torch.tensor(unknowns, dtype=torch.float64, requires_grad=True)
        start = time.perf_counter()
        observation = forward.predict(point)
        loss = torch.mean((observation - wanted) ** 2)
        middle = time.perf_counter()
        (gradient,) = torch.autograd.grad(loss, point)
        end = time.perf_counter()
        return Evaluation(
            unknowns=unknowns.copy(),
            observation=observation.detach().numpy(),
            loss=loss.item(),
            gradient=gradient.numpy(),
            forward_s=middle - start,
            backward_s=end - middle,
        )

    return evaluate
