"""The files that a scene in TOML names, made part of it: a scene is complete without them.

| key | of | becomes |
|---|---|---|
| `file` | terrain | `points`, or `origin`, `spacing` and `heights`; a CSV's column `friction` |
| `file` | mesh, a mass too | `vertices`, `triangles` |
| `file` | mass of particles | `positions`, `velocities`, `volume` |
| `friction` = a path | terrain in 3D | one for every height |
| `thickness` = a path | layer | rows x, thickness, or `origin`, `spacing` and rows |
| `scale`, `at`, `unit` | any of these | nothing: they say how to read it |
"""

import io
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from datasets.arrays import open_npz
from datasets.errors import InputError
from datasets.geometry.ground import BEYOND, check_covers, interpolated
from datasets.geometry.rasters import RASTERS, UNITS, Raster, read_field
from datasets.reading import file_size, read_columns, reading

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Entry = dict[str, Any]

HOW = {"terrain": ("at", "unit"), "layer": ("at", "unit"), "mesh": ("scale", "at"), "particles": ()}
"""Keys that say how the file of a kind is read."""
MESHES = {
    ".stl": "stl",
    ".obj": "obj",
    ".ply": "ply",
    ".off": "off",
    ".msh": "gmsh",
    ".mesh": "medit",
    ".vtk": "vtk",
    ".vtu": "vtu",
    ".nas": "nastran",
    ".bdf": "nastran",
    ".fem": "nastran",
}
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
    for group, read in (("solids", reader.solid), ("masses", reader.mass)):
        if isinstance(data.get(group), list):
            new[group] = [
                read(dict(entry), f"{group}[{index}]") if isinstance(entry, dict) and known(entry) else entry
                for index, entry in enumerate(data[group])
            ]
    return new


def known(entry: Entry) -> bool:
    """Whether the kind of an entry is a name, as it must be."""
    return isinstance(entry.get("kind", ""), str)


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

    def solid(self, entry: Entry, key: str) -> Entry:
        """A solid with what its files hold."""
        kind = entry.get("kind", "box")
        if kind in ("terrain", "mesh") and isinstance(entry.get("file"), str):
            path, how = self.file_of(entry, "file", key)
            with at_key(f"{key}.file"):
                if kind == "mesh":
                    found = placed_mesh(path, how)
                elif len(self.size) == 3:
                    found = self.height_field(path, how)
                else:
                    found = ground_line(path, how)
            entry = combined(entry, found, key)
        if isinstance(entry.get("friction"), str):
            with at_key(f"{key}.friction"):
                entry["friction"] = self.friction(entry).tolist()
        refuse(entry, ("scale", "at", "unit"), key)
        return entry

    def mass(self, entry: Entry, key: str) -> Entry:
        """A mass with what its files hold."""
        kind = entry.get("kind", "box")
        if kind != "box":
            refuse(entry, ("lower", "size"), key, f"no such key of a {kind}")
        name = "thickness" if kind == "layer" else "file"
        if kind in HOW and isinstance(entry.get(name), str):
            path, how = self.file_of(entry, name, key)
            with at_key(f"{key}.{name}"):
                if kind == "mesh":
                    found = placed_mesh(path, how)
                elif kind == "layer":
                    found = self.thickness(path, how)
                else:
                    found = read_particles(path, len(self.size) or 2)
            entry = combined(entry, found, key)
        refuse(entry, ("scale", "at", "unit"), key)
        return entry

    def file_of(self, entry: Entry, name: str, key: str) -> tuple[Path, Entry]:
        """The path of an entry's file, and how it is read; both are taken out of it. Raises InputError."""
        path, allowed = self.folder / str(entry.pop(name)), HOW[entry["kind"]]
        how: Entry = {}
        for part in ("scale", "at", "unit"):
            if part not in entry:
                continue
            value = how[part] = entry.pop(part)
            count = 3 if entry["kind"] == "mesh" else 2
            values = value if isinstance(value, list) else [value]
            numbers = [type(each) in (int, float) and abs(each) < np.inf for each in values]
            expected, ok = {
                "scale": ("a positive factor", isinstance(value, int | float) and all(numbers) and value > 0.0),
                "at": (f"{count} lengths in m", isinstance(value, list) and all(numbers) and len(numbers) == count),
                "unit": (f"one of {', '.join(UNITS)}", isinstance(value, str) and value in UNITS),
            }[part]
            if part not in allowed:
                raise InputError("expected no such key of this kind of file", key=f"{key}.{part}")
            if not ok:
                raise InputError(f"expected {expected}, got {value!r}", key=f"{key}.{part}")
        return path, how

    def located(self, path: Path, how: Entry, column: str, extra: str | None = None, own: bool = False) -> Raster:
        """A field in the coordinates of the box; a raster beside the terrain's where that is one, unless `own`."""
        field, at = read_field(path, column, how.get("unit", "m"), extra), how.get("at")
        beside = self.offset if path.suffix.lower() in RASTERS and not own else None
        x, z = at or (0.0, 0.0)
        offset = float(x) - field.corner[0], float(z) - field.corner[1]
        if own and path.suffix.lower() in RASTERS:
            self.offset = offset
        return field.moved(beside if beside is not None and at is None else offset)

    def height_field(self, path: Path, how: Entry) -> Entry:
        """A terrain in 3D: the part of the file in and around the box."""
        field = self.located(path, how, "y", "friction", own=True)
        field = field.cropped((self.size[0], self.size[2]), BEYOND * self.cell)
        field.check_whole(path)
        found = on_grid(field, "heights")
        if self.offset is not None and path.suffix.lower() in RASTERS:
            found |= {"corner": [-self.offset[0], -self.offset[1]], "crs": field.crs}
        if field.extra is not None:
            found["friction"] = field.extra.tolist()
        return found

    def friction(self, entry: Entry) -> Floats:
        """Friction from a raster at the heights of a terrain."""
        path = self.folder / str(entry["friction"])
        if entry.get("kind") != "terrain" or len(self.size) != 3 or not isinstance(entry.get("heights"), list):
            raise InputError("expected a number or a list; a file only of a terrain in 3D")
        field = self.located(path, {}, "friction")
        for name, at, length in (("x", field.x, self.size[0]), ("z", field.z, self.size[2])):
            check_covers(at, name, length, at[1] - at[0], "", what="friction", where=str(path))
        field = field.cropped((self.size[0], self.size[2]), BEYOND * self.cell)
        field.check_whole(path)
        with reading(path, "friction of a terrain with `origin`, `spacing` and `heights`"):
            shape = np.array(entry["heights"]).shape
            axes = [entry["origin"][k] + entry["spacing"][k] * np.arange(shape[k]) for k in range(2)]
        plan = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
        return interpolated(field.x, field.z, field.values, plan).reshape(shape)

    def thickness(self, path: Path, how: Entry) -> Entry:
        """The thickness of a layer."""
        if len(self.size) == 3:
            field = self.located(path, how, "thickness")
            field.check_whole(path)
            return on_grid(field, "thickness")
        columns = lengths(path, ("x", "thickness"), (), how)
        return {"thickness": np.stack([columns["x"], columns["thickness"]], axis=1).tolist()}


@contextmanager
def at_key(key: str) -> Iterator[None]:
    """An InputError of the block with the key of the file."""
    try:
        yield
    except InputError as error:
        raise InputError(error.message, where=error.where, key=key) from None


def refuse(entry: Entry, names: tuple[str, ...], key: str, expected: str = "no such key without a file") -> None:
    """Raise InputError where an entry has one of the keys."""
    for name in names:
        if name in entry:
            raise InputError(f"expected {expected}", key=f"{key}.{name}")


def combined(entry: Entry, found: Entry, key: str) -> Entry:
    """The keys of an entry and those of its file. Raises InputError where a key is in both."""
    refuse(entry, tuple(found), key, "no such key beside a file that has it")
    return entry | found


def on_grid(field: Raster, name: str) -> Entry:
    """A field as the keys of a solid or a mass, its values under `name`."""
    return {
        "origin": [float(field.x[0]), float(field.z[0])],
        "spacing": [float(np.diff(axis).mean()) for axis in (field.x, field.z)],
        name: field.values.tolist(),
    }


def lengths(path: Path, needed: tuple[str, ...], optional: tuple[str, ...], how: Entry) -> dict[str, Floats]:
    """Columns of a CSV of lengths in its `unit`, moved by `at` along the first two; `friction` as it stands."""
    columns, metres = read_columns(path, needed, optional), UNITS[how.get("unit", "m")]
    columns = {name: values if name == "friction" else metres * values for name, values in columns.items()}
    for name, shift in zip(("x", "y"), how.get("at", (0.0, 0.0)), strict=True):
        if name in columns:
            columns[name] = columns[name] + shift
    return columns


def ground_line(path: Path, how: Entry) -> Entry:
    """A terrain in 2D: columns x, y and, where there is one, friction."""
    columns = lengths(path, ("x", "y"), ("friction",), how)
    found: Entry = {"points": np.stack([columns["x"], columns["y"]], axis=1).tolist()}
    return found | ({"friction": columns["friction"].tolist()} if "friction" in columns else {})


def read_particles(path: Path, dimension: int) -> Entry:
    """Particles from a CSV (x, y, z, vx, vy, vz, volume) or an NPZ (positions, velocities, volume)."""
    if path.suffix.lower() == ".npz":
        with open_npz(path, "an NPZ of plain numbers") as file:
            arrays = {name: file.read(name) for name in file.keys}
        if "positions" not in arrays or arrays.keys() - {"positions", "velocities", "volume"}:
            expected = "expected `positions` and, if there are, `velocities` and `volume`"
            raise InputError(f"{expected}, got {sorted(arrays)}", where=str(path))
        return {name: values.tolist() for name, values in arrays.items()}
    if path.suffix.lower() != ".csv":
        raise InputError("expected particles in a CSV or an NPZ", where=str(path))
    axes = ("x", "y", "z")[:dimension]
    moving = tuple(f"v{axis}" for axis in axes)
    columns = read_columns(path, axes, (*moving, "volume"))
    found = {"positions": np.stack([columns[axis] for axis in axes], axis=1).tolist()}
    if any(name in columns for name in moving):
        if not all(name in columns for name in moving):
            raise InputError(f"expected all of the columns `{'`, `'.join(moving)}` or none", where=str(path))
        found["velocities"] = np.stack([columns[name] for name in moving], axis=1).tolist()
    return found | ({"volume": columns["volume"].tolist()} if "volume" in columns else {})


def placed_mesh(path: Path, how: Entry) -> Entry:
    """Vertices and triangles of a closed mesh, at its scale and place. Raises InputError."""
    from datasets.geometry.spatial import outward

    vertices, triangles = read_mesh(path)
    vertices = float(how.get("scale", 1.0)) * vertices + np.array(how.get("at", [0.0, 0.0, 0.0]), np.float64)
    try:
        triangles = outward(vertices, triangles, "")
    except InputError as error:
        raise error.at(str(path)) from None
    return {"vertices": vertices.tolist(), "triangles": triangles.tolist()}


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
