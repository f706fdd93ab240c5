"""Maps -> GeoTIFF, GeoJSON and pictures: in the coordinates of the terrain's raster where the scene has one."""

import json
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from shapely import MultiPolygon, Polygon
from shapely.geometry import mapping
from shapely.geometry.polygon import orient

from datasets.errors import WorkFailed
from datasets.files import replacing, write_text
from datasets.maps.plan import PlanMaps
from datasets.scene import Scene

Floats = NDArray[np.float64]

CLOSE = 1.0e-6
"""How far beyond its edge a map falls to 0 [cells]."""
WIDTH, HIGHEST = 9.0, 9.0
"""Of a picture [inches]."""
CONTOURS = 12
"""About as many contour lines of the ground."""


@dataclass(frozen=True, kw_only=True)
class Georeference:
    """Where a box lies: x runs to the east, z to the north."""

    east: float = 0.0
    """Easting of x = 0 [m]."""
    north: float = 0.0
    """Northing of z = 0 [m]."""
    crs: str | None = None
    """Coordinate reference system, as an authority's code or in WKT; None of local coordinates."""


LOCAL = Georeference()
"""Coordinates of the box itself."""


def georeference(scene: Scene) -> Georeference:
    """Where the box of `scene` lies: where the raster of its terrain says, the first that says so; else `LOCAL`."""
    for solid in scene.solids:
        if solid.corner is not None:
            return Georeference(east=solid.corner[0], north=solid.corner[1], crs=solid.crs)
    return LOCAL


def write_raster(path: Path, values: Floats, cell: float, georeference: Georeference, *, name: str, unit: str) -> None:
    """Write a map, shape [X, Z], over square cells [m], the first at x = z = 0, as a GeoTIFF.

    Rows run from the north (large z) to the south, columns to the east (x). Raises WorkFailed.
    """
    import rasterio
    from rasterio.errors import RasterioError

    rows = np.ascontiguousarray(values.T[::-1], np.float32)
    height, width = rows.shape
    profile: dict[str, Any] = {"driver": "GTiff", "compress": "deflate", "predictor": 3, "count": 1, "dtype": "float32"}
    # To the east along a row, to the south from row to row.
    transform = rasterio.Affine(cell, 0.0, georeference.east, 0.0, -cell, georeference.north + height * cell)
    try:
        with warnings.catch_warnings(), replacing(path) as part:
            # A box in its own coordinates has no reference system, which is no mistake.
            warnings.simplefilter("ignore")
            place: dict[str, Any] = {"width": width, "height": height, "transform": transform, "crs": georeference.crs}
            with rasterio.open(part, "w", **profile, **place) as raster:
                raster.write(rows, 1)
                raster.set_band_description(1, name)
                raster.set_band_unit(1, unit)
    except RasterioError as error:
        raise WorkFailed(f"{path.name} could not be written: {error}") from None


def outline(values: Floats, cell: float, georeference: Georeference, threshold: float) -> MultiPolygon:
    """Where a map, shape [X, Z], exceeds `threshold`: polygons with holes, in the map's coordinates.

    The line runs where the map, linear between the middles of its cells and even in the outer half of the last, equals
    the threshold, and along the edge of the map. Outer rings run anticlockwise, holes clockwise.
    """
    from contourpy import FillType, contour_generator

    padded = np.pad(np.pad(values, 1, mode="edge"), 1)
    x, z = (
        cell * np.concatenate([[-CLOSE, 0.0], np.arange(count) + 0.5, [count, count + CLOSE]]) for count in values.shape
    )
    places = georeference.east + x, georeference.north + z
    filled = contour_generator(*places, padded.T, fill_type=FillType.OuterOffset).filled(threshold, np.inf)
    parts = [np.split(points, offsets[1:-1]) for points, offsets in zip(*filled, strict=True)]
    return MultiPolygon([orient(Polygon(outer, holes)) for outer, *holes in parts])


def write_outlines(
    path: Path, outlines: Mapping[str, MultiPolygon], threshold: float, georeference: Georeference
) -> None:
    """Write named outlines as GeoJSON: a MultiPolygon each, with `name`, `threshold_m` and `area_m2`.

    Coordinates are those of the rasters, their system is named as GDAL does (`crs`); local ones name none.
    """
    from rasterio.crs import CRS

    features = [
        {
            "type": "Feature",
            "properties": {"name": name, "threshold_m": threshold, "area_m2": polygons.area},
            "geometry": mapping(polygons),
        }
        for name, polygons in outlines.items()
    ]
    collection: dict[str, Any] = {"type": "FeatureCollection", "features": features}
    if georeference.crs is not None:
        known = CRS.from_user_input(georeference.crs).to_authority()
        name = georeference.crs if known is None else f"urn:ogc:def:crs:{known[0]}::{known[1]}"
        collection["crs"] = {"type": "name", "properties": {"name": name}}
    write_text(path, json.dumps(collection) + "\n")


def draw_maps(
    path: Path, maps: PlanMaps, georeference: Georeference, kinds: Mapping[str, tuple[str, str, str]]
) -> None:
    """All maps where they are covered, one above the other; over the ground, with the outline of the deposit.

    kinds: title, unit and colours (of matplotlib) of each.
    """
    from matplotlib.figure import Figure

    x, z = maps.grid.axes
    x, z = x + georeference.east, z + georeference.north
    height = min(HIGHEST, 1.3 + 0.8 * WIDTH * len(z) / len(x))
    figure = Figure(figsize=(WIDTH, height * len(kinds)), layout="constrained")
    panels = figure.subplots(len(kinds), squeeze=False, subplot_kw={"aspect": "equal"})[:, 0]
    for panel, (name, (title, unit, colours)) in zip(panels, kinds.items(), strict=True):
        covered = (maps.thickness if name == "thickness" else maps.depth) > maps.threshold
        if np.ptp(maps.ground) > 0.0:
            panel.contour(x, z, maps.ground.T, levels=CONTOURS, colors="grey", linewidths=0.6)
        shown = np.ma.masked_where(~covered, getattr(maps, name)).T
        image = panel.pcolormesh(x, z, shown, cmap=colours, vmin=0.0, shading="nearest")
        figure.colorbar(image, label=f"{title} [{unit}]")
        if maps.thickness.min() < maps.threshold < maps.thickness.max():
            panel.contour(x, z, maps.thickness.T, levels=[maps.threshold], colors="black", linewidths=1.0)
        panel.set(xlabel="x, easting [m]", ylabel="z, northing [m]")
        panel.ticklabel_format(useOffset=False, style="plain")
    with replacing(path) as part:
        figure.savefig(part, dpi=120)
