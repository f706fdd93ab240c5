"""Heights of the flow at gauges, in the end or at times of their own."""

from typing import Self

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from datasets.errors import InputError
from datasets.particles import particle_volumes, released_volume
from datasets.scene import Scene
from datasets.trajectory import Trajectory
from inverse.observations.measured_profile import read_columns
from inverse.observations.observation import Context, Measurement, Observation, Rollout, Values
from inverse.observations.sampling import at_times, predicted_at_times, require_count, require_inside, require_times
from inverse.settings import ObservationSettings


class Gauges(Observation):
    """The height at gauges, in the end or each at a time of its own: M numbers.

    h_g = sum_i V_i w(x_i - x_g) / int w dx,    w(s) = max(0, 1 - |s| / spacing)

    with V the volumes of the particles: at its initial density, as a profile. In 3D w is also of z where that is given;
    else the height is the mean across the flow.
    """

    kind = "height"
    label = "the height at gauges"
    sources = ("csv", "values")
    source = "csv, or values at x"
    options = ("x", "z", "times", "spacing", "unit", "datum")
    alone = False

    def __init__(
        self, scene: Scene, x: Values, *, spacing: float, z: float | None = None, times: Values | None = None
    ) -> None:
        """x: of each number [m], shape [M]; times: of each [s], shape [M], the end where absent; spacing, z: [m]."""
        self.x, self.z, self.spacing, self.times = x, z, spacing, times
        self.over_time = times is not None
        self.area = hat_area(x, spacing, scene.domain.size[0])
        if scene.dimension == 3:
            width = scene.domain.size[2]
            self.area = self.area * (width if z is None else float(hat_area(np.array([z]), spacing, width)[0]))

    @classmethod
    def build(cls, settings: ObservationSettings, scene: Scene) -> Self:
        if settings.x is None:
            raise InputError("expected the x [m] of the gauges", key="x")
        x = require_inside(np.array(settings.x), scene.domain.size[0])
        times = None if settings.times is None else require_times(np.array(settings.times), scene)
        if times is not None and len(times) != len(x):
            # Every gauge at every time, one gauge after the other.
            x, times = np.repeat(x, len(times)), np.tile(times, len(x))
        return cls._at(settings, scene, x, times)

    @classmethod
    def read(cls, settings: ObservationSettings, context: Context) -> Measurement:
        if settings.csv is None:
            return super().read(settings, context)
        path, scene, metres = context.folder / settings.csv, context.scene, settings.unit.metres
        columns = read_columns(path, ("x", "height"), optional=("time",))
        x = require_inside(columns[0] * metres, scene.domain.size[0], path)
        times = require_times(columns[2], scene, path) if len(columns) > 2 else None
        values = (columns[1] - settings.datum) * metres
        return Measurement(observation=cls._at(settings, scene, x, times), values=values)

    @classmethod
    def _at(cls, settings: ObservationSettings, scene: Scene, x: Values, times: Values | None) -> Self:
        if settings.z is not None and (scene.dimension != 3 or not 0.0 <= settings.z <= scene.domain.size[2]):
            raise InputError(f"expected a z inside a box in 3D, got {settings.z:g}", key="z")
        return cls(scene, x, spacing=settings.spacing, z=settings.z, times=times)

    def stated(self, settings: ObservationSettings, scene: Scene) -> Values | None:
        return require_count(super().stated(settings, scene), len(self.x))

    def observe(self, trajectory: Trajectory) -> Values:
        scene = trajectory.scene
        volumes = particle_volumes(scene, trajectory.positions.shape[1])
        # Of particles from elsewhere only the mean volume is known, as in a profile.
        volumes = volumes * (released_volume(scene) / volumes.sum())

        def heights(positions: NDArray[np.floating]) -> Values:
            with torch.no_grad():
                return np.asarray(self._heights(torch.from_numpy(positions), torch.from_numpy(volumes)).numpy())

        if self.times is None:
            return heights(trajectory.positions[-1])
        return np.asarray(at_times(heights, trajectory, self.times).diagonal())

    def predict(self, rollout: Rollout) -> Tensor:
        def heights(positions: Tensor) -> Tensor:
            return self._heights(positions, rollout.volumes)

        if self.times is None:
            return heights(rollout.positions[-1])
        return predicted_at_times(heights, rollout, self.times).diagonal()

    def _heights(self, positions: Tensor, volumes: Tensor) -> Tensor:
        distance = (positions[:, 0].double()[:, None] - torch.from_numpy(self.x)).abs() / self.spacing
        share = (1.0 - distance).clamp(min=0.0)
        if self.z is not None:
            across = (positions[:, 2].double() - self.z).abs() / self.spacing
            share = share * (1.0 - across).clamp(min=0.0)[:, None]
        return (volumes.double() @ share) / torch.from_numpy(self.area)


def hat_area(x: Values, spacing: float, length: float) -> Values:
    """int w of `Gauges` at `x` [m] between the walls 0 and `length` [m], shape as `x`."""
    cut = [0.5 * np.maximum(0.0, spacing - room) ** 2 / spacing for room in (x, length - x)]
    return np.asarray(spacing - cut[0] - cut[1])
