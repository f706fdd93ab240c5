"""The target of an inversion: an operator, the numbers measured with it, and their errors."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise, starmap

import numpy as np
from numpy.typing import NDArray

from datasets.errors import InputError
from datasets.flow import measures
from datasets.flow.trajectory import Trajectory
from inverse.observations.errors import Covariance
from inverse.observations.measured_profile import MeasuredProfile
from inverse.observations.observation import Joint, JointPart, Observation, Values

ALL_DATA = "none"  # name of the left-out observation if all are used


@dataclass(frozen=True, kw_only=True)
class Target:
    """The target of one observation, or of several (`joined`). Only reports use the fields after `roughness`."""

    observation: Observation
    values: Values  # shape [M]
    errors: Covariance  # covariance of the measurement errors
    dof: Values | None = None  # degrees of freedom of Student's t of each error, inf if normal, [M]; None: all normal
    stated: Covariance | None = None  # the errors as stated, if `errors` has larger ones for outliers (`reweighted`)
    profile: MeasuredProfile | None = None  # the measured profile, if its heights have errors
    roughness: float = 1.0  # scatter of its heights over their stated noise, included in `errors`
    front: float = math.nan  # front of the deposit [m], to compare with that of an MPM run; nan if unknown
    cell: float | None = None  # cell size of the simulated flow that was observed [m]; None for a measured flow
    deposit: NDArray[np.floating] | None = None  # positions of the deposit [m], if known, shape [N, D]
    truth: dict[str, float] | None = None  # the true numbers, if known

    @property
    def deviation(self) -> Values:
        """Standard deviation of each value due to measurement errors, shape [M]."""
        return self.errors.deviation

    def reweighted(self, square: Values) -> "Target":
        """The target with errors updated from residuals whose expected squares are `square` [M].

            s_i^2 / l_i,    l_i = (nu + 1) / (nu + r_i^2 / s_i^2)

        Student's t is a normal distribution with a random variance; l is the mean of its precision given the
        residual (Lange, Little & Taylor, Robust statistical modeling using the t distribution, J. Am. Stat. Assoc. 84
        (1989) 881-896; over a posterior Tipping & Lawrence, Neurocomputing 69 (2005) 123-141)."""
        assert self.dof is not None, "normal errors have one weight"
        stated = self.stated or self.errors
        ratio = square / np.maximum(stated.deviation, 1e-300) ** 2
        robust = np.isfinite(self.dof)
        finite = np.where(robust, self.dof, 1.0)
        weights = np.where(robust, (finite + 1.0) / (finite + ratio), 1.0)
        return replace(self, errors=stated.over(np.sqrt(weights)), stated=stated)

    def misfit(self, values: Values) -> float:
        """Misfit of `values` [M]; see `Observation.misfit`."""
        return self.observation.misfit(values, self.values)

    def front_error(self, run: Trajectory) -> float:
        """Relative error of the deposit's front in `run`; nan if the target has no front."""
        return (measures.front(run.positions[-1], run.volumes) - self.front) / self.front


def without(target: Target, name: str) -> tuple[Target, NDArray[np.int64]]:
    """The joint target without the observation `name` (all of it if none has that name), and the remaining numbers."""
    parts, left, whole = [], np.arange(0), target.observation
    for part in whole.parts:
        if part.name != name:
            numbers = np.arange(len(target.values))[part.numbers]
            parts.append(replace(part, numbers=slice(len(left), len(left) + len(numbers))))
            left = np.concatenate([left, numbers])
    scale = np.broadcast_to(whole.scale, len(target.values))[left]
    prior = scale * whole.prior_scatter(target.values)[left]
    observation, values, errors = Joint(parts, scale, prior), target.values[left], target.errors.some(left)
    return replace(target, observation=observation, values=values, errors=errors, dof=None, stated=None), left


def joined(targets: Sequence[Target], names: Sequence[str]) -> Target:
    """Joins several observations, with their names in reports. Raises InputError for numbers without any deviation."""
    if len(targets) == 1:
        return targets[0]
    spans = starmap(slice, pairwise(np.cumsum([0, *(len(target.values) for target in targets)]).tolist()))
    rows = zip(names, targets, spans, strict=True)
    parts = [JointPart(name=name, observation=target.observation, numbers=span) for name, target, span in rows]
    prior = np.concatenate([target.observation.prior_scatter(target.values) for target in targets])
    errors = Covariance.joined([target.errors for target in targets])
    scale = np.hypot(errors.deviation, prior)
    for part in parts:
        if not np.all(scale[part.numbers] > 0.0):
            raise InputError(f"expected a noise above 0 for {part.name}, whose numbers are all 0", key="observations")
    dofs = [np.full(len(target.values), math.inf) if target.dof is None else target.dof for target in targets]
    return Target(
        dof=np.concatenate(dofs) if any(target.dof is not None for target in targets) else None,
        observation=Joint(parts, scale, prior),
        values=np.concatenate([target.values for target in targets]) / scale,
        errors=errors.over(scale),
        roughness=max(target.roughness for target in targets),
    )
