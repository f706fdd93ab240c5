"""Where a flow came to rest: front, runout, toe, the share beyond a line, every particle, the outline."""

from typing import ClassVar

import numpy as np
import scipy.optimize
import torch
from numpy.typing import NDArray
from torch import Tensor

from datasets import measures
from datasets.errors import InputError
from datasets.particles import mass_centroids, mass_volumes, particle_volumes
from datasets.scene import Scene
from inverse.observations.measured import Context, read_columns, require_inside
from inverse.observations.observation import Measurement, Observation, Values, fitted_tail
from inverse.settings import ObservationSettings

SHARE_SCATTER = 0.005
"""Standard deviation of a share from flow to flow [-], before an ensemble has measured it."""
DIRECTIONS_DEG = np.arange(0.0, 360.0, 22.5)
"""Of an outline, where none are named."""


class Front(Observation):
    """The x that 99.5 % of the volume is behind, by a fit (`measures.front`)."""

    kind = "front"
    label = "the front, the x that 99.5 % of the volume is behind"
    sources = ("value", "values", "csv")
    options = ("times", "unit")
    columns: ClassVar = {"time": "times", "front": "values"}

    def __init__(self, settings: ObservationSettings, scene: Scene) -> None:
        super().__init__(settings, scene)
        self.limits = (0.0, scene.domain.size[0])

    def exact(self, positions: NDArray[np.floating]) -> Values:
        return np.array([measures.front(positions, particle_volumes(self.scene, len(positions)))])

    def smooth(self, positions: Tensor, volumes: Tensor) -> Tensor:
        return fitted_tail(positions[:, 0], volumes).reshape(1)

    def front(self, values: Values) -> float:
        return float(values[-1])


class Runout(Observation):
    """The largest x; smoothly its mean under weights exp(x / width), the width a quarter of a cell."""

    kind = "runout"
    label = "the runout, the largest x of the deposit"

    def __init__(self, settings: ObservationSettings, scene: Scene) -> None:
        super().__init__(settings, scene)
        self.limits, self.width = (0.0, scene.domain.size[0]), 0.25 * scene.domain.cell

    def exact(self, positions: NDArray[np.floating]) -> Values:
        return np.array([measures.runout(positions)])

    def smooth(self, positions: Tensor, volumes: Tensor) -> Tensor:
        x = positions[:, 0].double()
        return (torch.softmax(x / self.width, 0) * x).sum().reshape(1)


class Toe(Observation):
    """The centroid of the furthest 10 % of the particles, D numbers; the misfit is the paper's |c - c_target|^2.

    Smoothly, a particle at x belongs to them by 1 / (1 + exp((t - x) / width)), the width half a cell, with the t at
    which the volume of all that belong is a tenth: a soft rank, by which the share of a particle that falls back goes
    to the others.
    """

    kind = "toe"
    label = "the toe, the centroid of the furthest 10 % of the particles"
    sources = ("values",)

    def __init__(self, settings: ObservationSettings, scene: Scene) -> None:
        super().__init__(settings, scene)
        self.width, self.components = 0.5 * scene.domain.cell, scene.dimension
        self.limits = (0.0, np.array(scene.domain.size))

    @property
    def count(self) -> int:
        return self.components

    def exact(self, positions: NDArray[np.floating]) -> Values:
        return np.array(measures.toe(positions))

    def smooth(self, positions: Tensor, volumes: Tensor) -> Tensor:
        points, share = positions.double(), volumes.double() / volumes.double().sum()
        x = points[:, 0]
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
        return (weight / weight.sum()) @ points


class Passed(Observation):
    """Share of the volume beyond x = `line` [m]; a particle counts smoothly as 1 / (1 + exp((line - x) / width))."""

    kind = "passed"
    label = "the share of the material that came to rest beyond the line"
    unit = ""
    options = ("line", "width")
    limits = (0.0, 1.0)

    def __init__(self, settings: ObservationSettings, scene: Scene) -> None:
        super().__init__(settings, scene)
        length, line, width = scene.domain.size[0], settings.line, settings.width
        if line is None or not 0.0 < line < length:
            raise InputError(f"expected a length in (0, {length:g}) m, got {line}", key="line")
        if width is not None and not 0.0 < width <= length:
            raise InputError(f"expected a length in (0, {length:g}] m, got {width}", key="width")
        self.line, self.width = line, width or scene.domain.cell

    def exact(self, positions: NDArray[np.floating]) -> Values:
        volumes = particle_volumes(self.scene, len(positions))
        return np.array([np.average(positions[:, 0].astype(np.float64) > self.line, weights=volumes)])

    def smooth(self, positions: Tensor, volumes: Tensor) -> Tensor:
        share = volumes.double() / volumes.double().sum()
        return (share @ torch.sigmoid((positions[:, 0].double() - self.line) / self.width)).reshape(1)

    def prior_scatter(self, values: Values) -> Values:
        return np.full(len(values), SHARE_SCATTER)

    def text(self, values: Values) -> str:
        return f"{100.0 * values[0]:.2f} % beyond {self.line:g} m"


class Deposit(Observation):
    """The final position of every particle, N D numbers, of a surrogate those that it follows.

    The misfit is the paper's mean of |p - p_target|^2.
    """

    kind = "deposit"
    label = "the final position of every particle of the deposit"
    sources = ()
    every_particle = True

    def __init__(self, settings: ObservationSettings, scene: Scene) -> None:
        super().__init__(settings, scene)
        self.components = scene.dimension

    def exact(self, positions: NDArray[np.floating]) -> Values:
        return np.asarray(positions.astype(np.float64).ravel())

    def smooth(self, positions: Tensor, volumes: Tensor) -> Tensor:
        return positions.double().flatten()

    def front(self, values: Values) -> float:
        positions = values.reshape(-1, self.components)
        return measures.front(positions, particle_volumes(self.scene, len(positions)))

    def of_particles(self, values: Values, indices: NDArray[np.int64]) -> Values:
        return np.asarray(values.reshape(-1, self.components)[indices].ravel())

    def text(self, values: Values) -> str:
        return f"{len(values) // self.components} particles"


class Outline(Observation):
    """The extent of a deposit in 3D from the centroid c of its masses along directions n of the plan.

    What a front is along x, of (p - c) . n: the support function of the outline, robust against single particles.
    """

    kind = "outline"
    label = "the outline of the deposit in plan"
    sources = ("csv", "values")
    options = ("directions_deg", "unit")

    def __init__(self, settings: ObservationSettings, scene: Scene) -> None:
        super().__init__(settings, scene)
        if scene.dimension != 3:
            raise InputError("expected a scene in 3D for an outline", key="kind")
        named = settings.directions_deg
        angles = np.deg2rad(DIRECTIONS_DEG if named is None else np.array(named))
        self.directions = np.stack([np.cos(angles), np.sin(angles)])
        """From +x towards +z, shape [2, M]."""
        volumes = mass_volumes(scene)
        self.centre = (volumes @ mass_centroids(scene) / volumes.sum())[[0, 2]]

    @classmethod
    def read(cls, settings: ObservationSettings, context: Context) -> Measurement:
        if settings.csv is None:
            return super().read(settings, context)
        observation, columns = cls(settings, context.scene), read_columns(context.folder / settings.csv, ("x", "z"))
        vertices = np.stack(list(columns.values()), axis=1) * settings.unit.metres
        require_inside(vertices[:, 0], context.scene.domain.size[0])
        return observation.measured(settings, observation.of_line(vertices))

    @property
    def count(self) -> int:
        return int(self.directions.shape[1])

    def exact(self, positions: NDArray[np.floating]) -> Values:
        extent = (positions[:, [0, 2]].astype(np.float64) - self.centre) @ self.directions
        volumes = particle_volumes(self.scene, len(positions))
        return np.array([measures.front(each[:, None], volumes) for each in extent.T])

    def smooth(self, positions: Tensor, volumes: Tensor) -> Tensor:
        extent = (positions[:, [0, 2]].double() - torch.from_numpy(self.centre)) @ torch.from_numpy(self.directions)
        return torch.stack([fitted_tail(each, volumes) for each in extent.T])

    def of_line(self, vertices: NDArray[np.float64]) -> Values:
        """Of a measured outline, vertices x and z [m], shape [V, 2], in any order; shape [M]."""
        return np.asarray(((vertices - self.centre) @ self.directions).max(axis=0))
