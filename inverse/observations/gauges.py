"""Records of instruments: heights and pore pressures at gauges, the impulse on a solid, and its peak force."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import torch
from torch import Tensor

from datasets.errors import InputError, require
from datasets.flow.trajectory import solid_names
from datasets.geometry.ground import elevation
from datasets.scene import Scene
from datasets.scene.grid_field import Floats
from datasets.scene.parts import Length
from datasets.scene.water import saturated
from inverse.observations.measured_profile import require_inside
from inverse.observations.observation import Rollout, SmoothObservation, Values, at_times
from inverse.observations.settings import LengthsSettings, ObservationSettings, SeriesSettings

AROUND, LEAST, FLAT = 2.0, 0.05, 1.0e-3
"""Half width over which a gauge averages pressure [cells]; filled share of it below which there is no flow; variance of
heights over the square of that width below which no slope is fitted."""


class Gauges(SmoothObservation):
    """The height at gauges, at the end or each at its own time: M numbers.

    h_g = sum_i V_i w(x_i - x_g) / int w dx,    w(s) = max(0, 1 - |s| / spacing)

    with V the volumes of the particles: like a profile, the height is at the initial density. In 3D, w also depends on
    z if z is given; else the height is the mean across the flow."""

    kind = "height"
    label = "the height at gauges"

    def __init__(self, scene: Scene, settings: "GaugesSettings") -> None:
        super().__init__(scene, settings)
        require(settings.x is not None, "x", "the x [m] of the gauges", "none")
        self.x = require_inside(np.array(settings.x), scene.domain.size[0])
        if self.times is not None:
            self.x, self.times = read_at(self.x, self.times, settings.count)
        self.z, self.spacing, self.count = settings.z, settings.spacing, len(self.x)
        inside = (z := settings.z) is None or (scene.dimension == 3 and 0.0 <= z <= scene.domain.size[2])
        require(inside, "z", "a z inside a box in 3D", z)
        # A gauge on dry ground may read slightly below its datum; heights in another unit lie beyond the box.
        self.limits = (-scene.domain.size[1], scene.domain.size[1])
        self.area = hat_area(self.x, self.spacing, scene.domain.size[0])
        if scene.dimension == 3:
            width = scene.domain.size[2]
            self.area = self.area * (width if z is None else float(hat_area(np.array([z]), self.spacing, width)[0]))

    @property
    def places(self) -> tuple[str, Values]:
        together = self.times is None or len(np.unique(self.times)) == 1
        return ("x [m]", self.x) if together else super().places

    def gathered(self, rows: Any) -> Any:
        return rows.diagonal()

    def smooth(self, positions: Tensor, volumes: Tensor) -> Tensor:
        distance = (positions[:, 0].double()[:, None] - torch.from_numpy(self.x)).abs() / self.spacing
        share = (1.0 - distance).clamp(min=0.0)
        if self.z is not None:
            across = (positions[:, 2].double() - self.z).abs() / self.spacing
            share = share * (1.0 - across).clamp(min=0.0)[:, None]
        return (volumes.double() @ share) / torch.from_numpy(self.area)


@dataclass(frozen=True, kw_only=True)
class GaugesSettings(LengthsSettings):
    """Settings of `Gauges`; the table has x, height and optionally time."""

    values: tuple[float, ...] | None = None  # a height [m] for each of `x`, or for each of these at each of `times`
    x: tuple[float, ...] | None = None  # of the gauges [m], if they are not in a table
    z: float | None = None  # of the gauges in 3D [m]; default: they take the mean across the flow
    times: tuple[float, ...] | None = None  # times [s] after the start; default: the end
    spacing: Length = 0.02  # half width over which a gauge takes the mean height [m]
    datum: float = 0.0  # height of the floor in a table [`unit`]

    operator_type = Gauges
    places: ClassVar = {"x": 0, "z": 2}
    columns: ClassVar = {"x": "x", "height": "values", "time": "times"}
    optional = ("time",)

    def table(
        self, path: Path, needed: Sequence[str], optional: Sequence[str] = (), dimension: int = 3
    ) -> dict[str, Floats]:
        table = super().table(path, needed, optional, dimension)
        return table | {"height": table["height"] - self.datum * self.metres}


class Impulse(SmoothObservation):
    """The momentum that the flow has transferred to a solid along an axis, in 2D per metre of width."""

    kind = "impulse"
    label = "the impulse on a solid"
    unit, scatter = "N s", 0.05
    over_time, of_positions = True, False

    def __init__(self, scene: Scene, settings: "ImpulseSettings | PeakForceSettings") -> None:
        super().__init__(scene, settings)
        self.unit += "/m" if scene.dimension == 2 else ""
        names, solid, axis = solid_names(scene), settings.solid, settings.axis
        number = names.index(solid) if isinstance(solid, str) and solid in names else solid
        if isinstance(number, str) or not 0 <= number < len(names):
            expected = ", ".join(names) or "none, the scene has no solids"
            raise InputError(f"expected one of {expected}, or its number from 0, got {solid!r}", key="solid")
        require(0 <= axis < scene.dimension, "axis", f"an index from 0 and below {scene.dimension}", axis)
        self.solid, self.axis = number, axis

    def predict(self, rollout: Rollout) -> Tensor:
        impulse = self.recorded(rollout)
        numbers: Tensor = (
            impulse[-1:] if self.times is None else at_times(lambda value: value, impulse, rollout.times, self.times)
        )
        return numbers

    def recorded(self, rollout: Rollout) -> Tensor:
        """The impulse on the solid along the axis, shape [T]. Raises InputError if the run has not recorded it."""
        impulses = rollout.impulses
        if impulses is None or self.solid >= impulses.shape[1]:
            raise InputError(f"expected a run that recorded the impulse on solid {self.solid}, it did not")
        return impulses[:, self.solid, self.axis]


@dataclass(frozen=True, kw_only=True)
class ImpulseSettings(SeriesSettings):
    """Settings of `Impulse` [N s], in 2D per metre of width; the table has time and impulse."""

    solid: int | str = 0  # which solid, by its name or its number: the baffles, from 0, then the other solids
    axis: int = 0  # along which axis of the scene: 0 for x, 1 for y, 2 for z

    operator_type = Impulse
    columns: ClassVar = {"time": "times", "impulse": "values"}


class PeakForce(Impulse):
    """The largest mean force on a solid along an axis, in either direction, over any period of length `window` [s].

        F = max over t of |J(t + window) - J(t)| / window,    J: the recorded impulse, linear between frames

    The difference is linear between the times at which t or t + window is a frame, so its maximum is at one of them."""

    kind = "peak-force"
    label = "the peak force on a solid"
    unit = "N"
    limits = (0.0, math.inf)

    def __init__(self, scene: Scene, settings: "PeakForceSettings") -> None:
        super().__init__(scene, settings)
        self.window = window = settings.window
        expected = f"a time from {scene.frame_dt:g} s, a frame, to {scene.duration:g} s, which the scene lasts"
        require(scene.frame_dt * (1.0 - 1e-9) <= window <= scene.duration, "window", expected, f"{window:g} s")

    def predict(self, rollout: Rollout) -> Tensor:
        impulse, time = self.recorded(rollout), rollout.times
        starts = np.concatenate([time, time - self.window])
        starts = starts[(starts >= time[0]) & (starts <= time[-1] - self.window * (1.0 - 1e-9))]
        first, last = (
            at_times(lambda value: value, impulse, time, moments) for moments in (starts, starts + self.window)
        )
        peak: Tensor = abs((last - first) / self.window).max().reshape(1)
        return peak


@dataclass(frozen=True, kw_only=True)
class PeakForceSettings(ObservationSettings):
    value: float | None = None  # [N], in 2D per metre of width
    window: float
    """Time over which the force is averaged [s]: that of the sensor or its filter, at least a frame of the scene."""
    solid: int | str = 0  # which solid, by its name or its number: the baffles, from 0, then the other solids
    axis: int = 0  # along which axis of the scene: 0 for x, 1 for y, 2 for z

    operator_type = PeakForce


class PorePressure(SmoothObservation):
    """The pore water pressure at gauges over time [Pa], each gauge at every time: M numbers.

        p_g = share (p - b (y - y_g))_+,   share = min(1, sum_i w_i V_i / V_0)

    p and y are means over the particles around a gauge with the weights w_i V_i, where w is a product of hat functions
    along the axes as in `Gauges`. b is the slope of the regression of p over y, so that a gauge on the ground reads the
    pressure there. V_0 is a twentieth of the volume that fills the hats: without flow there is no pressure."""

    kind = "pore-pressure"
    label = "the pore pressure at gauges"
    unit, scatter = "Pa", 0.05
    limits = (0.0, math.inf)
    over_time, of_positions, of_water = True, False, True

    def __init__(self, scene: Scene, settings: "PorePressureSettings") -> None:
        super().__init__(scene, settings)
        given = {key: getattr(settings, key) for key in "xyz"}
        require(saturated(scene) is not None, "kind", "a scene with saturated material", "a dry one")
        require(given["x"] is not None, "x", "the x [m] of the gauges", "none")
        require(settings.times is not None, "times", "the times [s] at which the gauges are read", "none")
        flat = scene.dimension == 2
        require((given["z"] is None) == flat, "z", "the z [m] of the gauges in 3D, none in 2D", given["z"])
        columns = {key: np.array(places, np.float64) for key, places in given.items() if places is not None}
        require(len({*map(len, columns.values())}) == 1, "x", "as many x, y and z as gauges", "others")
        for key, places in columns.items():
            length = scene.domain.size["xyz".index(key)]
            held = bool(((places >= 0.0) & (places <= length)).all())
            require(held, key, f"lengths between 0 and {length:g} m", places.tolist())
        plan = np.stack([columns[key] for key in "xz" if key in columns], axis=1)
        ground = elevation(scene.solids, scene.domain, plan)
        columns.setdefault("y", ground)
        deepest = int(np.argmin(columns["y"] - ground))
        above = columns["y"][deepest] >= ground[deepest] - scene.domain.cell
        expected = f"elevations above the ground, at {ground[deepest]:.4g} m for gauge {deepest}"
        require(above, "y", expected, f"{columns['y'][deepest]:.4g}")
        places = np.stack([columns[key] for key in "xyz" if key in columns], axis=1)
        gauges, self.times = read_at(places, np.array(settings.times), settings.count)
        self.gauges, self.which = np.unique(gauges, axis=0, return_inverse=True)
        self.spacing = settings.spacing or AROUND * scene.domain.cell
        self.count = len(self.times)

    @property
    def places(self) -> tuple[str, Values]:
        return super().places if len(self.gauges) == 1 else ("number", np.arange(1.0, self.count + 1.0))

    def gathered(self, rows: Any) -> Any:
        return rows[np.arange(self.count), self.which]

    def predict(self, rollout: Rollout) -> Tensor:
        water = rollout.pore_pressure
        if water is None:
            raise InputError("expected a run that recorded the pore pressure, it did not")
        state = torch.cat([rollout.positions.double(), water.double()[:, :, None]], dim=2)
        assert self.times is not None, "it has times"
        numbers: Tensor = self.gathered(at_times(partial(self.at, rollout.volumes), state, rollout.times, self.times))
        return numbers

    def at(self, volumes: Tensor, state: Tensor) -> Tensor:
        """The pressure at each gauge, shape [G], from positions and p of the particles [N, D + 1]."""
        places, p = state[:, :-1], state[:, -1]
        apart = (places[:, None] - torch.from_numpy(self.gauges)) / self.spacing
        weight = (1.0 - apart.abs()).clamp(min=0.0).prod(dim=2) * volumes.double()[:, None]
        total = weight.sum(dim=0)
        share, per = total / (LEAST * self.spacing**self.scene.dimension), 1.0 / total.clamp(min=1.0e-30)
        mean, middle = (weight * p[:, None]).sum(dim=0) * per, (weight * apart[:, :, 1]).sum(dim=0) * per
        across = apart[:, :, 1] - middle
        slope = (weight * across * p[:, None]).sum(dim=0) / ((weight * across**2).sum(dim=0) + FLAT * total + 1.0e-30)
        return share.clamp(max=1.0) * (mean - slope * middle).clamp(min=0.0)


@dataclass(frozen=True, kw_only=True)
class PorePressureSettings(LengthsSettings):
    """Settings of `PorePressure`; the table has time and pressure, for several gauges also x, optionally y and z."""

    values: tuple[float, ...] | None = None  # one [Pa] for each gauge at each of `times`, one gauge after the other
    x: tuple[float, ...] | None = None  # of the gauges [m]
    y: tuple[float, ...] | None = None  # their elevations [m]; default: on the ground
    z: tuple[float, ...] | None = None  # in 3D [m]
    times: tuple[float, ...] | None = None  # times [s] after the start
    spacing: Length | None = None  # half width over which a gauge takes the mean [m]; default: two cells

    operator_type = PorePressure
    places: ClassVar = {"x": 0, "y": 1, "z": 2}
    columns: ClassVar = {"time": "times", "pressure": "values", "x": "x", "y": "y", "z": "z"}
    optional = ("x", "y", "z")


def read_at(gauges: Floats, times: Values, count: int | None) -> tuple[Floats, Values]:
    """Gauges [G, ...] and times [s]: one for each, or every gauge at every time, one gauge after the other. Equal
    numbers of gauges and times are read as pairs, unless `count`, the number of values, needs all combinations."""
    if len(times) == len(gauges) and count != len(gauges) * len(times):
        return gauges, times
    return np.repeat(gauges, len(times), axis=0), np.tile(times, len(gauges))


def hat_area(x: Values, spacing: float, length: float) -> Values:
    """The integral of w of `Gauges` at `x` [m] between the walls 0 and `length` [m], shape as `x`."""
    cut = [0.5 * np.maximum(0.0, spacing - room) ** 2 / spacing for room in (x, length - x)]
    return np.asarray(spacing - cut[0] - cut[1])
