"""The most probable white numbers, by Gauss-Newton steps, and the Gaussian posterior about them.

Symbols are those of `inverse.fields.inversion`.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import scipy.linalg

from datasets.scene.grid_field import Floats

SHORTEST = 0.25  # shortest step of the line search, over the full step
DECREASE = 0.1  # smallest decrease of J, over that of the linear problem, for a step to be accepted
CONVERGED = 0.5  # decrease of J at which the search has converged: that of one standard deviation along one direction
SMALL = 0.2  # variance of a combination over draws from the prior, over that of its errors, below which it is left out


@dataclass(frozen=True)
class Gaussian:
    """The posterior of W white numbers."""

    mean: Floats  # the most probable white numbers, shape [W]
    jacobian: Floats  # G of the relevant combinations of the numbers, shape [r, W]
    promised: float  # decrease of J by another step if the numbers were linear
    combinations: Floats  # these combinations of the numbers, shape [r, M]
    cut: bool = False  # whether the largest number of iterations ended the search

    @cached_property
    def decomposition(self) -> tuple[Floats, Floats]:
        """s^2, shape [r], the largest first, and V, shape [W, r]."""
        _, singular, directions = np.linalg.svd(self.jacobian, full_matrices=False)
        return singular**2, directions.T

    @property
    def informative(self) -> int:
        """Number of directions in which the observation is more informative than the prior."""
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
        self,
        flow: Any,
        target: Floats,
        covariance: Floats,
        seeds: Sequence[int],
        *,
        lead: tuple[Any, Sequence[int]] | None = None,
        draws: Floats | None = None,
        combinations: Floats | None = None,
    ) -> None:
        """flow: `inverse.fields.flow.WhiteFlow`, or any object with `mean` and `jacobian`; target: y [M]; covariance: R
        [M, M]; seeds: n of F; lead: another flow that gives derivatives, and its jitter seeds; default: `flow`.
        Derivatives are of `combinations` [r, M] of the numbers if given. Else, with `draws`, numbers [n, M] at draws
        from the prior, they are of the combinations in which these differ; else of every number."""
        self.flow, self.target, self.seeds, self.lead = flow, target, seeds, lead or (flow, seeds)
        self.root = scipy.linalg.cholesky(covariance, lower=True)
        if combinations is not None:
            basis = np.linalg.qr((combinations @ self.root).T)[0]
        elif draws is None:
            basis = np.eye(len(target))
        else:
            basis, singular, _ = np.linalg.svd(self.whitened((draws - draws.mean(axis=0)).T), full_matrices=False)
            matter = int((singular**2 / (len(draws) - 1) > SMALL).sum())
            basis = basis[:, : max(1, matter)]
        self.combinations = np.asarray(scipy.linalg.solve_triangular(self.root, basis, lower=True, trans="T").T)
        """U^T L^-1 with orthonormal U: uncorrelated combinations of the numbers with errors of 1, shape [r, M]."""
        self.iterates: list[dict[str, float]] = []
        self.missed: list[tuple[float, float]] = []  # |e|^2 and |dw|^2 of each tried step, with e = L^-1 dF - G dw

    def whitened(self, numbers: Floats) -> Floats:
        """Numbers [M, ...] in units in which their errors are independent with variance 1."""
        return np.asarray(scipy.linalg.solve_triangular(self.root, numbers, lower=True))

    def iterate(self, white: Floats, numbers: Floats, step: float) -> dict[str, float]:
        residual = self.whitened(numbers - self.target)
        squares = float(residual @ residual)
        objective, misfit = 0.5 * (squares + float(white @ white)), math.sqrt(squares / len(residual))
        return {"objective": objective, "misfit": misfit, "step": step}

    def minimise(
        self,
        start: Floats,
        iterations: int,
        enough: float = CONVERGED,
        *,
        numbers: Floats | None = None,
        runs: float = math.inf,
    ) -> Gaussian:
        """Search from `start` [W] for the most probable white numbers.
        enough: decrease of J that a step must promise; numbers: F at the start [M] if known; runs: most evaluations."""
        white, (lead, seeds) = start, self.lead
        numbers = self.flow.mean(white, self.seeds) if numbers is None else numbers
        self.iterates.append(self.iterate(white, numbers, 0.0))
        decrease, first = math.inf, len(self.iterates)
        while True:
            jacobian = lead.jacobian(white, self.combinations, seeds)
            residual = self.combinations @ (numbers - self.target)
            proposed = linear_mean(jacobian, white, residual)
            promised = gain(jacobian, residual, white, proposed - white)
            posterior, step = Gaussian(white, jacobian, promised, self.combinations), 1.0
            if min(promised, decrease) < enough:
                return posterior
            if len(self.iterates) - first >= iterations:
                return replace(posterior, cut=True)
            while True:
                if len(self.missed) >= runs:
                    return posterior
                moved = step * (proposed - white)
                shown = self.flow.mean(white + moved, self.seeds)
                iterate = self.iterate(white + moved, shown, step)
                missed = self.combinations @ (shown - numbers) - jacobian @ moved
                self.missed.append((float(missed @ missed), float(moved @ moved)))
                decrease = self.iterates[-1]["objective"] - iterate["objective"]
                if decrease > DECREASE * gain(jacobian, residual, white, moved):
                    break
                if step <= SHORTEST:
                    return posterior
                step *= 0.5
            white, numbers = white + moved, shown
            self.iterates.append(iterate)

    def doubt(self, scatter: Floats) -> float:
        """Mean of |e|^2 / |dw|^2 over the steps, minus the part due to the `scatter` [M, M] of both runs."""
        noise = 2.0 * float(((self.combinations @ scatter) * self.combinations).sum())
        return float(np.mean([max(0.0, missed - noise) / moved for missed, moved in self.missed] or 0.0))


def doubted(posterior: Gaussian, wrong: float, directions: Floats) -> Gaussian:
    """A posterior that allows for errors E of its derivatives, with E|E dw|^2 = `wrong` |dw|^2 from its steps. If the
    truth is w_t, E (w_t - w) is an additional error of the combination U_k^T, whose own error is 1. E is assumed
    random, with a size along U_k proportional to s_k^(1/2), and to act along the `directions` D [V, W] in which the
    prior varies:

        s_k^2 <- s_k^2 / (1 + wrong tr(D cov(w) D^T) s_k / sum s)

    A direction with uncertain derivatives is therefore never known exactly, however small the noise. The exponent is
    the measured one of the difference between derivatives on two cell sizes in the problem `gully`."""
    left, values, rest = np.linalg.svd(posterior.jacobian, full_matrices=False)
    spread = len(directions) - float(((directions @ posterior.removed) ** 2).sum())
    share = values / max(float(values.sum()), np.finfo(np.float64).tiny)
    return replace(posterior, jacobian=left * (values / np.sqrt(1.0 + wrong * spread * share)) @ rest)


def linear_mean(jacobian: Floats, white: Floats, residual: Floats) -> Floats:
    """The most probable w [W] if the numbers are linear about `white`, at which their residual is `residual` [r].

    w = G^T (I + G G^T)^-1 (G w0 - residual) = (I + G^T G)^-1 G^T (G w0 - residual): whichever has fewer equations."""
    off = jacobian @ white - residual
    if len(residual) <= len(white):
        return np.asarray(jacobian.T @ np.linalg.solve(np.eye(len(residual)) + jacobian @ jacobian.T, off))
    return np.asarray(np.linalg.solve(np.eye(len(white)) + jacobian.T @ jacobian, jacobian.T @ off))


def gain(jacobian: Floats, residual: Floats, white: Floats, step: Floats) -> float:
    """Decrease of J along `step` [W] if the numbers are linear."""
    after, moved = residual + jacobian @ step, white + step
    return float(0.5 * (residual @ residual + white @ white - after @ after - moved @ moved))
