"""An observation of many numbers by its principal components over the runs.

    c = B^T W (y - mean),    W = 1 / (noise^2 + scatter^2)^(1/2)

B are orthonormal directions of the runs' weighted numbers, as in Higdon, Gattiker, Williams & Rightley (Computer model
calibration using high-dimensional output, J. Am. Stat. Assoc. 103 (2008) 570-583): first those in which a parameter
moves them to first order, however little, then the principal ones of what is left. What is across them is scatter, and
a discrepancy of the model is looked for in all numbers.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from inverse.observations import Target
from inverse.posterior.settings import CONSTANTS

Matrix = NDArray[np.float64]
Row = NDArray[np.float64]
NEGLIGIBLE = 1e-8
"""Effect of a parameter on any number, over scatter and noise, that is rounding."""
SMALL = 0.1
"""Root mean square of a direction besides the parameters' own, over scatter and noise, that is left out."""


@dataclass(frozen=True, kw_only=True)
class Reduction:
    """From M numbers to r components."""

    mean: Row
    """Shape [M]."""
    weights: Row
    """W, shape [M]."""
    basis: Matrix
    """B, shape [M, r]."""
    expected_scatter: Row
    """Standard deviation of a component from flow to flow, before runs have shown it, shape [r]."""
    noise: Matrix
    """Covariance of the components by errors of the measurement, shape [r, r]."""

    def __call__(self, numbers: Matrix) -> Matrix:
        """Components [..., r] of numbers [..., M]."""
        return np.asarray(((numbers - self.mean) * self.weights) @ self.basis)

    def numbers(self, components: Matrix) -> Matrix:
        """The numbers [..., M] that components [..., r] stand for."""
        return np.asarray(components @ self.basis.T / self.weights + self.mean)


def reduction(numbers: Matrix, points: Matrix, target: Target, *, scatter: Row) -> Reduction:
    """By runs at points [n, U] that show `numbers` [n, M]; scatter: expected deviation of each number per flow [M]."""
    noise = np.full(len(scatter), target.noise)
    if target.covariance is not None:
        noise = np.sqrt(np.diag(target.covariance))
    weights = 1.0 / np.maximum(np.hypot(noise, scatter), 1e-12)
    mean = numbers.mean(axis=0)
    weighted = (numbers - mean) * weights
    slopes = np.linalg.lstsq(points - points.mean(axis=0), weighted, rcond=None)[0]
    first = directions(slopes, len(slopes), NEGLIGIBLE)
    rest = directions(weighted - (weighted @ first) @ first.T, CONSTANTS.beyond_linear, SMALL * len(points) ** 0.5)
    basis = np.concatenate([first, rest], axis=1)[:, : CONSTANTS.max_components]
    scaled = basis * weights[:, None]
    own = target.covariance
    covariance = (scaled.T * noise**2) @ scaled if own is None else scaled.T @ own @ scaled
    # Between errors of single numbers and one of all together, of M^(1/2) times the effect.
    expected = np.sqrt((scaled**2).T @ scatter**2) * len(scatter) ** 0.25
    return Reduction(mean=mean, weights=weights, basis=basis, expected_scatter=expected, noise=covariance)


def directions(rows: Matrix, most: int, minimum: float) -> Matrix:
    """Orthonormal directions in which `rows` [k, M] extend by more than `minimum`, at most so many, shape [M, r]."""
    values, basis = np.linalg.svd(rows, full_matrices=False)[1:]
    return np.asarray(basis[:most][values[:most] > minimum].T)
