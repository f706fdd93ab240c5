"""The surrogate, corrected by what the MPM showed: output space mapping with Broyden's update.

    y(u) = y_k + S (s(u) - s(u_k)) + E (u - u_k),    S = 1 + A B

| symbol | variable | meaning |
|---|---|---|
| s | `surrogate` | the surrogate's observation [m], shape [m] |
| u_k, y_k | `anchor`, `shown` | the best MPM run so far: its unknowns and its observation |
| S | `response` | what a change of the surrogate's observation means for the MPM's [-], shape [m, m] of low rank |
| E | `extra` | what it has of the unknowns that no S can give the surrogate [m per unit], shape [m, U] |

With S = 1 this is plain output space mapping (Bandler, Cheng, Dakroury, Mohamed, Bakr, Madsen & Sondergaard, Space
mapping: the state of the art, IEEE Trans. Microwave Theory Tech. 52 (2004) 337-361): it agrees with the MPM at u_k and
has the surrogate's slope. That slope may be wrong by a factor of three, enough to diverge. So S is updated by Broyden's
rule (A class of methods for solving nonlinear simultaneous equations, Math. Comp. 19 (1965) 577-593) until y passes
through other MPM runs as well. It multiplies, as in manifold mapping (Echeverria & Hemker, Comput. Methods Appl. Math.
5 (2005) 107-136), because a surrogate that answers too strongly does so everywhere. Fewer numbers than unknowns cannot
say by S that the surrogate has the wrong unknown for the cause: E, Broyden's update of the slope itself, does there.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from inverse.forward.interface import Surrogate
from inverse.observations.deposit import Values
from inverse.parameters.parameters import Vector

Matrix = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Response:
    """S: a deposit is thousands of numbers, so it is kept as what it does besides leaving things as they are."""

    left: Matrix
    """A, shape [m, n]."""
    right: Matrix
    """B, shape [n, m]."""
    along: Matrix | None = None
    """Where there, what is left of a change before all else: its part in the space of these columns, shape [m, r]."""

    def __call__(self, change: Matrix) -> Matrix:
        """S times `change`, shape [m] or [m, any]."""
        if self.along is not None:
            change = self.along @ (self.along.T @ change)
        return np.asarray(change + self.left @ (self.right @ change))

    def of_tensor(self, change: Tensor) -> Tensor:
        """The same, through which autograd can look; shape [m]."""
        if self.along is not None:
            along = torch.from_numpy(self.along)
            change = along @ (along.T @ change)
        return change + torch.from_numpy(self.left) @ (torch.from_numpy(self.right) @ change)


class Corrected:
    """A differentiable forward that agrees with the MPM where the MPM has been."""

    def __init__(self, surrogate: Surrogate, anchor: Vector, shown: Values) -> None:
        """shown: the MPM's exact observation [M] at `anchor`; what of it the surrogate can be held against counts."""
        self.surrogate, self.anchor, self.shown = surrogate, anchor, surrogate.wanted(shown)
        size = len(self.shown)
        self.response = Response(left=np.zeros((size, 0)), right=np.zeros((0, size)))
        self.extra = np.zeros((size, len(anchor)))
        (self.base,) = surrogate.observe([anchor])

    def predict(self, unknowns: Tensor) -> Tensor:
        """The corrected observation, float64 of shape [m], of unknowns of shape [U]."""
        change = self.surrogate.predict(unknowns) - torch.from_numpy(self.base)
        moved = torch.from_numpy(self.extra) @ (unknowns - torch.from_numpy(self.anchor))
        return torch.from_numpy(self.shown) + self.response.of_tensor(change) + moved

    def observe(self, unknowns: Sequence[Vector]) -> list[Values]:
        """The corrected observation [m] of each vector of unknowns [U]."""
        return [
            self.shown + self.response(value - self.base) + self.extra @ (each - self.anchor)
            for each, value in zip(unknowns, self.surrogate.observe(unknowns), strict=True)
        ]

    def learn(self, unknowns: Sequence[Vector], shown: Sequence[Values], scatter: float, widths: Vector) -> None:
        """Broyden's update for several runs at once: y passes through the MPM's `shown` [M] at `unknowns` [U] as well.

        Where the surrogate says that runs should hardly differ, what they differ by is mostly the MPM's own `scatter`
        [m], and the update fades. For a single unknown, one run says all there is to say to first order: whatever else
        the surrogate does (a profile of another shape) is left out. widths: of the box of the unknowns, shape [U].
        """
        if not unknowns:
            return
        # Columns are runs: what the surrogate says changes [m, n], and what the MPM says.
        said = np.stack([value - self.base for value in self.surrogate.observe(unknowns)], axis=1)
        seen = np.stack([self.surrogate.wanted(value) - self.shown for value in shown], axis=1)
        noise = 0.5 * len(said) * scatter**2
        gram = said.T @ said + noise * np.eye(len(unknowns))
        along = None
        if len(self.anchor) == 1:
            along = np.linalg.svd(said, full_matrices=False)[0][:, :1]
        self.response = Response(
            left=seen - said, right=np.asarray(np.linalg.solve(gram, said.T), np.float64), along=along
        )
        if len(said) < len(self.anchor):
            moves = np.stack([(each - self.anchor) / widths for each in unknowns], axis=1)
            rest = seen - self.response(said)
            # A move of a hundredth of the range tells nothing of a slope.
            weight = moves.T @ moves + 1e-4 * np.eye(len(unknowns))
            self.extra = rest @ np.linalg.solve(weight, moves.T) / widths
