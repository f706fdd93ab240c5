"""Shapes from the vector files of a GIS by pyogrio: shapefile, GeoPackage, GeoJSON, KML."""

import re
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import shapely
from rasterio.crs import CRS
from rasterio.errors import RasterioError
from rasterio.warp import transform as reprojected
from shapely import Polygon

from datasets.errors import naming, require
from datasets.files import file_size, reading

LARGEST = 2**28
"""Bytes of a file."""
BEGINNINGS = {
    ".shp": rb"\x00\x00\x27\x0a",
    ".gpkg": rb"SQLite format 3\x00",
    ".geojson": rb"(\xef\xbb\xbf)?\s*\{",
    ".json": rb"(\xef\xbb\xbf)?\s*\{",
    ".kml": rb"(\xef\xbb\xbf)?\s*(<\?xml[^>]*>\s*)?(<!--.*?-->\s*)*<kml",
}
"""How files of these endings begin: GDAL goes by what is in them, and some formats name other files."""
MOST_DEGREES = 360.0
"""Coordinates beyond it are no degrees: GeoJSON without a reference system counts as degrees for GDAL."""


class Feature(NamedTuple):
    """A polygon with what the file says of it."""

    polygon: Polygon
    """In metres."""
    attributes: dict[str, Any]
    """Names in lower case."""


def read_polygons(path: Path, crs: str | None) -> list[Feature]:
    """The polygons of a file, each of several in a feature by itself, in the reference system `crs` (`read_shapes`)."""
    shapes = [(part, named) for place, named in read_shapes(path, crs, "polygons") for part in shapely.get_parts(place)]
    features = [Feature(part, named) for part, named in shapes if part.geom_type == "Polygon" and not part.is_empty]
    require(bool(features), "", "polygons", "none")
    require(all(each.polygon.is_valid for each in features), "", "polygons that do not cross themselves", "others")
    return features


def read_bounds(path: Path, crs: str | None) -> tuple[float, float, float, float]:
    """West, south, east and north end [m] of all polygons, lines and points of a file (`read_shapes`)."""
    with naming(path):
        found = shapely.total_bounds([place for place, _ in read_shapes(path, crs, "polygons, lines or points")])
        require(bool(np.isfinite(found).all()), "", "polygons, lines or points", "none")
    west, south, east, north = map(float, found)
    return west, south, east, north


def read_shapes(path: Path, crs: str | None, what: str) -> list[tuple[shapely.Geometry, dict[str, Any]]]:
    """The shapes of a file and their attributes, names in lower case, in the reference system `crs` in metres.

    crs: of the map, as an authority's code or in WKT; None of a map that names none, in which the file then is too. A
    file that names none is in that of the map. Raises InputError.
    """
    import pyogrio

    file_size(path, what, most=LARGEST)
    pattern = BEGINNINGS.get(path.suffix.lower())
    require(pattern is not None, "", f"a file whose name ends in {' '.join(BEGINNINGS)}", repr(path.suffix))
    with path.open("rb") as raw:
        known = re.match(pattern or b"", raw.read(4096), re.DOTALL) is not None
    require(known, "", f"a file as its ending {path.suffix} says", "another one")
    with reading(path, what):
        described, _, shapes, values = pyogrio.raw.read(path.resolve(), force_2d=True)
        places = shapely.from_wkb(shapes)
    system, bounds = described["crs"], np.abs(shapely.total_bounds(places))
    degrees = system is not None and CRS.from_user_input(system).is_geographic
    unnamed = crs is None and path.suffix.lower() in (".geojson", ".json")
    if degrees and (unnamed or bool((bounds > MOST_DEGREES).any())):
        system, degrees = None, False
    require(crs is not None or not degrees, "", "metres, as the map without a reference system", "degrees")
    if system is not None and crs is not None and system != crs:
        with reading(path, f"coordinates of {system} that lie in {crs}"):
            places = shapely.transform(places, lambda rows: projected(rows, system, crs))
    columns = {name.lower(): column for name, column in zip(described["fields"], values, strict=True)}
    return [(place, {name: column[n] for name, column in columns.items()}) for n, place in enumerate(places)]


def projected(rows: Any, system: str, crs: str) -> Any:
    """Places [N, 2] of one reference system in another one. Raises RasterioError where they have none there."""
    found = np.stack(reprojected(system, crs, rows[:, 0], rows[:, 1]), axis=1)
    if not np.isfinite(found).all():
        raise RasterioError("they have no place there")
    return found
