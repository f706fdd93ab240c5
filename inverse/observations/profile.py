"""The height profile along x of the deposit, or of the flow at a time; with noise on heights, at its measured rows.

    h_rows = P h,    area(x) = int_0^x h_rows dx' with h_rows linear between rows,    area(x_k) = s_k area(L)

P interpolates the model's profile at its stations to the rows, so that both profiles are linear between rows. A row is
the height at one x, the model's a mean over its spacing: a representation error (Janjic et al., On the representation
error in data assimilation, Quart. J. Roy. Meteorol. Soc. 144 (2018) 1257-1278) of `REPRESENTATION` cells is added to
the noise of each height.
"""

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from datasets.errors import naming, require
from datasets.flow import measures
from datasets.flow.trajectory import Trajectory
from datasets.geometry.ground import elevation
from datasets.scene import Scene
from datasets.scene.particles import particle_volumes
from inverse.observations.errors import Covariance, Noise
from inverse.observations.measured_profile import Heights, MeasuredProfile, checked_profile
from inverse.observations.observation import Between, Observation, Values, at_times
from inverse.observations.settings import LengthsSettings
from inverse.observations.target import Target

SHARES = (*(0.025 + 0.05 * number for number in range(20)), measures.FRONT_QUANTILE)
"""Shares of a profile's area: the middles of twenty equal parts, and the front."""
REPRESENTATION = 0.25  # standard deviation of a height at one x from the model's mean around it, in cells
NEARLY = 1.0e-4  # part of the distance of two stations that counts as none: positions are in single precision
Ends = tuple[float, float]
DRAWS = 400  # draws of noise on the heights, which give the covariance of the observation to 7 %


class Profile(Observation):
    """The height profile by its quantiles: the x behind which each of `SHARES` of its area lies. Heights at fixed x do
    not show how far apart two fronts are that do not overlap. The mean square difference of positions of equal shares
    is the squared transport (Wasserstein) distance of the two areas: Engquist & Froese, Application of the Wasserstein
    metric to seismic signals, Commun. Math. Sci. 12 (2014) 979-988. In 3D the area is the mean over z."""

    kind = "profile"
    label = "the height profile"

    def __init__(
        self, scene: Scene, settings: "ProfileSettings", rows: Values | None = None, ends: Ends | None = None
    ) -> None:
        """rows: ascending x of the known heights [m], [R], continued to the walls; default: the model's stations.
        ends: the two x [m] between which the profile lies, by default the walls; material beyond does not count."""
        super().__init__(scene, settings)
        length, spacing, times = scene.domain.size[0], settings.spacing, settings.times
        require(0.0 < spacing <= length / 2, "spacing", f"a length in (0, {length / 2:g}] m", spacing)
        require(times is None or len(times) == 1, "times", "one time for each profile", len(times or ()))
        low, high = self.ends = ends or (0.0, length)
        self.fine = self.stations = np.linspace(low, high, round((high - low) / spacing) + 1)
        if rows is not None:
            self.stations = to_the_wall(rows, low, high)
        units = np.eye(len(self.fine))
        self.sampling = np.stack([np.interp(self.stations, self.fine, unit) for unit in units], axis=1)
        self.width = math.prod(scene.domain.size[2:])

    def heights(self, positions: NDArray[np.floating]) -> Values:
        """The profile itself [m], at `stations`; positions [m], shape [N, D]."""
        held, volumes = self.held(positions), particle_volumes(self.scene, len(positions))
        heights = measures.height_profile(positions[held], volumes[held] / self.width, self.fine)
        return np.asarray(self.sampling @ heights)

    def held(self, positions: Any) -> Any:
        """Which positions [N, D] lie between the ends, shape [N]."""
        return (positions[:, 0] >= self.ends[0]) & (positions[:, 0] <= self.ends[1])

    def of_heights(self, heights: Values) -> Values:
        """The observation [M] of a profile [m] at `stations`."""
        return np.asarray(self._quantiles(torch.from_numpy(heights)).numpy())

    def exact(self, positions: NDArray[np.floating]) -> Values:
        return self.of_heights(self.heights(positions))

    def smooth(self, positions: Tensor, volumes: Tensor) -> Tensor:
        stations, held = torch.from_numpy(self.fine), self.held(positions)
        positions, volumes = positions[held], volumes[held]
        spacing, last = stations[1] - stations[0], len(stations) - 1
        scaled = ((positions[:, 0].double() - stations[0]) / spacing).clamp(0.0, float(last))
        left = scaled.detach().long().clamp(max=last - 1)
        share = scaled - left
        area = volumes.double()
        heights = torch.zeros(last + 1, dtype=torch.float64)
        heights = heights.index_add(0, left, area * (1.0 - share)).index_add(0, left + 1, area * share)
        # At a wall, half of a station's length lies outside.
        ends = torch.ones_like(heights)
        ends[[0, last]] = 2.0
        return self._quantiles(torch.from_numpy(self.sampling) @ (heights * ends))

    def _quantiles(self, heights: Tensor) -> Tensor:
        stations = torch.from_numpy(self.stations)
        spacing = stations.diff()
        pieces = 0.5 * (heights[1:] + heights[:-1]) * spacing
        area = torch.cat([torch.zeros(1, dtype=torch.float64), torch.cumsum(pieces, 0)])
        shares = torch.tensor(SHARES, dtype=torch.float64) * area[-1]
        right = torch.searchsorted(area.detach(), shares.detach()).clamp(1, len(pieces))
        low, rest = heights[right - 1], shares - area[right - 1]
        bend = 2.0 * (heights[right] - low) / spacing[right - 1]
        # The root of low s + bend s^2 / 4 = rest that tends to rest / low without a bend.
        return stations[right - 1] + 2.0 * rest / (low + torch.sqrt((low**2 + bend * rest).clamp(min=1e-300)))

    @property
    def places(self) -> tuple[str, Values]:
        return "share of the area [-]", np.array(SHARES)

    def front(self, values: Values) -> float:
        return float(values[-1]) if math.isfinite(self.at_end(values[-1:])) else math.nan

    def text(self, values: Values) -> str:
        return f"mean x {values.mean():.4f} m, 99.5 % within {values[-1]:.4f} m"


class SurfaceProfile(Profile):
    """`Profile` of the deposit's surface: the height of its particles above the ground, including dilation. At a
    station it is the centre of the highest particle nearest to this station, in 3D the mean of these over the width:
    for a level layer, the surface within a quarter of a particle. The surrogate follows too few particles for a
    surface, so its smooth form uses the equivalent heights, and the emulator of the MPM represents the difference."""

    def heights(self, positions: NDArray[np.floating]) -> Values:
        scene, rows, spacing = self.scene, len(self.fine), float(self.fine[1] - self.fine[0])
        positions = positions[self.held(positions)]
        widths = [round(width / spacing) or 1 for width in scene.domain.size[2:]]
        # A tie goes up. To even numbers, a lattice between the stations would leave out every second station.
        nearest = np.floor((positions[:, 0] - self.fine[0]) / spacing + 0.5 + NEARLY).astype(np.int64)
        index = np.clip(nearest, 0, rows - 1)
        for axis, count in enumerate(widths, 2):
            across = np.clip((positions[:, axis] / scene.domain.size[axis] * count).astype(np.int64), 0, count - 1)
            index = index * count + across
        plan = np.delete(positions.astype(np.float64), 1, axis=1)
        base = elevation(scene.solids, scene.domain, plan)
        top = np.zeros(rows * math.prod(widths))
        np.maximum.at(top, index, positions[:, 1] - base)
        return np.asarray(self.sampling @ top.reshape(rows, -1).mean(axis=1))


@dataclass(frozen=True, kw_only=True)
class ProfileSettings(LengthsSettings):
    """Settings of `Profile`; the table has x and height."""

    heights: Heights = Heights.EQUIVALENT  # meaning of the heights
    spacing: float = 0.02  # distance between the stations [m]
    times: tuple[float, ...] | None = None  # one time [s] after the start; default: the end
    datum: float = 0.0  # height of the floor in a table [`unit`]

    operator_type, blanks = Profile, True
    robust = False

    def operator(self, scene: Scene, rows: Values | None = None, ends: Ends | None = None) -> Profile:
        """See `ObservationSettings.operator`; rows, ends: see `Profile`."""
        kind = Profile if self.heights is Heights.EQUIVALENT else SurfaceProfile
        return kind(scene, self, rows, ends)

    def read(self, scene: Scene, folder: Path, released: Between) -> Target:
        path = folder / str(self.csv)
        x, height = self.table(path, ("x", "height")).values()
        corner = scene.domain.corner
        floor = self.datum * self.metres + (corner[1] if self.heights is Heights.ELEVATION else 0.0)
        with naming(path):
            profile = checked_profile(x - corner[0], height - floor, scene, self.heights, released)
        operator = self.operator(scene, profile.x, profile.ends)
        return self.sampled(operator, operator.of_heights(profile.at(operator.stations)), profile)

    def of_run(self, scene: Scene, run: Trajectory) -> Target:
        """See `ObservationSettings.of_run`; the noise applies to the heights."""
        operator = self.operator(scene)
        values = operator.observe(run)
        # A profile without noise is compared as it is.
        if self.noise == 0.0 and self.heights is Heights.EQUIVALENT:
            return self.compared(operator, values)
        positions = run.positions[-1]
        if operator.times is not None:
            positions = at_times(lambda frame: frame, run.positions, run.time, operator.times)[0]
        profile = MeasuredProfile(x=operator.stations, height=operator.heights(positions))
        return self.sampled(operator, values, profile)

    def sampled(self, operator: Profile, values: Values, profile: MeasuredProfile) -> Target:
        """`values` [M] with the stated and representation errors of the heights, larger if rows scatter more."""
        noise = Noise.stated(self.noise)
        self.warn_of_noise(profile.height, operator.scene.domain.size[1])
        represented = math.hypot(noise.deviation, REPRESENTATION * operator.scene.domain.cell)
        stated = profile.deviation(replace(noise, deviation=represented))
        roughness = profile.roughness(stated)
        draws = np.random.default_rng(0).standard_normal((DRAWS, len(profile.x)))
        heights = np.maximum(profile.height + roughness * stated * draws, 0.0)
        measured = (MeasuredProfile(x=profile.x, height=row) for row in heights)
        numbers = [operator.of_heights(drawn.at(operator.stations)) for drawn in measured]
        off = np.stack(numbers) - np.mean(numbers, axis=0)
        errors = Covariance.of(np.asarray(off.T @ off / (DRAWS - 1.0)))
        return Target(observation=operator, values=values, errors=errors, profile=profile, roughness=roughness)


def to_the_wall(rows: NDArray[np.float64], low: float, high: float) -> NDArray[np.float64]:
    """`rows` [m], continued with their own spacing to the ends at x = `low` and `high` [m]."""
    rows = np.clip(rows, low, high)
    before = np.arange(rows[0] - (rows[1] - rows[0]), low, rows[0] - rows[1])[::-1]
    beyond = np.arange(rows[-1] + (rows[-1] - rows[-2]), high, rows[-1] - rows[-2])
    every = np.concatenate([[low], before, rows, beyond, [high]])
    # A last step of the size of a rounding error is dropped.
    return np.asarray(every[np.concatenate([[True], np.diff(every) > 1e-6 * (high - low)])])
