"""Several observations as one: each number in its own standard deviations, so that all are compared in one sum.

    z_i = y_i / s_i,    s_i^2 = n_i^2 + c_i^2,    misfit = 1/M sum_i (z_i - z*_i)^2

| symbol | variable | meaning |
|---|---|---|
| y | | the numbers of the observations, M of them in their own units |
| n | | standard deviation by errors of the measurement, as stated |
| c | `prior` | that of one flow, another initial jitter: what two perfect measurements of one sand differ by |
| s | `scale` | together; the weights 1 / s^2 are those of least squares |

The scatter of a flow keeps a number that was measured very precisely from outweighing all others.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from datasets.trajectory import Trajectory
from inverse.observations.observation import Observation, Rollout, Values


@dataclass(frozen=True, kw_only=True)
class Part:
    """One of several observations."""

    name: str
    """As reports call it."""
    observation: Observation
    numbers: slice
    """Which of all numbers are its own."""


class Joint(Observation):
    """Several observations, each number over its standard deviation: without a unit."""

    kind = "joint"
    label = "several observations"
    unit = "standard deviations"

    def __init__(self, parts: Sequence[Part], scale: Values, prior: Values) -> None:
        """scale, prior: s and c of each number, in its unit, both of shape [M]."""
        self.parts, self.scale, self.prior = tuple(parts), scale, prior
        self.of_positions = all(part.observation.of_positions for part in parts)

    @property
    def over_time(self) -> bool:
        return any(part.observation.over_time for part in self.parts)

    def raw(self, values: Values) -> Values:
        return np.asarray(values * self.scale)

    def record(self) -> dict[str, Any]:
        parts = [
            {"name": part.name, "unit": part.observation.unit, "first": part.numbers.start, "end": part.numbers.stop}
            for part in self.parts
        ]
        return {"parts": parts, "deviation": self.scale.tolist()}

    def observe(self, trajectory: Trajectory) -> Values:
        return np.concatenate([part.observation.observe(trajectory) for part in self.parts]) / self.scale

    def predict(self, rollout: Rollout) -> Tensor:
        numbers = torch.cat([part.observation.predict(rollout) for part in self.parts])
        return numbers / torch.from_numpy(self.scale)

    def prior_scatter(self, values: Values) -> Values:
        return np.asarray(self.prior / self.scale)
