"""How far an observation may be from the mean flow of the right fields: errors of measurement, and scatter.

    R = N + (1 + 1/n) C

| symbol | variable | meaning |
|---|---|---|
| N | `measured` | covariance of the measurement |
| C | `scatter` | covariance of the numbers of flows that differ in their jitter seed alone |
| n | `seeds` | over which predictions are averaged: the mean has a scatter of its own |

C is estimated from few flows and shrunk towards its diagonal: C = D^(1/2) [(1 - q) c + q I] D^(1/2), c the sample
correlation and q the share that minimises the expected error of a Gaussian sample towards the identity (oracle
approximating shrinkage: Chen, Wiesel, Eldar & Hero, IEEE Trans. Signal Process. 58 (2010) 5016-5029, eq. 23).
"""

from dataclasses import dataclass

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

Floats = NDArray[np.float64]

FLOOR = 1.0e-6
"""Part of the largest variance of a number that every number has: rounding, where one does not vary at all."""


@dataclass(frozen=True, kw_only=True)
class Noise:
    """Errors of M numbers."""

    measured: Floats
    """N, shape [M, M]."""
    scatter: Floats
    """C, shape [M, M]."""
    seeds: int
    """n."""

    @property
    def covariance(self) -> Floats:
        """R, shape [M, M]."""
        return np.asarray(self.measured + (1.0 + 1.0 / self.seeds) * self.scatter)

    def whitened(self, numbers: Floats) -> Floats:
        """Numbers [M, ...] in units in which their errors are independent and 1: L^-1 of R = L L^T."""
        root = scipy.linalg.cholesky(self.covariance, lower=True)
        return np.asarray(scipy.linalg.solve_triangular(root, numbers, lower=True))

    @property
    def deviation(self) -> Floats:
        """Standard deviation between what was observed and one run of the right fields, shape [M]."""
        return np.sqrt(np.diag(self.measured) + 2.0 * np.diag(self.scatter))


def shrunk(sample: Floats) -> Floats:
    """C [M, M] of the numbers of flows [n, M]."""
    count, size = sample.shape
    variance = sample.var(axis=0, ddof=1)
    variance = np.maximum(variance, FLOOR * max(float(variance.max()), 1e-12))
    centred = (sample - sample.mean(axis=0)) / np.sqrt(variance)
    correlation = centred.T @ centred / (count - 1)
    square, trace = float((correlation**2).sum()), float(np.trace(correlation))
    top = (1.0 - 2.0 / size) * square + trace**2
    bottom = (count + 1.0 - 2.0 / size) * (square - trace**2 / size)
    share = 1.0 if bottom <= 0.0 else min(1.0, top / bottom)
    correlation = (1.0 - share) * correlation + share * np.eye(size)
    np.fill_diagonal(correlation, 1.0)
    return np.asarray(correlation * np.sqrt(np.outer(variance, variance)))
