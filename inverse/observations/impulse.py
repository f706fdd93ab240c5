"""Impulse and largest force on a solid. Solids are the baffles, counted from 0, then the others."""

from typing import Self

import numpy as np
import torch
from torch import Tensor

from datasets.errors import InputError
from datasets.scene import Scene
from datasets.trajectory import Trajectory, solid_names
from inverse.observations.measured_profile import read_columns
from inverse.observations.observation import Context, Measurement, Observation, Rollout, Values
from inverse.observations.sampling import brackets, require_count, require_times
from inverse.settings import ObservationSettings

SCATTER = 0.05
"""Standard deviation of an impulse or a force from flow to flow over its value, until an ensemble has measured it."""


class SolidObservation(Observation):
    """A number of the impact on a solid along an axis; no surrogate predicts it."""

    alone = False
    over_time = True
    of_positions = False

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
    source = "value, csv, or values at times"
    options = ("solid", "axis", "times")

    def __init__(self, solid: int, axis: int, times: Values | None = None) -> None:
        """times: [s], shape [M]; the end where absent."""
        self.solid, self.axis, self.times = solid, axis, times

    @classmethod
    def build(cls, settings: ObservationSettings, scene: Scene) -> Self:
        times = None if settings.times is None else require_times(np.array(settings.times), scene)
        return cls(solid_of(settings, scene), settings.axis, times)

    @classmethod
    def read(cls, settings: ObservationSettings, context: Context) -> Measurement:
        if settings.csv is None:
            return super().read(settings, context)
        path, scene = context.folder / settings.csv, context.scene
        times, values = read_columns(path, ("time", "impulse"))
        operator = cls(solid_of(settings, scene), settings.axis, require_times(times, scene, path))
        return Measurement(observation=operator, values=values)

    def stated(self, settings: ObservationSettings, scene: Scene) -> Values | None:
        return require_count(super().stated(settings, scene), 1 if self.times is None else len(self.times))

    def observe(self, trajectory: Trajectory) -> Values:
        impulse = impulse_on(trajectory, self.solid, self.axis)
        if self.times is None:
            return impulse[-1:].copy()
        return np.asarray(np.interp(self.times, trajectory.time, impulse))

    def predict(self, rollout: Rollout) -> Tensor:
        impulse = predicted_impulse(rollout, self.solid, self.axis)
        return impulse[-1:] if self.times is None else interpolated(impulse, rollout.times, self.times)


class PeakForce(SolidObservation):
    """The largest force on a solid along an axis: max_t |I(t + w/2) - I(t - w/2)| / w, w the window, I the impulse.

    In 2D per metre of width.
    """

    kind = "peak-force"
    label = "the largest force on a solid"
    unit = "N"
    options = ("solid", "axis", "window")

    def __init__(self, solid: int, axis: int, window: float) -> None:
        """window: [s]."""
        self.solid, self.axis, self.window = solid, axis, window

    @classmethod
    def build(cls, settings: ObservationSettings, scene: Scene) -> Self:
        solid = solid_of(settings, scene)
        if not 0.0 < settings.window <= scene.duration:
            raise InputError(f"expected a time in (0, {scene.duration:g}] s, got {settings.window}", key="window")
        return cls(solid, settings.axis, settings.window)

    def observe(self, trajectory: Trajectory) -> Values:
        impulse, time = impulse_on(trajectory, self.solid, self.axis), trajectory.time
        middles = self.middles(time)
        before, after = (np.interp(middles + half * self.window, time, impulse) for half in (-0.5, 0.5))
        return np.array([np.abs(after - before).max(initial=0.0) / self.window])

    def predict(self, rollout: Rollout) -> Tensor:
        """Differentiable but where the largest force changes from one time to another."""
        impulse, middles = predicted_impulse(rollout, self.solid, self.axis), self.middles(rollout.times)
        before, after = (interpolated(impulse, rollout.times, middles + half * self.window) for half in (-0.5, 0.5))
        return (after - before).abs().max().reshape(1) / self.window

    def middles(self, time: Values) -> Values:
        """The frames about which the whole window lies in the run [s]."""
        inner = (time >= time[0] + (0.5 - 1e-9) * self.window) & (time <= time[-1] - (0.5 - 1e-9) * self.window)
        return np.asarray(time[inner])


def solid_of(settings: ObservationSettings, scene: Scene) -> int:
    """The number of the solid that the settings name. Raises InputError for a solid or an axis that is not there."""
    names, asked = solid_names(scene), settings.solid
    number = names.index(asked) if isinstance(asked, str) and asked in names else asked
    if isinstance(number, str) or not 0 <= number < len(names):
        known = ", ".join(names) or "none, the scene has no solids"
        raise InputError(f"expected one of {known}, or its number from 0, got {asked!r}", key="solid")
    if not 0 <= settings.axis < scene.dimension:
        raise InputError(f"expected an index below {scene.dimension}, got {settings.axis}", key="axis")
    return number


def impulse_on(trajectory: Trajectory, solid: int, axis: int) -> Values:
    """Impulse on a solid along an axis, shape [T]. Raises InputError where none was recorded."""
    impulse = trajectory.solid_impulse
    if impulse is None or solid >= impulse.shape[1]:
        raise InputError(f"expected a run that recorded the impulse on solid {solid}, it did not")
    return np.asarray(impulse[:, solid, axis])


def predicted_impulse(rollout: Rollout, solid: int, axis: int) -> Tensor:
    """As `impulse_on`, differentiable."""
    if rollout.impulses is None or solid >= rollout.impulses.shape[1]:
        raise InputError(f"expected a run that recorded the impulse on solid {solid}, it did not")
    return rollout.impulses[:, solid, axis]


def interpolated(values: Tensor, time: Values, times: Values) -> Tensor:
    """`values` [T] at each of `times` [s], linear in time, differentiable; shape [M]."""
    before, share = brackets(time, times)
    after = np.minimum(before + 1, len(time) - 1)
    return torch.lerp(values[before], values[after], torch.from_numpy(share).to(values))
