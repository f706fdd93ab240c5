"""Rasters by rasterio: elevations and thicknesses read, maps written."""

import re
import warnings
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import rasterio
from numpy.typing import NDArray
from rasterio.crs import CRS
from rasterio.errors import CRSError, NotGeoreferencedWarning, RasterioError
from rasterio.io import MemoryFile
from rasterio.warp import transform as reprojected

from datasets.errors import InputError, WorkFailed, require, shortened
from datasets.files import LARGEST, MARKS, NEW_LINE, decoded, file_size, reading, replacing
from datasets.geometry.shapes import usual
from datasets.memory import require as require_memory
from datasets.scene.grid_field import Floats

VALUE = 32  # bytes per value while a raster is read
METRES = ("", "m", "metre", "metres", "meter", "meters")  # accepted units of a raster's values
UNDECLARED = (-9999.0, -99999.0, -32767.0, -32768.0)  # values that stand for no data by custom, as they are in the file
CLIFF, STEEP = 500.0, 10.0
"""Height of a step [m], and over the cell, above which isolated values such as -999, 9999 or 0 are not ground."""
OTHERS: dict[str | bytes, str] = {".img": "HFA", ".bil": "EHdr", ".flt": "EHdr", ".vrt": "VRT"}
OTHERS |= {b"DSBB": "GSBG", b"DSRB": "GS7BG", b"DSAA": "GSAG"}
"""GDAL's drivers by a file's ending or, of a grid of Surfer, by its beginning; others are GeoTIFF or ESRI ASCII."""
ELSEWHERE = re.compile(rb"/vsi|://|pixelfunction", re.IGNORECASE)
"""Forbidden contents of a mosaic (.vrt): files of other machines and code."""
HEADER = re.compile(rb"\s*((ncols|nrows|[xy]ll(corner|center)|cellsize|d[xy]|nodata_value)\s+\S+\s+)*", re.IGNORECASE)
"""The header of an ASCII raster, before its values."""
VALUES = re.compile(
    rb"(?:\s*+[+-]?+(?:(?:\d++[.,]?+\d*+|[.,]\d++)(?:e[+-]?+\d++)?+|nan|inf|1\.#\w++|null)(?=\s|$))*+\s*+",
    re.IGNORECASE,
)
"""Numbers as GDAL reads them; for any other word it takes the leading digits, or 0."""
LOCAL = ("LOCAL_CS", "ENGCRS")
"""Beginnings in WKT of reference systems without a place on the earth, which GDAL gives to a raster without any."""
HEIGHTS = re.compile(r'VERT_CS\[.*UNIT\["([^"]+)",([^\],]+)')
"""The unit of the heights of a reference system in WKT, and what one is in metres."""
NO_ELEVATION = 2.0e4  # elevation or thickness [m] above any on earth: 32767, 1e20, -3.4e38
LONGEST_WORD = 40  # most characters of a word that are shown
LENGTH, EARTH = 100.0, 6.371e6  # length on the map for its scale; radius of the earth [m]
DISTORTED = 0.02
"""Largest relative difference of a metre on the map from one on the ground; the earth's flattening causes 0.5 %."""
SAME_PLACE = 1.0  # largest distance between the places of two reference systems that count as the same [m]


class Raster(NamedTuple):
    """Values on a regular grid."""

    x: Floats  # ascending [m], shape [X]
    z: Floats  # ascending [m], shape [Z]
    values: Floats  # NaN in holes, shape [X, Z]
    spacing: tuple[float, float]  # of the grid along x and z [m]
    corner: tuple[float, float]  # lower left corner of the extent in the file's own coordinates [m]
    crs: str | None  # coordinate reference system, as an authority's code or in WKT, where it names one
    description: str = ""  # of the band, where there is one


def read_raster(path: Path, *, coefficients: bool = False) -> Raster:
    """A raster of one band in metres on the ground, rows from west to east, scale and offset applied. Impossible
    lengths count as no data, with a warning; for `coefficients`, only UNDECLARED values do. Raises InputError."""
    with opened(path) as file:
        require_memory(VALUE * file.width * file.height, "a raster", "cut it to the box")
        if file.driver == "AAIGrid":
            check_values(plain_text(path), file.width * file.height)
        georeferenced = not file.transform.is_identity
        transform, crs, bands, unit = file.transform, system_of(file), file.count, file.units[0]
        description = file.descriptions[0] or ""
        scale, offset = float(file.scales[0]), float(file.offsets[0])
        require(not file.dtypes[0].startswith("complex"), "", "real numbers", file.dtypes[0])
        raw_values = file.read(1, masked=True).astype(np.float64).filled(np.nan)
    require(bool(np.isfinite(tuple(transform)).all()), "", "a raster that lies at finite coordinates", "others")
    require(bands == 1, "", "a raster of one band", bands)
    unit = (height_unit(crs) if crs else "") or unit
    require(coefficients or unit is None or unit.lower() in METRES, "", "elevations in metres", repr(unit))
    name = "metre" if not crs else "degrees" if crs.is_geographic else str(crs.linear_units)
    require(name.lower() in METRES, "", "a projected coordinate system in metres", f"one in {name}")
    require(georeferenced, "", "a raster that says where it lies and how large its cells are", "one that does not")
    sized = transform.a * transform.e != transform.b * transform.d
    require(sized, "", "cells larger than 0 m", f"{transform.a:g} x {abs(transform.e):g} m")
    upright = transform.b == transform.d == 0.0 and transform.a > 0.0 and transform.e != 0.0
    require(upright, "", "a raster whose rows run from west to east", "one that is turned or mirrored")
    require(scale != 0.0 and usual(scale) and usual(offset), "", "a finite scale and offset", (scale, offset))
    rows, columns = raw_values.shape
    values = scale * raw_values + offset
    none = np.isfinite(values) & np.isin(raw_values, UNDECLARED)
    if not coefficients:
        none |= np.isfinite(values) & (np.abs(values) >= NO_ELEVATION)
        none |= beyond_cliffs(np.where(none, np.nan, values), max(CLIFF, STEEP * max(transform.a, abs(transform.e))))
    got = f"{raw_values[none][0]:g} and the like" if none.any() else "no data everywhere"
    some = bool((np.isfinite(values) & ~none).any())
    require(some, "", "coefficients" if coefficients else f"lengths in m, below {NO_ELEVATION:g}", got)
    if none.any():
        which = f"{int(none.sum())} values such as {raw_values[none][0]:g}"
        warnings.warn(f"{path}: {which} are taken as no data, which the file does not declare", stacklevel=2)
    values[none | ~np.isfinite(values)] = np.nan
    # From the south to the north.
    height = abs(transform.e)
    south = transform.f + (rows * transform.e if transform.e < 0.0 else 0.0)
    values = values[::-1] if transform.e < 0.0 else values
    x = np.asarray(transform.c + (np.arange(columns) + 0.5) * transform.a)
    z = np.asarray(south + (np.arange(rows) + 0.5) * height)
    if crs:
        check_lengths(crs, float(x.mean()), float(z.mean()))
    spacing, corner = (float(transform.a), float(height)), (float(transform.c), float(south))
    return Raster(x, z, np.ascontiguousarray(values.T), spacing, corner, crs.to_string() if crs else None, description)


def raster_system(path: Path) -> str | None:
    """The reference system that a raster names, as an authority's code or in WKT. Raises InputError."""
    with opened(path) as file:
        crs = system_of(file)
        return str(crs.to_string()) if crs else None


def system_of(file: Any) -> CRS | None:
    """The reference system of a raster; None if it is a local one in metres without a place on the earth."""
    crs = file.crs
    return None if crs and crs.to_wkt().startswith(LOCAL) and crs.units_factor[1] == 1.0 else crs


@contextmanager
def opened(path: Path) -> Iterator[Any]:
    """A raster as rasterio has it, of a mosaic (.vrt) on this machine alone. Raises InputError, also for the block."""
    file_size(path, "a raster", most=LARGEST)
    with reading(path, "a readable raster"), warnings.catch_warnings(), ExitStack() as stack:
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        with path.open("rb") as raw:
            head = raw.read(4)
        plain = "GTiff" if head[:2] in (b"II", b"MM") else "AAIGrid"
        driver = OTHERS.get(path.suffix.lower()) or OTHERS.get(head) or plain
        here = driver != "VRT" or not ELSEWHERE.search(path.read_bytes())
        require(here, "", "a mosaic of files of this machine, without functions", "another one")
        # Text in double precision: elevations of 2,000 m have steps of 0.1 mm in single.
        options = {"driver": driver} | ({"DATATYPE": "Float64"} if driver == "AAIGrid" else {})
        if head.startswith(tuple(MARKS)):
            # The driver reads only plain text.
            yield stack.enter_context(stack.enter_context(MemoryFile(plain_text(path), ext=".asc")).open(**options))
        else:
            yield stack.enter_context(rasterio.open(path.resolve(), **options))


def plain_text(path: Path) -> bytes:
    """The text of a file without a mark of how it is encoded."""
    raw = path.read_bytes()
    return decoded(raw).encode() if raw.startswith(tuple(MARKS)) else raw


def check_values(text: bytes, count: int) -> None:
    """Raise InputError unless the text of an ASCII raster has so many values and all of them are numbers."""
    header = HEADER.match(text)
    begin = 0 if header is None else header.end()
    numbers = VALUES.match(text, begin)
    end = begin if numbers is None else numbers.end()
    if end < len(text):
        got = text[end : end + LONGEST_WORD].split()[0].decode(errors="replace")
        raise InputError(f"expected numbers, got {got!r} in line {text.count(NEW_LINE, 0, end) + 1}")
    blank = np.frombuffer(text, np.uint8)[begin:] <= ord(" ")
    words = int(np.count_nonzero(blank[:-1] & ~blank[1:])) + int(not blank[:1].all())
    require(words == count, "", f"{count} values, as the header says", words)


def beyond_cliffs(values: Floats, step: float) -> NDArray[np.bool_]:
    """Which values lie further than `step` [m] above or below most of them, with none between; NaN counts as none."""
    finite = values[np.isfinite(values)]
    beyond = np.zeros(values.shape, bool)
    if finite.size == 0 or np.ptp(finite) <= step:
        return beyond
    # A gap of a step leaves a class of half a step empty.
    counts, edges = np.histogram(finite, bins=int(np.ptp(finite) / (0.5 * step)) + 1)
    middle = float(np.median(finite))
    for edge in edges[:-1][counts == 0]:
        below, above = finite[finite < edge].max(), finite[finite >= edge].min()
        if above - below > step:
            beyond |= values <= below if middle > below else values >= above
    return beyond


def height_unit(crs: CRS) -> str:
    """What a reference system names the unit of its heights; empty of metres, and where it has none."""
    unit = HEIGHTS.search(crs.to_wkt())
    return unit[1] if unit and float(unit[2]) != 1.0 else ""


def check_lengths(crs: Any, east: float, north: float) -> None:
    """Raise InputError where a metre of the map at a place is not one on the ground, such as in Web Mercator."""
    steps = [(0.0, 0.0), (LENGTH, 0.0), (0.0, LENGTH)]
    places = carried(crs, "EPSG:4326", [east + step for step, _ in steps], [north + step for _, step in steps])
    if places is None:
        return  # a system of its own, without a place on the earth
    longitude, latitude = np.radians(places)
    ground = EARTH * np.hypot(np.cos(latitude[0]) * (longitude[1:] - longitude[0]), latitude[1:] - latitude[0]) / LENGTH
    expected = "a projected coordinate system whose metres are metres on the ground (UTM or a country's own)"
    got = f"{crs.to_string()[:60]}, where one is {ground[0]:.3g} m"
    require(bool((np.abs(ground - 1.0) <= DISTORTED).all()), "", expected, got)


def known_system(crs: str, key: str = "crs", place: Sequence[float] = ()) -> str:
    """The name of a reference system that a user gave. Raises InputError unless it is a projected one in metres; at a
    place, if given, in metres on the ground (`check_lengths`)."""
    try:
        system = CRS.from_user_input(crs)
    except CRSError:
        system = None
    unit = "" if system is None else "degrees" if system.is_geographic else str(system.linear_units)
    metres = system is not None and unit.lower() in METRES[1:] and not height_unit(system)
    require(metres, key, "a projected coordinate system in metres, such as 'EPSG:2056'", repr(shortened(crs, 60)))
    if place:
        check_lengths(system, *place)
    return crs if system is None else str(system.to_string())


def same_system(name: str | None, raster: Raster) -> bool:
    """Whether a raster's corner lies at one place by its own reference system and by another, or either is none."""
    if name is None or raster.crs is None or name == raster.crs:
        return True
    east, north = raster.corner
    there = carried(raster.crs, name, [east], [north])
    return there is not None and bool(np.hypot(*(there[:, 0] - raster.corner)) <= SAME_PLACE)


def carried(source: Any, target: Any, east: Sequence[float], north: Sequence[float]) -> Floats | None:
    """Places of one reference system in another one, [2, N]; None where it has none there."""
    try:
        return np.array(reprojected(source, target, east, north))
    except Exception:  # PROJ's own errors are of no public class
        return None


def write_raster(
    path: Path, values: Floats, cell: float, corner: Sequence[float], crs: str | None, name: str, unit: str
) -> None:
    """Write `values` [X, Z] on square cells of an edge `cell` [m], from `corner` on (east, north), as a GeoTIFF. Rows
    run from the north (large z) to the south, columns to the east (x); NaN is no data. Raises WorkFailed."""
    rows = np.ascontiguousarray(values.T[::-1], np.float32)
    (height, width), (east, north) = rows.shape, corner
    profile: dict[str, Any] = {"driver": "GTiff", "compress": "deflate", "predictor": 3, "count": 1, "dtype": "float32"}
    # To the east along a row, to the south from row to row.
    transform = rasterio.Affine(cell, 0.0, east, 0.0, -cell, north + height * cell)
    profile |= {"nodata": np.nan, "transform": transform, "crs": crs}
    try:
        with warnings.catch_warnings(), replacing(path) as part:
            # A box in its own coordinates has no reference system; that is no error.
            warnings.simplefilter("ignore")
            with rasterio.open(part, "w", width=width, height=height, **profile) as raster:
                raster.write(rows, 1)
                raster.set_band_description(1, name)
                raster.set_band_unit(1, unit)
    except RasterioError as error:
        raise WorkFailed(f"{path.name} could not be written: {error}") from None
