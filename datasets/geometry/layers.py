"""Where a layer lies in plan, how thick it is there, and its exact volume."""

from typing import TYPE_CHECKING

import numpy as np
import shapely
from numpy.typing import NDArray

from datasets.errors import InputError
from datasets.geometry.ground import first_diagonal, interpolated
from datasets.geometry.margins import Box
from datasets.geometry.planar import check_simple
from datasets.geometry.solid import check_ground_line, check_rows, check_vectors

if TYPE_CHECKING:
    from datasets.scene import Mass

Floats = NDArray[np.float64]


class Plan:
    """A layer of a scene in plan: in 2D a range of x, in 3D a polygon of x and z. Raises InputError."""

    def __init__(self, mass: "Mass", box: Box, key: str) -> None:
        self.mass, self.dimension = mass, box.dimension
        size = np.array([box.size[axis] for axis in range(box.dimension) if axis != 1])
        self.check(key)
        self.stations = self.given_stations()
        lower, upper = np.zeros_like(size), size
        if self.stations is not None:
            lower = np.maximum(lower, [axis[0] for axis in self.stations])
            upper = np.minimum(upper, [axis[-1] for axis in self.stations])
        outline = None if mass.outline is None else np.array(mass.outline)
        if outline is not None:
            lower, upper = np.maximum(lower, outline.min(axis=0)), np.minimum(upper, outline.max(axis=0))
        if (upper <= lower).any():
            raise InputError("expected a layer that lies in the box, in plan it does not", key=key)
        self.region = shapely.box(*lower, *upper) if self.dimension == 3 else None
        if self.region is not None and outline is not None:
            check_simple(outline, f"{key}.outline")
            self.region = self.region.intersection(shapely.Polygon(outline))
            if self.region.area <= 0.0:
                raise InputError("expected an outline that lies in the box", key=f"{key}.outline")
            lower, upper = np.array(self.region.bounds).reshape(2, 2)
        self.lower: Floats = lower
        """Least x, and z, of the layer [m], shape [D - 1]."""
        self.upper: Floats = upper
        """Greatest [m]."""
        if self.region is not None:
            shapely.prepare(self.region)

    def check(self, key: str) -> None:
        """Raise InputError for a thickness that is none."""
        given, mass = self.mass.thickness, self.mass
        gridded = isinstance(given, tuple) and self.dimension == 3
        for name in ("origin", "spacing"):
            value = getattr(mass, name)
            if (value is not None) != gridded:
                expected = (
                    "x and z of a grid of thicknesses" if gridded else "no such key without a grid of thicknesses"
                )
                raise InputError(f"expected {expected}", key=f"{key}.{name}")
        if not isinstance(given, tuple):
            if not given or not 0.0 < given < np.inf:
                raise InputError(f"expected a positive length in m, got {given}", key=f"{key}.thickness")
            return
        if gridded:
            check_rows(given, f"{key}.thickness")
            check_vectors((mass.origin or (), mass.spacing or ()), ("origin", "spacing"), key, 2)
            if min(mass.spacing or (0.0,)) <= 0.0:
                raise InputError(f"expected positive lengths in m, got {mass.spacing}", key=f"{key}.spacing")
        else:
            check_ground_line(given, f"{key}.thickness")
        values = np.array(given) if gridded else np.array(given)[:, 1]
        if values.min() < 0.0:
            raise InputError(f"expected thicknesses of at least 0 m, got {values.min():g}", key=f"{key}.thickness")
        if values.max() <= 0.0:
            raise InputError("expected some thickness, all are 0", key=f"{key}.thickness")

    def given_stations(self) -> tuple[Floats, ...] | None:
        """Where the thickness is given along each axis in plan [m]; None of a number."""
        given = self.mass.thickness
        if not isinstance(given, tuple):
            return None
        if self.dimension == 2:
            return (np.array(given)[:, 0],)
        shape = np.array(given).shape
        origin, spacing = self.mass.origin or (), self.mass.spacing or ()
        return tuple(np.asarray(origin[k] + spacing[k] * np.arange(shape[k]), np.float64) for k in range(2))

    @property
    def greatest(self) -> float:
        """The largest thickness anywhere [m]."""
        given = self.mass.thickness
        if not isinstance(given, tuple):
            return float(given or 0.0)
        return float(np.array(given).max() if self.dimension == 3 else np.array(given)[:, 1].max())

    def contains(self, plan: Floats) -> NDArray[np.bool_]:
        """Which places in plan [m], shape [N, D - 1], are in the layer's outline, shape [N]."""
        if self.region is None:
            return np.asarray(((plan >= self.lower) & (plan <= self.upper)).all(axis=1))
        return np.asarray(shapely.contains_xy(self.region, plan[:, 0], plan[:, 1]), bool)

    def thickness(self, plan: Floats) -> Floats:
        """Thickness [m] at places in plan, shape [N]."""
        given = self.mass.thickness
        if self.stations is None:
            return np.full(len(plan), float(given or 0.0))  # type: ignore[arg-type]
        if self.dimension == 2:
            return np.asarray(np.interp(plan[:, 0], self.stations[0], np.array(given)[:, 1]))
        x, z = self.stations
        return interpolated(x, z, np.array(given), plan)

    @property
    def volume(self) -> float:
        """Volume of the layer [m^D]: thickness, linear between what is given, over the outline."""
        if self.dimension == 2:
            (low,), (high,) = self.lower, self.upper
            ends = np.array([low, high])
            if self.stations is None:
                return float((high - low) * self.greatest)
            (x,) = self.stations
            x = np.unique(np.concatenate([ends, x[(x > low) & (x < high)]]))
            return float(np.trapezoid(self.thickness(x[:, None]), x))
        assert self.region is not None
        if self.stations is None:
            return float(self.region.area * self.greatest)
        return self.gridded_volume()

    def gridded_volume(self) -> float:
        """The volume over the part of each triangle of the grid that is in the outline: area times mean height."""
        assert self.stations is not None
        x, z = self.stations
        values = np.array(self.mass.thickness)
        grid = np.stack([*np.meshgrid(x, z, indexing="ij"), values], axis=-1)
        a, b, c, d = (grid[:-1, :-1], grid[1:, :-1], grid[1:, 1:], grid[:-1, 1:])
        along = first_diagonal(values)[..., None, None, None]
        halves = np.where(
            along,
            np.stack([np.stack([a, b, c], axis=2), np.stack([a, c, d], axis=2)], axis=2),
            np.stack([np.stack([a, b, d], axis=2), np.stack([b, c, d], axis=2)], axis=2),
        ).reshape(-1, 3, 3)
        halves = halves[halves[..., 2].any(axis=1)]
        parts = shapely.intersection(shapely.polygons(halves[..., :2]), self.region)
        area, centre = shapely.area(parts), shapely.centroid(parts)
        kept = area > 0.0
        plan = np.stack([shapely.get_x(centre[kept]), shapely.get_y(centre[kept])], axis=1)
        # The height of a triangle is linear: its mean over a part is that at the part's centroid.
        first, edges = halves[kept][:, 0], halves[kept][:, 1:] - halves[kept][:, :1]
        share = np.linalg.solve(edges[:, :, :2].swapaxes(1, 2), (plan - first[:, :2])[..., None])[..., 0]
        height = first[:, 2] + (share * edges[:, :, 2]).sum(axis=1)
        return float((area[kept] * height).sum())
