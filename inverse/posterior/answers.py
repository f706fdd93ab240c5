"""The answers: the separate parts of the region that holds 95 % of the posterior.

The region is that of highest density. Two of its samples belong to one part if the segment between them stays in the
region; a chain of such segments joins curved parts.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from inverse.posterior import Matrix, Row
from inverse.posterior.sampling import Samples, systematic
from inverse.posterior.settings import CONSTANTS

AT_MOST = 800  # most samples of the region that are joined
ALONG = (0.25, 0.5, 0.75)  # places along a segment at which the density is evaluated


@dataclass(frozen=True, kw_only=True)
class Part:
    """A part of the region, in fractions of the ranges."""

    point: Row  # the answer: the median of each number, if it lies in the region, else its nearest sample; shape [U]
    interval: Matrix  # quantiles of 2.5 and 97.5 % of each number over the part, shape [2, U]
    weight: float  # share of the posterior
    points: Matrix  # samples in the part, shape [S, U]
    threshold: float  # log-likelihood above which parameters lie in the region

    @property
    def half_widths(self) -> Row:
        """Half of the interval's width, shape [U]."""
        return np.asarray(0.5 * (self.interval[1] - self.interval[0]))


def parts(samples: Samples, log_likelihood: Callable[[Matrix], Row], rng: np.random.Generator) -> list[Part]:
    """The parts of the 95 % region that weigh enough, heaviest first."""
    index = systematic(samples.weights, min(AT_MOST, len(samples.points)), rng)
    points, density = samples.points[index], samples.log_likelihood[index]
    threshold = float(np.quantile(density, 1.0 - CONSTANTS.credible))
    # Otherwise copies of a sample would be its only neighbours.
    points = np.unique(points[density >= threshold], axis=0)
    scale = np.maximum(points.std(axis=0), 1e-9)
    count = min(CONSTANTS.neighbours + 1, len(points))
    nearest = cKDTree(points / scale).query(points / scale, k=count)[1].reshape(len(points), count)
    pairs = np.stack([np.repeat(np.arange(len(points)), count), nearest.ravel()], axis=1)
    first, second = np.unique(np.sort(pairs, axis=1), axis=0).T
    lowest = np.full(len(first), np.inf)
    for share in ALONG:
        between = (1.0 - share) * points[first] + share * points[second]
        lowest = np.minimum(lowest, log_likelihood(between))
    # The density is an estimate: a dip by less than a half does not separate parts.
    joined = lowest >= threshold - np.log(2.0)
    graph = coo_array((np.ones(int(joined.sum())), (first[joined], second[joined])), shape=(len(points), len(points)))
    number, label = connected_components(graph, directed=False)
    every = cKDTree(points / scale).query(samples.points / scale)[1]
    shares = np.array([samples.weights[label[every] == component].sum() for component in range(number)])
    heaviest, *others = np.argsort(-shares)
    kept = [heaviest, *(component for component in others if shares[component] >= CONSTANTS.smallest_weight)]
    regions = []
    for component in kept:
        belonging = label[every] == component
        inside, weights = samples.points[belonging], samples.weights[belonging] / shares[kept].sum()
        share = weights / weights.sum()
        low, centre, high = quantiles(inside, share)
        if float(log_likelihood(centre[None])[0]) < threshold:
            dense = inside[samples.log_likelihood[belonging] >= threshold]
            centre = dense[int(np.argmin((((dense - centre) / scale) ** 2).sum(axis=1)))]
        interval, weight = np.stack([low, high]), float(weights.sum())
        regions.append(Part(point=centre, interval=interval, weight=weight, points=inside, threshold=threshold))
    return regions


def quantiles(points: Matrix, share: Row) -> Matrix:
    """Lower limit, median and upper limit of the 95 % interval of samples [S, U] of weights [S], shape [3, U]."""
    rest = 0.5 * (1.0 - CONSTANTS.credible)
    return np.asarray(np.quantile(points, [rest, 0.5, 1.0 - rest], axis=0, weights=share, method="inverted_cdf"))


def half_widths(points: Matrix, share: Row, centre: Row) -> Row:
    """The smallest half-widths about `centre` [U] that hold 95 % of samples [S, U] of weights [S], shape [U]."""
    level = CONSTANTS.credible * (1.0 - 1e-9)
    return np.asarray(np.quantile(np.abs(points - centre), level, axis=0, weights=share, method="inverted_cdf"))
