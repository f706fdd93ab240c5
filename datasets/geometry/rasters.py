"""Fields over the plan from files: ESRI ASCII and GeoTIFF rasters.

Plan coordinates are x, to the east, and z, to the north. A raster's values stand at the centres of its cells; by
default the lower left corner of its extent becomes the corner x = 0, z = 0 of the box.
"""

import dataclasses
import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from datasets.errors import InputError
from datasets.files import file_size, reading
from datasets.memory import require

Floats = NDArray[np.float64]

LARGEST = 2**30
"""Bytes of a raster's file."""
VALUE = 32
"""Bytes that a value takes while a raster is read."""
METRES = ("", "m", "metre", "metres", "meter", "meters")
"""What a raster may call the unit of its values."""


@dataclass(frozen=True, kw_only=True)
class Raster:
    """Values on a regular grid."""

    x: Floats
    """Ascending [m], shape [X]."""
    z: Floats
    """Ascending [m], shape [Z]."""
    values: Floats
    """NaN in holes, shape [X, Z]."""
    corner: tuple[float, float]
    """Lower left corner of the extent in the file's own coordinates [m]."""
    crs: str | None = None
    """Coordinate reference system, as an authority's code or in WKT, where it names one."""

    def placed(self, offset: tuple[float, float], size: tuple[float, float], margin: float) -> "Raster":
        """What lies in [0, size] and `margin` [m] around it once moved by `offset` [m], two values an axis at least.

        Raises InputError for holes there.
        """
        axes, parts = [], []
        for coordinates, shift, length in zip((self.x, self.z), offset, size, strict=True):
            moved = coordinates + shift
            low = max(0, int(np.searchsorted(moved, -margin, side="right")) - 1)
            high = min(len(moved), int(np.searchsorted(moved, length + margin)) + 1)
            parts.append(slice(min(low, len(moved) - 2), max(high, low + 2)))
            axes.append(moved[parts[-1]])
        values = self.values[parts[0], parts[1]]
        holes = np.argwhere(np.isnan(values))
        for i, k in holes[:1]:
            where = f"{len(holes)} cells without data, the first at x = {axes[0][i]:g}, z = {axes[1][k]:g}"
            raise InputError(f"expected a raster without holes in the box, got {where}")
        return dataclasses.replace(self, x=axes[0], z=axes[1], values=values)


def read_raster(path: Path) -> Raster:
    """A raster of one band, north up, in metres. Raises InputError."""
    import rasterio
    from rasterio.errors import NotGeoreferencedWarning

    file_size(path, "a raster", most=LARGEST)
    with path.open("rb") as raw:
        head = raw.read(2)
    with reading(path, "a readable raster"), warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        # A path without a scheme, and one of two drivers: others open what a file names, on this machine or elsewhere.
        with rasterio.open(path.resolve(), driver="GTiff" if head in (b"II", b"MM") else "AAIGrid") as file:
            require(VALUE * file.width * file.height, "a raster", "cut it to the box")
            georeferenced = not file.transform.is_identity
            transform, crs, bands, unit = file.transform, file.crs, file.count, file.units[0]
            masked = file.read(1, masked=True).astype(np.float64)
    if not np.isfinite(tuple(transform)).all():
        raise InputError("expected a raster that lies at finite coordinates")
    if bands != 1:
        raise InputError(f"expected a raster of one band, got {bands}")
    if unit is not None and unit.lower() not in METRES:
        raise InputError(f"expected elevations in metres, the raster says {unit!r}")
    name = "metre" if not crs else "degrees" if crs.is_geographic else str(crs.linear_units)
    if name.lower() not in METRES:
        raise InputError(f"expected a projected coordinate system in metres, got one in {name}")
    if not georeferenced:
        raise InputError("expected a raster that says where it lies and how large its cells are, this one does not")
    if transform.b != 0.0 or transform.d != 0.0 or transform.a <= 0.0 or transform.e >= 0.0:
        raise InputError("expected a raster with north up, got one that is turned or mirrored")
    rows, columns = masked.shape
    if min(rows, columns) < 2:
        raise InputError(f"expected at least 2 x 2 values, got {rows} x {columns}")
    values = masked.filled(np.nan)
    values[~np.isfinite(values)] = np.nan
    return Raster(
        x=np.asarray(transform.c + (np.arange(columns) + 0.5) * transform.a),
        z=np.asarray(transform.f + (np.arange(rows)[::-1] + 0.5) * transform.e),
        values=np.ascontiguousarray(values[::-1].T),
        corner=(float(transform.c), float(transform.f + rows * transform.e)),
        crs=crs.to_string() if crs else None,
    )
