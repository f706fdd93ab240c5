"""What an observation operator is: M numbers of a flow, exactly for verdicts and smoothly for gradients.

A new kind is an operator, its settings beside it, and a line in `inverse.observations.KINDS`.
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

LONG = 1.0e4  # numbers from here on are written without decimals
SCATTER_CELLS = 0.25  # standard deviation of a length from flow to flow, before an ensemble has measured it, in cells
SMALL = 0.1  # of the largest number: smaller ones scatter as much as this where they scatter in proportion


@dataclass(frozen=True, kw_only=True)
class Rollout:
    """The particles' positions from the start to the end, and where it is the MPM's what solids took meanwhile."""

    positions: Tensor
    """[m], shape [T, N, D]."""
    times: Values
    """[s], shape [T]."""
    volumes: Tensor
    """[m^D], shape [N]."""
    impulses: Tensor | None = None
    """Momentum that solids have taken [N s], in 2D per metre of width, shape [T, solids, D]; no surrogate has it."""
    pore_pressure: Tensor | None = None
    """Of the particles where it was recorded [Pa], shape [T, N]; no surrogate has it."""


@dataclass(frozen=True, kw_only=True)
class JointPart:
    """One of the observations that are compared together."""

    name: str
    """As reports call it."""
    observation: "Observation"
    numbers: slice
    """Which of all numbers are its own."""


class Observation:
    """An observation operator."""

    kind: ClassVar[str]
    """Its name in a problem's TOML."""
    label: ClassVar[str]
    """As reports call it."""
    unit: ClassVar[str] = "m"
    """Of the numbers; empty for a share."""
    scatter: ClassVar[float | None] = None
    """Standard deviation from flow to flow over a number, before an ensemble has measured it; of lengths None."""
    limits: tuple[Any, Any] = (-math.inf, math.inf)
    """Between which its numbers are possible."""
    every_particle: ClassVar[bool] = False
    """Whether its numbers are those of single particles: too many for a Jacobian, and as many in every run."""
    count: int = 1
    """M, of numbers that were measured."""
    components: int = 1
    """How many of the numbers are the components of one point: their squared differences add up in the misfit."""
    scale: Values | float = 1.0
    """What 1 stands for in the unit of a number, shape [M] or the same for all."""
    times: Values | None = None
    """When it looks at the flow [s], one time for each number or one for all; in the end where absent."""
    over_time: bool = False
    """Whether it needs more of a trajectory than its last frame."""
    of_positions: bool = True
    """Whether it follows from positions alone: what the surrogate predicts."""
    of_water: bool = False
    """Whether it needs the pore pressure of the particles."""
    dense: ClassVar[bool] = False
    """Whether it follows from positions all the same, of more particles than a surrogate has."""

    def __init__(self, scene: Scene, settings: Any = None) -> None:
        """The operator for flows of `scene` by the settings of its kind. Raises InputError, which names their key."""
        self.scene = scene
        self.parts: tuple[JointPart, ...] = (JointPart(name=self.kind, observation=self, numbers=slice(None)),)
        if (times := getattr(settings, "times", None)) is None:
            return
        self.times, self.count, self.over_time = np.array(times), len(times), True
        beyond = self.times[(self.times < 0.0) | (self.times > scene.duration * (1.0 + 1e-9))]
        expected = f"times in [0, {scene.duration:g}] s, which the scene lasts"
        require(len(beyond) == 0, "times", expected, ", ".join(f"{time:g}" for time in beyond))

    def observe(self, trajectory: Trajectory) -> Values:
        """Of a run, exactly; shape [M]."""
        if self.times is None:
            return self.exact(trajectory.positions[-1])
        return np.asarray(self.gathered(at_times(self.exact, trajectory.positions, trajectory.time, self.times)))

    def predict(self, rollout: Rollout) -> Tensor:
        """Of a rollout, differentiable; shape [M]."""
        smooth = partial(self.smooth, volumes=rollout.volumes)
        if self.times is None:
            return smooth(rollout.positions[-1])
        numbers: Tensor = self.gathered(at_times(smooth, rollout.positions, rollout.times, self.times))
        return numbers

    def gathered(self, rows: Any) -> Any:
        """The numbers [M] from those at each of the times [T, ...]."""
        return rows.reshape(-1)

    def exact(self, positions: NDArray[np.floating]) -> Values:
        """Of the positions of all particles [m], shape [N, D]; returns shape [M]."""
        raise NotImplementedError(f"{self.kind} of positions")

    def smooth(self, positions: Tensor, volumes: Tensor) -> Tensor:
        """Of positions [m], shape [N, D], of particles with `volumes` [m^D], shape [N]; differentiable; shape [M]."""
        raise NotImplementedError(f"{self.kind} of positions")

    def front(self, values: Values) -> float:
        """The deposit's front [m] by this observation alone; nan where it does not give it."""
        return math.nan

    def at_end(self, values: Values) -> float:
        """The latest of `values` [M]; nan where the scene lasts more than a frame longer, and the flow may go on."""
        if self.times is None:
            return float(values[-1])
        latest, end = self.times.max(), self.scene.duration - self.scene.frame_dt
        return float(values[self.times == latest][-1]) if latest >= end * (1.0 - 1e-9) else math.nan

    def of_particles(self, values: Values, indices: NDArray[np.int64]) -> Values:
        """The part of an exact observation that can be compared with that of the particles `indices` alone."""
        return values

    def misfit(self, values: Values, target: Values) -> float:
        """Mean over numbers or points of the squared distance from the target [unit^2], as in the paper."""
        return self.components * float(np.mean((values - target) ** 2))

    @property
    def places(self) -> tuple[str, Values]:
        """Where or when its numbers were observed, shape [M], and what that is; numbers from 1 on where neither is."""
        if self.times is not None and len(self.times) == self.count:
            return "time [s]", self.times
        return "number", np.arange(1.0, self.count + 1.0)

    def scores(self, positions: NDArray[np.floating], volumes: Values) -> dict[str, float]:
        """How well a deposit [m], shape [N, D], of `volumes` [N] covers what was observed, by name [-]."""
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
    """One whose smooth form is the exact one too: a run is observed as a rollout is, by its own volumes."""

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
    """Several observations, each number over its standard deviation, so that all are compared in one sum.

        z_i = y_i / s_i,    s_i^2 = n_i^2 + c_i^2,    misfit = 1/M sum_i (z_i - z*_i)^2

    y are the numbers in their own units, n their standard deviations by errors of the measurement, c (`prior`) those of
    one flow, another initial jitter: what two perfect measurements of one sand differ by. The weights 1 / s^2 (`scale`)
    are those of least squares; c keeps a number that was measured very precisely from outweighing all others.
    """

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
    """What a run of the MPM has to record for these."""
    moving, wet = (any(getattr(observation, key) for observation in observations) for key in ("over_time", "of_water"))
    return Recording(frames="all" if moving else "last", pore_pressure=wet)


def at_times(operator: Callable[[Any], Any], series: Any, time: Values, times: Values) -> Any:
    """`operator` of a series [T, ...], arrays or tensors, at each of `times` [s], shape [times, ...].

    Between two frames the series is linear in time: heights at a gauge are far from it.
    """
    different, which = np.unique(times, return_inverse=True)
    before, share = brackets(time, different)
    after = np.minimum(before + 1, len(time) - 1)
    between = zip(before.tolist(), after.tolist(), share.tolist(), strict=True)
    rows = [operator((1.0 - s) * series[b] + s * series[a]) for b, a, s in between]
    return torch.stack(rows)[torch.from_numpy(which)] if isinstance(rows[0], Tensor) else np.stack(rows)[which]


def fitted_tail(values: Tensor, volumes: Tensor) -> Tensor:
    """The value that 99.5 % of the volume is behind, by a fit (`measures.front`), differentiable; both of shape [n]."""
    ordered, order = torch.sort(values.double())
    weights = measures.tail_weights(volumes.detach().double().numpy()[order.numpy()])
    return torch.minimum((torch.from_numpy(weights) * ordered).sum(), ordered[-1])
