"""Records of a camera or a radar of a moving flow: its arrival at a place, and its speed there."""

import math
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import torch
from torch import Tensor

from datasets.errors import require
from datasets.geometry.placement import corners
from datasets.scene import Scene
from datasets.scene.parts import Length
from inverse.observations.gauges import Gauges, GaugesSettings
from inverse.observations.measured_profile import require_inside
from inverse.observations.observation import Rollout, SmoothObservation, Values, at_times, fitted_tail
from inverse.observations.settings import LengthsSettings, SeriesSettings

LAYER = 0.5
"""Share of a layer of particles. With less material than this at the place, the speed is scaled in proportion: a single
particle is no flow."""


class Arrival(SmoothObservation):
    """The times at which the flow reaches some x: M times [s].

        t = t_k + (L - s_k) / (s_(k+1) - s_k) (t_(k+1) - t_k)    of the first frames with s_k < L <= s_(k+1)

    s is the front and L the x; with a `thickness`, s is the height at the x, as at a gauge (`Gauges`), and L the
    thickness. A flow that stops short of L is continued at its mean rate so far, so that the number is continuous:
    t_max (L - s_0) / (s_max - s_0), at most twice the time of the last frame."""

    kind = "arrival"
    label = "the time at which the flow arrives"
    unit, scatter = "s", 0.02
    over_time = True

    def __init__(self, scene: Scene, settings: "ArrivalSettings") -> None:
        super().__init__(scene, settings)
        x, z, self.thickness = settings.x, settings.z, settings.thickness
        require(x is not None, "x", "the x [m] that the flow reaches", "none")
        tall = z is None or self.thickness is not None
        require(tall, "thickness", "a thickness, above which the flow is at z", "none")
        self.x = require_inside(np.array(x), scene.domain.size[0])
        gauges = GaugesSettings(x=x, z=z, spacing=settings.spacing)
        self.gauges = None if self.thickness is None else Gauges(scene, gauges)
        self.count, self.limits = len(self.x), (0.0, scene.duration)

    @property
    def places(self) -> tuple[str, Values]:
        return "x [m]", self.x

    def predict(self, rollout: Rollout) -> Tensor:
        if self.gauges is None:
            front = torch.stack([fitted_tail(frame[:, 0], rollout.volumes) for frame in rollout.positions])
            return torch.stack([first_passage(front, rollout.times, float(level)) for level in self.x])
        heights = torch.stack([self.gauges.smooth(frame, rollout.volumes) for frame in rollout.positions])
        level = float(self.thickness or 0.0)
        return torch.stack([first_passage(series, rollout.times, level) for series in heights.T])


def first_passage(series: Tensor, time: Values, level: float) -> Tensor:
    """The time at which `series` [T] at `time` [s] first reaches `level`, as in `Arrival`."""
    begin, latest = float(time[0]), 2.0 * float(time[-1])
    reached, top = torch.nonzero(series.detach() >= level), int(series.detach().argmax())
    if len(reached) > 0:
        last = int(reached[0, 0])
        if last == 0:
            return series.new_tensor(begin)
        share = (level - series[last - 1]) / (series[last] - series[last - 1])
        passed: Tensor = time[last - 1] + share * (time[last] - time[last - 1])
        return passed
    if top == 0:
        return series.new_tensor(latest)
    late: Tensor = begin + (time[top] - begin) * (level - series[0]) / (series[top] - series[0])
    return late.clamp(max=latest)


@dataclass(frozen=True, kw_only=True)
class ArrivalSettings(LengthsSettings):
    """Settings of `Arrival`; the table has x and time."""

    values: tuple[float, ...] | None = None  # a time [s] for each of `x`, after the start
    x: tuple[float, ...] | None = None  # places that the flow reaches [m], if they are not in a table
    z: float | None = None  # in 3D with a thickness: place across the flow [m]; default: the mean over the width
    thickness: Length | None = None  # height above which the flow has arrived [m]; default: the front arrives
    spacing: Length = 0.02  # half width over which this height is a mean [m]

    operator_type = Arrival
    places: ClassVar = {"x": 0, "z": 2}
    columns: ClassVar = {"x": "x", "time": "values"}


class Speed(SmoothObservation):
    """Mean speed of the material between two x, in 3D optionally two z, at some times or the largest over time [m/s].

        v = sum_p w_p V_p |x_p(t + T/2) - x_p(t - T/2)| / T / max(sum_p w_p V_p, V_0),    T = `window`

    V are the volumes of the particles, proportional to their masses; w is 1 in the region and falls to 0 over a cell at
    its edges; V_0 is half a layer of particles over the region, which is limited to the initial extent of all masses:
    a flow is narrower than its box. At the start and the end of the flow, T is shortened to the recorded time."""

    kind = "speed"
    label = "the speed of the flow at a place"
    unit, scatter = "m/s", 0.05
    limits = (0.0, math.inf)
    over_time = True

    def __init__(self, scene: Scene, settings: "SpeedSettings") -> None:
        super().__init__(scene, settings)
        cell, self.window, area, z = scene.domain.cell, settings.window or scene.frame_dt, 1.0, settings.z
        lower, upper = corners(scene.masses)
        released = upper.max(axis=0) - lower.min(axis=0)
        expected = f"a time in (0, {scene.duration:g}] s"
        require(0.0 < self.window <= scene.duration, "window", expected, settings.window)
        require(z is None or scene.dimension == 3, "z", "none in 2D", z)
        self.sides: list[tuple[int, float, float]] = []
        for axis, key, ends in ((0, "x", settings.x), (2, "z", z)):
            length = scene.domain.size[axis] if axis < scene.dimension else 1.0
            if ends is not None:
                expected = f"two lengths between 0 and {length:g} m, a cell apart"
                held = len(ends) == 2 and 0.0 <= ends[0] <= ends[-1] - cell and ends[-1] <= length
                require(held, key, expected, list(ends))
                self.sides.append((axis, ends[0], ends[1]))
                length = ends[1] - ends[0]
            area *= min(length, float(released[axis])) if axis < scene.dimension else length
        self.least = LAYER * scene.particle_spacing * area

    def predict(self, rollout: Rollout) -> Tensor:
        if self.times is not None:
            return torch.stack([self.at(rollout, float(time)) for time in self.times])
        middles = 0.5 * (rollout.times[1:] + rollout.times[:-1])
        return torch.stack([self.at(rollout, float(time)) for time in middles]).max().reshape(1)

    def at(self, rollout: Rollout, time: float) -> Tensor:
        """The mean speed at a time [s], a number."""
        ends = np.clip([time - 0.5 * self.window, time + 0.5 * self.window], rollout.times[0], rollout.times[-1])
        moments = np.array([ends[0], time, ends[1]])
        before, here, after = at_times(lambda frame: frame.double(), rollout.positions, rollout.times, moments)
        # The root has no slope at 0, for a particle at rest.
        moved = ((after - before) ** 2).sum(dim=1).clamp(min=1e-24).sqrt() / (ends[1] - ends[0])
        weight: Any = rollout.volumes.double()
        for axis, low, high in self.sides:
            along, cell = here[:, axis], self.scene.domain.cell
            weight = weight * ((along - low) / cell + 0.5).clamp(0.0, 1.0)
            weight = weight * ((high - along) / cell + 0.5).clamp(0.0, 1.0)
        mean: Tensor = (weight @ moved) / weight.sum().clamp(min=self.least)
        return mean


@dataclass(frozen=True, kw_only=True)
class SpeedSettings(SeriesSettings):
    """Settings of `Speed` [m/s], without times the largest over time; the table has time and speed."""

    x: tuple[float, ...]  # the two x of the region [m]
    z: tuple[float, ...] | None = None  # in 3D its two z [m]; default: the whole width
    window: float | None = None  # time over which a particle's speed is averaged [s]; default: a frame of the scene

    operator_type = Speed
    places: ClassVar = {"x": 0, "z": 2}
    columns: ClassVar = {"time": "times", "speed": "values"}
