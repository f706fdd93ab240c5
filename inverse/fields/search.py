"""The most probable fields, by Gauss-Newton steps with a line search.

    2 J(w) = |L^-1 (F(w) - y)|^2 + |w|^2

Steps solve the problem that is linear about w (`inverse.fields.posterior.linear_mean`). Far from the minimum the slopes
along the path differ from those over a whole step, so a step is halved until J has fallen, as measured by runs; a run
costs less than half of a reverse pass. Derivatives are taken of those combinations of the numbers alone that fields of
the prior move by more than their errors.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from inverse.fields.flow import Flow
from inverse.fields.noise import Noise
from inverse.fields.posterior import linear_mean

Floats = NDArray[np.float64]

SHORTEST = 0.25
"""Of the steps of the line search, over a whole one."""
DECREASE = 0.1
"""Of J, over that of the linear problem, with which a step is accepted."""
CONVERGED = 0.5
"""Decrease of J below which there is nothing left to gain: that of one standard deviation along one direction."""
SMALL = 0.2
"""Variance of a combination over draws of the prior, over that of its errors, below which it is left out."""


@dataclass(frozen=True, kw_only=True)
class Iterate:
    """One evaluation on the way."""

    objective: float
    """J."""
    misfit: float
    """Root mean square of the whitened residuals of all numbers [-]."""
    step: float
    """Part of the Gauss-Newton step; 0 at the start."""


@dataclass(frozen=True, kw_only=True)
class Minimum:
    """Where the search ended."""

    white: Floats
    """Shape [W]."""
    jacobian: Floats
    """G there, shape [r, W]."""
    numbers: Floats
    """F there, shape [M]."""
    iterates: list[Iterate]
    promised: float
    """Decrease of J that another step would bring where the numbers are linear."""


def combinations(draws: Floats, noise: Noise) -> Floats:
    """Orthonormal combinations of the whitened numbers that the prior moves; draws: numbers [n, M]; [r, M].

    Those in which draws of one jitter seed vary by more than `SMALL`, the most variable first.
    """
    whitened = noise.whitened((draws - draws.mean(axis=0)).T)
    basis, singular, _ = np.linalg.svd(whitened, full_matrices=False)
    variance = singular**2 / (len(draws) - 1)
    kept = max(1, int((variance > SMALL).sum()))
    return np.asarray(basis[:, :kept].T)


def minimise(
    flow: Flow,
    target: Floats,
    noise: Noise,
    rows: Floats,
    start: Floats,
    iterations: int,
    seeds: Sequence[int],
    enough: float = CONVERGED,
) -> Minimum:
    """From `start` [W] to the most probable white numbers.

    target: y [M]; rows: `combinations` [r, M]; iterations: at most; seeds: over which predictions are averaged; enough:
    decrease of J that a step must promise.
    """
    white, numbers = start, flow.mean(start, seeds)
    iterates = [evaluated(noise.whitened(numbers - target), white, 0.0)]
    outer, decrease = noise.whitened(np.eye(len(target))), math.inf
    while True:
        jacobian = flow.jacobian(white, rows @ outer, seeds)
        residual = rows @ noise.whitened(numbers - target)
        proposed = linear_mean(jacobian, white, residual)
        promised = gain(jacobian, residual, white, proposed - white)
        here = Minimum(white=white, jacobian=jacobian, numbers=numbers, iterates=iterates, promised=promised)
        if min(promised, decrease) < enough or len(iterates) > iterations:
            return here
        step = 1.0
        while True:
            tried = white + step * (proposed - white)
            found = flow.mean(tried, seeds)
            iterate = evaluated(noise.whitened(found - target), tried, step)
            decrease = iterates[-1].objective - iterate.objective
            if decrease > DECREASE * gain(jacobian, residual, white, tried - white):
                break
            if step <= SHORTEST:
                return here
            step *= 0.5
        white, numbers = tried, found
        iterates.append(iterate)


def gain(jacobian: Floats, residual: Floats, white: Floats, step: Floats) -> float:
    """By how much J falls along `step` [W] where the numbers are linear."""
    after = residual + jacobian @ step
    moved = white + step
    return float(0.5 * (residual @ residual + white @ white - after @ after - moved @ moved))


def evaluated(residual: Floats, white: Floats, step: float) -> Iterate:
    """J and the misfit of whitened residuals [M]."""
    squares = float(residual @ residual)
    return Iterate(
        objective=0.5 * (squares + float(white @ white)), misfit=float(np.sqrt(squares / len(residual))), step=step
    )
