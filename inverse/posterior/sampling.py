"""Samples a posterior over the unit box by sequential Monte Carlo, which copes with several separate maxima.

A population of the prior becomes one of the posterior in stages, in which the exponent of the likelihood rises (Del
Moral, Doucet & Jasra, Sequential Monte Carlo samplers, J. Roy. Statist. Soc. B 68 (2006) 411-436). At each stage
samples are resampled by weight and moved by differential evolution (ter Braak, A Markov chain Monte Carlo version of
the genetic algorithm Differential Evolution, Stat. Comput. 16 (2006) 239-249): the difference of two others gives a
step that matches the width of the population in each direction, or leads from one maximum to another.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.stats import qmc

from inverse.posterior import Matrix, Row
from inverse.posterior.settings import CONSTANTS

LogLikelihood = Callable[[Matrix], Row]  # points [S, U] -> the logarithm of the likelihood [S]
JUMP = 0.1  # share of moves by the whole difference, which lead from one maximum to another


@dataclass(frozen=True, kw_only=True)
class Samples:
    """Weighted samples of a posterior."""

    points: Matrix  # shape [S, U], in fractions of the ranges
    weights: Row  # shape [S], together 1
    log_likelihood: Row  # shape [S]
    evidence: float  # logarithm of the mean likelihood over the part of the prior that is not excluded
    difference: float  # largest difference between the means of populations, in standard deviations of the posterior
    acceptance: float  # share of the moves that were accepted at the last stage

    @property
    def mean(self) -> Row:
        """Shape [U]."""
        return np.asarray(self.weights @ self.points)

    @property
    def covariance(self) -> Matrix:
        """Shape [U, U]."""
        off = self.points - self.mean
        return np.asarray((off.T * self.weights) @ off)

    def drawn(self, count: int, rng: np.random.Generator) -> Matrix:
        """Points resampled to equal weights, shape [count, U]."""
        return np.asarray(self.points[systematic(self.weights, count, rng)])


def sample(log_likelihood: LogLikelihood, rng: np.random.Generator, *, low: Row, high: Row) -> Samples:
    """Samples of the posterior with a uniform prior between `low` and `high`, both of shape [U]."""
    populations = [population(log_likelihood, rng, low, high) for _ in range(CONSTANTS.populations)]
    points = np.concatenate([batch[0] for batch in populations])
    evidences = np.array([batch[2] for batch in populations])
    # The weight of each population is its own estimate of the evidence.
    shares = np.exp(evidences - evidences.max())
    weights = np.repeat(shares / shares.sum(), [len(batch[0]) for batch in populations]) / CONSTANTS.samples
    spread = np.maximum(points.std(axis=0), 1e-12)
    means = np.stack([batch[0].mean(axis=0) for batch in populations])
    return Samples(
        points=points,
        weights=weights / weights.sum(),
        log_likelihood=np.concatenate([batch[1] for batch in populations]),
        evidence=float(np.log(shares.mean()) + evidences.max()),
        difference=float(np.max(np.ptp(means, axis=0) / spread)),
        acceptance=min(batch[3] for batch in populations),
    )


def population(
    log_likelihood: LogLikelihood, rng: np.random.Generator, low: Row, high: Row
) -> tuple[Matrix, Row, float, float]:
    """Equally weighted points [S, U], their likelihoods [S], the evidence, and the share of accepted moves."""
    size = CONSTANTS.samples
    sobol = qmc.Sobol(len(low), seed=rng).random_base2((size - 1).bit_length())[:size]

    def inside(points: Matrix) -> Row:
        return log_likelihood(low + (high - low) * points)

    points, likelihood = sobol, inside(sobol)
    exponent, evidence, accepted = 0.0, 0.0, 1.0
    while exponent < 1.0:
        step = next_step(likelihood, 1.0 - exponent)
        weights = np.exp(step * (likelihood - likelihood.max()))
        evidence += float(np.log(weights.mean()) + step * likelihood.max())
        exponent = min(1.0, exponent + step)
        chosen = systematic(weights / weights.sum(), size, rng)
        points, likelihood, accepted = moved(inside, points[chosen], likelihood[chosen], exponent, rng)
    return low + (high - low) * points, likelihood, evidence, accepted


def next_step(likelihood: Row, most: float) -> float:
    """Largest rise of the exponent that keeps `effective` of the samples effective (Kish, Survey sampling, 1965)."""

    def effective(step: float) -> float:
        weights = np.exp(step * (likelihood - likelihood.max()))
        return float(weights.sum() ** 2 / (weights**2).sum() / len(weights)) - CONSTANTS.effective

    return most if effective(most) >= 0.0 else float(brentq(effective, 0.0, most, xtol=1e-12, rtol=1e-3))


def systematic(weights: Row, count: int, rng: np.random.Generator) -> NDArray[np.int64]:
    """Indices drawn by weight: one in each of `count` equal parts of the cumulated weight."""
    marks = (rng.random() + np.arange(count)) / count
    return np.minimum(np.searchsorted(np.cumsum(weights), marks), len(weights) - 1)


def moved(
    log_likelihood: LogLikelihood, points: Matrix, likelihood: Row, exponent: float, rng: np.random.Generator
) -> tuple[Matrix, Row, float]:
    """The population [S, U] after moves of each half by differences within the other, and the accepted share."""
    points, likelihood = points.copy(), likelihood.copy()
    size, unknowns = points.shape
    order = rng.permutation(size)
    halves = (order[: size // 2], order[size // 2 :])
    accepted, tried = 0, 0
    for _ in range(CONSTANTS.max_sweeps):
        for half, other in (halves, halves[::-1]):
            first, second = rng.integers(len(other), size=(2, len(half)))
            scale = np.where(rng.random(len(half)) < JUMP, 1.0, 2.38 / np.sqrt(2.0 * unknowns))
            jitter = 1e-3 * points[other].std(axis=0) + 1e-9
            step = scale[:, None] * (points[other[first]] - points[other[second]])
            proposed = points[half] + step + jitter * rng.standard_normal((len(half), unknowns))
            # Mirroring at a face would make a step of correlated parameters more likely than the step back.
            inside = np.all((proposed >= 0.0) & (proposed <= 1.0), axis=1)
            there = np.full(len(half), -np.inf)
            if inside.any():
                there[inside] = log_likelihood(proposed[inside])
            moves = np.log(rng.random(len(half))) < exponent * (there - likelihood[half])
            points[half[moves]], likelihood[half[moves]] = proposed[moves], there[moves]
            accepted += int(moves.sum())
            tried += len(half)
        if accepted >= CONSTANTS.jumps * size:
            break
    return points, likelihood, accepted / tried
