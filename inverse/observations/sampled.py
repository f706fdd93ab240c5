"""A profile that was measured at few places: the model's own is seen at the same ones before the two are compared.

    h_rows = P h,    area(x) = int_0^x h_rows dx' with h_rows linear between rows,    area(x_k) = s_k area(L)

P interpolates the model's profile at its stations to the rows. A chord between two rows cuts what lies between them off
both profiles alike; a measured profile refined to the model's stations would be short of it where the model's is not.

A row is the height at one place, the model's a mean over its spacing. The difference is an error of representation
(Janjic et al., On the representation error in data assimilation, Quart. J. Roy. Meteorol. Soc. 144 (2018) 1257-1278):
`REPRESENTATION` of a cell, added to the noise of each height.
"""

import math

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from datasets.geometry.ground import elevation
from datasets.geometry.margins import Box
from datasets.scene import Scene
from inverse.observations.deposit import SHARES, Profile, Values
from inverse.observations.profile import MeasuredProfile
from inverse.settings import Heights

REPRESENTATION = 0.25
"""Standard deviation of a height at one place from the model's mean around it, in cells."""
DRAWS = 400
"""Of noise on the heights, by which the covariance of the observation is known to 7 %."""


class SampledProfile(Profile):
    """`Profile`, of which the heights at given rows alone are known."""

    def __init__(self, scene: Scene, spacing: float, rows: NDArray[np.float64]) -> None:
        """rows: [m], ascending, shape [R]; beyond their ends they go on to the walls, as far apart as the last two."""
        super().__init__(scene, spacing)
        self.fine, self.stations = self.stations, to_the_wall(rows, scene.domain.size[0])
        places = np.eye(len(self.fine))
        self.sampling = np.stack([np.interp(self.stations, self.fine, each) for each in places], axis=1)

    def heights(self, positions: NDArray[np.floating]) -> Values:
        """The profile [m] at the rows, shape [R]; positions [m], shape [N, D]."""
        return np.asarray(self.sampling @ self.at(positions, self.fine))

    def smooth(self, positions: Tensor, volumes: Tensor) -> Tensor:
        heights = self.smooth_heights(positions, volumes, self.fine)
        return self._sideways(torch.from_numpy(self.sampling) @ heights)

    def _sideways(self, heights: Tensor) -> Tensor:
        stations = torch.from_numpy(self.stations)
        spacing = stations.diff()
        pieces = 0.5 * (heights[1:] + heights[:-1]) * spacing
        area = torch.cat([torch.zeros(1, dtype=torch.float64), torch.cumsum(pieces, 0)])
        wanted = torch.tensor(SHARES, dtype=torch.float64) * area[-1]
        right = torch.searchsorted(area.detach(), wanted.detach()).clamp(1, len(pieces))
        low, rest = heights[right - 1], wanted - area[right - 1]
        bend = 2.0 * (heights[right] - low) / spacing[right - 1]
        # The root of low s + bend s^2 / 4 = rest that goes over into rest / low where there is no bend.
        return stations[right - 1] + 2.0 * rest / (low + torch.sqrt((low**2 + bend * rest).clamp(min=1e-300)))

    def covariance(self, profile: MeasuredProfile, deviation: NDArray[np.float64]) -> NDArray[np.float64]:
        """Covariance [m^2], shape [M, M], of the observation of `profile` by errors of its heights.

        deviation: standard deviation of each height [m], shape [R] as the profile; its errors are independent of each
        other and the numbers that they make are not.
        """
        rng = np.random.default_rng(0)
        draws = np.maximum(profile.height + deviation * rng.standard_normal((DRAWS, len(profile.x))), 0.0)
        seen = [self.of_heights(np.interp(self.stations, profile.x, each, left=0.0, right=0.0)) for each in draws]
        apart = np.stack(seen) - np.mean(seen, axis=0)
        covariance: NDArray[np.float64] = apart.T @ apart / (DRAWS - 1.0)
        return covariance


class SurfaceProfile(SampledProfile):
    """`SampledProfile` of the deposit's surface: how high above the ground its particles lie, loosened or not.

    At a station it is the centre of the highest particle that is nearer to this station than to another, in 3D the mean
    of these over the width. Of a level layer on its lattice that is the surface within a quarter of a particle: the
    material reaches half a particle further up than a centre, the highest of several lies about as much above the rest.
    The surrogate follows too few points for a surface: its smooth form is that of the equivalent
    heights, and what the two differ by is left to the correction by the MPM (`validation.loop.correction`).
    """

    def heights(self, positions: NDArray[np.floating]) -> Values:
        scene = self.scene
        spacing = float(self.fine[1] - self.fine[0])
        rows = len(self.fine)
        widths = [round(width / spacing) or 1 for width in scene.domain.size[2:]]
        place = np.clip(np.rint(positions[:, 0] / spacing).astype(np.int64), 0, rows - 1)
        for axis, count in enumerate(widths, 2):
            across = np.clip((positions[:, axis] / scene.domain.size[axis] * count).astype(np.int64), 0, count - 1)
            place = place * count + across
        plan = np.delete(positions.astype(np.float64), 1, axis=1)
        ground = elevation(scene.solids, Box(size=scene.domain.size, cell=scene.domain.cell), plan)
        top = np.zeros(rows * math.prod(widths))
        np.maximum.at(top, place, positions[:, 1] - ground)
        return np.asarray(self.sampling @ top.reshape(rows, -1).mean(axis=1))


def sampled(heights: Heights) -> type[SampledProfile]:
    """What a measured profile of such heights is compared with."""
    return SampledProfile if heights is Heights.EQUIVALENT else SurfaceProfile


def to_the_wall(rows: NDArray[np.float64], length: float) -> NDArray[np.float64]:
    """`rows` [m] from the wall at x = 0 to the one at `length` [m]; where they end before it, they go on as before."""
    rows = np.clip(rows, 0.0, length)
    before = np.arange(rows[0] - (rows[1] - rows[0]), 0.0, rows[0] - rows[1])[::-1]
    beyond = np.arange(rows[-1] + (rows[-1] - rows[-2]), length, rows[-1] - rows[-2])
    every = np.concatenate([[0.0], before, rows, beyond, [length]])
    # A last step that ends a hair before the wall is none.
    return np.asarray(every[np.concatenate([[True], np.diff(every) > 1e-6 * length])])
