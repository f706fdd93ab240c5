"""The most probable parameters, fields among them, and what the observation tells of each: Laplace's approximation.

    2 J(w) = |L^-1 (F(w) - y)|^2 + |w|^2,    R = N + (1 + 1/n) C = L L^T
    G = L^-1 dF/dw = U S V^T,    covariance of w = I - V diag(s^2 / (1 + s^2)) V^T

| symbol | variable | meaning |
|---|---|---|
| w | `white` | independent normal numbers of the prior, of which fields and numbers are functions (`inverse.white`) |
| F | `numbers` | what runs of the MPM show, mean over n jitter seeds |
| N, C | `noise` | covariance of the measurement; of flows that differ in their jitter seed alone |

Gauss-Newton steps solve the problem that is linear about w. Far from the minimum the slopes along the path differ from
those over a whole step, so a step is halved until J has fallen, as measured by runs; a run costs less than half of a
reverse pass. Derivatives are taken of those combinations of the numbers alone that the prior moves by more than their
errors. The posterior is a low-rank update of the prior by the eigenpairs of the Hessian of the misfit, preconditioned
by the prior (Bui-Thanh, Ghattas, Martin & Stadler, A computational framework for infinite-dimensional Bayesian inverse
problems, SIAM J. Sci. Comput. 35 (2013) A2494-A2523): along V_k the observation tells s_k^2 times as much as the
prior.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from inverse.white import WhiteFlow

Floats = NDArray[np.float64]

SHORTEST = 0.25
"""Of the steps of the line search, over a whole one."""
DECREASE = 0.1
"""Of J, over that of the linear problem, with which a step is accepted."""
CONVERGED = 0.5
"""Decrease of J below which there is nothing left to gain: that of one standard deviation along one direction."""
SMALL = 0.2
"""Variance of a combination over draws of the prior, over that of its errors, below which it is left out."""


@dataclass(frozen=True)
class Gaussian:
    """The posterior of W white numbers."""

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
    def informative(self) -> int:
        """How many directions the observation tells more of than the prior."""
        return int((self.decomposition[0] > 1.0).sum())

    @property
    def removed(self) -> Floats:
        """V (s^2 / (1 + s^2))^(1/2), shape [W, r]: squares of its rows, or of their images, are removed variance."""
        values, directions = self.decomposition
        return np.asarray(directions * np.sqrt(values / (1.0 + values)))

    def draws(self, count: int) -> Floats:
        """Samples, shape [count, W]: mean + (I + V diag((1 + s^2)^(-1/2) - 1) V^T) times white noise."""
        values, directions = self.decomposition
        white = np.random.default_rng(0).standard_normal((count, len(self.mean)))
        return np.asarray(self.mean + white + (white @ directions * (1.0 / np.sqrt(1.0 + values) - 1.0)) @ directions.T)


class Objective:
    """J, its Gauss-Newton steps, and every iterate on the way."""

    def __init__(
        self, flow: WhiteFlow, target: Floats, covariance: Floats, draws: Floats, seeds: Sequence[int]
    ) -> None:
        """target: y [M]; covariance: R [M, M]; draws: numbers [n, M] of draws of the prior; seeds: n of F."""
        self.flow, self.target, self.seeds = flow, target, seeds
        self.root = scipy.linalg.cholesky(covariance, lower=True)
        self.rows = combinations(self.whitened((draws - draws.mean(axis=0)).T))
        self.iterates: list[dict[str, float]] = []

    def whitened(self, numbers: Floats) -> Floats:
        """Numbers [M, ...] in units in which their errors are independent and 1."""
        return np.asarray(scipy.linalg.solve_triangular(self.root, numbers, lower=True))

    def evaluated(self, white: Floats, step: float) -> tuple[Floats, dict[str, float]]:
        """F [M] and the iterate at white numbers [W]; step: part of the Gauss-Newton step, 0 at the start."""
        numbers = self.flow.mean(white, self.seeds)
        residual = self.whitened(numbers - self.target)
        squares = float(residual @ residual)
        objective, misfit = 0.5 * (squares + float(white @ white)), math.sqrt(squares / len(residual))
        return numbers, {"objective": objective, "misfit": misfit, "step": step}

    def minimise(self, start: Floats, iterations: int, enough: float = CONVERGED) -> "Minimum":
        """From `start` [W] to the most probable white numbers; enough: decrease of J that a step must promise."""
        white, (numbers, iterate) = start, self.evaluated(start, 0.0)
        self.iterates.append(iterate)
        outer, decrease, first = self.whitened(np.eye(len(self.target))), math.inf, len(self.iterates)
        while True:
            jacobian = self.flow.jacobian(white, self.rows @ outer, self.seeds)
            residual = self.rows @ self.whitened(numbers - self.target)
            proposed = linear_mean(jacobian, white, residual)
            promised = gain(jacobian, residual, white, proposed - white)
            here = Minimum(posterior=Gaussian(white, jacobian), promised=promised)
            if min(promised, decrease) < enough or len(self.iterates) - first >= iterations:
                return here
            step = 1.0
            while True:
                tried = white + step * (proposed - white)
                found, iterate = self.evaluated(tried, step)
                decrease = self.iterates[-1]["objective"] - iterate["objective"]
                if decrease > DECREASE * gain(jacobian, residual, white, tried - white):
                    break
                if step <= SHORTEST:
                    return here
                step *= 0.5
            white, numbers = tried, found
            self.iterates.append(iterate)


@dataclass(frozen=True, kw_only=True)
class Minimum:
    """Where the search ended."""

    posterior: Gaussian
    promised: float
    """Decrease of J that another step would bring where the numbers are linear."""


def combinations(whitened: Floats) -> Floats:
    """Orthonormal combinations [r, M] in which whitened numbers of draws [M, n] vary by more than `SMALL`."""
    basis, singular, _ = np.linalg.svd(whitened, full_matrices=False)
    variance = singular**2 / (whitened.shape[1] - 1)
    return np.asarray(basis[:, : max(1, int((variance > SMALL).sum()))].T)


def linear_mean(jacobian: Floats, white: Floats, residual: Floats) -> Floats:
    """The most probable w [W] of numbers that are linear about `white`, where they are off by `residual` [r].

    w = G^T (I + G G^T)^-1 (G w0 - residual): r equations in place of W.
    """
    inner = np.eye(len(residual)) + jacobian @ jacobian.T
    return np.asarray(jacobian.T @ np.linalg.solve(inner, jacobian @ white - residual))


def gain(jacobian: Floats, residual: Floats, white: Floats, step: Floats) -> float:
    """By how much J falls along `step` [W] where the numbers are linear."""
    after, moved = residual + jacobian @ step, white + step
    return float(0.5 * (residual @ residual + white @ white - after @ after - moved @ moved))
