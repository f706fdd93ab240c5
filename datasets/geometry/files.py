"""The files that a scene in TOML names, made part of it: a scene is complete without them.

Which keys name them, and what they become: docs/formats.md, "Solids and bodies". A raster's values stand at the centres
of its cells; x runs to the east, z to the north.
"""

import io
import warnings
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from datasets.errors import InputError, require
from datasets.files import file_size, read_columns, reading
from datasets.geometry.closed import outward
from datasets.geometry.ground import BEYOND, TOUCHING, Floats, Integers
from datasets.geometry.shapes import usual
from datasets.memory import require as require_memory

Entry = dict[str, Any]

FILES = {"terrain": "file", "layer": "thickness", "mesh": "file"}
"""The key that names the file of a kind."""
MESHES = (".stl", ".obj", ".ply", ".off", ".msh", ".vtk", ".vtu")
"""Endings of meshes: those that hold all they need and name no other file."""
LARGEST = 2**30
"""Bytes of a file."""
VALUE = 32
"""Bytes that a value takes while a raster is read."""
METRES = ("", "m", "metre", "metres", "meter", "meters")
"""What a raster may call the unit of its values."""
UNDECLARED = (-9999.0, -99999.0, -32767.0, -32768.0)
"""Values that stand for no data by custom, as they are in the file."""
NO_ELEVATION = 2.0e4
"""Elevations and thicknesses [m] from here on are none on this earth: 32767, 1e20, -3.4e38."""
SAME = (1.0e-9, 1.0e-7, 1.0e-6, 1.0e-5)
"""Distances of vertices that are one, over the extent of the mesh: the first with which its surface is closed."""
LENGTH, EARTH = 100.0, 6.371e6
"""Of the map over which its scale is looked at; radius of the earth [m]."""
DISTORTED = 0.02
"""What a metre of the map may differ from one on the ground; the earth's flattening makes up 0.5 % of it."""
SAME_PLACE = 1.0
"""How far two reference systems may be apart that are one for a flow [m]."""


def with_files(data: Entry, folder: Path) -> Entry:
    """The keys of a scene with what its files hold in place of their names. Raises InputError.

    folder: where relative paths begin. What is wrong with other keys is left to the scene's own checks.
    """
    reader, new = Reader(data, folder), dict(data)
    for group in ("solids", "masses"):
        if isinstance(data.get(group), list):
            new[group] = [reader.complete(entry, f"{group}[{index}]") for index, entry in enumerate(data[group])]
    return new


class Reader:
    """Reads the files of one scene; remembers where its terrain's raster lies, and in which reference system."""

    def __init__(self, data: Entry, folder: Path) -> None:
        domain = data.get("domain")
        size, cell = (domain.get("size"), domain.get("cell")) if isinstance(domain, dict) else (None, None)
        numbers = isinstance(size, list) and all(isinstance(each, int | float) for each in size)
        self.folder = folder
        self.size = tuple(map(float, size)) if size and numbers else ()
        self.cell = float(cell) if isinstance(cell, int | float) else 0.0
        self.offset: tuple[float, float] | None = None
        self.crs: str | None = None

    def complete(self, entry: Any, key: str) -> Any:
        """A solid or a mass with what its files hold; what is neither as it is."""
        if not isinstance(entry, dict) or not isinstance(entry.get("kind", ""), str):
            return entry
        entry, kind = dict(entry), entry.get("kind", "box")
        if key.startswith("masses") and kind != "box":
            refuse(entry, ("lower", "size"), key, f"no such key of a {kind}")
        name = FILES.get(kind, "")
        if isinstance(entry.get(name), str):
            path = self.folder / entry.pop(name)
            scale, at = placement(entry, key)
            try:
                if kind == "mesh":
                    vertices, triangles = read_mesh(path)
                    vertices = scale * vertices + np.array(at or [0.0, 0.0, 0.0], np.float64)
                    vertices, triangles = outward(vertices, triangles, "")
                    found = {"vertices": vertices.tolist(), "triangles": triangles.tolist()}
                elif len(self.size) == 3:
                    found = self.field(path, at, "heights" if kind == "terrain" else name)
                elif kind == "terrain":
                    columns = read_columns(path, ("x", "y"), ("friction",))
                    points = np.stack([columns["x"], columns["y"]], axis=1) + np.array(at or (0.0, 0.0))
                    found = {"points": points.tolist()}
                    if "friction" in columns:
                        found["friction"] = columns["friction"].tolist()
                else:
                    raise InputError("expected a number; a raster only of a layer in 3D")
            except InputError as error:
                raise InputError(error.message, where=error.where or str(path), key=f"{key}.{name}") from None
            refuse(entry, tuple(found), key, "no such key beside a file that has it")
            entry |= found
        refuse(entry, ("scale", "at"), key)
        return entry

    def field(self, path: Path, at: list[float] | None, name: str) -> Entry:
        """A raster as keys of a solid or a mass: of a terrain what lies in and around the box, of a layer where it is.

        Its corner stands `at` a place [m], else beside the terrain's, else at x = z = 0. Raises InputError for holes of
        a terrain in the box, and for another reference system than the terrain's.
        """
        raster = read_raster(path)
        terrain, offset = name == "heights", self.offset
        self.crs = self.crs or raster.crs
        same = same_system(self.crs, raster)
        require(same, "", f"the reference system of the scene's other raster, {self.crs}", raster.crs)
        if terrain or at is not None or offset is None:
            x, z = at or (0.0, 0.0)
            offset = float(x) - raster.corner[0], float(z) - raster.corner[1]
        axes = [axis + shift for axis, shift in zip((raster.x, raster.z), offset, strict=True)]
        values = raster.values
        if terrain:
            axes, values = self.around_box(axes, values)
            self.offset = offset
        else:
            # A cell without data, or without material, is no layer.
            values = np.nan_to_num(values, nan=0.0)
            require(bool(values.any()), "", "a raster with some thickness", "none")
            parts = [np.flatnonzero(values.any(axis=1 - axis)) for axis in (0, 1)]
            ranges = [slice(part[0], part[-1] + 1) for part in parts]
            axes = [axis[part] for axis, part in zip(axes, ranges, strict=True)]
            values = values[ranges[0], ranges[1]]
        found: Entry = {
            "origin": [float(axis[0]) for axis in axes],
            "spacing": list(raster.spacing),
            name: values.tolist(),
        }
        if terrain:
            found |= {"corner": [-offset[0], -offset[1]], "crs": raster.crs}
        return found

    def around_box(self, axes: list[Floats], values: Floats) -> tuple[list[Floats], Floats]:
        """What of a terrain [X, Z] lies in and around the box, two values an axis at least; there without holes.

        Holes beyond the box have the elevation of the nearest value. Raises InputError for those in it.
        """
        from scipy.ndimage import distance_transform_edt

        parts, margin = [], BEYOND * self.cell
        for axis, length in zip(axes, self.size[::2], strict=True):
            low = max(0, int(np.searchsorted(axis, -margin, side="right")) - 1)
            high = min(len(axis), int(np.searchsorted(axis, length + margin)) + 1)
            parts.append(slice(min(low, len(axis) - 2), max(high, low + 2)))
        x, z = axes = [axis[part] for axis, part in zip(axes, parts, strict=True)]
        values = values[parts[0], parts[1]]
        holes = np.isnan(values)
        if not holes.any():
            return axes, values
        # The cells of the raster that reach into the box.
        halves = [0.5 * (axis[1] - axis[0]) - TOUCHING for axis in axes]
        sides = zip(axes, halves, self.size[::2], strict=True)
        within = np.logical_and.outer(*[(axis > -half) & (axis < length + half) for axis, half, length in sides])
        missing = np.argwhere(holes & within)
        for i, k in missing[:1]:
            where = f"{len(missing)} cells without data, the first at x = {x[i]:g}, z = {z[k]:g}"
            raise InputError(f"expected a raster without holes in the box, got {where}")
        require(not holes.all(), "", "a raster with values around the box", "none")
        nearest = distance_transform_edt(holes, return_distances=False, return_indices=True)
        return axes, np.asarray(values[tuple(nearest)])


def refuse(entry: Entry, names: tuple[str, ...], key: str, expected: str = "no such key without a file") -> None:
    """Raise InputError where an entry has one of the keys."""
    for name in names:
        require(name not in entry, f"{key}.{name}", expected, "one")


def placement(entry: Entry, key: str) -> tuple[float, list[float] | None]:
    """`scale` and `at` [m] of an entry's file, taken out of it. Raises InputError."""
    mesh = entry["kind"] == "mesh"
    require(mesh or "scale" not in entry, f"{key}.scale", "no such key but of a mesh", "one")
    scale, at = entry.pop("scale", 1.0), entry.pop("at", None)
    require(is_length(scale) and scale > 0.0, f"{key}.scale", "a positive factor", repr(scale))
    count = 3 if mesh else 2
    ok = at is None or (isinstance(at, list) and len(at) == count and all(map(is_length, at)))
    require(ok, f"{key}.at", f"{count} lengths in m", repr(at))
    return float(scale), at


def is_length(value: Any) -> bool:
    """Whether a value of a TOML is a finite number."""
    return type(value) in (int, float) and usual(value)


class Raster(NamedTuple):
    """Values on a regular grid."""

    x: Floats
    """Ascending [m], shape [X]."""
    z: Floats
    """Ascending [m], shape [Z]."""
    values: Floats
    """NaN in holes, shape [X, Z]."""
    spacing: tuple[float, float]
    """Of the grid along x and z [m]."""
    corner: tuple[float, float]
    """Lower left corner of the extent in the file's own coordinates [m]."""
    crs: str | None
    """Coordinate reference system, as an authority's code or in WKT, where it names one."""


def read_raster(path: Path) -> Raster:
    """A raster of one band whose rows run from west to east, in metres on the ground. Raises InputError.

    Scale and offset of its band are applied. Values that no elevation or thickness has are no data, also where the file
    does not say so, which a warning then does.
    """
    import rasterio
    from rasterio.errors import NotGeoreferencedWarning

    file_size(path, "a raster", most=LARGEST)
    with path.open("rb") as raw:
        head = raw.read(2)
    with reading(path, "a readable raster"), warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        # A path without a scheme, and one of two drivers: others open what a file names, on this machine or elsewhere.
        with rasterio.open(path.resolve(), driver="GTiff" if head in (b"II", b"MM") else "AAIGrid") as file:
            require_memory(VALUE * file.width * file.height, "a raster", "cut it to the box")
            georeferenced = not file.transform.is_identity
            transform, crs, bands, unit = file.transform, file.crs, file.count, file.units[0]
            scale, offset = float(file.scales[0]), float(file.offsets[0])
            masked = file.read(1, masked=True).astype(np.float64)
    require(bool(np.isfinite(tuple(transform)).all()), "", "a raster that lies at finite coordinates", "others")
    require(bands == 1, "", "a raster of one band", bands)
    require(unit is None or unit.lower() in METRES, "", "elevations in metres", repr(unit))
    name = "metre" if not crs else "degrees" if crs.is_geographic else str(crs.linear_units)
    require(name.lower() in METRES, "", "a projected coordinate system in metres", f"one in {name}")
    require(georeferenced, "", "a raster that says where it lies and how large its cells are", "one that does not")
    upright = transform.b == transform.d == 0.0 and transform.a > 0.0 and transform.e != 0.0
    require(upright, "", "a raster whose rows run from west to east", "one that is turned or mirrored")
    require(scale != 0.0 and usual(scale) and usual(offset), "", "a finite scale and offset", (scale, offset))
    rows, columns = masked.shape
    raw_values = masked.filled(np.nan)
    values = scale * raw_values + offset
    none = np.isfinite(values) & (np.isin(raw_values, UNDECLARED) | (np.abs(values) >= NO_ELEVATION))
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
    return Raster(
        x=x,
        z=z,
        values=np.ascontiguousarray(values.T),
        spacing=(float(transform.a), float(height)),
        corner=(float(transform.c), float(south)),
        crs=crs.to_string() if crs else None,
    )


def check_lengths(crs: Any, east: float, north: float) -> None:
    """Raise InputError where a metre of the map at a place is not one on the ground, such as in Web Mercator."""
    from rasterio.errors import RasterioError
    from rasterio.warp import transform

    steps = [(0.0, 0.0), (LENGTH, 0.0), (0.0, LENGTH)]
    try:
        longitude, latitude = np.radians(
            transform(crs, "EPSG:4326", [east + step for step, _ in steps], [north + step for _, step in steps])
        )
    except RasterioError:
        return  # a system of its own, without a place on the earth
    ground = EARTH * np.hypot(np.cos(latitude[0]) * (longitude[1:] - longitude[0]), latitude[1:] - latitude[0]) / LENGTH
    require(
        bool((np.abs(ground - 1.0) <= DISTORTED).all()),
        "",
        "a projected coordinate system whose metres are metres on the ground (UTM or a country's own)",
        f"{crs.to_string()[:60]}, where one is {ground[0]:.3g} m",
    )


def same_system(name: str | None, raster: Raster) -> bool:
    """Whether a raster's corner lies at one place by its own reference system and by another; so where either is none."""
    from rasterio.errors import RasterioError
    from rasterio.warp import transform

    if name is None or raster.crs is None or name == raster.crs:
        return True
    try:
        (east,), (north,) = transform(raster.crs, name, *([each] for each in raster.corner))
    except RasterioError:
        return False
    return bool(np.hypot(east - raster.corner[0], north - raster.corner[1]) <= SAME_PLACE)


def read_mesh(path: Path) -> tuple[Floats, Integers]:
    """Vertices [V, 3] and triangles [T, 3] of the outer surface of a mesh, those at one place one vertex.

    Vertices further apart are one where the surface is open without. Raises InputError, which names the file.
    """
    import pyvista

    file_size(path, "a mesh", most=LARGEST)
    if path.suffix.lower() not in MESHES:
        raise InputError(f"expected a mesh, a file that ends in {' '.join(MESHES)}", where=str(path))
    output = io.StringIO()
    with (
        reading(path, "a readable mesh"),
        # Readers warn of normals that are none of a vertex's, and print what they leave out.
        warnings.catch_warnings(),
        redirect_stdout(output),
        redirect_stderr(output),
        pyvista.vtk_verbosity("off"),
    ):
        warnings.simplefilter("ignore")
        mesh = pyvista.read(path)
        require(isinstance(mesh, pyvista.DataSet), "", "one mesh", type(mesh).__name__)
        mesh.clear_data()
        require(bool(np.isfinite(mesh.points).all()), "", "vertices of finite coordinates", "others")
        skin = mesh.extract_surface(algorithm="dataset_surface").triangulate()
        for tolerance in SAME:
            merged = skin.clean(tolerance=tolerance)
            if merged.n_open_edges == 0:
                break
        require(merged.n_cells > 0, "", "a mesh with triangles", "none")
        return np.asarray(merged.points, np.float64), np.asarray(merged.regular_faces, np.int64)
