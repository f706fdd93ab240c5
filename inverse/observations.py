"""What is compared of a deposit: each observation exactly, as verdicts use it, and smoothly, as gradients need it.

The exact forms are those of `datasets.measures`; a target is always exact. A new observation is added here alone.
"""

import math
from collections.abc import Callable
from typing import Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.special import betainc
from torch import Tensor

from datasets import measures
from datasets.scene import Scene
from inverse.problem import Observable, ObservationSettings

Values = NDArray[np.float64]
"""An observation: M numbers [m], shape [M]."""


SHARES = (*(0.025 + 0.05 * number for number in range(20)), measures.FRONT_QUANTILE)
"""Shares of a profile's area: the middles of twenty equal parts, and the front."""


class Observation(Protocol):
    """Something measured on a deposit: M numbers in metres."""

    def exact(self, positions: NDArray[np.floating]) -> Values:
        """Of the positions of all points [m], shape [N, D]; returns shape [M]."""

    def smooth(self, positions: Tensor, volumes: Tensor) -> Tensor:
        """Of positions [m], shape [N, D], of points with `volumes` [m^D], shape [N]; differentiable; shape [M]."""

    def edge(self, values: Values) -> float:
        """How far the deposit reaches [m], as far as this observation alone can tell."""


class Front:
    """The x that 99.5 % of the points are behind."""

    def exact(self, positions: NDArray[np.floating]) -> Values:
        return np.array([measures.front(positions)])

    def smooth(self, positions: Tensor, volumes: Tensor) -> Tensor:
        return harrell_davis(positions[:, 0], volumes, measures.FRONT_QUANTILE).reshape(1)

    def edge(self, values: Values) -> float:
        return float(values[0])


class Runout:
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


class Profile:
    """The height profile, read sideways: the x behind which a given share of its area lies, for `SHARES` of it.

    The heights themselves (`datasets.measures.height_profile`) are a poor thing to compare: two fronts that do not
    overlap differ by the same heights however far they are apart. Positions of equal shares move with the deposit, and
    their mean square difference is the squared transport (Wasserstein) distance of the two areas: Engquist & Froese,
    Application of the Wasserstein metric to seismic signals, Commun. Math. Sci. 12 (2014) 979-988. In 3D the area is
    the mean over z.
    """

    def __init__(self, scene: Scene, spacing: float) -> None:
        self.stations = measures.profile_stations(scene, spacing)
        self.volume = sum(math.prod(mass.size) for mass in scene.masses)
        self.width = math.prod(scene.domain.size[2:])

    def heights(self, positions: NDArray[np.floating]) -> Values:
        """The profile itself [m], at `stations`; positions [m], shape [N, D]."""
        share = self.volume / (len(positions) * self.width)
        return measures.height_profile(positions, share, self.stations)

    def of_heights(self, heights: Values) -> Values:
        """The observation [M] of a profile [m] at `stations`."""
        return np.asarray(self._sideways(torch.from_numpy(heights)).numpy())

    def exact(self, positions: NDArray[np.floating]) -> Values:
        return self.of_heights(self.heights(positions))

    def smooth(self, positions: Tensor, volumes: Tensor) -> Tensor:
        stations = torch.from_numpy(self.stations)
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
        return self._sideways(heights * ends)

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


_BUILDERS: dict[Observable, Callable[[ObservationSettings, Scene], Observation]] = {
    Observable.FRONT: lambda settings, scene: Front(),
    Observable.RUNOUT: lambda settings, scene: Runout(scene),
    Observable.PROFILE: lambda settings, scene: Profile(scene, settings.spacing),
}


def build(settings: ObservationSettings, scene: Scene) -> Observation:
    """The observation that `settings` describe, for deposits of `scene`."""
    return _BUILDERS[settings.kind](settings, scene)


def loss(values: Values, target: Values) -> float:
    """Mean squared difference [m^2]; for one number the paper's (d - d_target)^2."""
    return float(np.mean((values - target) ** 2))
