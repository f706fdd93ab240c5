"""The target of an inversion: the operator, its numbers and their errors, in one object."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from datasets import measures
from inverse.observations.observation import DepositObservation, Matrix, Observation, Values


@dataclass(frozen=True, kw_only=True)
class Target:
    """What the inversion is given (`observation`, `values` and their errors), and what reports alone use (the rest)."""

    observation: Observation
    """The operator with which the values were measured."""
    values: Values
    """The observed numbers, shape [M]."""
    front: float
    """Front of the deposit [m], with which that of an MPM run is compared; nan where it is not known."""
    noise: float = 0.0
    """Standard deviation of each of the values by errors of the measurement; of values whose errors are dependent
    (below) that of the combination of them, a unit vector, whose error is largest."""
    covariance: Matrix | None = None
    """Of the values by errors of the measurement, shape [M, M]; where absent the errors are independent, of `noise`."""
    cell: float | None = None
    """Of the grid that the observed flow was simulated on [m]; None of a measured one."""
    deposit: NDArray[np.floating] | None = None
    """Where known: positions of the deposit [m], shape [N, D]."""
    profile: tuple[Values, Values] | None = None
    """Where it was measured: stations and heights of the deposit [m], both of shape [S]."""
    deviation: Values | None = None
    """Of a measured profile: standard deviation of each of these heights [m], shape [S]."""
    roughness: float = 1.0
    """By how much the heights of a measured profile scatter more than their stated noise; it is part of `deviation`."""
    truth: dict[str, float] | None = None
    """Where known: the true parameters."""

    def misfit(self, values: Values) -> float:
        """Misfit of `values` [M]; see `Observation.misfit`."""
        return self.observation.misfit(values, self.values)

    def front_error(self, deposit: NDArray[np.floating]) -> float:
        """Relative error of the front of `deposit`, positions [m], shape [N, D]; nan where the target has none.

        Where the target's deposit is not known, both fronts are those that the observation gives.
        """
        if self.deposit is not None:
            front = measures.front(deposit)
        elif isinstance(self.observation, DepositObservation):
            front = self.observation.front(self.observation.exact(deposit))
        else:
            return float("nan")
        return (front - self.front) / self.front
