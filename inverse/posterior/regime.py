"""Where flows are such as the target's: a cohesive column stands or falls, and nothing is between the two.

A process that is smooth over the whole box would have to be as rough within a regime as from one to the other; so the
emulator is of one regime alone where that predicts its runs far better (treed Gaussian processes: Gramacy & Lee,
Bayesian treed Gaussian process models with an application to computer modeling, J. Am. Stat. Assoc. 103 (2008)
1119-1130). A regime ends where what the runs show has a gap.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from inverse.posterior.emulator import fewest_runs, squared_distance
from inverse.posterior.settings import CONSTANTS

Matrix = NDArray[np.float64]
Row = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, kw_only=True)
class Regime:
    """Runs in it and out of it."""

    inside: Matrix
    """Points of the runs in it, shape [n, U]."""
    outside: Matrix
    """Of all others, shape [m, U]."""

    def __call__(self, points: Matrix) -> Row:
        """Logarithm of the probability that points [S, U] are in it, shape [S].

        The share of the runs that are, each by the power -(U + 2) of its distance (Shepard, A two-dimensional
        interpolation function for irregularly-spaced data, Proc. ACM Natl. Conf. 23 (1968) 517-524): the nearest count.
        """
        power = 0.5 * points.shape[1] + 1.0
        inside, outside = (
            (np.maximum(squared_distance(points, runs, np.ones(1)), 1e-12) ** -power).sum(axis=1)
            for runs in (self.inside, self.outside)
        )
        return np.asarray(np.log(np.maximum(inside / (inside + outside), 1e-300)))


def of_target(components: Matrix, points: Matrix, near: Mask, target: Row) -> Mask | None:
    """Which of the runs at points [n, U] with components [n, r] are in the regime of the target [r].

    Those before the widest gap between distances from the target, relative to the distance. None where it is no wider
    than `regime_gap`, and where those of them that are `near` [n] are too few for an emulator or all that are.
    """
    distances = np.sqrt(((components - target) ** 2).sum(axis=1))
    ordered = np.sort(distances[near])
    _, first = np.unique(points[near], axis=0, return_index=True)
    enough = np.sort(distances[near][first])[fewest_runs(points.shape[1]) - 1 :]
    if len(enough) < 2:
        return None
    ratios = ordered[1:] / np.maximum(ordered[:-1], 1e-300)
    ratios[ordered[:-1] < enough[0]] = 0.0
    widest = int(np.argmax(ratios))
    return distances <= ordered[widest] if ratios[widest] > CONSTANTS.regime_gap else None
