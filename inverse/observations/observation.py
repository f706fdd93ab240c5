"""What an observation operator is: an object that holds all that depends on which one it is, each kind in one file.

A new kind is a class in a file of its own and a line in `inverse.observations.KINDS`.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np
import torch
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from numpy.typing import NDArray
from scipy.special import betainc
from torch import Tensor

from datasets import measures
from datasets.errors import InputError
from datasets.scene import Scene
from datasets.trajectory import Trajectory
from inverse.settings import LoopSettings, ObservationSettings

if TYPE_CHECKING:
    from inverse.observations.measured_profile import MeasuredProfile
    from inverse.observations.target import Target

Values = NDArray[np.float64]
"""An observation: M numbers in their unit, shape [M]."""
Matrix = NDArray[np.float64]

SCATTER_CELLS = 0.25
"""Standard deviation of a length from flow to flow, before an ensemble has measured it, in cells."""


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


@dataclass(frozen=True, kw_only=True)
class Context:
    """What the numbers of a measurement are read and checked with."""

    scene: Scene
    folder: Path
    """Relative paths start here."""
    released: float | None
    """Volume of the masses over the width [m^2]; None where that is itself a parameter."""
    joint: bool
    """Whether other observations are compared along with it."""


@dataclass(frozen=True, kw_only=True)
class Errors:
    """Errors of the measurement."""

    covariance: Matrix
    """Of the numbers, shape [M, M]."""
    roughness: float = 1.0
    """By how much a measured profile scatters more than its stated noise."""
    profile: tuple[Values, Values] | None = None
    """Of a profile: stations and heights [m], both of shape [S]."""
    deviation: Values | None = None
    """Standard deviation of each of these heights [m], shape [S]."""


@dataclass(frozen=True, kw_only=True)
class Measurement:
    """An operator and what was measured with it."""

    observation: "Observation"
    values: Values | None
    """Shape [M]; None where a simulated flow makes them."""
    profile: "MeasuredProfile | None" = None
    """Where a height profile was measured."""


class Observation(ABC):
    """An observation operator: M numbers of a flow, exactly for verdicts and smoothly for gradients."""

    kind: ClassVar[str]
    """Its name in a problem's TOML."""
    label: ClassVar[str]
    """As reports call it."""
    unit: ClassVar[str] = "m"
    """Of the numbers; empty for a share."""
    sources: ClassVar[tuple[str, ...]] = ("value",)
    """Keys under which its numbers may stand."""
    source: ClassVar[str] = "value"
    """The same in words."""
    options: ClassVar[tuple[str, ...]] = ()
    """Keys of its settings besides `kind`, `name`, `noise` and those of its numbers."""
    alone: ClassVar[bool] = True
    """Whether it may be a problem's only observation: there is a tolerance for it."""
    jointly: ClassVar[bool] = True
    """Whether it may be one of multiple observations."""
    scalar: ClassVar[bool] = False
    """Whether it is one number."""
    every_particle: ClassVar[bool] = False
    """Whether its numbers are those of single particles: too many for a Jacobian, and as many in every run."""
    along_flow: ClassVar[bool] = False
    """Whether its numbers are lengths along x, which grow with the runout."""
    components: int = 1
    """How many of the numbers are the components of one point: their squared differences add up in the misfit."""
    over_time: bool = False
    """Whether it needs more of a trajectory than its last frame."""
    times: Values | None = None
    """When it looks at the flow [s], where it does so at times."""
    of_positions: bool = True
    """Whether it follows from positions alone: what the surrogate predicts."""
    distance_unit: ClassVar[tuple[float, str]] = (100.0, "%")
    """Factor and unit in which `distance` is reported."""
    change_unit: ClassVar[tuple[float, str]] = (1e3, "mm")
    """Factor and unit in which a change of a number is reported."""

    # The operator

    @classmethod
    @abstractmethod
    def build(cls, settings: ObservationSettings, scene: Scene) -> Self:
        """The operator for flows of `scene`. Raises InputError, which names the key of the settings."""

    @classmethod
    def read(cls, settings: ObservationSettings, context: Context) -> Measurement:
        """The operator and its numbers. Raises InputError, which names the key or the file."""
        observation = cls.build(settings, context.scene)
        return Measurement(observation=observation, values=observation.stated(settings, context.scene))

    def stated(self, settings: ObservationSettings, scene: Scene) -> Values | None:
        """The numbers that stand in the settings themselves, shape [M]. Raises InputError for impossible ones."""
        if settings.value is not None:
            self.check_value(settings.value, scene)
            return np.array([settings.value])
        return None if settings.values is None else np.array(settings.values)

    def check_value(self, value: float, scene: Scene) -> None:
        """Raise InputError unless the one number is possible: by default a length in the box."""
        length = scene.domain.size[0]
        if not 0.0 < value <= length:
            raise InputError(f"expected a length in (0, {length:g}] m, got {value}", key="value")

    def check_run(self, run: Trajectory, scene: Scene) -> None:  # noqa: B027
        """Raise InputError for an observed run that cannot be compared with runs of `scene`."""

    def profile_of(self, run: Trajectory) -> "MeasuredProfile | None":
        """Of a simulated flow the profile whose heights have errors; None where there is none."""
        return None

    @abstractmethod
    def observe(self, trajectory: Trajectory) -> Values:
        """Of a run, exactly; shape [M]."""

    def predict(self, rollout: Rollout) -> Tensor:
        """Of a rollout, differentiable; shape [M]."""
        raise NotImplementedError(f"{self.kind} of a rollout")

    def front(self, values: Values) -> float:
        """The deposit's front [m] by this observation alone; nan where it does not give it."""
        return math.nan

    def of_particles(self, values: Values, indices: NDArray[np.int64]) -> Values:
        """The part of an exact observation that can be compared with that of the particles `indices` alone."""
        return values

    # Against a target

    def misfit(self, values: Values, target: Values) -> float:
        """Mean over what is compared of the squared distance from the target [unit^2].

        For one number the paper's (d - d_target)^2, for points the mean of |p - p_target|^2.
        """
        return self.components * float(np.mean((values - target) ** 2))

    def distance(self, values: Values, target: Values) -> float:
        """How far two observations are apart in the measure of the verdict: by default root mean square [unit]."""
        return math.sqrt(self.misfit(values, target))

    def tolerance(self, loop: LoopSettings, cell: float, target: "Target", scatter: float) -> float:
        """The largest `distance` from the target within which the MPM confirms.

        cell: of the grid [m]; scatter: root mean square of `distance` between runs that differ in their jitter seed
        alone. Where twice of it is more than what was asked for, that is what can be had.
        """
        raise NotImplementedError(f"{self.kind} is no problem's only observation; `alone` says so")

    def is_within(
        self,
        loop: LoopSettings,
        cell: float,
        target: "Target",
        values: Values,
        *,
        front_error: float,
        scatter: float,
        front_scatter: float,
    ) -> bool:
        """Whether the MPM's `values` [M] confirm.

        front_error: relative error of its front [-]; scatter: see `tolerance`; front_scatter: the same of the front.
        """
        if abs(front_error) > self.front_tolerance(loop, target, front_scatter):
            return False
        return self.distance(values, target.values) <= self.tolerance(loop, cell, target, scatter)

    def front_tolerance(self, loop: LoopSettings, target: "Target", front_scatter: float) -> float:
        """Relative error of the front [-] within which the MPM confirms; infinite where only the numbers count."""
        return math.inf

    def prior_scatter(self, values: Values, cell: float) -> Values:
        """Expected standard deviation of each of `values` [M] from flow to flow, shape [M]."""
        return np.full(len(values), SCATTER_CELLS * cell)

    def errors(
        self, values: Values, profile: "MeasuredProfile | None", *, share: float, noise: float, cell: float
    ) -> Errors:
        """Errors of the measured `values` [M], by default independent of each other.

        share, noise: stated standard deviation as a share of each number [-] and in its unit; cell: [m].
        """
        return Errors(covariance=np.diag((share * values) ** 2 + noise**2))

    def residuals(
        self, target: "Target", found: Sequence[Trajectory], ensemble: Sequence[Trajectory]
    ) -> tuple[Values, Values, Matrix]:
        """Mean residual [K] of the runs `found`, standard deviation [K] of the target, numbers [n, K] of `ensemble`."""
        noise = np.full(len(target.values), target.noise)
        if target.covariance is not None:
            noise = np.sqrt(np.diag(target.covariance))
        shown = np.mean([self.observe(run) for run in found], axis=0)
        return shown - target.values, noise, np.stack([self.observe(run) for run in ensemble])

    # In reports and pictures

    def raw(self, values: Values) -> Values:
        """`values` [M] in their own units."""
        return values

    def record(self) -> dict[str, Any]:
        """What `result.json` tells of the numbers besides their values."""
        return {}

    @classmethod
    def misfit_unit(cls) -> str:
        """Unit of the misfit."""
        return f"{cls.unit}^2" if cls.unit else "-"

    def values_text(self, values: Values) -> str:
        """The numbers in words."""
        return f"{self.kind} {values[0]:.4f} {self.unit}"

    @classmethod
    def distance_text(cls, distance: float) -> str:
        """`distance` in words."""
        factor, unit = cls.distance_unit
        return f"{factor * distance:.3g} {unit}"

    @classmethod
    def change_text(cls, change: float, *, sign: bool = True) -> str:
        """A change of a number in words."""
        factor, unit = cls.change_unit
        return f"{factor * change:{'+' if sign else ''}.3g} {unit}"

    @classmethod
    def misfit_text(cls, misfit: float, cell: float) -> str:
        """The distance that a misfit stands for, in words; cell: [m]."""
        root = math.sqrt(misfit)
        return f"{1e3 * root:.3g} mm ({root / cell:.2g} cells)"

    def caption(self, deposit: NDArray[np.floating]) -> str:
        """What was observed of a deposit, positions [m], shape [N, D], in a few words."""
        return f"front at {measures.front(deposit):.4f} m"

    def mark(self, axis: Axes, deposit: NDArray[np.floating], colour: str, target: Values | None) -> None:
        """Mark what was observed on a picture of a deposit, positions [m], shape [N, D]; target: shape [M]."""
        axis.axvline(measures.front(deposit), color=colour, linewidth=0.9)

    def mark_profile(self, axis: Axes) -> None:  # noqa: B027
        """Mark on a picture of height profiles where the observation was made."""

    def legend(self) -> list[Line2D]:
        """What the marks mean."""
        return []


class DepositObservation(Observation):
    """Something observed of a deposit alone."""

    def observe(self, trajectory: Trajectory) -> Values:
        return self.exact(trajectory.positions[-1])

    def predict(self, rollout: Rollout) -> Tensor:
        return self.smooth(rollout.positions[-1], rollout.volumes)

    @abstractmethod
    def exact(self, positions: NDArray[np.floating]) -> Values:
        """Of the positions of all particles [m], shape [N, D]; returns shape [M]."""

    @abstractmethod
    def smooth(self, positions: Tensor, volumes: Tensor) -> Tensor:
        """Of positions [m], shape [N, D], of particles with `volumes` [m^D], shape [N]; differentiable; shape [M]."""


def harrell_davis(values: Tensor, volumes: Tensor, quantile: float) -> Tensor:
    """The quantile as a weighted mean of all order statistics: smooth, where the usual one depends on one particle.

    Harrell & Davis, A new distribution-free quantile estimator, Biometrika 69 (1982) 635-640:
    sum_i w_i x_(i) with w_i = I_{c_i}(a, b) - I_{c_(i-1)}(a, b), a = (n + 1) q, b = (n + 1) (1 - q), I the regularised
    incomplete beta function and c_i = i/n, here the share of the volume up to the i-th particle. `values` and
    `volumes` of shape [n].
    """
    ordered, order = torch.sort(values.double())
    count = len(values)
    shares = np.cumsum(volumes.detach().double().numpy()[order.numpy()])
    shares = np.concatenate([[0.0], shares / shares[-1]])
    weights = np.diff(betainc((count + 1) * quantile, (count + 1) * (1.0 - quantile), shares))
    return (torch.from_numpy(weights) * ordered).sum()
