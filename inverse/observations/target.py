"""What an inversion is given: an operator, what was measured with it, and the errors of these numbers."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from datasets.errors import InputError
from datasets.flow import measures
from datasets.flow.trajectory import Trajectory
from inverse.observations.errors import Covariance
from inverse.observations.measured_profile import MeasuredProfile
from inverse.observations.observation import Joint, JointPart, Observation, Values


@dataclass(frozen=True, kw_only=True)
class Target:
    """Of one observation, or of several as one (`joined`). What follows `roughness` reports alone use."""

    observation: Observation
    values: Values
    """Shape [M]."""
    errors: Covariance
    """Of the values by errors of the measurement."""
    profile: MeasuredProfile | None = None
    """Where heights of a profile have errors."""
    roughness: float = 1.0
    """By how much these scatter more than their stated noise, which is counted."""
    front: float = math.nan
    """Front of the deposit [m], with which that of an MPM run is compared; nan where it is not known."""
    cell: float | None = None
    """Of the grid that the observed flow was simulated on [m]; None of a measured one."""
    deposit: NDArray[np.floating] | None = None
    """Where known: positions of the deposit [m], shape [N, D]."""
    truth: dict[str, float] | None = None
    """Where known: the true numbers."""

    @property
    def deviation(self) -> Values:
        """Standard deviation of each value by errors of the measurement, shape [M]."""
        return self.errors.deviation

    def misfit(self, values: Values) -> float:
        """Misfit of `values` [M]; see `Observation.misfit`."""
        return self.observation.misfit(values, self.values)

    def front_error(self, run: Trajectory) -> float:
        """Relative error of the front of the deposit of `run`; nan where the target has none."""
        return (measures.front(run.positions[-1], run.volumes) - self.front) / self.front


def joined(targets: Sequence[Target], names: Sequence[str]) -> Target:
    """Several observations, as reports call them, as one. Raises InputError for numbers without any deviation."""
    if len(targets) == 1:
        return targets[0]
    ends = np.cumsum([0, *(len(each.values) for each in targets)]).tolist()
    parts = [
        JointPart(name=name, observation=each.observation, numbers=slice(first, end))
        for name, each, first, end in zip(names, targets, ends[:-1], ends[1:], strict=True)
    ]
    prior = np.concatenate([each.observation.prior_scatter(each.values) for each in targets])
    errors = Covariance.joined([each.errors for each in targets])
    scale = np.hypot(errors.deviation, prior)
    for part in parts:
        if not np.all(scale[part.numbers] > 0.0):
            raise InputError(f"expected a noise above 0 for {part.name}, whose numbers are all 0", key="observations")
    return Target(
        observation=Joint(parts, scale, prior),
        values=np.concatenate([each.values for each in targets]) / scale,
        errors=errors.over(scale),
        roughness=max(each.roughness for each in targets),
    )
