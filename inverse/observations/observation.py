"""Observation operators: M numbers of a flow, in an exact form for verdicts and a smooth form for gradients.

A new kind needs an operator, its settings and a line in `inverse.observations.KINDS`.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from datasets.errors import require
from datasets.flow import measures
from datasets.flow.trajectory import Trajectory, brackets
from datasets.forces import momentum
from datasets.scene import Scene
from mpm.output.recording import Recording

Values = NDArray[np.float64]  # an observation: M numbers in their unit, shape [M]
Between = tuple[float, float]  # the least and the greatest value

LONG = 1.0e4  # numbers of at least this are written without decimals
SCATTER_CELLS = 0.25  # standard deviation of a length from flow to flow, before an ensemble has measured it, in cells
SMALL = 0.1  # share of the largest number: if scatter is proportional, smaller numbers scatter as much as this


@dataclass(frozen=True, kw_only=True)
class Rollout:
    """The particles' positions from start to end and, from the MPM, impulses and pore pressure."""

    positions: Tensor  # positions [m], shape [T, N, D]
    times: Values  # times [s], shape [T]
    volumes: Tensor  # volumes [m^D], shape [N]
    impulses: Tensor | None = None  # on each solid [N s], in 2D per metre of width, [T, solids, D]; not of a surrogate
    pore_pressure: Tensor | None = None  # of the particles, if recorded [Pa], shape [T, N]; not from a surrogate


@dataclass(frozen=True, kw_only=True)
class JointPart:
    """One of the observations that are compared together."""

    name: str  # name in reports
    observation: "Observation"
    numbers: slice  # its part of all numbers


class Observation:
    """An observation operator."""

    kind: ClassVar[str]  # name in a problem's TOML
    label: ClassVar[str]  # name in reports
    unit: str = "m"  # unit of the numbers; empty for a share
    scatter: ClassVar[float | None] = None  # deviation from flow to flow over a number before any run; None for lengths
    limits: tuple[Any, Any] = (-math.inf, math.inf)  # smallest and largest possible number
    every_particle: ClassVar[bool] = False  # whether numbers are of single particles: many, and as many in every run
    count: int = 1  # M, the number of measured numbers
    components: int = 1  # number of components of one point: their squared differences add up in the misfit
    scale: Values | float = 1.0  # the value of 1 in the unit of a number, shape [M] or the same for all
    times: Values | None = None  # times of the observation [s], one for each number or one for all; default: the end
    over_time: bool = False  # whether it needs more of a trajectory than its last frame
    of_positions: bool = True  # whether it follows from positions alone, which the surrogate predicts
    of_water: bool = False  # whether it needs the pore pressure of the particles
    dense: ClassVar[bool] = False  # whether it follows from positions, but of more particles than a surrogate has

    def __init__(self, scene: Scene, settings: Any = None) -> None:
        """The operator for flows of `scene` with the settings of its kind. Raises InputError, which names their key."""
        self.scene = scene
        self.parts: tuple[JointPart, ...] = (JointPart(name=self.kind, observation=self, numbers=slice(None)),)
        if (times := getattr(settings, "times", None)) is None:
            return
        self.times, self.count, self.over_time = np.array(times), len(times), True
        beyond = self.times[(self.times < 0.0) | (self.times > scene.duration * (1.0 + 1e-9))]
        expected = f"times in [0, {scene.duration:g}] s, which the scene lasts"
        require(len(beyond) == 0, "times", expected, ", ".join(f"{time:g}" for time in beyond))

    def observe(self, trajectory: Trajectory) -> Values:
        """The exact observation of a run, shape [M]."""
        if self.times is None:
            return self.exact(trajectory.positions[-1])
        return np.asarray(self.gathered(at_times(self.exact, trajectory.positions, trajectory.time, self.times)))

    def predict(self, rollout: Rollout) -> Tensor:
        """The differentiable observation of a rollout, shape [M]."""
        smooth = partial(self.smooth, volumes=rollout.volumes)
        if self.times is None:
            return smooth(rollout.positions[-1])
        numbers: Tensor = self.gathered(at_times(smooth, rollout.positions, rollout.times, self.times))
        return numbers

    def gathered(self, rows: Any) -> Any:
        """The numbers [M] from the values at each of the times [T, ...]."""
        return rows.reshape(-1)

    def exact(self, positions: NDArray[np.floating]) -> Values:
        """The exact observation, shape [M], of the positions of all particles [m], shape [N, D]."""
        raise NotImplementedError(f"{self.kind} of positions")

    def smooth(self, positions: Tensor, volumes: Tensor) -> Tensor:
        """The differentiable observation, shape [M], of positions [m], [N, D], with `volumes` [m^D], [N]."""
        raise NotImplementedError(f"{self.kind} of positions")

    def front(self, values: Values) -> float:
        """The deposit's front [m] from this observation alone; nan if it does not determine the front."""
        return math.nan

    def at_end(self, values: Values) -> float:
        """The latest of `values` [M]; nan if the scene lasts more than a frame longer, as the flow may continue."""
        if self.times is None:
            return float(values[-1])
        latest, end = self.times.max(), self.scene.duration - self.scene.frame_dt
        return float(values[self.times == latest][-1]) if latest >= end * (1.0 - 1e-9) else math.nan

    def of_particles(self, values: Values, indices: NDArray[np.int64]) -> Values:
        """The part of an exact observation that belongs to the particles `indices`."""
        return values

    def misfit(self, values: Values, target: Values) -> float:
        """Mean over numbers or points of the squared distance from the target [unit^2], as in the paper."""
        return self.components * float(np.mean((values - target) ** 2))

    @property
    def places(self) -> tuple[str, Values]:
        """Label and places or times of the numbers, shape [M]; without either, numbers from 1 on."""
        if self.times is not None and len(self.times) == self.count:
            return "time [s]", self.times
        return "number", np.arange(1.0, self.count + 1.0)

    def scores(self, positions: NDArray[np.floating], volumes: Values) -> dict[str, float]:
        """Name -> score of how well a deposit [m], [N, D], of `volumes` [N] covers the observed area [-]."""
        return {}

    def prior_scatter(self, values: Values) -> Values:
        """Expected standard deviation of each of `values` [M] from flow to flow, shape [M]."""
        if self.scatter is None:
            return np.full(len(values), SCATTER_CELLS * self.scene.domain.cell)
        return np.asarray(self.scatter * np.maximum(np.abs(values), SMALL * np.abs(values).max()))

    def text(self, values: Values) -> str:
        if len(values) > 3:
            return f"{len(values)} numbers"
        return f"{', '.join(f'{v:.4f}' if abs(v) < LONG else f'{v:.6g}' for v in values)} {self.unit}".strip()

    def root_text(self, root: float) -> str:
        """A root mean square of changes of the numbers in words."""
        small = {"m": (1e3, "mm"), "": (100.0, "%")}
        factor, unit = (1.0, self.unit) if root >= 1.0 and self.unit else small.get(self.unit, (1.0, self.unit))
        return f"{factor * root:.3g} {unit}"


class SmoothObservation(Observation):
    """An observation whose smooth form is also exact: a run is observed like a rollout, with its own volumes."""

    def observe(self, trajectory: Trajectory) -> Values:
        impulse, water = momentum(trajectory), trajectory.pore_pressure
        rollout = Rollout(
            positions=torch.from_numpy(np.asarray(trajectory.positions)),
            times=trajectory.time,
            volumes=torch.from_numpy(trajectory.volumes),
            impulses=None if impulse is None else torch.from_numpy(impulse),
            pore_pressure=None if water is None else torch.from_numpy(np.asarray(water)),
        )
        return np.asarray(self.predict(rollout).numpy())


class Joint(Observation):
    """Several observations, compared in one sum by dividing each number by its standard deviation.

        z_i = y_i / s_i,    s_i^2 = n_i^2 + c_i^2,    misfit = 1/M sum_i (z_i - z*_i)^2

    y are the numbers in their own units, n their standard deviations from measurement errors, c (`prior`) those between
    flows with different initial jitter, as between two perfect measurements of one sand. The weights 1 / s^2 (`scale`)
    are those of least squares; c prevents a very precisely measured number from outweighing all others."""

    kind = "joint"
    label = "several observations"
    unit = "standard deviations"

    def __init__(self, parts: Sequence[JointPart], scale: Values, prior: Values) -> None:
        """scale, prior: of each number, in its unit, both of shape [M]."""
        self.parts, self.scale, self.prior = tuple(parts), scale, prior
        self.of_positions = all(part.observation.of_positions for part in parts)
        self.over_time = any(part.observation.over_time for part in parts)
        self.of_water = any(part.observation.of_water for part in parts)

    def observe(self, trajectory: Trajectory) -> Values:
        return np.concatenate([part.observation.observe(trajectory) for part in self.parts]) / self.scale

    def predict(self, rollout: Rollout) -> Tensor:
        numbers = torch.cat([part.observation.predict(rollout) for part in self.parts])
        return numbers / torch.as_tensor(self.scale)

    def prior_scatter(self, values: Values) -> Values:
        return np.asarray(self.prior / self.scale)

    def front(self, values: Values) -> float:
        measured = self.scale * values
        fronts = [part.observation.front(measured[part.numbers]) for part in self.parts]
        return next(filter(math.isfinite, fronts), math.nan)


def recording(observations: Sequence[Observation]) -> Recording:
    """The quantities that an MPM run has to record for these observations."""
    moving, wet = (any(getattr(observation, key) for observation in observations) for key in ("over_time", "of_water"))
    return Recording(frames="all" if moving else "last", pore_pressure=wet)


def at_times(operator: Callable[[Any], Any], series: Any, time: Values, times: Values) -> Any:
    """`operator` of a series [T, ...], arrays or tensors, at each of `times` [s], shape [times, ...]. Between two
    frames it interpolates the series, not the result: heights at a gauge are not linear in time."""
    different, which = np.unique(times, return_inverse=True)
    before, share = brackets(time, different)
    after = np.minimum(before + 1, len(time) - 1)
    between = zip(before.tolist(), after.tolist(), share.tolist(), strict=True)
    rows = [operator((1.0 - s) * series[b] + s * series[a]) for b, a, s in between]
    return torch.stack(rows)[torch.from_numpy(which)] if isinstance(rows[0], Tensor) else np.stack(rows)[which]


def fitted_tail(values: Tensor, volumes: Tensor) -> Tensor:
    """The value behind which 99.5 % of the volume lies, by a differentiable fit (`measures.front`); inputs [n]."""
    ordered, order = torch.sort(values.double())
    weights = measures.tail_weights(volumes.detach().double().numpy()[order.numpy()])
    return torch.minimum((torch.from_numpy(weights) * ordered).sum(), ordered[-1])
