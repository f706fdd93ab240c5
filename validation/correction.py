"""The surrogate, corrected by what the MPM showed: output space mapping with Broyden's update.

    y(u) = y_k + S (s(u) - s(u_k))

| symbol | variable | meaning |
|---|---|---|
| s | `surrogate` | the surrogate's observation [m] |
| u_k, y_k | `anchor`, `shown` | the best MPM run so far: its unknowns and its observation |
| S | `response` | what a change of the surrogate's observation means for the MPM's [-], shape [M, M] |

With S = 1 this is plain output space mapping (Bandler, Cheng, Dakroury, Mohamed, Bakr, Madsen & Sondergaard, Space
mapping: the state of the art, IEEE Trans. Microwave Theory Tech. 52 (2004) 337-361): it agrees with the MPM at u_k and
has the surrogate's slope. That slope may be wrong by a factor of three, enough to diverge. So S is updated by Broyden's
rule (A class of methods for solving nonlinear simultaneous equations, Math. Comp. 19 (1965) 577-593) until y passes
through other MPM runs as well. It multiplies, as in manifold mapping (Echeverria & Hemker, Comput. Methods Appl. Math.
5 (2005) 107-136), because a surrogate that answers too strongly does so everywhere.
"""

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from inverse.forward import Differentiable
from inverse.observations import Values
from inverse.unknowns import Vector


class Corrected:
    """A differentiable forward that agrees with the MPM where the MPM has been."""

    def __init__(self, surrogate: Differentiable, anchor: Vector, shown: Values) -> None:
        self.surrogate, self.anchor, self.shown = surrogate, anchor, shown
        self.response = np.eye(len(shown))
        (self.base,) = surrogate.observe([anchor])

    def predict(self, unknowns: Tensor) -> Tensor:
        """The corrected observation, float64 of shape [M], of unknowns of shape [U]."""
        change = self.surrogate.predict(unknowns) - torch.from_numpy(self.base)
        return torch.from_numpy(self.shown) + torch.from_numpy(self.response) @ change

    def observe(self, unknowns: Sequence[Vector]) -> list[Values]:
        """The corrected observation [M] of each vector of unknowns [U]."""
        return [self.shown + self.response @ (value - self.base) for value in self.surrogate.observe(unknowns)]

    def learn(self, unknowns: Sequence[Vector], shown: Sequence[Values], scatter: float) -> None:
        """Broyden's update for several runs at once: y passes through the MPM's `shown` [M] at `unknowns` [U] as well.

        Where the surrogate says that runs should hardly differ, what they differ by is mostly the MPM's own `scatter`
        [m], and the update fades. Once there are as many runs as unknowns, they say all there is to say to first
        order: whatever else the surrogate does (a profile of another shape) is left out.
        """
        if not unknowns:
            return
        # Columns are runs: what the surrogate says changes [M, n], and what the MPM says.
        said = np.stack([value - self.base for value in self.surrogate.observe(unknowns)], axis=1)
        seen = np.stack([value - self.shown for value in shown], axis=1)
        gram = said.T @ said + 0.5 * len(said) * scatter**2 * np.eye(len(unknowns))
        self.response = np.eye(len(said)) + (seen - said) @ np.linalg.solve(gram, said.T)
        if len(unknowns) >= len(self.anchor):
            along = np.linalg.svd(said, full_matrices=False)[0][:, : len(self.anchor)]
            self.response = self.response @ along @ along.T
