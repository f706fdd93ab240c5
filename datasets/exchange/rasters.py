"""Maps -> GeoTIFF, ESRI ASCII and GeoJSON: in the coordinates of the terrain's raster where the scene has one."""

import itertools
import json
import tempfile
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from datasets.command_line import WorkFailed
from datasets.files import write_text
from datasets.scene import Scene

Floats = NDArray[np.float64]
Ring = list[list[float]]

DRIVERS = {"tif": "GTiff", "asc": "AAIGrid"}
OPTIONS: dict[str, dict[str, Any]] = {
    "tif": {"compress": "deflate", "predictor": 3},
    "asc": {"significant_digits": 9},
}

CLOSE = 1.0e-6
"""How far beyond its edge a map falls to 0 [cells]."""


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


def write_raster(
    path: Path,
    values: Floats,
    cell: float,
    georeference: Georeference,
    *,
    kind: Literal["tif", "asc"],
    name: str,
    unit: str,
) -> None:
    """Write a map, shape [X, Z], over square cells [m], the first at x = z = 0: a GeoTIFF or an ESRI ASCII grid.

    Rows run from the north (large z) to the south, columns to the east (x). What stands beside an ASCII grid, its
    coordinate system in a .prj, comes along. Raises WorkFailed.
    """
    import rasterio
    from rasterio.errors import RasterioError

    rows = np.ascontiguousarray(values.T[::-1], np.float32)
    profile: dict[str, Any] = {
        "driver": DRIVERS[kind],
        "width": rows.shape[1],
        "height": rows.shape[0],
        "count": 1,
        "dtype": "float32",
        "crs": georeference.crs,
        # To the east along a row, to the south from row to row.
        "transform": rasterio.Affine(
            cell, 0.0, georeference.east, 0.0, -cell, georeference.north + rows.shape[0] * cell
        ),
        **OPTIONS[kind],
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=path.parent, prefix=".raster-") as folder:
        try:
            with warnings.catch_warnings():
                # A box in its own coordinates has no reference system, which is no mistake.
                warnings.simplefilter("ignore")
                with rasterio.open(Path(folder) / path.name, "w", **profile) as raster:
                    raster.write(rows, 1)
                    if kind == "tif":
                        raster.set_band_description(1, name)
                        raster.set_band_unit(1, unit)
        except (RasterioError, OSError) as error:
            raise WorkFailed(f"{path.name} could not be written: {error}") from None
        for file in sorted(Path(folder).iterdir()):
            file.chmod(0o644)
            file.replace(path.parent / file.name)


def outline(values: Floats, cell: float, georeference: Georeference, threshold: float) -> list[list[Ring]]:
    """Where a map, shape [X, Z], exceeds `threshold`: polygons of an outer ring and holes, in the map's coordinates.

    The line runs where the map, linear between the middles of its cells and even in the outer half of the last, equals
    the threshold, and along the edge of the map.
    Outer rings run anticlockwise, holes clockwise, all are closed, as GeoJSON has them.
    """
    from contourpy import FillType, contour_generator

    padded = np.pad(np.pad(values, 1, mode="edge"), 1)
    x, z = (
        cell * np.concatenate([[-CLOSE, 0.0], np.arange(count) + 0.5, [count, count + CLOSE]]) for count in values.shape
    )
    generator = contour_generator(
        georeference.east + x, georeference.north + z, padded.T, fill_type=FillType.OuterOffset
    )
    lines = generator.filled(threshold, np.inf)
    polygons = []
    for points, offsets in zip(*lines, strict=True):
        rings = [points[begin:end].tolist() for begin, end in itertools.pairwise(offsets)]
        polygons.append(
            [ring if (signed_area(ring) > 0.0) is (index == 0) else ring[::-1] for index, ring in enumerate(rings)]
        )
    return polygons


def signed_area(ring: Ring) -> float:
    """Area within a closed ring [m^2], positive where it runs anticlockwise."""
    x, y = (np.array(ring) - ring[0]).T
    return float(0.5 * (x[:-1] * y[1:] - x[1:] * y[:-1]).sum())


def area(polygons: Sequence[Sequence[Ring]]) -> float:
    """Area of polygons with holes [m^2]."""
    return sum(signed_area(ring) for polygon in polygons for ring in polygon)


def write_outlines(
    path: Path, outlines: dict[str, list[list[Ring]]], threshold: float, georeference: Georeference
) -> None:
    """Write named outlines as GeoJSON: a MultiPolygon each, with `name`, `threshold_m` and `area_m2`.

    Coordinates are those of the rasters, their system is named as GDAL does (`crs`); local ones name none.
    """
    features = [
        {
            "type": "Feature",
            "properties": {"name": name, "threshold_m": threshold, "area_m2": area(polygons)},
            "geometry": {"type": "MultiPolygon", "coordinates": polygons},
        }
        for name, polygons in outlines.items()
    ]
    collection: dict[str, Any] = {"type": "FeatureCollection", "features": features}
    if georeference.crs is not None:
        collection["crs"] = {"type": "name", "properties": {"name": urn(georeference.crs)}}
    write_text(path, json.dumps(collection) + "\n")


def urn(crs: str) -> str:
    """The name of a coordinate reference system as GeoJSON has it, such as urn:ogc:def:crs:EPSG::25832."""
    from rasterio.crs import CRS

    known = CRS.from_user_input(crs).to_authority()
    return crs if known is None else f"urn:ogc:def:crs:{known[0]}::{known[1]}"
