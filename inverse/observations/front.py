"""The front of a deposit, the x that 99.5 % of its particles are behind, in the end or at given times."""

from typing import Self

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from datasets import measures
from datasets.errors import InputError
from datasets.scene import Scene
from datasets.trajectory import Trajectory
from inverse.observations.measured_profile import read_columns
from inverse.observations.observation import (
    Context,
    DepositObservation,
    Measurement,
    Observation,
    Rollout,
    Values,
    harrell_davis,
)
from inverse.observations.sampling import at_times, predicted_at_times, require_count, require_inside, require_times
from inverse.observations.target import Target
from inverse.settings import LoopSettings, ObservationSettings


class Front(DepositObservation):
    """The x that 99.5 % of the particles are behind."""

    kind = "front"
    label = "the front of the deposit, the x that 99.5 % of its particles are behind"
    scalar = True
    along_flow = True
    distance_unit = (100.0, "% of the front")

    @classmethod
    def build(cls, settings: ObservationSettings, scene: Scene) -> Self:
        return cls()

    def exact(self, positions: NDArray[np.floating]) -> Values:
        return np.array([measures.front(positions)])

    def smooth(self, positions: Tensor, volumes: Tensor) -> Tensor:
        return harrell_davis(positions[:, 0], volumes, measures.FRONT_QUANTILE).reshape(1)

    def front(self, values: Values) -> float:
        return float(values[0])

    def distance(self, values: Values, target: Values) -> float:
        """Relative to the target's [-]."""
        return float(np.abs(values - target).sum() / np.abs(target).sum())

    def tolerance(self, loop: LoopSettings, cell: float, target: Target, scatter: float) -> float:
        """Or half of the scatter: twice the standard error of a mean of eight runs, which decides no finer."""
        return max(loop.confirm_within, 0.5 * scatter)


class FrontOverTime(Observation):
    """The front at given times."""

    kind = "front-over-time"
    label = "the front over time"
    sources = ("csv", "values")
    source = "csv, or values at times"
    options = ("times", "unit")
    alone = False
    over_time = True
    times: Values

    def __init__(self, times: Values) -> None:
        """times: [s] after the start, shape [M]."""
        self.times = times

    @classmethod
    def build(cls, settings: ObservationSettings, scene: Scene) -> Self:
        if settings.times is None:
            raise InputError("expected the times [s] of the fronts", key="times")
        return cls(require_times(np.array(settings.times), scene))

    @classmethod
    def read(cls, settings: ObservationSettings, context: Context) -> Measurement:
        if settings.csv is None:
            return super().read(settings, context)
        path, scene = context.folder / settings.csv, context.scene
        times, fronts = read_columns(path, ("time", "front"))
        fronts = require_inside(fronts * settings.unit.metres, scene.domain.size[0], path)
        return Measurement(observation=cls(require_times(times, scene, path)), values=fronts)

    def stated(self, settings: ObservationSettings, scene: Scene) -> Values | None:
        return require_count(super().stated(settings, scene), len(self.times))

    def observe(self, trajectory: Trajectory) -> Values:
        def front(positions: NDArray[np.floating]) -> Values:
            return np.array([measures.front(positions)])

        return at_times(front, trajectory, self.times)[:, 0]

    def predict(self, rollout: Rollout) -> Tensor:
        def front(positions: Tensor) -> Tensor:
            return harrell_davis(positions[:, 0], rollout.volumes, measures.FRONT_QUANTILE).reshape(1)

        return predicted_at_times(front, rollout, self.times)[:, 0]
