"""The box of the prior bounds."""

from dataclasses import dataclass

import numpy as np

from inverse.parameters import Vector
from inverse.problem import Problem


@dataclass(frozen=True, kw_only=True)
class Bounds:
    """The box of the prior bounds."""

    lower: Vector
    upper: Vector

    @classmethod
    def from_problem(cls, problem: Problem) -> "Bounds":
        """Those of `problem`."""
        lower, upper = np.array(problem.bounds).T
        return cls(lower=lower, upper=upper)

    @property
    def range(self) -> Vector:
        """Width of the box, shape [U]."""
        return self.upper - self.lower

    @property
    def middle(self) -> Vector:
        """Centre of the box, shape [U]."""
        return 0.5 * (self.lower + self.upper)

    def clip(self, parameters: Vector) -> Vector:
        """The nearest point of the box."""
        return np.clip(parameters, self.lower, self.upper)

    def around(self, centre: Vector, radius: Vector) -> "Bounds":
        """The part of the box within the trust `radius` [U] of `centre`."""
        return Bounds(lower=np.maximum(self.lower, centre - radius), upper=np.minimum(self.upper, centre + radius))
