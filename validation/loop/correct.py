"""The surrogate, corrected by checks of the MPM: output space mapping with Broyden's update.

    y(u) = y_k + S (s(u) - s(u_k)) + E (u - u_k),    S = 1 + A B

| symbol | variable | meaning |
|---|---|---|
| s | `surrogate` | the surrogate's observation, shape [m] |
| u_k, y_k | `anchor`, `shown` | the best MPM run so far: its parameters and its observation |
| S | `response` | ratio of a change of the MPM's observation to one of the surrogate's [-], [m, m] of low rank |
| E | `extra` | slope of what no S can give the surrogate [unit per unit of the parameter], shape [m, U] |

With S = 1 this is plain output space mapping (Bandler, Cheng, Dakroury, Mohamed, Bakr, Madsen & Sondergaard, Space
mapping: the state of the art, IEEE Trans. Microwave Theory Tech. 52 (2004) 337-361): it agrees with the MPM at u_k and
has the surrogate's slope. That slope may be wrong by a factor of three, enough to diverge. So S is updated by Broyden's
rule (A class of methods for solving nonlinear simultaneous equations, Math. Comp. 19 (1965) 577-593) until y passes
through other MPM runs as well. It multiplies, as in manifold mapping (Echeverria & Hemker, Comput. Methods Appl. Math.
5 (2005) 107-136), because a slope that is too steep is so everywhere. Fewer numbers than parameters leave it open
which parameter a change is due to: there E, Broyden's update of the slope itself, is fitted as well.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from inverse.forward.interface import Surrogate
from inverse.observations import Values
from inverse.parameters import Vector
from validation.loop.check import Check, History, Task

Matrix = NDArray[np.float64]

NEARBY = 1.5
"""Distance from the best check up to which further checks than the number of parameters count, in trust regions."""
MAX_NEARBY = 3
"""How many of them."""


@dataclass(frozen=True, kw_only=True)
class Response:
    """S, by its factors: an observation may be thousands of numbers."""

    left: Matrix
    """A, shape [m, n]."""
    right: Matrix
    """B, shape [n, m]."""
    along: Matrix | None = None
    """Where given, a change is first projected on these columns, shape [m, r]."""

    def __call__(self, change: Matrix) -> Matrix:
        """S times `change`, shape [m] or [m, any]."""
        if self.along is not None:
            change = self.along @ (self.along.T @ change)
        return np.asarray(change + self.left @ (self.right @ change))

    def of_tensor(self, change: Tensor) -> Tensor:
        """The same, differentiable; shape [m]."""
        if self.along is not None:
            along = torch.from_numpy(self.along)
            change = along @ (along.T @ change)
        return change + torch.from_numpy(self.left) @ (torch.from_numpy(self.right) @ change)


class Corrected:
    """A differentiable forward model that agrees with the MPM at the checks."""

    def __init__(self, surrogate: Surrogate, anchor: Vector, shown: Values) -> None:
        """shown: the MPM's exact observation [M] at `anchor`."""
        self.surrogate, self.anchor, self.shown = surrogate, anchor, surrogate.select(shown)
        size = len(self.shown)
        self.response = Response(left=np.zeros((size, 0)), right=np.zeros((0, size)))
        self.extra = np.zeros((size, len(anchor)))
        (self.base,) = surrogate.observe([anchor])

    def predict(self, parameters: Tensor, /) -> Tensor:
        """The corrected observation, float64 of shape [m], of parameters of shape [U]."""
        change = self.surrogate.predict(parameters) - torch.from_numpy(self.base)
        moved = torch.from_numpy(self.extra) @ (parameters - torch.from_numpy(self.anchor))
        return torch.from_numpy(self.shown) + self.response.of_tensor(change) + moved

    def observe(self, parameters: Sequence[Vector], /) -> list[Values]:
        """The corrected observation [m] at each vector of parameters [U]."""
        return [
            self.shown + self.response(value - self.base) + self.extra @ (each - self.anchor)
            for each, value in zip(parameters, self.surrogate.observe(parameters), strict=True)
        ]

    def select(self, target: Values, /) -> Values:
        """The part of an exact observation [M] that its own numbers [m] are compared with."""
        return self.surrogate.select(target)

    def deposit(self, parameters: Vector, /) -> NDArray[np.floating]:
        """Final positions of the surrogate's particles [m], shape [N, D], without the correction."""
        return self.surrogate.deposit(parameters)

    def fit(self, parameters: Sequence[Vector], shown: Sequence[Values], scatter: float, ranges: Vector) -> None:
        """Broyden's update for several runs at once: y passes through the MPM's `shown` [M] at `parameters` [U] too.

        Where the surrogate's change between runs is small, theirs is mostly the MPM's own `scatter`, and the update
        fades. For a single parameter one run fixes the first order: components of the surrogate's change across its
        main direction (a profile of another shape) are left out. ranges: of the parameters, shape [U].
        """
        if not parameters:
            return
        # Columns are runs: changes by the surrogate [m, n], and by the MPM.
        predicted = np.stack([value - self.base for value in self.surrogate.observe(parameters)], axis=1)
        measured = np.stack([self.select(value) - self.shown for value in shown], axis=1)
        noise = 0.5 * len(predicted) * scatter**2
        gram = predicted.T @ predicted + noise * np.eye(len(parameters))
        along = np.linalg.svd(predicted, full_matrices=False)[0][:, :1] if len(self.anchor) == 1 else None
        right = np.asarray(np.linalg.solve(gram, predicted.T), np.float64)
        self.response = Response(left=measured - predicted, right=right, along=along)
        if len(predicted) < len(self.anchor):
            moves = np.stack([(each - self.anchor) / ranges for each in parameters], axis=1)
            rest = measured - self.response(predicted)
            # A move of a hundredth of the range is too short for a slope.
            weight = moves.T @ moves + 1e-4 * np.eye(len(parameters))
            self.extra = rest @ np.linalg.solve(weight, moves.T) / ranges


def corrected(task: Task, history: History) -> Corrected:
    """The surrogate with the jitter of the nearest check, corrected by it and the checks around it."""
    anchor, ranges = history.nearest, task.bounds.range
    model = Corrected(task.source.start(anchor.trajectory), anchor.parameters, anchor.observation)

    def distance(check: Check) -> float:
        return float(np.linalg.norm((check.parameters - anchor.parameters) / ranges))

    others = sorted((check for check in history.checks if distance(check) > 0.0), key=distance)
    # At least as many as parameters, however far they are: a secant is better than the surrogate's slope.
    radius = NEARBY * task.problem.loop.trust
    fitted = [
        check
        for number, check in enumerate(others)
        if number < len(ranges) or (distance(check) <= radius and number < MAX_NEARBY)
    ]
    model.fit([each.parameters for each in fitted], [each.observation for each in fitted], task.prior_scatter, ranges)
    return model
