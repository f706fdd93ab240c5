"""The box of a scene in map coordinates: whole cells around the ground that a flow reaches, or around GIS shapes.

`[domain] around = "release.gpkg"`, `margin = 200.0` stand for `origin` and `size`: the bounds of all shapes of the file
and a margin on each side, as far as the terrain goes, from the lowest ground there to some air above the highest.
"""

import math
import warnings
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from datasets.errors import require
from datasets.geometry.shapes import usual
from datasets.scene.grid_field import Floats

Entry = dict[str, Any]
Ends = Sequence[tuple[float, float]]  # first and last post of the terrain along x and z [m]

ROUNDING = 1.0e-6  # share of a metre or of two cells that counts as rounding
BENEATH, AIR = 4, 10  # cells beneath the lowest ground of a box; cells of air above the highest


def whole_cells(lower: Floats, upper: Floats, cell: float, ends: Ends, key: str) -> Entry:
    """`size`, `cell` and `origin` of a box between two corners [m], shape [3], limited to the ground of the terrain.
    Raises InputError, which names `key`, if no cell fits."""
    lower, upper = lower.copy(), upper.copy()
    for axis, (first, last) in zip((0, 2), ends, strict=True):
        lower[axis], upper[axis] = max(first, lower[axis]), min(last, upper[axis])
    lower[1], upper[1] = lower[1] - BENEATH * cell, upper[1] + AIR * cell
    unit = unit_of(cell)
    origin = unit * np.ceil(lower / unit - ROUNDING)
    origin[1] = unit * math.floor(lower[1] / unit)
    # Even numbers: on cells twice as large the same box shows their error (`surrogate = "coarse"`, forecasts).
    counts = 2.0 * np.floor((upper - origin) / (2.0 * cell) + 1.0e-9)
    counts[1] += 2.0
    require(bool((counts >= 1.0).all()), key, "cells that fit what lies in the box", f"{cell:g} m")
    return {"size": np.round(counts * cell, 9).tolist(), "cell": cell, "origin": np.round(origin, 9).tolist()}


def unit_of(cell: float) -> float:
    """The unit to which corners of a box are rounded: a metre, or for small cells a decimal fraction of it [m]."""
    return min(1.0, 10.0 ** math.floor(math.log10(cell)))


def plan_around(domain: Entry, solids: Any, folder: Path) -> Entry:
    """`[domain]` with origin and size in plan around the shapes of a file, with provisional heights; in the reference
    system of the terrain's raster among `solids`. Raises InputError."""
    # Half a second, which other scenes do not wait.
    from datasets.exchange.rasters import known_system, raster_system
    from datasets.exchange.vectors import read_bounds

    domain = dict(domain)
    around, margin, cell, crs = domain.pop("around"), domain.pop("margin", None), domain.get("cell"), domain.get("crs")
    for key in ("size", "origin"):
        require(key not in domain, key, "no such key beside around", "one")
    require(isinstance(around, str), "around", "the name of a file with polygons, lines or points", repr(around))
    given = isinstance(margin, int | float) and usual(margin) and margin >= 0.0
    require(given, "margin", "a length of at least 0 m beside around", margin)
    require(isinstance(cell, int | float) and usual(cell) and cell > 0.0, "cell", "a positive length in m", cell)
    if crs is None and isinstance(solids, list):
        files = [solid.get("file") for solid in solids if isinstance(solid, dict) and solid.get("kind") == "terrain"]
        crs = next((raster_system(folder / file) for file in files if isinstance(file, str)), None)
    elif crs is not None:
        crs = known_system(str(crs))
    bounds = read_bounds(folder / around, crs)
    lower, upper = bounds[:2] - margin, bounds[2:] + margin
    require(bool((upper > lower).all()), "margin", "a length above 0 m around a single place", margin)
    # Outwards to whole metres and an even number of cells.
    edge = float(domain["cell"])
    lower = unit_of(edge) * np.floor(lower / unit_of(edge) + ROUNDING)
    size = 2.0 * edge * np.ceil((upper - lower) / (2.0 * edge) - ROUNDING)
    box = {"origin": [lower[0], 0.0, lower[1]], "size": [size[0], edge, size[1]]}
    return domain | box | ({} if crs is None else {"crs": crs})


def with_elevations(domain: Entry, data: Entry) -> Entry:
    """A `[domain]` of `plan_around` in whole cells, limited to the terrain of `data` and as high as its contents need.
    Raises InputError for a scene without terrain there."""
    lower, upper = (np.array(domain["origin"]) + step * np.array(domain["size"]) for step in (0.0, 1.0))
    low, high, ends = math.inf, -math.inf, [(-math.inf, math.inf)] * 2
    for grid in filter(None, map(posts_of, entries(data, "solids"))):
        axes, heights = grid
        spans = zip(axes, lower[::2], upper[::2], strict=True)
        parts = [(at > first - at[1] + at[0]) & (at < last + at[1] - at[0]) for at, first, last in spans]
        within = heights[np.ix_(*parts)]
        require(within.size > 0, "around", "shapes that lie on the terrain", "others")
        low, high = min(low, float(within.min())), max(high, float(within.max()))
        ends = [(max(end[0], float(at[0])), min(end[1], float(at[-1]))) for end, at in zip(ends, axes, strict=True)]
    require(low < math.inf, "around", "a terrain in 3D, which says how high the box is", "none")
    short = any(lower[2 * n] < first or upper[2 * n] > last for n, (first, last) in enumerate(ends))
    thick = max((largest(mass.get("thickness", 0.0)) for mass in entries(data, "masses")), default=0.0)
    tops = [top for group in ("masses", "baffles", "solids") for top in map(top_of, entries(data, group))]
    cell = float(domain["cell"])
    # If the terrain moves the lower end, the cells end at the upper one or beyond.
    upper += 2.0 * cell * (1.0 - ROUNDING)
    lower[1], upper[1] = low, max(high + thick, *tops)
    box = whole_cells(lower, upper, cell, ends, "cell")
    if short:
        warnings.warn("domain.margin: the box ends where the terrain does", stacklevel=2)
    return domain | box


def filled(values: Floats, spacing: Sequence[float] | None = None) -> Floats:
    """Values at posts `spacing` [m] apart, [X, Z], holes (NaN) with those of the nearest posts."""
    from scipy.ndimage import distance_transform_edt

    holes = np.isnan(values)
    if not holes.any():
        return values
    nearest = distance_transform_edt(holes, spacing, return_distances=False, return_indices=True)
    return np.asarray(values[tuple(nearest)])


def entries(data: Entry, group: str) -> list[Entry]:
    """The tables of a group such as `masses`; the scene's own checks refuse other values."""
    listed = data.get(group)
    return [table for table in listed if isinstance(table, dict)] if isinstance(listed, list) else []


def posts_of(terrain: Entry) -> tuple[list[Floats], Floats] | None:
    """x and z of the posts of a terrain in 3D [m] and their elevations [X, Z]; None if they form no grid."""
    with suppress(KeyError, TypeError, ValueError):
        heights = np.array(terrain["heights"], np.float64)
        sides = zip(terrain["origin"], terrain["spacing"], heights.shape, strict=True)
        axes = [float(first) + float(step) * np.arange(count) for first, step, count in sides]
        return (axes, heights) if len(axes) == 2 and min(heights.shape) > 1 else None
    return None


def largest(thickness: Any) -> float:
    """The largest thickness of a layer [m]; 0 for invalid values."""
    with suppress(TypeError, ValueError):
        return float(np.max(np.array(thickness, np.float64)))
    return 0.0


def top_of(entry: Entry) -> float:
    """Elevation of the top of a box [m]; -inf for other entries."""
    with suppress(KeyError, TypeError, ValueError, IndexError):
        return float(entry["lower"][1]) + float(entry["size"][1])
    return -math.inf
