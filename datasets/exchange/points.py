"""Points of a survey on a map: eastings, northings and elevations from CSV, XYZ, LAS or LAZ (laspy)."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rasterio.crs import CRS

from datasets.errors import InputError, naming, require
from datasets.exchange.rasters import known_system
from datasets.exchange.spreadsheet import read_columns
from datasets.exchange.vectors import projected
from datasets.files import LONGEST_LINE, file_size, read_text, reading
from datasets.scene.grid_field import Floats

ENDINGS = (".csv", ".xyz", ".las", ".laz")  # of the files that are read, in lower case
NAMES = (("x", "y", "z"), ("easting", "northing", "elevation"))
"""Columns of a CSV: those of a surveyor, whose z points up."""
PORTION = 2**20  # points of a LAS that are read together
GROUND, NOISE = 2, (7, 18)
"""Classes of points (ASPRS, LAS 1.4 R15, tables 9 and 17): the ground, and points that are none."""
WKT, GEO_KEYS = 2112, 34735  # records of a LAS that name a reference system: in WKT, or in keys of GeoTIFF
PROJECTED_SYSTEM, USER_DEFINED = 3072, 32767
"""GeoTIFF's key of the code of a projected reference system; its value where it has none."""


def read_points(path: Path, crs: str | None, low: Floats, high: Floats) -> Floats:
    """Easting, northing and elevation [m], [N, 3], of the points between two corners of a plan [m] in the system `crs`,
    in which a file that names none is; of a LAS those of the ground, else all but noise. Raises InputError."""
    places, kinds = [], []
    for rows, classes in portions(path, crs):
        inside = ((rows[:, :2] > low) & (rows[:, :2] < high)).all(axis=1)
        places.append(rows[inside])
        kinds.append(classes[inside])
    points, classified = np.concatenate(places), np.concatenate(kinds) == GROUND
    points = points[classified] if classified.any() else points
    box = ", ".join(f"{first:.10g} to {last:.10g}" for first, last in zip(low, high, strict=True))
    with naming(path):
        require(len(points) > 0, "", f"points within the box, {box}", "none")
        require(bool(np.isfinite(points).all()), "", "finite elevations", "others")
    return points


def portions(path: Path, crs: str | None) -> Iterator[tuple[Floats, NDArray[np.int64]]]:
    """Places [N, 3] and classes [N] of the points of a file, one portion after the other. Raises InputError."""
    if path.suffix.lower() in (".las", ".laz"):
        yield from las_portions(path, crs)
        return
    text = read_text(path, "points")
    if path.suffix.lower() == ".xyz":
        with reading(path, "rows of easting, northing and elevation"):
            rows = np.loadtxt(text.splitlines(), np.float64, usecols=(0, 1, 2), ndmin=2)
    else:
        names = NAMES[NAMES[1][0] in text[:LONGEST_LINE].lower()]
        rows = np.stack([*read_columns(path, names, others=True).values()], axis=1)
    yield rows, np.zeros(len(rows), np.int64)


def las_portions(path: Path, crs: str | None) -> Iterator[tuple[Floats, NDArray[np.int64]]]:
    """Places [N, 3] and classes [N] of the points of a LAS, portion by portion, without noise. Raises InputError."""
    try:
        import laspy
    except ImportError:
        raise InputError('expected laspy, which reads it: pip install "talus[las]"', where=str(path)) from None
    file_size(path, "points (LAS)")
    with reading(path, "a readable LAS or LAZ"), laspy.open(path) as file:
        system = las_system(file.header)
        if system is not None:
            system = known_system(system, "", file.header.mins[:2].tolist() if crs is None else ())
        for points in file.chunk_iterator(PORTION):
            rows = np.stack([points.x, points.y, points.z], axis=1).astype(np.float64)
            kinds = np.array(points.classification, np.int64)
            if system is not None and crs is not None and system != crs:
                rows[:, :2] = projected(rows[:, :2], system, crs)
            kept = ~np.isin(kinds, NOISE) & (np.array(points.withheld) == 0)
            yield rows[kept], kinds[kept]


def las_system(header: Any) -> str | None:
    """The reference system that a LAS names in WKT, or by its code in keys of GeoTIFF; None where it names none."""
    for record in header.vlrs:
        if record.record_id == WKT and record.string:
            return str(CRS.from_user_input(record.string).to_string())
        for key in record.geo_keys if record.record_id == GEO_KEYS else ():
            if key.id == PROJECTED_SYSTEM and key.value_offset != USER_DEFINED:
                return f"EPSG:{key.value_offset}"
    return None
