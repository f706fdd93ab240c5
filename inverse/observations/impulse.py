"""Impulse and largest force on a solid. Solids are the baffles, counted from 0, then the others."""

from typing import Any, Self

import numpy as np
from torch import Tensor

from datasets.errors import InputError
from datasets.scene import Scene
from datasets.trajectory import Trajectory, solid_names
from inverse.observations.measured_profile import read_columns
from inverse.observations.observation import (
    Context,
    Measurement,
    Observation,
    Rollout,
    Values,
    at_times,
    require_times,
)
from inverse.settings import ObservationSettings

SCATTER = 0.05
"""Standard deviation of an impulse or a force from flow to flow over its value, until an ensemble has measured it."""


class SolidObservation(Observation):
    """A number of the impact on a solid along an axis; no surrogate predicts it."""

    of_positions = False

    def __init__(self, settings: ObservationSettings, scene: Scene, times: Values | None = None) -> None:
        """times: [s], shape [M]; the end where absent. Raises InputError for a solid or an axis that is not there."""
        names, asked = solid_names(scene), settings.solid
        number = names.index(asked) if isinstance(asked, str) and asked in names else asked
        if isinstance(number, str) or not 0 <= number < len(names):
            known = ", ".join(names) or "none, the scene has no solids"
            raise InputError(f"expected one of {known}, or its number from 0, got {asked!r}", key="solid")
        if not 0 <= settings.axis < scene.dimension:
            raise InputError(f"expected an index below {scene.dimension}, got {settings.axis}", key="axis")
        self.solid, self.axis, self.window, self.times = number, settings.axis, settings.window, times

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
        raise NotImplementedError

    def prior_scatter(self, values: Values, cell: float) -> Values:
        return np.asarray(SCATTER * np.maximum(np.abs(values), 0.1 * np.abs(values).max()))

    def check_value(self, value: float, scene: Scene) -> None:
        """Any number."""


class Impulse(SolidObservation):
    """The momentum that the flow has transferred to a solid along an axis, in the end or at given times.

    In 2D per metre of width.
    """

    kind = "impulse"
    label = "the impulse on a solid"
    unit = "N s"
    sources = ("value", "csv", "values")
    options = ("solid", "axis", "times")

    @classmethod
    def build(cls, settings: ObservationSettings, scene: Scene) -> Self:
        times = None if settings.times is None else require_times(np.array(settings.times), scene)
        return cls(settings, scene, times)

    @classmethod
    def read(cls, settings: ObservationSettings, context: Context) -> Measurement:
        if settings.csv is None:
            return super().read(settings, context)
        times, values = read_columns(context.folder / settings.csv, ("time", "impulse"))
        operator = cls(settings, context.scene, require_times(times, context.scene))
        return Measurement(observation=operator, values=values)

    @property
    def count(self) -> int:
        return 1 if self.times is None else len(self.times)

    def of_series(self, impulse: Any, time: Values) -> Any:
        return impulse[-1:] if self.times is None else at_times(lambda value: value, impulse, time, self.times)


class PeakForce(SolidObservation):
    """The largest force on a solid along an axis: max_t |I(t + w/2) - I(t - w/2)| / w, w the window, I the impulse.

    In 2D per metre of width. Differentiable but where the largest force changes from one time to another.
    """

    kind = "peak-force"
    label = "the largest force on a solid"
    unit = "N"
    options = ("solid", "axis", "window")

    @classmethod
    def build(cls, settings: ObservationSettings, scene: Scene) -> Self:
        if not 0.0 < settings.window <= scene.duration:
            raise InputError(f"expected a time in (0, {scene.duration:g}] s, got {settings.window}", key="window")
        return cls(settings, scene)

    def of_series(self, impulse: Any, time: Values) -> Any:
        # About frames around which the whole window lies in the run.
        room = (0.5 - 1e-9) * self.window
        middles = time[(time >= time[0] + room) & (time <= time[-1] - room)]
        if not len(middles):
            middles = np.array([0.5 * (time[0] + time[-1])])
        ends = (middles + half * self.window for half in (-0.5, 0.5))
        before, after = (at_times(lambda value: value, impulse, time, each) for each in ends)
        return abs(after - before).max().reshape(1) / self.window
