"""Shapes from the vector files of a GIS by pyogrio: shapefile, GeoPackage, GeoJSON, KML."""

import math
import re
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import shapely
from rasterio.crs import CRS
from rasterio.errors import RasterioError
from rasterio.warp import transform as reprojected
from shapely import Polygon

from datasets.errors import naming, require
from datasets.exchange.rasters import known_system
from datasets.files import file_size, reading
from datasets.scene.grid_field import Floats

LARGEST_LAYERS = 2**28  # bytes of a file
BEGINNINGS = {
    ".shp": rb"\x00\x00\x27\x0a",
    ".gpkg": rb"SQLite format 3\x00",
    ".geojson": rb"(\xef\xbb\xbf)?\s*\{",
    ".json": rb"(\xef\xbb\xbf)?\s*\{",
    ".kml": rb"(\xef\xbb\xbf)?\s*(<\?xml[^>]*>\s*)?(<!--.*?-->\s*)*<kml",
}
"""How files of these endings begin: GDAL goes by what is in them, and some formats name other files."""
LAYER = "|layername="  # between the name of a file and that of one of its layers, as QGIS has it
MOST_DEGREES = 360.0
"""Coordinates beyond it are no degrees: GeoJSON without a reference system counts as degrees for GDAL."""

Shape = tuple[shapely.Geometry, dict[str, Any], str]


class Feature(NamedTuple):
    """A polygon with what the file says of it."""

    polygon: Polygon  # in metres
    attributes: dict[str, Any]  # names in lower case

    def length(self, *names: str) -> float | None:
        """The first of these attributes that has a value [m], None where none has. Raises InputError for what is no
        length of at least 0."""
        values = [self.attributes[name] for name in names if name in self.attributes]
        # NULL is None or NaN, and in a column of text it may be empty.
        value = next((value for value in values if value == value and value not in (None, "")), None)
        try:
            length = 0.0 if value is None else float(value)
        except (TypeError, ValueError):
            length = math.nan
        require(0.0 <= length < math.inf, "", f"a number [m] in the attribute {' or '.join(names)}", value)
        return None if value is None else length


def read_polygons(path: Path, crs: str | None) -> list[Feature]:
    """The polygons of a file, each of several in a feature by itself, in the reference system `crs` (`read_shapes`)."""
    by_layer: dict[str, list[Feature]] = {}
    for place, named, layer in read_shapes(path, crs, "polygons"):
        parts = shapely.get_parts(place)
        while (shapely.get_type_id(parts) >= shapely.GeometryType.MULTIPOINT).any():
            parts = shapely.get_parts(parts)  # a collection may hold further ones
        polygons = [part for part in parts if part.geom_type == "Polygon" and not part.is_empty]
        by_layer.setdefault(layer, []).extend(Feature(polygon, named) for polygon in polygons)
    layers = [layer for layer, polygons in by_layer.items() if polygons]
    require(len(layers) > 0, "", "polygons", "none")
    require(len(layers) == 1, "", f"polygons in one layer, or FILE{LAYER}NAME", f"them in {', '.join(layers)}")
    features = by_layer[layers[0]]
    simple = all(feature.polygon.is_valid for feature in features)
    require(simple, "", "polygons that do not cross themselves", "others")
    return features


def read_bounds(path: Path, crs: str | None) -> Floats:
    """West, south, east and north end [m] of all polygons, lines and points of a file (`read_shapes`)."""
    with naming(path):
        shapes = [place for place, *_ in read_shapes(path, crs, "polygons, lines or points")]
        bounds = shapely.total_bounds(shapes) if shapes else np.full(4, np.nan)
        require(bool(np.isfinite(bounds).all()), "", "polygons, lines or points", "none")
    return np.asarray(bounds)


def read_shapes(path: Path, crs: str | None, what: str) -> Iterator[Shape]:
    """The shapes of a file, or of its layer in FILE|layername=NAME as QGIS has it, with their attributes, names in
    lower case, and layers; in metres in the system `crs`, in which a file that names none is. Raises InputError."""
    import pyogrio

    name, _, chosen = str(path).partition(LAYER)
    path = Path(name)
    file_size(path, what, most=LARGEST_LAYERS)
    pattern = BEGINNINGS.get(path.suffix.lower())
    require(pattern is not None, "", f"a file whose name ends in {' '.join(BEGINNINGS)}", repr(path.suffix))
    with path.open("rb") as raw:
        fits = re.match(pattern or b"", raw.read(4096), re.DOTALL) is not None
    require(fits, "", f"a file as its ending {path.suffix} says", "another one")
    with reading(path, what):
        layers = [str(layer) for layer, kind in pyogrio.list_layers(path.resolve()) if kind is not None]
    require(not chosen or chosen in layers, "", f"one of the layers {', '.join(layers)}", repr(chosen))
    for layer in [chosen] if chosen else layers:
        with reading(path, what):
            described, _, shapes, values = pyogrio.raw.read(path.resolve(), layer=layer, force_2d=True)
            places = shapely.from_wkb(shapes)
        if len(places) == 0:
            continue
        system, bounds = described["crs"], shapely.total_bounds(places)
        degrees = system is not None and CRS.from_user_input(system).is_geographic
        unnamed = crs is None and path.suffix.lower() in (".geojson", ".json")
        if degrees and (unnamed or bool((np.abs(bounds) > MOST_DEGREES).any())):
            system = None
        if system is not None and crs is None and np.isfinite(bounds).all():
            # Beside a map without a reference system, coordinates count as metres.
            known_system(system, "", (0.5 * (bounds[:2] + bounds[2:])).tolist())
        if system is not None and crs is not None and system != crs:
            with reading(path, f"coordinates of {system} that lie in {crs}"):
                places = shapely.transform(places, partial(projected, system=system, crs=crs))
        columns = {name.lower(): column for name, column in zip(described["fields"], values, strict=True)}
        for number, place in enumerate(places):
            yield place, {name: column[number] for name, column in columns.items()}, layer


def projected(rows: Any, system: str, crs: str) -> Any:
    """Places [N, 2] of one reference system in another one. Raises RasterioError where they have none there."""
    places = np.stack(reprojected(system, crs, rows[:, 0], rows[:, 1]), axis=1)
    if not np.isfinite(places).all():
        raise RasterioError("they have no place there")
    return places
