"""The outline of a deposit in plan (3D): distances along the observed boundary, or extents in some directions.

    y_i = + |p_i - q_i| where the model covers p_i, - |p_i - q_i| where not;    observed: 0

p are points along the observed boundary, q the nearest points of the model's boundary, on which its thickness
(`inverse.observations.plan`) is `thickness`. If the thickness changes by dh, y_i changes by dh / |grad h|.
"""

import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import shapely
import torch
from numpy.typing import NDArray
from torch import Tensor

from datasets.errors import InputError, naming, require
from datasets.exchange.vectors import read_polygons
from datasets.flow.trajectory import Trajectory
from datasets.maps import least_thickness, map_corner, region_above
from datasets.scene import Scene
from datasets.scene.grid_field import Floats
from datasets.scene.particles import mass_centroids, mass_volumes
from datasets.scene.parts import Length
from inverse.observations.errors import Covariance, Noise
from inverse.observations.observation import Between, Observation, SmoothObservation, Values, fitted_tail
from inverse.observations.plan import plan_grid, plan_sides, volume_over
from inverse.observations.settings import LengthsSettings
from inverse.observations.target import Target

DIRECTIONS_DEG = np.arange(0.0, 360.0, 22.5)  # default directions of extents
POINTS = (8, 64)  # smallest and largest number of points along the observed boundary, two cells apart or more
ISLAND = 0.05  # area over the largest part's, below which a part of a deposit is only stray particles
THRESHOLD = ("threshold_m", "threshold_")  # attribute of `datasets.maps`; in a shapefile its first ten characters
THICK = 0.2  # share of the least thickness released, above which a default `thickness`, of large cells, gives a warning
TVERSKY = (0.3, 0.7)  # weights of areas that only the model covers, and of areas that it misses, which is worse


class Extents(SmoothObservation):
    """The extent of a deposit in 3D from the centroid c of its masses along directions n of the plan. Each is the front
    of (p - c) . n instead of x: the support function of the outline, robust against single particles."""

    kind = "outline"
    label = "the extent of the deposit in plan"

    def __init__(self, scene: Scene, directions_deg: Sequence[float] | None) -> None:
        super().__init__(scene)
        plan_sides(scene)
        angles = np.deg2rad(DIRECTIONS_DEG if directions_deg is None else np.array(directions_deg))
        self.directions = np.stack([np.cos(angles), np.sin(angles)])  # from +x towards +z, shape [2, M]
        self.count = len(angles)
        volumes = mass_volumes(scene)
        self.centre = (volumes @ mass_centroids(scene) / volumes.sum())[[0, 2]]

    def smooth(self, positions: Tensor, volumes: Tensor) -> Tensor:
        extent = (positions[:, [0, 2]].double() - torch.from_numpy(self.centre)) @ torch.from_numpy(self.directions)
        return torch.stack([fitted_tail(along, volumes) for along in extent.T])


class Boundary(SmoothObservation):
    """Signed distances from points of the observed boundary to the model's [m], positive if the model covers more."""

    kind = "outline"
    label = "the outline of the deposit in plan"
    of_positions, dense = False, True

    def __init__(self, scene: Scene, region: shapely.Geometry, thickness: float | None = None) -> None:
        """region: the covered area in plan, from the box's corner [m], of which small islands do not count, as of the
        model's; thickness: above which the model covers [m]."""
        super().__init__(scene)
        self.grid, self.region = plan_grid(scene, scene.domain.cell), without_islands(region)
        least = 0.5 * min(map(least_thickness, scene.masses))
        self.thickness = min(scene.particle_spacing, least) if thickness is None else thickness
        rings = shapely.get_parts(self.region.boundary)
        ends = np.cumsum(shapely.length(rings))
        self.count = round(float(np.clip(ends[-1] / (2.0 * scene.domain.cell), *POINTS)))
        # At equal distances along the rings one after the other: a short one may have none.
        along = (np.arange(self.count) + 0.5) / self.count * ends[-1]
        which = np.searchsorted(ends, along)
        self.points = shapely.line_interpolate_point(rings[which], along - (ends - shapely.length(rings))[which])

    def covered(self, thickness: Floats) -> shapely.Geometry:
        """The area in which thicknesses [K] exceed that of the outline, without small islands."""
        return without_islands(region_above(self.grid, thickness.reshape(self.grid.nodes), self.thickness))

    def heights(self, positions: Tensor, volumes: Tensor) -> Tensor:
        """Thickness in the cells of the grid [m], shape [K]."""
        return volume_over(self.grid, positions, volumes) / math.prod(self.grid.spacing)

    def smooth(self, positions: Tensor, volumes: Tensor) -> Tensor:
        heights = self.heights(positions, volumes)
        thickness = heights.detach().numpy()
        model = self.covered(thickness)
        if model.is_empty:
            # Without any deposit the distance is the length of the box.
            return torch.full((self.count,), -max(self.scene.domain.size), dtype=torch.float64)
        edge = model.boundary
        inside = shapely.contains_xy(model, shapely.get_coordinates(self.points))
        distance = np.where(inside, 1.0, -1.0) * shapely.distance(self.points, edge)
        if not heights.requires_grad:
            return torch.from_numpy(distance)
        nearest = shapely.get_coordinates(shapely.shortest_line(self.points, edge))[1::2]
        steps = 0.5 * self.scene.domain.cell * np.eye(2)
        slopes = [(self.grid.weights(nearest + step) - self.grid.weights(nearest - step)) @ thickness for step in steps]
        steep = np.maximum(np.hypot(*slopes) / self.scene.domain.cell, 1e-12)
        at_edge = torch.from_numpy(self.grid.weights(nearest).toarray()) @ heights
        moved: Tensor = torch.from_numpy(distance) + (at_edge - at_edge.detach()) / torch.from_numpy(steep)
        return moved

    def scores(self, positions: NDArray[np.floating], volumes: Values) -> dict[str, float]:
        heights = self.heights(torch.from_numpy(np.asarray(positions)), torch.from_numpy(volumes)).numpy()
        model = self.covered(heights)
        both = model.intersection(self.region).area
        beyond, missed = model.area - both, self.region.area - both
        weighed = TVERSKY[0] * beyond + TVERSKY[1] * missed
        return {"intersection_over_union": both / (both + beyond + missed), "tversky": both / (both + weighed)}


def without_islands(region: shapely.Geometry) -> shapely.Geometry:
    """A region without parts much smaller than the largest one (`ISLAND`)."""
    parts = shapely.get_parts(region)
    return shapely.union_all(parts[shapely.area(parts) >= ISLAND * shapely.area(parts).max(initial=0.0)])


@dataclass(frozen=True, kw_only=True)
class OutlineSettings(LengthsSettings):
    """Settings of `Boundary`, or of `Extents` with values or directions. The table has ordered vertices x, z."""

    file: str | None = None  # polygons (GeoJSON, shapefile, GeoPackage, KML), in the map coordinates of the scene
    values: tuple[float, ...] | None = None  # extent [m] in each of `directions_deg`
    directions_deg: tuple[float, ...] | None = None  # from +x towards +z; default: every 22.5 degrees
    thickness: Length | None = None  # above which a place is covered [m]; default: as in `datasets.maps`
    length: Length | None = None
    """Correlation length of the errors along the boundary [m]: exp(-distance / length); default: independent."""

    operator_type = Boundary
    robust = False

    def __post_init__(self) -> None:
        super().__post_init__()
        far = self.values is not None or self.directions_deg is not None or Noise.stated(self.noise).share == 0.0
        require(far, "noise", "a distance in m for an outline", self.noise)

    def operator(self, scene: Scene) -> Observation:
        if self.values is not None or self.directions_deg is not None:
            return Extents(scene, self.directions_deg)
        # For a twin, whose outline is not known yet.
        return Boundary(scene, shapely.box(0.0, 0.0, *plan_sides(scene)), self.thickness)

    def read(self, scene: Scene, folder: Path, released: Between) -> Target:
        if self.values is not None:
            return super().read(scene, folder, released)
        box = shapely.box(0.0, 0.0, *plan_sides(scene))
        path, (corner, crs), thickness = folder / str(self.csv or self.file), map_corner(scene), self.thickness
        with naming(path):
            if self.csv is not None:
                corner = (float(scene.domain.corner[0]), float(scene.domain.corner[2]))
                places = np.stack([*self.table(path, ("x", "z")).values()], axis=1)
                require(len(places) > 2, "", "three vertices along the outline or more", len(places))
                polygons = [shapely.Polygon(places)]
                crossed = "an outline that crosses itself"
                require(polygons[0].is_valid, "", "vertices in order along the outline", crossed)
            else:
                features = read_polygons(path, crs)
                # A file of `datasets.maps` has outlines of the deposit and of the flow, for each threshold.
                deposit = [feature for feature in features if str(feature.attributes.get("name")).lower() == "deposit"]
                thresholds = [feature.length(*THRESHOLD) for feature in deposit]
                if levels := sorted({level for level in thresholds if level}):
                    require(
                        all(thresholds), "", f"a {THRESHOLD[0]} above 0 m of each deposit, or of none", "one without"
                    )
                    thickness = levels[0] if thickness is None else thickness
                    choices = ", ".join(f"{level:g}" for level in levels)
                    require(thickness in levels, "thickness", f"one of the file's, {choices}", thickness)
                    pairs = zip(deposit, thresholds, strict=True)
                    deposit = [feature for feature, level in pairs if level == thickness]
                polygons = [feature.polygon for feature in deposit or features]
            region = shapely.transform(shapely.union_all(polygons), lambda rows: rows - corner)
            if not box.buffer(1e-6 * max(scene.domain.size)).contains(region):
                got = ", ".join(f"{bound:.6g}" for bound in region.bounds)
                raise InputError(f"expected an outline within the box, got x and z from its corner from {got} m")
        operator = Boundary(scene, region, thickness)
        if dropped := shapely.get_num_geometries(region) - shapely.get_num_geometries(operator.region):
            said = f"parts smaller than {ISLAND:.0%} of the largest do not count, as those of the model"
            warnings.warn(f"{path}: {said}: {dropped}", stacklevel=2)
        if thickness is None and operator.thickness > THICK * min(map(least_thickness, scene.masses)):
            said = f"the model's outline is where it is {operator.thickness:.2g} m thick"
            warnings.warn(f"{path}: {said}; `thickness` says what was mapped", stacklevel=2)
        return self.around(operator)

    def of_run(self, scene: Scene, run: Trajectory) -> Target:
        operator = self.operator(scene)
        if not isinstance(operator, Boundary):
            return self.compared(operator, operator.observe(run))
        last, volumes = torch.from_numpy(np.asarray(run.positions[-1])), torch.from_numpy(run.volumes)
        region = operator.covered(operator.heights(last, volumes).numpy())
        require(not region.is_empty, "thickness", "a deposit thicker than that somewhere", self.thickness)
        return self.around(Boundary(scene, region, self.thickness))

    def around(self, operator: Boundary) -> Target:
        """The target of an observed boundary: distances of 0 with the stated errors."""
        values = np.zeros(operator.count)
        deviation = Noise.stated(self.noise).of(values)
        errors = Covariance.correlated(deviation, shapely.get_coordinates(operator.points), self.length)
        return Target(observation=operator, values=values, errors=errors)
