"""What an observation tells of fields: the Gaussian approximation about the most probable ones.

    G = L^-1 dF/dw,    G = U S V^T,    covariance of w = I - V diag(s^2 / (1 + s^2)) V^T

with F the predicted numbers, R = L L^T their errors and w the white numbers of the prior: a low-rank update of the
prior by the eigenpairs of the Hessian of the misfit, preconditioned by the prior (Bui-Thanh, Ghattas, Martin & Stadler,
A computational framework for infinite-dimensional Bayesian inverse problems, SIAM J. Sci. Comput. 35 (2013)
A2494-A2523). Along the direction V_k the observation tells s_k^2 times as much as the prior. Where that is more than 1
the direction is informative.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Posterior:
    """Of W white numbers, Gaussian."""

    mean: Floats
    """The most probable ones, shape [W]."""
    jacobian: Floats
    """G of as many combinations of the numbers as matter, shape [r, W]."""

    @cached_property
    def decomposition(self) -> tuple[Floats, Floats]:
        """s^2, shape [r], the largest first, and V, shape [W, r]."""
        _, singular, directions = np.linalg.svd(self.jacobian, full_matrices=False)
        return singular**2, directions.T

    @property
    def eigenvalues(self) -> Floats:
        """s^2, shape [r]."""
        return self.decomposition[0]

    @property
    def informative(self) -> int:
        """How many directions the observation tells more of than the prior."""
        return int((self.eigenvalues > 1.0).sum())

    @property
    def removed(self) -> Floats:
        """V (s^2 / (1 + s^2))^(1/2), shape [W, r]: sum of the squares of its rows, or of their images, is the variance

        that the observation removed.
        """
        values, directions = self.decomposition
        return np.asarray(directions * np.sqrt(values / (1.0 + values)))

    def draws(self, count: int, seed: int = 0) -> Floats:
        """Samples, shape [count, W]: mean + (I + V diag((1 + s^2)^(-1/2) - 1) V^T) times white noise."""
        values, directions = self.decomposition
        white = np.random.default_rng(seed).standard_normal((count, len(self.mean)))
        return np.asarray(self.mean + white + (white @ directions * (1.0 / np.sqrt(1.0 + values) - 1.0)) @ directions.T)


def linear_mean(jacobian: Floats, white: Floats, residual: Floats) -> Floats:
    """The most probable w [W] of numbers that are linear about `white`, where they are off by `residual` [r].

    w = G^T (I + G G^T)^-1 (G w0 - residual): r equations in place of W.
    """
    inner = np.eye(len(residual)) + jacobian @ jacobian.T
    return np.asarray(jacobian.T @ np.linalg.solve(inner, jacobian @ white - residual))
