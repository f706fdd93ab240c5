"""Errors of measured numbers: the stated noise and their covariance."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import PlainValidator
from scipy.linalg import block_diag
from scipy.spatial.distance import cdist

from datasets.errors import InputError, require
from datasets.scene.grid_field import Floats
from datasets.schema import Bounds, Record, fraction, from_mapping


@dataclass(frozen=True, kw_only=True)
class Student(Record):
    """Robust noise: Student's t, whose tails allow an outlier that a normal distribution would fit."""

    dof: Annotated[float, Bounds("at least 1 degree of freedom", ge=1.0)] = 4.0
    """Degrees of freedom; the fewer, the more outliers."""
    deviation: float | str
    """Its scale: the standard deviation of the numbers that are no outliers, stated like a normal noise."""


def read_noise(given: Any) -> Any:
    """A noise as a file states it. Raises InputError."""
    if isinstance(given, dict):
        kind = given.get("kind")
        require(kind == "student", "kind", "student; a number or a percentage is normal noise", repr(kind))
        return from_mapping(Student, {key: value for key, value in given.items() if key != "kind"})
    stands = isinstance(given, float | int | str | Student) and not isinstance(given, bool)
    require(stands, "", "a number, a percentage such as 3% or a table with the kind student", repr(given))
    return given


StatedNoise = Annotated[float | str | Student, PlainValidator(read_noise, json_schema_input_type=Any)]
"""Noise of each number: a standard deviation in its unit, a percentage such as "3%", or robust noise."""


@dataclass(frozen=True, kw_only=True)
class Noise:
    """A stated noise: the standard deviation of a number y is ((share y)^2 + deviation^2)^(1/2)."""

    share: float = 0.0  # share of each number [-]
    deviation: float = 0.0  # absolute part, in the unit of the numbers

    @classmethod
    def stated(cls, noise: float | str | Student) -> "Noise":
        """The noise of a number, a percentage such as "3%", or the scale of robust noise. Raises InputError."""
        if isinstance(noise, Student):
            return cls.stated(noise.deviation)
        if isinstance(noise, str):
            share = fraction(noise) if noise.strip().endswith("%") else math.nan
            if not 0.0 < share < 1.0:
                raise InputError(f"expected a number or a percentage such as 3%, got {noise.strip()!r}", key="noise")
            return cls(share=share)
        require(0.0 <= noise < math.inf, "noise", "a standard deviation of at least 0", f"{noise:g}")
        return cls(deviation=noise)

    def of(self, numbers: Floats) -> Floats:
        """Standard deviation of each of `numbers` [M], shape [M]."""
        return np.asarray(np.hypot(self.share * numbers, self.deviation))


@dataclass(frozen=True)
class Covariance:
    """Covariance of the errors of M numbers; for independent errors without a matrix: a deposit has thousands."""

    deviation: Floats  # standard deviation of each number, shape [M]
    dependent: Floats | None = None  # the full covariance if errors are dependent, shape [M, M]

    @staticmethod
    def of(matrix: Floats) -> "Covariance":
        """The covariance of a matrix [M, M]."""
        return Covariance(np.sqrt(np.diag(matrix)), matrix)

    @staticmethod
    def correlated(deviation: Floats, places: Floats, length: float | None) -> "Covariance":
        """Errors at places [m], shape [M, 2], correlated as exp(-distance / length); independent without `length`."""
        if length is None:
            return Covariance(deviation)
        distance = cdist(places, places)
        return Covariance(deviation, np.outer(deviation, deviation) * np.exp(-distance / length))

    @staticmethod
    def joined(parts: Sequence["Covariance"]) -> "Covariance":
        """The covariance of the numbers of all parts in a row; errors of different parts are independent."""
        return Covariance(np.concatenate([part.deviation for part in parts]), block_diag(*(e.matrix for e in parts)))

    @property
    def matrix(self) -> Floats:
        """The covariance matrix, shape [M, M]."""
        return np.diag(self.deviation**2) if self.dependent is None else self.dependent

    def over(self, scale: Floats) -> "Covariance":
        """The covariance of the numbers divided by `scale` [M]."""
        matrix = None if self.dependent is None else self.dependent / np.outer(scale, scale)
        return Covariance(self.deviation / scale, matrix)

    def some(self, index: NDArray[np.int64]) -> "Covariance":
        matrix = None if self.dependent is None else self.dependent[np.ix_(index, index)]
        return Covariance(self.deviation[index], matrix)

    def combined(self, combinations: Floats) -> Floats:
        """Covariance [r, r] of combinations [M, r] of the numbers."""
        if self.dependent is None:
            return np.asarray((combinations.T * self.deviation**2) @ combinations)
        return np.asarray(combinations.T @ self.dependent @ combinations)

    def drawn(self, rng: np.random.Generator) -> Floats:
        """Random errors, shape [M]."""
        if self.dependent is None:
            return np.asarray(self.deviation * rng.standard_normal(len(self.deviation)))
        variances, axes = np.linalg.eigh(self.dependent)
        return np.asarray(axes @ (np.sqrt(np.maximum(variances, 0.0)) * rng.standard_normal(len(variances))))
