"""The files that a scene in TOML names, made part of it: a scene is complete without them.

| key | of | becomes |
|---|---|---|
| `file` | terrain in 2D, a CSV | `points`, a column `friction` |
| `file` | terrain in 3D, a raster | `origin`, `spacing` and `heights`, `corner` and `crs` |
| `friction` = a raster's path | terrain in 3D | one for every height |
| `thickness` = a path | layer | rows x, thickness of a CSV, in 3D `origin`, `spacing` and rows of a raster |
| `file` | mesh, a mass too | `vertices`, `triangles` |
| `scale`, `at` | of a mesh, of any of these | nothing: they say how to read it |
"""

import io
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from datasets.errors import InputError
from datasets.files import file_size, read_columns, reading
from datasets.geometry.ground import BEYOND, check_covers, interpolated
from datasets.geometry.rasters import Raster, read_raster
from datasets.geometry.shapes import require, usual

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Entry = dict[str, Any]

FILES = {"terrain": "file", "layer": "thickness", "mesh": "file"}
"""The key that names the file of a kind."""
MESHES = {".stl": "stl", ".obj": "obj", ".ply": "ply", ".off": "off", ".msh": "gmsh", ".vtk": "vtk", ".vtu": "vtu"}
"""Endings of meshes, as which format of meshio: those that hold all they need and name no other file."""
LARGEST = 2**28
"""Bytes of a mesh."""
SAME = 1.0e-9
"""Distance of vertices that are one, over the extent of the mesh."""


def with_files(data: Entry, folder: Path) -> Entry:
    """The keys of a scene with what its files hold in place of their names. Raises InputError.

    folder: where relative paths begin. What is wrong with other keys is left to the scene's own checks.
    """
    reader = Reader(data, folder)
    new = dict(data)
    for group in ("solids", "masses"):
        if isinstance(data.get(group), list):
            new[group] = [
                reader.complete(entry, f"{group}[{index}]")
                if isinstance(entry, dict) and isinstance(entry.get("kind", ""), str)
                else entry
                for index, entry in enumerate(data[group])
            ]
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

    def complete(self, entry: Entry, key: str) -> Entry:
        """A solid or a mass with what its files hold."""
        entry, kind = dict(entry), entry.get("kind", "box")
        if key.startswith("masses") and kind != "box":
            refuse(entry, ("lower", "size"), key, f"no such key of a {kind}")
        name = FILES.get(kind, "")
        if isinstance(entry.get(name), str):
            path = self.folder / entry.pop(name)
            scale, at = placement(entry, key)
            with naming(path, f"{key}.{name}"):
                if kind == "mesh":
                    found = placed_mesh(path, scale, at)
                elif len(self.size) == 3:
                    field = self.located(path, at, ground=kind == "terrain")
                    found = on_grid(field, "heights" if kind == "terrain" else "thickness")
                    if kind == "terrain" and self.offset is not None:
                        found |= {"corner": [-self.offset[0], -self.offset[1]], "crs": field.crs}
                else:
                    found = table(path, "y" if kind == "terrain" else "thickness", at)
            refuse(entry, tuple(found), key, "no such key beside a file that has it")
            entry |= found
        if isinstance(entry.get("friction"), str):
            path = self.folder / entry["friction"]
            with naming(path, f"{key}.friction"):
                entry["friction"] = self.friction(entry, path).tolist()
        refuse(entry, ("scale", "at"), key)
        return entry

    def located(self, path: Path, at: list[float] | None = None, *, ground: bool = False) -> Raster:
        """A raster in and around the box: its corner `at` a place, else beside the terrain's, else at 0, 0."""
        field, offset = read_raster(path), self.offset
        if ground or at is not None or offset is None:
            x, z = at or (0.0, 0.0)
            offset = float(x) - field.corner[0], float(z) - field.corner[1]
        if ground:
            self.offset = offset
        return field.placed(offset, (self.size[0], self.size[2]), BEYOND * self.cell)

    def friction(self, entry: Entry, path: Path) -> Floats:
        """Friction from a raster at the heights of a terrain."""
        if entry.get("kind") != "terrain" or len(self.size) != 3 or not isinstance(entry.get("heights"), list):
            raise InputError("expected a number or a list; a file only of a terrain in 3D")
        field = self.located(path)
        for name, coordinates, length in (("x", field.x, self.size[0]), ("z", field.z, self.size[2])):
            check_covers(coordinates, name, length, coordinates[1] - coordinates[0], "", what="friction")
        with reading(path, "friction of a terrain with `origin`, `spacing` and `heights`"):
            shape = np.array(entry["heights"]).shape
            axes = [entry["origin"][k] + entry["spacing"][k] * np.arange(shape[k]) for k in range(2)]
        plan = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
        return interpolated((field.x, field.z), field.values, plan).reshape(shape)


@contextmanager
def naming(path: Path, key: str) -> Iterator[None]:
    """An InputError of the block with the file and its key."""
    try:
        yield
    except InputError as error:
        raise InputError(error.message, where=error.where or str(path), key=key) from None


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


def on_grid(field: Raster, name: str) -> Entry:
    """A field as the keys of a solid or a mass, its values under `name`."""
    return {
        "origin": [float(field.x[0]), float(field.z[0])],
        "spacing": [float(np.diff(axis).mean()) for axis in (field.x, field.z)],
        name: field.values.tolist(),
    }


def table(path: Path, name: str, at: list[float] | None) -> Entry:
    """A terrain in 2D, columns x, y and perhaps friction of a CSV; or a layer, columns x and thickness."""
    columns = read_columns(path, ("x", name), ("friction",) if name == "y" else ())
    shift = np.array(at or (0.0, 0.0)) * ([1.0, 1.0] if name == "y" else [1.0, 0.0])
    rows = (np.stack([columns["x"], columns[name]], axis=1) + shift).tolist()
    if name == "thickness":
        return {"thickness": rows}
    return {"points": rows} | ({"friction": columns["friction"].tolist()} if "friction" in columns else {})


def placed_mesh(path: Path, scale: float, at: list[float] | None) -> Entry:
    """Vertices and triangles of a closed mesh, at its scale and place. Raises InputError."""
    from datasets.geometry.spatial import outward

    vertices, triangles = read_mesh(path)
    vertices = scale * vertices + np.array(at or [0.0, 0.0, 0.0], np.float64)
    return {"vertices": vertices.tolist(), "triangles": outward(vertices, triangles, "").tolist()}


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
        if not np.isfinite(mesh.points).all():
            raise InputError("expected vertices of finite coordinates")
        skin = pyvista.from_meshio(mesh).extract_surface(algorithm="dataset_surface").triangulate()
        skin = skin.clean(tolerance=SAME)
        if not skin.n_cells:
            raise InputError("expected a mesh with triangles, it has none")
        return np.asarray(skin.points, np.float64), np.asarray(skin.regular_faces, np.int64)
