"""What is compared of a deposit: each observation exactly, as verdicts use it, and smoothly, as gradients need it.

The exact forms are those of `datasets.measures`; a target is always exact. A new observation is added here alone.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy.optimize
import torch
from numpy.typing import NDArray
from scipy.special import betainc
from torch import Tensor

from datasets import measures
from datasets.particles import particle_volumes, released_volume
from datasets.scene import Scene
from datasets.trajectory import Trajectory
from inverse.problem import Observable, ObservationSettings

Values = NDArray[np.float64]
"""An observation: M numbers, shape [M]; lengths [m], but for a share, which has no unit."""

SHARES = (*(0.025 + 0.05 * number for number in range(20)), measures.FRONT_QUANTILE)
"""Shares of a profile's area: the middles of twenty equal parts, and the front."""


@dataclass(frozen=True, kw_only=True)
class Rollout:
    """Where particles were from the start to the end, as the surrogate predicts it."""

    positions: Tensor
    """[m], shape [T, N, D]."""
    times: Values
    """[s], shape [T]."""
    volumes: Tensor
    """[m^D], shape [N]."""


class Observation(ABC):
    """Something measured on a flow: M numbers."""

    unit = "m"
    """Of the numbers; empty for a share."""
    components = 1
    """How many of the numbers are the components of one point: their squared differences add up (see `loss`)."""
    over_time = False
    """Whether it needs more of a trajectory than its last frame."""
    by_surrogate = True
    """Whether a learned surrogate can tell it."""

    @abstractmethod
    def observe(self, trajectory: Trajectory) -> Values:
        """Of a run, exactly; shape [M]."""

    @abstractmethod
    def predict(self, rollout: Rollout) -> Tensor:
        """Of a rollout of the surrogate, differentiable; shape [M]."""

    @abstractmethod
    def edge(self, values: Values) -> float:
        """How far the deposit reaches [m], as far as this observation alone can tell; nan where it cannot."""

    def of_points(self, values: Values, indices: NDArray[np.int64]) -> Values:
        """The part of an exact observation that the points `indices` alone can be held against."""
        return values


class OfDeposit(Observation):
    """Something measured on a deposit."""

    def observe(self, trajectory: Trajectory) -> Values:
        return self.exact(trajectory.positions[-1])

    def predict(self, rollout: Rollout) -> Tensor:
        return self.smooth(rollout.positions[-1], rollout.volumes)

    @abstractmethod
    def exact(self, positions: NDArray[np.floating]) -> Values:
        """Of the positions of all points [m], shape [N, D]; returns shape [M]."""

    @abstractmethod
    def smooth(self, positions: Tensor, volumes: Tensor) -> Tensor:
        """Of positions [m], shape [N, D], of points with `volumes` [m^D], shape [N]; differentiable; shape [M]."""


class Front(OfDeposit):
    """The x that 99.5 % of the points are behind."""

    def exact(self, positions: NDArray[np.floating]) -> Values:
        return np.array([measures.front(positions)])

    def smooth(self, positions: Tensor, volumes: Tensor) -> Tensor:
        return harrell_davis(positions[:, 0], volumes, measures.FRONT_QUANTILE).reshape(1)

    def edge(self, values: Values) -> float:
        return float(values[0])


class Runout(OfDeposit):
    """The largest x; smoothly, the mean of x under weights exp(x / width) over the points.

    The width is a quarter of a cell: points further than a cell behind the first hardly count.
    """

    def __init__(self, scene: Scene) -> None:
        self.width = 0.25 * scene.domain.cell

    def exact(self, positions: NDArray[np.floating]) -> Values:
        return np.array([measures.runout(positions)])

    def smooth(self, positions: Tensor, volumes: Tensor) -> Tensor:
        x = positions[:, 0].double()
        return (torch.softmax(x / self.width, 0) * x).sum().reshape(1)

    def edge(self, values: Values) -> float:
        return float(values[0])


class Profile(OfDeposit):
    """The height profile, read sideways: the x behind which a given share of its area lies, for `SHARES` of it.

    The heights themselves (`datasets.measures.height_profile`) are a poor thing to compare: two fronts that do not
    overlap differ by the same heights however far they are apart. Positions of equal shares move with the deposit, and
    their mean square difference is the squared transport (Wasserstein) distance of the two areas: Engquist & Froese,
    Application of the Wasserstein metric to seismic signals, Commun. Math. Sci. 12 (2014) 979-988. In 3D the area is
    the mean over z.
    """

    def __init__(self, scene: Scene, spacing: float) -> None:
        self.stations = measures.profile_stations(scene, spacing)
        self.scene, self.volume = scene, released_volume(scene)
        self.width = math.prod(scene.domain.size[2:])

    def heights(self, positions: NDArray[np.floating]) -> Values:
        """The profile itself [m], at `stations`; positions [m], shape [N, D]."""
        return self.at(positions, self.stations)

    def at(self, positions: NDArray[np.floating], stations: Values) -> Values:
        """The profile [m] at evenly spaced `stations` [m]; positions [m], shape [N, D]."""
        volumes = particle_volumes(self.scene, len(positions))
        # Of particles from elsewhere only the mean volume is known: that of the masses over their number.
        share = volumes * (self.volume / (volumes.sum() * self.width))
        return measures.height_profile(positions, share, stations)

    def of_heights(self, heights: Values) -> Values:
        """The observation [M] of a profile [m] at `stations`."""
        return np.asarray(self._sideways(torch.from_numpy(heights)).numpy())

    def exact(self, positions: NDArray[np.floating]) -> Values:
        return self.of_heights(self.heights(positions))

    def smooth(self, positions: Tensor, volumes: Tensor) -> Tensor:
        return self._sideways(self.smooth_heights(positions, volumes, self.stations))

    @staticmethod
    def smooth_heights(positions: Tensor, volumes: Tensor, along: Values) -> Tensor:
        """The profile at evenly spaced stations `along` x [m], but for a constant factor, shape [S]; differentiable."""
        stations = torch.from_numpy(along)
        spacing, last = stations[1] - stations[0], len(stations) - 1
        place = ((positions[:, 0].double() - stations[0]) / spacing).clamp(0.0, float(last))
        left = place.detach().long().clamp(max=last - 1)
        share = place - left
        area = volumes.double()
        heights = torch.zeros(last + 1, dtype=torch.float64)
        heights = heights.index_add(0, left, area * (1.0 - share)).index_add(0, left + 1, area * share)
        # Half of a station's length lies beyond the wall.
        ends = torch.ones_like(heights)
        ends[[0, last]] = 2.0
        return heights * ends

    def _sideways(self, heights: Tensor) -> Tensor:
        stations = torch.from_numpy(self.stations)
        pieces = (heights[1:] + heights[:-1]) * 0.5
        area = torch.cat([torch.zeros(1, dtype=torch.float64), torch.cumsum(pieces, 0)])
        wanted = torch.tensor(SHARES, dtype=torch.float64) * area[-1]
        right = torch.searchsorted(area.detach(), wanted.detach()).clamp(1, len(pieces))
        part = (wanted - area[right - 1]) / pieces[right - 1]
        return stations[right - 1] + part * (stations[1] - stations[0])

    def edge(self, values: Values) -> float:
        return float(values[-1])


class Toe(OfDeposit):
    """The centroid of the furthest 10 % of the points, D numbers; the loss is the paper's |c - c_target|^2.

    Smoothly, a point at x belongs to them by 1 / (1 + exp((t - x) / width)), with the t at which the volume of all that
    belong is a tenth: a soft rank. The share of a point that falls back goes to the others, and its part in the
    centroid's y and z as well, which fixed weights by rank would not see. The width is half a cell.
    """

    def __init__(self, scene: Scene) -> None:
        self.width = 0.5 * scene.domain.cell
        self.components = scene.dimension

    def exact(self, positions: NDArray[np.floating]) -> Values:
        return np.array(measures.toe(positions))

    def smooth(self, positions: Tensor, volumes: Tensor) -> Tensor:
        places, share = positions.double(), volumes.double() / volumes.double().sum()
        x = places[:, 0]
        known, weights = x.detach(), share.detach()
        low, high = float(known.min()) - 40.0 * self.width, float(known.max()) + 40.0 * self.width

        def surplus(threshold: float) -> float:
            return float(weights @ torch.sigmoid((known - threshold) / self.width)) - measures.TOE_FRACTION

        found = scipy.optimize.brentq(surplus, low, high, xtol=1e-14, rtol=1e-14)
        belongs = torch.sigmoid((x - found) / self.width)
        # A step of Newton's at the root changes its value by rounding alone and gives it its gradient.
        slope = (weights @ (belongs * (1.0 - belongs)).detach()) / self.width
        threshold = found + (share @ belongs - measures.TOE_FRACTION) / slope
        weight = share * torch.sigmoid((x - threshold) / self.width)
        return (weight / weight.sum()) @ places

    def edge(self, values: Values) -> float:
        return float(values[0])


class Deposit(OfDeposit):
    """Where every point came to rest, N D numbers; the loss is the paper's mean over the points of |p - p_target|^2.

    The surrogate follows some of the points: it is held against the same ones of the target.
    """

    def __init__(self, scene: Scene) -> None:
        self.components = scene.dimension

    def exact(self, positions: NDArray[np.floating]) -> Values:
        return np.asarray(positions.astype(np.float64).ravel())

    def smooth(self, positions: Tensor, volumes: Tensor) -> Tensor:
        return positions.double().flatten()

    def edge(self, values: Values) -> float:
        return measures.front(values.reshape(-1, self.components))

    def of_points(self, values: Values, indices: NDArray[np.int64]) -> Values:
        return np.asarray(values.reshape(-1, self.components)[indices].ravel())


class Passed(OfDeposit):
    """The share of the volume that came to rest beyond a line across the flow, x = `line` [m].

    Smoothly, a point at x counts as 1 / (1 + exp((line - x) / width)).
    """

    unit = ""

    def __init__(self, scene: Scene, line: float, width: float) -> None:
        self.scene, self.line, self.width = scene, line, width

    def exact(self, positions: NDArray[np.floating]) -> Values:
        volumes = particle_volumes(self.scene, len(positions))
        return np.array([np.average(positions[:, 0].astype(np.float64) > self.line, weights=volumes)])

    def smooth(self, positions: Tensor, volumes: Tensor) -> Tensor:
        share = volumes.double() / volumes.double().sum()
        return (share @ torch.sigmoid((positions[:, 0].double() - self.line) / self.width)).reshape(1)

    def edge(self, values: Values) -> float:
        return math.nan


def harrell_davis(values: Tensor, volumes: Tensor, quantile: float) -> Tensor:
    """The quantile as a weighted mean of all order statistics: smooth where the usual one is a single point's fate.

    Harrell & Davis, A new distribution-free quantile estimator, Biometrika 69 (1982) 635-640:
    sum_i w_i x_(i) with w_i = I_{c_i}(a, b) - I_{c_(i-1)}(a, b), a = (n + 1) q, b = (n + 1) (1 - q), I the regularised
    incomplete beta function and c_i = i/n, here the share of the volume up to the i-th point. `values` and `volumes`
    of shape [n]; the gradient reaches each point by its weight.
    """
    ordered, order = torch.sort(values.double())
    count = len(values)
    shares = np.cumsum(volumes.detach().double().numpy()[order.numpy()])
    shares = np.concatenate([[0.0], shares / shares[-1]])
    weights = np.diff(betainc((count + 1) * quantile, (count + 1) * (1.0 - quantile), shares))
    return (torch.from_numpy(weights) * ordered).sum()


def _passed(settings: ObservationSettings, scene: Scene) -> OfDeposit:
    assert settings.line is not None, "a problem has been checked"
    return Passed(scene, settings.line, settings.width or scene.domain.cell)


_BUILDERS: dict[Observable, Callable[[ObservationSettings, Scene], OfDeposit]] = {
    Observable.FRONT: lambda settings, scene: Front(),
    Observable.RUNOUT: lambda settings, scene: Runout(scene),
    Observable.PROFILE: lambda settings, scene: Profile(scene, settings.spacing),
    Observable.TOE: lambda settings, scene: Toe(scene),
    Observable.DEPOSIT: lambda settings, scene: Deposit(scene),
    Observable.PASSED: _passed,
}


def build(settings: ObservationSettings, scene: Scene) -> OfDeposit:
    """The observation that `settings` describe, for deposits of `scene`."""
    return _BUILDERS[settings.kind](settings, scene)


def loss(values: Values, target: Values, components: int = 1) -> float:
    """Mean over what is compared of the squared distance from the target [m^2; of a share without a unit].

    For one number the paper's (d - d_target)^2. components: of `Observation`, numbers that make up one thing.
    """
    return components * float(np.mean((values - target) ** 2))
