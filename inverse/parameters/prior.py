"""Stated priors of numbers: a distribution for each, truncated at the bounds, and correlations of pairs.

A distribution function F between bounds a and b becomes F*(x) = (F(x) - F(a)) / (F(b) - F(a)), of density f*. Pairs
are correlated by their normal scores z = Phi^-1(F*(x)), a Gaussian copula,

    p(x) = phi(z; R) prod_i f*_i(x_i) / phi(z_i)

with R of the stated coefficients: correlations of z; those of x are slightly lower (Liu & Der Kiureghian, Multivariate
distribution models with prescribed marginals and covariances, Probab. Eng. Mech. 1 (1986) 105-112; after Nataf).
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Any

import numpy as np
from scipy import stats
from scipy.special import ndtr, ndtri

from datasets.errors import require
from datasets.schema import Bounds, Record
from inverse.posterior import Matrix

KINDS = {"uniform": (), "normal": ("mean", "deviation"), "lognormal": ("mean", "deviation"), "triangular": ("mode",)}
"""Kind of a prior -> its keys."""
LEAST_MASS = 1e-6  # smallest probability between the bounds: below it the stated prior contradicts them
LOWEST = -1e6  # logarithm of a density of 0
LEAST_SHARE = 1e-15  # smallest distance of a share from 0 and 1: normal scores up to 8
CREDIBLE = 0.95  # probability of the interval that defines the width of a prior


@dataclass(frozen=True, kw_only=True)
class Prior(Record):
    """The prior of a number before truncation at the bounds.

    >>> Parameter(name="friction_deg", lower=16.0, upper=45.0, prior=Prior(kind="normal", mean=30.0, deviation=3.0))
    """

    kind: str
    """A key of `KINDS`."""
    mean: float | None = None
    """Mean of a normal or lognormal number (not of its logarithm)."""
    deviation: Annotated[float | None, Bounds("a value above 0", gt=0.0, le=math.inf)] = None
    """Standard deviation of the number."""
    mode: float | None = None
    """Mode of a triangular prior, whose density falls to 0 at both bounds."""

    def check(self, lower: float, upper: float) -> None:
        """Raise InputError, which names the key, for a prior that is invalid between the bounds."""
        require(self.kind in KINDS, "kind", f"one of {', '.join(KINDS)}", repr(self.kind))
        for name in ("mean", "deviation", "mode"):
            value, needed = getattr(self, name), name in KINDS[self.kind]
            require(not needed or value is not None, name, f"a value of a {self.kind} prior", "none")
            require(needed or value is None, name, f"none of a {self.kind} prior", value)
        if self.mode is not None:
            require(lower <= self.mode <= upper, "mode", f"a value in [{lower:g}, {upper:g}]", self.mode)
        if self.kind == "lognormal":
            require(lower >= 0.0, "kind", "a lower bound of at least 0 with lognormal", lower)
            require((self.mean or 0.0) > 0.0, "mean", "a value above 0", self.mean)
        mass = Marginal(law=self.law(lower, upper), lower=lower, upper=upper).mass
        message = f"a prior with a probability of at least {LEAST_MASS:g} between the bounds {lower:g} and {upper:g}"
        require(mass >= LEAST_MASS, "mean", message, f"{mass:.1g}")

    def law(self, lower: float, upper: float) -> Any:
        """The SciPy distribution, which depends on the bounds for two of the kinds."""
        mean, deviation = self.mean or 0.0, self.deviation or 0.0
        if self.kind == "normal":
            return stats.norm(mean, deviation)
        if self.kind == "lognormal":
            variance = math.log1p((deviation / mean) ** 2)
            return stats.lognorm(math.sqrt(variance), scale=mean * math.exp(-0.5 * variance))
        if self.mode is not None:
            return stats.triang((self.mode - lower) / (upper - lower), loc=lower, scale=upper - lower)
        return stats.uniform(lower, upper - lower)

    @property
    def text(self) -> str:
        """Text for reports."""
        numbers = {"normal": f" {self.mean} ± {self.deviation}", "triangular": f" about {self.mode}"}
        return self.kind + (numbers | {"lognormal": numbers["normal"]}).get(self.kind, "")


@dataclass(frozen=True, kw_only=True)
class Correlation(Record):
    """Correlation of the priors of two numbers (`[[correlations]]`)."""

    between: tuple[str, str]
    """Names of the two numbers."""
    coefficient: Annotated[float, Bounds("a value in (-1, 1)", gt=-1.0, lt=1.0)]
    """Correlation coefficient of their normal scores."""


@dataclass(frozen=True, kw_only=True)
class Marginal:
    """The prior of one number between its bounds."""

    law: Any  # a SciPy distribution
    lower: float
    upper: float

    @cached_property
    def below(self) -> float:
        """F(a)."""
        return float(self.law.cdf(self.lower))

    @cached_property
    def mass(self) -> float:
        """F(b) - F(a)."""
        return float(self.law.cdf(self.upper)) - self.below

    def log_density(self, values: Matrix) -> Matrix:
        """ln f* + ln(b - a), the density over the uniform one; any shape."""
        return np.asarray(self.law.logpdf(values) - math.log(self.mass) + math.log(self.upper - self.lower))

    def share(self, values: Matrix) -> Matrix:
        """F*; any shape."""
        return np.asarray((self.law.cdf(values) - self.below) / self.mass)

    def at(self, shares: Matrix) -> Matrix:
        """The inverse of F*; any shape."""
        return np.asarray(np.clip(self.law.ppf(self.below + self.mass * shares), self.lower, self.upper))

    @property
    def width(self) -> float:
        """Width of a uniform prior with a 95 % interval of the same length."""
        low, high = self.at(np.array([0.5 - 0.5 * CREDIBLE, 0.5 + 0.5 * CREDIBLE]))
        return float(high - low) / CREDIBLE


class JointPrior:
    """The prior of U numbers. Points are in fractions of their ranges, densities over the uniform one."""

    def __init__(self, numbers: Mapping[str, Marginal], correlations: Sequence[Correlation] = ()) -> None:
        """numbers: name -> prior. Raises InputError, which names the key, for invalid correlations."""
        self.marginals = [*numbers.values()]
        self.lower = np.array([marginal.lower for marginal in self.marginals])
        self.range = np.array([marginal.upper - marginal.lower for marginal in self.marginals])
        names, self.correlation = [*numbers], np.eye(len(numbers))
        for index, correlation in enumerate(correlations):
            key, (first, second) = f"correlations[{index}]", correlation.between
            for name in correlation.between:
                require(name in names, f"{key}.between", f"two of the numbers {', '.join(names)}", repr(name))
            require(first != second, f"{key}.between", "two different numbers", f"{first!r} twice")
            row, column = names.index(first), names.index(second)
            require(self.correlation[row, column] == 0.0, f"{key}.between", "each pair once", f"{first}, {second}")
            self.correlation[row, column] = self.correlation[column, row] = correlation.coefficient
        smallest = float(np.linalg.eigvalsh(self.correlation).min())
        require(smallest > 1e-9, "correlations", "coefficients that go together (a positive definite matrix)", "others")

    def __call__(self, points: Matrix) -> Matrix:
        """Logarithm of its density over the uniform one at points [S, U], shape [S]."""
        columns = [*zip(self.marginals, (self.lower + self.range * points).T, strict=True)]
        log_density = sum(marginal.log_density(column) for marginal, column in columns)
        if not np.array_equal(self.correlation, np.eye(len(self.range))):
            shares = np.stack([marginal.share(column) for marginal, column in columns], axis=1)
            scores = ndtri(np.clip(shares, LEAST_SHARE, 1.0 - LEAST_SHARE))
            more = np.linalg.inv(self.correlation) - np.eye(len(self.range))
            determinant = np.linalg.slogdet(self.correlation)[1]
            log_density = log_density - 0.5 * (determinant + ((scores @ more) * scores).sum(axis=1))
        return np.maximum(log_density, LOWEST)

    def at(self, shares: Matrix) -> Matrix:
        """Points of the prior for independent uniform numbers, both [..., U]."""
        scores = ndtri(np.clip(shares, LEAST_SHARE, 1.0 - LEAST_SHARE)) @ np.linalg.cholesky(self.correlation).T
        columns = zip(self.marginals, np.moveaxis(scores, -1, 0), strict=True)
        values = np.stack([marginal.at(ndtr(column)) for marginal, column in columns], axis=-1)
        return np.asarray((values - self.lower) / self.range)

    @cached_property
    def filling(self) -> Matrix:
        """Points that represent the prior, shape [1024, U]."""
        return self.at(stats.qmc.Sobol(len(self.range), seed=0).random(1024))

    @cached_property
    def precision(self) -> Matrix:
        """Inverse of its covariance, shape [U, U]: half the curvature of -2 ln p for a normal prior."""
        return np.linalg.inv(np.atleast_2d(np.cov(self.filling.T)))

    def slope(self, points: Matrix) -> Matrix:
        """Derivatives of its log-density at points [S, U], by differences within the bounds, shape [S, U]."""
        slopes = np.zeros_like(points)
        for index, step in enumerate(1e-5 * np.eye(points.shape[1])):
            ends = np.clip(points - step, 0.0, 1.0), np.clip(points + step, 0.0, 1.0)
            slopes[:, index] = (self(ends[1]) - self(ends[0])) / (ends[1] - ends[0])[:, index]
        return slopes
