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
from datasets.geometry.ground import BEYOND, Floats, Integers
from datasets.geometry.shapes import usual
from datasets.memory import require as require_memory

Entry = dict[str, Any]

FILES = {"terrain": "file", "layer": "thickness", "mesh": "file"}
"""The key that names the file of a kind."""
MESHES = {".stl": "stl", ".obj": "obj", ".ply": "ply", ".off": "off", ".msh": "gmsh", ".vtk": "vtk", ".vtu": "vtu"}
"""Endings of meshes, as which format of meshio: those that hold all they need and name no other file."""
LARGEST = 2**30
"""Bytes of a file."""
VALUE = 32
"""Bytes that a value takes while a raster is read."""
METRES = ("", "m", "metre", "metres", "meter", "meters")
"""What a raster may call the unit of its values."""
SAME = 1.0e-9
"""Distance of vertices that are one, over the extent of the mesh."""


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
    """Reads the files of one scene; remembers where its terrain's raster lies."""

    def __init__(self, data: Entry, folder: Path) -> None:
        domain = data.get("domain")
        size, cell = (domain.get("size"), domain.get("cell")) if isinstance(domain, dict) else (None, None)
        numbers = isinstance(size, list) and all(isinstance(each, int | float) for each in size)
        self.folder = folder
        self.size = tuple(map(float, size)) if size and numbers else ()
        self.cell = float(cell) if isinstance(cell, int | float) else 0.0
        self.offset: tuple[float, float] | None = None

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
                    found = {"vertices": vertices.tolist(), "triangles": outward(vertices, triangles, "").tolist()}
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
        """What of a raster lies in and around the box, two values an axis at least, as keys of a solid or a mass.

        Its corner stands `at` a place [m], else beside the terrain's, else at x = z = 0. Raises InputError for holes.
        """
        raster, offset = read_raster(path), self.offset
        if name == "heights" or at is not None or offset is None:
            x, z = at or (0.0, 0.0)
            offset = float(x) - raster.corner[0], float(z) - raster.corner[1]
        axes, parts, margin = [], [], BEYOND * self.cell
        for coordinates, shift, length in zip((raster.x, raster.z), offset, self.size[::2], strict=True):
            moved = coordinates + shift
            low = max(0, int(np.searchsorted(moved, -margin, side="right")) - 1)
            high = min(len(moved), int(np.searchsorted(moved, length + margin)) + 1)
            parts.append(slice(min(low, len(moved) - 2), max(high, low + 2)))
            axes.append(moved[parts[-1]])
        values = raster.values[parts[0], parts[1]]
        holes = np.argwhere(np.isnan(values))
        for i, k in holes[:1]:
            where = f"{len(holes)} cells without data, the first at x = {axes[0][i]:g}, z = {axes[1][k]:g}"
            raise InputError(f"expected a raster without holes in the box, got {where}")
        found: Entry = {
            "origin": [float(axis[0]) for axis in axes],
            "spacing": [float(np.diff(axis).mean()) for axis in axes],
            name: values.tolist(),
        }
        if name == "heights":
            self.offset = offset
            found |= {"corner": [-offset[0], -offset[1]], "crs": raster.crs}
        return found


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
    corner: tuple[float, float]
    """Lower left corner of the extent in the file's own coordinates [m]."""
    crs: str | None
    """Coordinate reference system, as an authority's code or in WKT, where it names one."""


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
            require_memory(VALUE * file.width * file.height, "a raster", "cut it to the box")
            georeferenced = not file.transform.is_identity
            transform, crs, bands, unit = file.transform, file.crs, file.count, file.units[0]
            masked = file.read(1, masked=True).astype(np.float64)
    require(bool(np.isfinite(tuple(transform)).all()), "", "a raster that lies at finite coordinates", "others")
    require(bands == 1, "", "a raster of one band", bands)
    require(unit is None or unit.lower() in METRES, "", "elevations in metres", repr(unit))
    name = "metre" if not crs else "degrees" if crs.is_geographic else str(crs.linear_units)
    require(name.lower() in METRES, "", "a projected coordinate system in metres", f"one in {name}")
    require(georeferenced, "", "a raster that says where it lies and how large its cells are", "one that does not")
    northwards = transform.b == transform.d == 0.0 and transform.a > 0.0 > transform.e
    require(northwards, "", "a raster with north up", "one that is turned or mirrored")
    rows, columns = masked.shape
    require(min(rows, columns) >= 2, "", "at least 2 x 2 values", f"{rows} x {columns}")
    values = masked.filled(np.nan)
    values[~np.isfinite(values)] = np.nan
    return Raster(
        x=np.asarray(transform.c + (np.arange(columns) + 0.5) * transform.a),
        z=np.asarray(transform.f + (np.arange(rows)[::-1] + 0.5) * transform.e),
        values=np.ascontiguousarray(values[::-1].T),
        corner=(float(transform.c), float(transform.f + rows * transform.e)),
        crs=crs.to_string() if crs else None,
    )


def read_mesh(path: Path) -> tuple[Floats, Integers]:
    """Vertices [V, 3] and triangles [T, 3] of the outer surface of a mesh, those at one place one vertex.

    Raises InputError, which names the file.
    """
    import meshio
    import pyvista

    file_size(path, "a mesh", most=LARGEST)
    if path.suffix.lower() not in MESHES:
        raise InputError(f"expected a mesh, a file that ends in {' '.join(MESHES)}", where=str(path))
    output = io.StringIO()
    with (
        reading(path, "a mesh that meshio reads"),
        # Its test for a binary STL overflows on the text of one that is none; it prints what it leaves out.
        warnings.catch_warnings(),
        redirect_stdout(output),
        redirect_stderr(output),
    ):
        warnings.simplefilter("ignore", RuntimeWarning)
        mesh = meshio.read(path, file_format=MESHES[path.suffix.lower()])
        mesh.points = np.asarray(mesh.points, np.float64)
        for block in mesh.cells:
            if block.data.size and not 0 <= block.data.min() <= block.data.max() < len(mesh.points):
                raise InputError(f"expected cells of the {len(mesh.points)} vertices in the file, got others")
        require(bool(np.isfinite(mesh.points).all()), "", "vertices of finite coordinates", "others")
        skin = pyvista.from_meshio(mesh).extract_surface(algorithm="dataset_surface").triangulate()
        skin = skin.clean(tolerance=SAME)
        require(skin.n_cells > 0, "", "a mesh with triangles", "none")
        return np.asarray(skin.points, np.float64), np.asarray(skin.regular_faces, np.int64)
