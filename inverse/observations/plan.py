"""The thickness of a deposit, or the largest thickness of a flow, over the cells of a raster in plan (3D).

    h_c = f_c / A  sum_p w_c(x_p) V_p

w shares the volume V_p of a particle linearly between the cells around it, as `datasets.maps` does; A is the area of a
cell. Volumes are those at the initial density. With n the normal of the ground and g gravity, f is n_y for a thickness
normal to the ground, and n_y |g| / (-n . g) for a vertical one, along gravity.

Many cells are compared in blocks, by means over each block. A peak is first taken in each cell, over the frames and, if
the flow crosses cells from one frame to the next, between them: the mean of the peaks exceeds the peak of the mean.
"""

import itertools
import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Literal

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, distance_transform_edt
from torch import Tensor

from datasets.errors import naming, require
from datasets.exchange.points import ENDINGS, read_points
from datasets.exchange.rasters import Raster, read_raster, same_system
from datasets.flow.trajectory import Trajectory
from datasets.geometry.ground import elevation, slopes_in_plan
from datasets.maps import BETWEEN, FAST, MEASURED, map_corner
from datasets.scene import Scene
from datasets.scene.grid_field import Floats, Grid
from datasets.scene.parts import Length
from inverse.observations.errors import Covariance, Noise
from inverse.observations.observation import SCATTER_CELLS, Between, Rollout, SmoothObservation, Values
from inverse.observations.settings import ObservationSettings
from inverse.observations.target import Target

MOST = 1500  # most cells of an observation, whose covariance is a dense matrix; finer rasters are compared in blocks
AROUND = 0.25
"""Distance from the deposit, over the root of its area, up to which bare cells count: more would hide a misfit."""
TOO_MUCH = 2.0  # volume of a deposit over the released one, above which the unit or the scene must be wrong
OPEN = 0.5  # share of cells without data around a deposit that gives a warning: an overrun there would not be seen
SUNKEN = 0.1  # depth of a survey beneath the terrain, in cells, that gives a warning


def plan_sides(scene: Scene) -> tuple[float, ...]:
    """Lengths of a scene along x and z [m]. Raises InputError in 2D."""
    require(scene.dimension == 3, "kind", "a scene in 3D", f"{scene.dimension}D")
    return scene.domain.size[::2]


def plan_grid(scene: Scene, cell: float) -> Grid:
    """Square cells of edge about `cell` [m] over the whole plan of a 3D scene, given by their centres."""
    sides = plan_sides(scene)
    counts = tuple(max(1, round(side / cell)) for side in sides)
    spacing = tuple(side / count for side, count in zip(sides, counts, strict=True))
    return Grid((0.5 * spacing[0], 0.5 * spacing[1]), spacing, counts)


def volume_over(grid: Grid, positions: Tensor, volumes: Tensor) -> Tensor:
    """Volume [m^3] in each cell of `grid`, shape [K], of particles [N, 3] with `volumes` [N]; differentiable."""
    origin, spacing = (torch.from_numpy(np.array(lengths)) for lengths in (grid.origin, grid.spacing))
    scaled = (positions[:, ::2].double() - origin) / spacing
    last = torch.tensor(grid.nodes) - 1
    within = ((scaled > -0.5) & (scaled < last + 0.5)).all(dim=1)
    scaled = torch.minimum(scaled[within].clamp(min=0.0), last.double())
    first = torch.minimum(scaled.detach().long(), (last - 1).clamp(min=0))
    share, volume = scaled - first, volumes.double()[within]
    totals = torch.zeros(grid.count, dtype=torch.float64)
    for x, z in ((0, 0), (0, 1), (1, 0), (1, 1)):
        weight = (share[:, 0] if x else 1.0 - share[:, 0]) * (share[:, 1] if z else 1.0 - share[:, 1])
        column, row = (torch.minimum(first[:, n] + (x, z)[n], last[n]) for n in (0, 1))
        totals = totals.index_add(0, column * grid.nodes[1] + row, weight * volume)
    return totals


def factors(scene: Scene, grid: Grid, direction: str | None) -> Floats:
    """f of each cell of `grid`, shape [K]; `direction` is vertical or normal, which it is where None."""
    slopes = [slope.ravel() for slope in slopes_in_plan(scene, grid)]
    upright = 1.0 / np.sqrt(1.0 + slopes[0] ** 2 + slopes[1] ** 2)
    if direction != "vertical" or scene.gravity == 0.0:
        return np.asarray(upright)
    along, down, _ = scene.gravity_vector
    return np.asarray(scene.gravity / -(down - along * slopes[0]))


class Thickness(SmoothObservation):
    """The thickness in cells of a raster or in blocks: of the deposit, or the largest at any time; M numbers [m]."""

    kind = "thickness"
    label = "the thickness over the plan"
    of_positions, dense = False, True

    def __init__(
        self, scene: Scene, settings: "ThicknessSettings", blocks: "Blocks", chosen: NDArray[np.int64] | None = None
    ) -> None:
        """chosen: indices of the measured blocks; default: all."""
        super().__init__(scene, settings)
        self.blocks, self.grid, self.over_time = blocks, blocks.grid, settings.peak
        self.cells = np.arange(self.grid.count) if chosen is None else chosen
        self.count = len(self.cells)
        inside = blocks.cells
        self.factor = torch.from_numpy(factors(scene, inside, settings.direction) / math.prod(inside.spacing))

    def smooth(self, positions: Tensor, volumes: Tensor) -> Tensor:
        return self.measured(self.in_cells(positions, volumes))

    def in_cells(self, positions: Tensor, volumes: Tensor) -> Tensor:
        """The thickness in each of the cells within the blocks [m]."""
        return volume_over(self.blocks.cells, positions, volumes) * self.factor

    def measured(self, thickness: Tensor) -> Tensor:
        """The means of a thickness in the cells over the measured blocks."""
        return self.blocks.means(thickness)[torch.from_numpy(self.cells)]

    def predict(self, rollout: Rollout) -> Tensor:
        if not self.over_time:
            return super().predict(rollout)
        positions, volumes = rollout.positions, rollout.volumes
        highest = self.in_cells(positions[0], volumes)
        for before, after in itertools.pairwise(positions):
            moved = torch.quantile((after - before).detach().norm(dim=1).float(), FAST).item()
            count = min(max(math.ceil(moved / min(self.blocks.cells.spacing)), 1), BETWEEN)
            for share in range(1, count + 1):
                moment = torch.lerp(before, after, share / count)
                highest = torch.maximum(highest, self.in_cells(moment, volumes))
        return self.measured(highest)

    def prior_scatter(self, values: Values) -> Values:
        columns = max(1.0, min(self.grid.spacing) / self.scene.domain.cell)
        return np.full(len(values), SCATTER_CELLS * self.scene.particle_spacing / columns)


@dataclass(frozen=True, kw_only=True)
class ThicknessSettings(ObservationSettings):
    file: str | None = None
    """A raster of thicknesses [m], or points of a survey of the surface (`datasets.exchange.points`), in the map
    coordinates of the scene."""
    cell: Length | None = None  # for a survey, a twin or a trajectory: edge of the cells [m]; default: the scene's
    peak: bool = False  # whether thicknesses are the largest over time instead of the deposit's
    direction: Literal["normal", "vertical"] | None = None
    """How thicknesses are measured: normal to the ground or along gravity; default: as a map of Talus says, else
    normal."""
    length: Length | None = None
    """Correlation length of their errors in plan [m]: exp(-distance / length); default: independent."""

    operator_type = Thickness
    robust = False

    def __post_init__(self) -> None:
        super().__post_init__()
        allowed = self.file is None or Path(self.file).suffix.lower() in ENDINGS or self.cell is None
        require(allowed, "cell", "none beside a raster, which has its own", self.cell)

    def operator(self, scene: Scene) -> Thickness:
        edge, parts = max(self.cell or 0.0, scene.domain.cell), (1, 1)
        grid = plan_grid(scene, edge)
        if grid.count > MOST:
            grid = plan_grid(scene, math.sqrt(math.prod(plan_sides(scene)) / MOST))
            parts = (max(1, int(grid.spacing[0] / edge)), max(1, int(grid.spacing[1] / edge)))
        return Thickness(scene, self, Blocks(grid, parts))

    def read(self, scene: Scene, folder: Path, released: Between) -> Target:
        plan_sides(scene)
        path, (corner, crs), direction = folder / str(self.file), map_corner(scene), self.direction
        with naming(path):
            if path.suffix.lower() in ENDINGS:
                cut, values = self.surveyed(scene, path)
            else:
                raster = read_raster(path)
                require(same_system(crs, raster), "", f"the reference system of the scene, {crs}", raster.crs)
                # In a tilted box our own maps are along neither.
                mapped = MEASURED.get(raster.description) if scene.slope_deg == 0.0 else None
                fits = mapped is None or direction in (None, mapped)
                require(fits, "direction", f"{mapped}, as this map of Talus is measured", direction)
                direction = direction or mapped
                cut, values = in_blocks(raster, corner, scene)
            grid = cut.grid
            if not self.peak:
                volume = float(np.nansum(values / factors(scene, grid, direction)) * math.prod(grid.spacing))
                most = TOO_MUCH * released[1] * scene.domain.size[2]
                expected = f"a volume of at most {most:.4g} m^3, twice the released one"
                require(volume <= most, "", expected, f"{volume:.4g}")
            return replace(self, direction=direction).measured(scene, cut, values)

    def surveyed(self, scene: Scene, path: Path) -> tuple["Blocks", Values]:
        """Cells, and the thickness [m] above the ground in each cell [K] from the points of a survey. It is the mean
        elevation of a cell's points above the terrain, NaN without points; if it is below twice the noise, the ground
        is bare."""
        (corner, crs), cut = map_corner(scene), self.operator(scene).blocks
        grid = cut.grid
        low, sides = np.array(corner), np.array(plan_sides(scene))
        points = read_points(path, crs, low, low + sides)
        plan = points[:, :2] - low
        above = points[:, 2] - scene.domain.corner[1] - elevation(scene.solids, scene.domain, plan)
        column, row = np.minimum((plan / np.array(grid.spacing)).astype(int), np.array(grid.nodes) - 1).T
        cell, deviation = column * grid.nodes[1] + row, Noise.stated(self.noise).deviation
        counts, sums = np.bincount(cell, minlength=grid.count), np.bincount(cell, above, grid.count)
        values = np.divide(sums, counts, out=np.full(grid.count, np.nan), where=counts > 0)
        deep = float(np.nanmedian(values))
        if deep < -max(2.0 * deviation, SUNKEN * scene.domain.cell):
            said = f"half of the survey lies {-deep:.2g} m or more beneath the terrain of the scene: another datum?"
            warnings.warn(f"{path}: {said}", stacklevel=2)
        values[values < 2.0 * deviation] = 0.0
        return cut, values * factors(scene, grid, self.direction)

    def of_run(self, scene: Scene, run: Trajectory) -> Target:
        whole = self.operator(scene)
        return self.measured(scene, whole.blocks, whole.observe(run))

    def measured(self, scene: Scene, cut: "Blocks", values: Values) -> Target:
        """The target of values [m] in the blocks `cut` [K], NaN without data; bare blocks around the deposit count."""
        grid = cut.grid
        covered = (np.nan_to_num(values) > 0.0).reshape(grid.nodes)
        require(bool(covered.any()), "", "a thickness above 0 m in the box", "none")
        beside = binary_dilation(covered, np.ones((3, 3))) & ~covered
        unknown = float(np.isnan(values.reshape(grid.nodes)[beside]).mean()) if beside.any() else 0.0
        if unknown > OPEN:
            said = f"{unknown:.0%} of the cells around the deposit have no data and are not compared; 0 is bare ground"
            warnings.warn(said, stacklevel=2)
        apart = distance_transform_edt(~covered, sampling=grid.spacing)
        reach = max(2.0 * max(grid.spacing), AROUND * math.sqrt(covered.sum() * math.prod(grid.spacing)))
        cells = np.flatnonzero((apart <= reach).ravel() & np.isfinite(values))
        shown = values[cells]
        self.warn_of_noise(shown, scene.domain.size[1])
        # Bare ground has the noise of a mean thickness, because a thinner deposit would not have been seen.
        deviation = Noise.stated(self.noise).of(np.where(shown > 0.0, shown, shown[shown > 0.0].mean()))
        errors = Covariance.correlated(deviation, grid.positions[cells], self.length)
        return Target(observation=Thickness(scene, self, cut, cells), values=shown, errors=errors)


@dataclass(frozen=True)
class Blocks:
    """Blocks of cells in plan, K in all."""

    grid: Grid  # of the blocks
    parts: tuple[int, int]  # number of cells of a block along x and z

    @cached_property
    def cells(self) -> Grid:
        """The cells within the blocks."""
        both = [*zip(self.grid.origin, self.grid.spacing, self.grid.nodes, self.parts, strict=True)]
        origin = tuple(first - 0.5 * length * (1.0 - 1.0 / parts) for first, length, _, parts in both)
        spacing = tuple(length / parts for _, length, _, parts in both)
        return Grid(origin, spacing, tuple(count * parts for _, _, count, parts in both))

    def means(self, values: Tensor) -> Tensor:
        """The mean over each block, shape [K], of values in the cells."""
        (x, z), (of_x, of_z) = self.grid.nodes, self.parts
        return values.view(x, of_x, z, of_z).mean(dim=(1, 3)).flatten()


def in_blocks(raster: Raster, corner: Sequence[float], scene: Scene) -> tuple[Blocks, Values]:
    """The cells of a raster in the box, and their values [K]: means over blocks at least as large as a scene's cell.
    corner: of the box on the map [m], shape [2]; a block with a hole is NaN. Raises InputError if no cell is in it."""
    places, kept = (raster.x - corner[0], raster.z - corner[1]), []
    for at, side in zip(places, plan_sides(scene), strict=True):
        kept.append(np.flatnonzero((at > 0.0) & (at < side)))
        expected = f"cells between 0 and {side:g} m from the corner of the box"
        require(len(kept[-1]) > 0, "", expected, "none of them there")
    # Cells of the model are no finer than the scene's.
    least = math.ceil(scene.domain.cell / min(raster.spacing) - 1e-6)
    width = least * math.ceil(max(1.0, math.sqrt(len(kept[0]) * len(kept[1]) / MOST) / least))
    parts = [max(1, min(width, len(indices)) // least) for indices in kept]
    widths = [min(part * least, len(indices)) for part, indices in zip(parts, kept, strict=True)]
    counts = [len(indices) // block for indices, block in zip(kept, widths, strict=True)]
    rows = []
    for indices, count, block in zip(kept, counts, widths, strict=True):
        # Cells that fill no block are left out at both ends.
        rows.append(indices[(len(indices) - count * block) // 2 :][: count * block])
    cut = raster.values[np.ix_(*rows)].reshape(counts[0], widths[0], counts[1], widths[1])
    spacing = (raster.spacing[0] * widths[0], raster.spacing[1] * widths[1])
    origin = tuple(float(at[row[:block]].mean()) for at, row, block in zip(places, rows, widths, strict=True))
    grid = Grid(origin, spacing, (counts[0], counts[1]))
    return Blocks(grid, (parts[0], parts[1])), np.asarray(cut.mean(axis=(1, 3)).ravel())
