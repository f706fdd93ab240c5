"""Several observations as one: each number in its own standard deviations, so that all are compared in one sum.

    z_i = y_i / s_i,    s_i^2 = n_i^2 + c_i^2,    misfit = 1/M sum_i (z_i - z*_i)^2

| symbol | variable | meaning |
|---|---|---|
| y | | what the observations say, M numbers in their own units |
| n | | standard deviation by errors of the measurement, as stated |
| c | `chance` | that of one flow, another initial jitter: what two perfect measurements of one sand differ by |
| s | `scale` | together; the weights 1 / s^2 are those of least squares |

The chance keeps a number that was measured to a hair from outweighing all others, whose flow is left to it as well.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from datasets.trajectory import Trajectory
from inverse.observations.deposit import Observation, Rollout, Values


@dataclass(frozen=True, kw_only=True)
class Part:
    """One of several observations."""

    name: str
    """As reports call it."""
    observation: Observation
    numbers: slice
    """Which of all numbers are its own."""


class Combined(Observation):
    """Several observations, each number over its standard deviation: without a unit."""

    unit = ""

    def __init__(self, parts: Sequence[Part], scale: Values, chance: Values) -> None:
        """scale, chance: s and c of each number, in its unit, both of shape [M]."""
        self.parts, self.scale, self.chance = tuple(parts), scale, chance
        self.over_time = any(part.observation.over_time for part in parts)
        self.by_surrogate = all(part.observation.by_surrogate for part in parts)

    def raw(self, values: Values) -> Values:
        """`values` [M] in the units of the observations."""
        return np.asarray(values * self.scale)

    def observe(self, trajectory: Trajectory) -> Values:
        return np.asarray(observed([part.observation for part in self.parts], trajectory) / self.scale)

    def predict(self, rollout: Rollout) -> Tensor:
        seen = torch.cat([part.observation.predict(rollout) for part in self.parts])
        return seen / torch.from_numpy(self.scale)

    def edge(self, values: Values) -> float:
        return float("nan")

    @property
    def by_chance(self) -> float:
        """What a number of the MPM is expected to scatter from flow to flow, root mean square [standard deviations]."""
        return float(np.sqrt(np.mean((self.chance / self.scale) ** 2)))


def observed(observations: Sequence[Observation], trajectory: Trajectory) -> Values:
    """What all `observations` say of a run, each in its unit, one after the other; shape [M]."""
    return np.concatenate([each.observe(trajectory) for each in observations])
