"""The whole deposit: the final position of every particle, and its outline in plan (3D)."""

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from datasets import measures
from datasets.errors import InputError
from datasets.particles import mass_centroids, mass_volumes, particle_count
from datasets.scene import Scene
from datasets.trajectory import Trajectory
from inverse.observations.measured import Context, read_columns, require_inside
from inverse.observations.observation import Measurement, Observation, Values, fitted_tail
from inverse.settings import ObservationSettings

DIRECTIONS_DEG = np.arange(0.0, 360.0, 22.5)
"""Of an outline, where none are named."""


class Deposit(Observation):
    """The final position of every particle, N D numbers; the misfit is the paper's mean of |p - p_target|^2.

    The surrogate follows some of the particles: they are compared with the same ones of the target.
    """

    kind = "deposit"
    label = "the final position of every particle of the deposit"
    sources = ()
    every_particle = True

    def __init__(self, settings: ObservationSettings, scene: Scene) -> None:
        super().__init__(settings, scene)
        self.components = scene.dimension

    def check_run(self, run: Trajectory) -> None:
        count = particle_count(self.scene)
        if run.positions.shape[1] != count:
            got = f"got {run.positions.shape[1]}"
            raise InputError(f"expected the {count} particles of the problem's scene for a deposit, {got}")

    def exact(self, positions: NDArray[np.floating]) -> Values:
        return np.asarray(positions.astype(np.float64).ravel())

    def smooth(self, positions: Tensor, volumes: Tensor) -> Tensor:
        return positions.double().flatten()

    def front(self, values: Values) -> float:
        return measures.front(values.reshape(-1, self.components))

    def of_particles(self, values: Values, indices: NDArray[np.int64]) -> Values:
        return np.asarray(values.reshape(-1, self.components)[indices].ravel())

    def text(self, values: Values) -> str:
        return f"{len(values) // self.components} particles"


class Outline(Observation):
    """The extent of a deposit in 3D from the centroid of its masses along directions of the plan.

    Along a direction n it is the quantile of (p - c) . n over the particles that a front is along x, c the centroid of
    the masses in plan: the support function of the deposit's outline, robust against single particles.
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
        return np.asarray(np.quantile(extent, measures.FRONT_QUANTILE, axis=0))

    def smooth(self, positions: Tensor, volumes: Tensor) -> Tensor:
        extent = (positions[:, [0, 2]].double() - torch.from_numpy(self.centre)) @ torch.from_numpy(self.directions)
        return torch.stack([fitted_tail(each, volumes) for each in extent.T])

    def of_line(self, vertices: NDArray[np.float64]) -> Values:
        """Of a measured outline, vertices x and z [m], shape [V, 2], in any order; shape [M]."""
        return np.asarray(((vertices - self.centre) @ self.directions).max(axis=0))
