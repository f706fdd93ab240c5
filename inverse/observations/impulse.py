"""Impulse on a solid. Solids are the baffles, counted from 0, then the others."""

from typing import Any, ClassVar

import numpy as np
from torch import Tensor

from datasets.errors import InputError
from datasets.scene import Scene
from datasets.trajectory import Trajectory, solid_names
from inverse.observations.observation import Observation, Rollout, Values, at_times
from inverse.settings import ObservationSettings

SCATTER = 0.05
"""Standard deviation of an impulse from flow to flow over its value, until an ensemble has measured it."""


class Impulse(Observation):
    """The momentum that the flow has transferred to a solid along an axis, in the end or at given times.

    In 2D per metre of width. No surrogate predicts it.
    """

    kind = "impulse"
    label = "the impulse on a solid"
    unit = "N s"
    sources = ("value", "csv", "values")
    options = ("solid", "axis", "times")
    columns: ClassVar = {"time": "times", "impulse": "values"}
    of_positions = False

    def __init__(self, settings: ObservationSettings, scene: Scene) -> None:
        super().__init__(settings, scene)
        names, asked = solid_names(scene), settings.solid
        number = names.index(asked) if isinstance(asked, str) and asked in names else asked
        if isinstance(number, str) or not 0 <= number < len(names):
            known = ", ".join(names) or "none, the scene has no solids"
            raise InputError(f"expected one of {known}, or its number from 0, got {asked!r}", key="solid")
        if not 0 <= settings.axis < scene.dimension:
            raise InputError(f"expected an index below {scene.dimension}, got {settings.axis}", key="axis")
        self.solid, self.axis = number, settings.axis

    @property
    def over_time(self) -> bool:
        return True

    def observe(self, trajectory: Trajectory) -> Values:
        return np.asarray(self.of_series(self.series(trajectory.solid_impulse), trajectory.time))

    def predict(self, rollout: Rollout) -> Tensor:
        found: Tensor = self.of_series(self.series(rollout.impulses), rollout.times)
        return found

    def series(self, impulses: Any) -> Any:
        """The impulse over time [T] among those of all solids [T, solids, D]. Raises InputError where there is none."""
        if impulses is None or self.solid >= impulses.shape[1]:
            raise InputError(f"expected a run that recorded the impulse on solid {self.solid}, it did not")
        return impulses[:, self.solid, self.axis]

    def of_series(self, impulse: Any, time: Values) -> Any:
        """The numbers [M] of an impulse over `time` [s], both of shape [T]."""
        return impulse[-1:] if self.times is None else at_times(lambda value: value, impulse, time, self.times)

    def prior_scatter(self, values: Values) -> Values:
        return np.asarray(SCATTER * np.maximum(np.abs(values), 0.1 * np.abs(values).max()))
