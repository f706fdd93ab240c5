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

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from datasets.arrays import open_npz
from datasets.errors import InputError
from datasets.geometry.ground import BEYOND, interpolated
from datasets.geometry.meshes import read_mesh
from datasets.geometry.rasters import RASTERS, UNITS, Field, read_field
from datasets.reading import read_columns

Floats = NDArray[np.float64]
Entry = dict[str, Any]

HOW = ("scale", "at", "unit")
"""Keys that say how a file is read."""


def with_files(data: Entry, folder: Path) -> Entry:
    """The keys of a scene with what its files hold in place of their names. Raises InputError.

    folder: where relative paths begin. What is wrong with other keys is left to the scene's own checks.
    """
    reader = Reader(data, folder)
    new = dict(data)
    for group, read in (("solids", reader.solid), ("masses", reader.mass)):
        entries = data.get(group)
        if isinstance(entries, list):
            new[group] = [
                read(dict(entry), f"{group}[{index}]") if isinstance(entry, dict) else entry
                for index, entry in enumerate(entries)
            ]
    return new


class Reader:
    """Reads the files of one scene; remembers where its terrain's raster lies."""

    def __init__(self, data: Entry, folder: Path) -> None:
        domain = data.get("domain")
        size = domain.get("size") if isinstance(domain, dict) else None
        cell = domain.get("cell") if isinstance(domain, dict) else None
        self.folder = folder
        numbers = isinstance(size, list) and all(isinstance(each, int | float) for each in size)
        self.size = tuple(map(float, size)) if numbers and size else ()
        self.cell = float(cell) if isinstance(cell, int | float) else 0.0
        self.offset: tuple[float, float] | None = None

    def solid(self, entry: Entry, key: str) -> Entry:
        """A solid with what its files hold."""
        kind = entry.get("kind", "box")
        if isinstance(entry.get("file"), str) and kind in ("terrain", "mesh"):
            path, how = self.file_of(entry, key)
            if kind == "mesh":
                entry |= self.mesh(path, how, entry, key)
            elif len(self.size) == 3:
                entry |= self.at_key(key, lambda: self.height_field(path, how, entry, key))
            else:
                self.refuse(entry, ("points",), key)
                entry |= self.at_key(key, lambda: ground_line(path, how))
        if isinstance(entry.get("friction"), str):
            entry["friction"] = self.friction(entry, key)
        self.refuse(entry, HOW, key)
        return entry

    def mass(self, entry: Entry, key: str) -> Entry:
        """A mass with what its files hold."""
        kind = entry.get("kind", "box")
        if kind != "box":
            self.refuse(entry, ("lower", "size"), key, f"no such key of a {kind}")
        if isinstance(entry.get("file"), str) and kind in ("mesh", "particles"):
            path, how = self.file_of(entry, key)
            if kind == "mesh":
                entry |= self.mesh(path, how, entry, key)
            else:
                self.refuse(entry, ("positions", "velocities"), key)
                found = self.at_key(key, lambda: read_particles(path, len(self.size) or 2))
                if "volume" in found:
                    self.refuse(entry, ("volume",), key, "no volume beside those in the file")
                entry |= found
        if kind == "layer" and isinstance(entry.get("thickness"), str):
            name = entry["thickness"]
            how = {name: entry.pop(name) for name in HOW if name in entry}
            check_how(how, key, ("at", "unit"))
            entry |= self.at_key(key, lambda: self.thickness(self.folder / name, how), "thickness")
        self.refuse(entry, HOW, key)
        return entry

    def file_of(self, entry: Entry, key: str) -> tuple[Path, Entry]:
        """The path of an entry's file and how it is read, taken out of it."""
        allowed = {"mesh": ("scale", "at")}.get(entry["kind"], ("at", "unit") if entry["kind"] == "terrain" else ())
        how = {name: entry.pop(name) for name in HOW if name in entry}
        check_how(how, key, allowed)
        return self.folder / str(entry.pop("file")), how

    def refuse(self, entry: Entry, names: tuple[str, ...], key: str, expected: str = "") -> None:
        """Raise InputError where an entry has one of the keys."""
        for name in names:
            if name in entry:
                raise InputError(
                    f"expected {expected or 'no such key beside a file, or without one'}", key=f"{key}.{name}"
                )

    def at_key(self, key: str, read: Callable[[], Entry], name: str = "file") -> Entry:
        """What `read` returns; its InputError with the key of the file."""
        try:
            return read()
        except InputError as error:
            raise InputError(error.message, where=error.where, key=f"{key}.{name}") from None

    def mesh(self, path: Path, how: Entry, entry: Entry, key: str) -> Entry:
        """Vertices and triangles of a closed mesh."""
        self.refuse(entry, ("vertices", "triangles"), key)
        from datasets.geometry.spatial import outward

        def read() -> Entry:
            vertices, triangles = read_mesh(path)
            vertices = float(how.get("scale", 1.0)) * vertices + np.array(how.get("at", [0.0, 0.0, 0.0]), np.float64)
            try:
                triangles = outward(vertices, triangles, "")
            except InputError as error:
                raise error.at(str(path)) from None
            return {"vertices": vertices.tolist(), "triangles": triangles.tolist()}

        return self.at_key(key, read)

    def located(self, path: Path, how: Entry, column: str, extra: str | None = None, own: bool = False) -> Field:
        """A field in the coordinates of the box; a raster beside the terrain's where that is one, unless `own`."""
        field = read_field(path, column, how.get("unit", "m"), extra)
        at = how.get("at")
        if at is None and self.offset is not None and not own and path.suffix.lower() in RASTERS:
            return field.moved(self.offset)
        x, z = at or (0.0, 0.0)
        offset = float(x) - field.corner[0], float(z) - field.corner[1]
        if own and path.suffix.lower() in RASTERS:
            self.offset = offset
        return field.moved(offset)

    def height_field(self, path: Path, how: Entry, entry: Entry, key: str) -> Entry:
        """A terrain in 3D: the part of the file in and around the box."""
        self.refuse(entry, ("origin", "spacing", "heights", "corner", "crs"), key)
        field = self.located(path, how, "y", "friction", own=True)
        field = field.cropped((self.size[0], self.size[2]), BEYOND * self.cell)
        whole(field, path)
        found = grid(field, "heights")
        if self.offset is not None and path.suffix.lower() in RASTERS:
            found |= {"corner": [-self.offset[0], -self.offset[1]], "crs": field.crs}
        if field.extra is not None:
            self.refuse(entry, ("friction",), key, "no friction beside that in the file")
            found["friction"] = field.extra.tolist()
        return found

    def friction(self, entry: Entry, key: str) -> list[list[float]]:
        """Friction from a raster at the heights of a terrain."""
        path = self.folder / str(entry["friction"])
        if entry.get("kind") != "terrain" or len(self.size) != 3 or not isinstance(entry.get("heights"), list):
            raise InputError("expected a number or a list; a file only of a terrain in 3D", key=f"{key}.friction")

        def read() -> Entry:
            field = self.located(path, {}, "friction")
            x, z = (
                entry["origin"][k] + entry["spacing"][k] * np.arange(np.array(entry["heights"]).shape[k])
                for k in range(2)
            )
            size = np.array([self.size[0], self.size[2]])
            step = np.array([field.x[1] - field.x[0], field.z[1] - field.z[0]])
            first, last = np.array([field.x[0], field.z[0]]), np.array([field.x[-1], field.z[-1]])
            if (first > step).any() or (last < size - step).any():
                raise InputError(
                    f"expected friction over the whole box, got x from {first[0]:g} to {last[0]:g} "
                    f"and z from {first[1]:g} to {last[1]:g}",
                    where=str(path),
                )
            field = field.cropped((self.size[0], self.size[2]), BEYOND * self.cell)
            whole(field, path)
            plan = np.stack(np.meshgrid(x, z, indexing="ij"), axis=-1)
            values = interpolated(field.x, field.z, field.values, plan.reshape(-1, 2))
            return {"friction": values.reshape(plan.shape[:2]).tolist()}

        found: list[list[float]] = self.at_key(key, read, "friction")["friction"]
        return found

    def thickness(self, path: Path, how: Entry) -> Entry:
        """The thickness of a layer."""
        if len(self.size) == 3:
            field = self.located(path, how, "thickness")
            whole(field, path)
            return grid(field, "thickness")
        columns = lengths(path, ("x", "thickness"), (), how)
        return {"thickness": np.stack([columns["x"], columns["thickness"]], axis=1).tolist()}


def check_how(how: Entry, key: str, allowed: tuple[str, ...]) -> None:
    """Raise InputError for a key that says how to read a file and is none, or none of its kind."""
    for name, value in how.items():
        if name not in allowed:
            raise InputError("expected no such key of this kind of file", key=f"{key}.{name}")
        if name == "unit" and value not in UNITS:
            raise InputError(f"expected one of {', '.join(UNITS)}, got {value!r}", key=f"{key}.{name}")
        if name == "scale" and not (isinstance(value, int | float) and not isinstance(value, bool) and value > 0.0):
            raise InputError(f"expected a positive factor, got {value!r}", key=f"{key}.{name}")
        if name == "at":
            count = 3 if "scale" in allowed else 2
            numbers = isinstance(value, list) and all(type(each) in (int, float) for each in value)
            if not (numbers and len(value) == count and np.isfinite(value).all()):
                raise InputError(f"expected {count} lengths in m, got {value!r}", key=f"{key}.{name}")


def whole(field: Field, path: Path) -> None:
    """Raise InputError for a field with holes."""
    holes = np.argwhere(np.isnan(field.values))
    if len(holes):
        i, k = holes[0]
        raise InputError(
            f"expected a raster without holes in the box, got {len(holes)} cells without data, the first at "
            f"x = {field.x[i]:g}, z = {field.z[k]:g}",
            where=str(path),
        )


def grid(field: Field, name: str) -> Entry:
    """A field as the keys of a solid or a mass, its values under `name`."""
    return {
        "origin": [float(field.x[0]), float(field.z[0])],
        "spacing": [float(np.diff(axis).mean()) for axis in (field.x, field.z)],
        name: field.values.tolist(),
    }


def lengths(path: Path, needed: tuple[str, ...], optional: tuple[str, ...], how: Entry) -> dict[str, Floats]:
    """Columns of a CSV of lengths in its `unit`, moved by `at` along the first two; `friction` as it stands."""
    try:
        columns = read_columns(path, needed, optional)
    except InputError as error:
        raise error.at(str(path)) from None
    metres = UNITS[how.get("unit", "m")]
    columns = {name: values if name == "friction" else metres * values for name, values in columns.items()}
    for name, shift in zip(("x", "y"), how.get("at", (0.0, 0.0)), strict=True):
        if name in columns:
            columns[name] = columns[name] + shift
    return columns


def ground_line(path: Path, how: Entry) -> Entry:
    """A terrain in 2D: columns x, y and, where there is one, friction."""
    columns = lengths(path, ("x", "y"), ("friction",), how)
    found: Entry = {"points": np.stack([columns["x"], columns["y"]], axis=1).tolist()}
    if "friction" in columns:
        found["friction"] = columns["friction"].tolist()
    return found


def read_particles(path: Path, dimension: int) -> Entry:
    """Particles from a CSV (x, y, z, vx, vy, vz, volume) or an NPZ (positions, velocities, volume)."""
    try:
        if path.suffix.lower() == ".csv":
            axes = ("x", "y", "z")[:dimension]
            moving = tuple(f"v{axis}" for axis in axes)
            columns = read_columns(path, axes, (*moving, "volume"))
            arrays = {"positions": np.stack([columns[axis] for axis in axes], axis=1)}
            if any(name in columns for name in moving):
                if not all(name in columns for name in moving):
                    raise InputError(f"expected all of the columns `{'`, `'.join(moving)}` or none")
                arrays["velocities"] = np.stack([columns[name] for name in moving], axis=1)
            if "volume" in columns:
                arrays["volume"] = columns["volume"]
        elif path.suffix.lower() == ".npz":
            arrays = read_arrays(path)
        else:
            raise InputError("expected particles in a CSV or an NPZ")
    except InputError as error:
        raise error.at(str(path)) from None
    return {name: values.tolist() for name, values in arrays.items()}


def read_arrays(path: Path) -> dict[str, Floats]:
    """The arrays of an NPZ of particles. Raises InputError."""
    with open_npz(path, "an NPZ of plain numbers") as file:
        arrays = {name: file.read(name) for name in file.keys}
    unknown = arrays.keys() - {"positions", "velocities", "volume"}
    if unknown or "positions" not in arrays:
        raise InputError(f"expected `positions` and, if there are, `velocities` and `volume`, got {sorted(arrays)}")
    for name, values in arrays.items():
        flat = name == "volume"
        if values.ndim > 1 if flat else values.ndim != 2:
            raise InputError(f"expected `{name}` of shape {'[N]' if flat else '[N, D]'}, got {list(values.shape)}")
        if values.dtype.kind not in "iuf" or not np.isfinite(values).all():
            raise InputError(f"expected finite numbers in `{name}`")
    return {name: values.astype(np.float64, copy=False) for name, values in arrays.items()}
