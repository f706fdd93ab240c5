"""Reduces an observation of many numbers to its principal components over the runs.

    c = B^T W (y - mean),    W = 1 / (noise^2 + scatter^2)^(1/2)

B are orthonormal directions of the runs' weighted numbers, as in Higdon, Gattiker, Williams & Rightley (Computer model
calibration using high-dimensional output, J. Am. Stat. Assoc. 103 (2008) 570-583): first those in which a parameter
moves them to first order, however little, then the principal ones of the rest. The part orthogonal to them is scatter.
A discrepancy of the model is sought in all numbers.
"""

from dataclasses import dataclass

import numpy as np

from inverse.observations.target import Target
from inverse.posterior import Matrix, Row
from inverse.posterior.settings import CONSTANTS

NEGLIGIBLE = 1e-8  # effect of a parameter on any number, over scatter and noise, below which it is rounding
STEEP = 3.0  # standard errors above which a slope is significant
SMALL = 0.1  # root mean square of a further direction, over scatter and noise, below which it is left out


@dataclass(frozen=True)
class Reduction:
    """From M numbers to r components."""

    mean: Row  # shape [M]
    weights: Row  # W, shape [M]
    basis: Matrix  # B, shape [M, r]
    expected_scatter: Row  # standard deviation of a component from flow to flow, before runs have shown it, shape [r]
    components: Matrix  # components of the runs, each in the directions from the other runs, shape [n, r]
    noise: Matrix  # covariance of the components by errors of the measurement, shape [r, r]
    remainder: Row  # standard deviation over the runs of each number's part orthogonal to the components, shape [M]

    def __call__(self, numbers: Matrix) -> Matrix:
        """Components [..., r] of numbers [..., M]."""
        return np.asarray(((numbers - self.mean) * self.weights) @ self.basis)

    def numbers(self, components: Matrix) -> Matrix:
        """The numbers [..., M] of components [..., r]."""
        return np.asarray(components @ self.basis.T / self.weights + self.mean)


def reduction(numbers: Matrix, points: Matrix, target: Target, *, scatter: Row) -> Reduction:
    """The reduction from runs at points [n, U] with results `numbers` [n, M]; scatter: expected, per number [M]."""
    weights = 1.0 / np.maximum(np.hypot(target.deviation, scatter), 1e-12)
    mean = numbers.mean(axis=0)
    weighted = (numbers - mean) * weights
    functions = points - points.mean(axis=0)
    slopes = np.linalg.lstsq(functions, weighted, rcond=None)[0]
    first = directions(slopes, len(slopes), NEGLIGIBLE)
    rest = directions(weighted - (weighted @ first) @ first.T, CONSTANTS.beyond_linear, SMALL * len(points) ** 0.5)
    basis = np.concatenate([first, rest], axis=1)[:, : CONSTANTS.max_components]
    if basis.shape[1] == 0:
        # All runs have the same results: the distance from the target is no function of the parameters.
        apart = (target.values - mean) * weights
        basis = (apart if apart.any() else np.ones_like(apart))[:, None]
        basis = basis / np.linalg.norm(basis)
    components = weighted @ basis
    components[:, : first.shape[1]] = cross_fitted(weighted, points, first)[:, : basis.shape[1]]
    scaled = basis * weights[:, None]
    # Between independent errors of the numbers and one common error, which has M^(1/2) times the effect.
    expected = np.maximum(np.sqrt((scaled**2).T @ scatter**2) * len(scatter) ** 0.25, 1e-12)
    noise = target.errors.combined(scaled)
    rest = np.sqrt(((weighted - (weighted @ basis) @ basis.T) ** 2).mean(axis=0)) / weights
    return Reduction(mean, weights, basis, expected, components, noise, rest)


def cross_fitted(weighted: Matrix, points: Matrix, first: Matrix) -> Matrix:
    """Components [n, r] of runs [n, M] at points [n, U] in the directions `first` [M, r], cross-fitted. A slope
    contains some of each run's own deviation, hence cross-fitting (Chernozhukov et al., Double/debiased machine
    learning for treatment and structural parameters, Econom. J. 21 (2018) C1-C68, section 3). Of the slopes without the
    runs at one point it uses those whose projection on `first` is `first`. A direction whose slope is at most `STEEP`
    standard errors keeps the components of all runs: along it there is only curvature and scatter."""
    components, products = weighted @ first, weighted @ weighted.T
    crossed = components.copy()
    functions = np.concatenate([np.ones((len(points), 1)), points], axis=1)
    steep = slope_over_error(components, functions) > STEEP
    _, label = np.unique(points, axis=0, return_inverse=True)
    for group in range(int(label.max()) + 1):
        here, others = np.flatnonzero(label == group), np.flatnonzero(label != group)
        if np.linalg.matrix_rank(functions[others]) < functions.shape[1]:
            continue
        # The product of this matrix and the other runs' numbers gives the slopes.
        slopes = np.linalg.pinv(functions[others])[1:]
        along = slopes @ components[np.ix_(others, steep)]
        crossed[np.ix_(here, steep)] = products[np.ix_(here, others)] @ slopes.T @ np.linalg.pinv(along.T)
    return crossed


def slope_over_error(components: Matrix, functions: Matrix) -> Row:
    """Slope over its error, [r], in the linear fit of each component [n, r] by 1 and the parameters [n, 1 + U]."""
    fit = np.linalg.pinv(functions)
    coefficients = fit @ components
    freedom = max(1, len(functions) - functions.shape[1])
    scatter = np.sqrt(((components - functions @ coefficients) ** 2).sum(axis=0) / freedom)
    slopes = np.linalg.norm(coefficients[1:], axis=0)
    ways = np.linalg.norm(coefficients[1:].T @ fit[1:], axis=1) / np.maximum(slopes, 1e-300)
    return np.asarray(slopes / np.maximum(scatter * ways, 1e-300))


def directions(rows: Matrix, most: int, minimum: float) -> Matrix:
    """At most `most` orthonormal directions in which `rows` [k, M] extend by more than `minimum`, shape [M, r]."""
    values, basis = np.linalg.svd(rows, full_matrices=False)[1:]
    return np.asarray(basis[:most][values[:most] > minimum].T)
