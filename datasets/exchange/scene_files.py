"""The files that a scene in TOML names, made part of it: a scene is complete without them.

Which keys name them, and what they become: docs/formats.md, "Solids and bodies". A raster's values stand at the centres
of its cells; x runs to the east, z to the north.
"""

import re
from pathlib import Path
from typing import Any

import numpy as np

from datasets.errors import InputError, keyed, naming, require
from datasets.exchange.map_box import filled, plan_around, posts_of, with_elevations
from datasets.exchange.meshes import read_mesh
from datasets.exchange.spreadsheet import read_columns
from datasets.geometry.ground import BEYOND, TOUCHING, Floats
from datasets.geometry.shapes import check_kind, usual
from datasets.geometry.shells import outward
from datasets.scene.parts import INFLOW, Domain, Mass, Solid
from datasets.schema import from_mapping

Entry = dict[str, Any]

BED = ("friction", "turbulence")  # keys of a terrain in 3D that may name rasters
NEARLY = 1.0e-6  # part of a raster's cell that counts as none
WATER = "water table"  # what the reader calls `water`, a table without a kind
FILES = {"terrain": "file", "layer": "thickness", "mesh": "file", INFLOW: "file", WATER: "table"}
"""The key that names the file of a kind."""


def with_files(data: Entry, folder: Path) -> Entry:
    """The keys of a scene with what its files hold in place of their names. Raises InputError. folder: where relative
    paths begin. What is wrong with other keys is left to the scene's own checks."""
    if not isinstance(data.get("domain"), dict):
        return data
    domain, new = data["domain"], dict(data)
    with keyed("domain"):
        if "around" in domain:
            new["domain"] = domain = plan_around(domain, data.get("solids"), folder)
        reader = Reader(from_mapping(Domain, domain), folder, "crs" in data["domain"])
    for group in ("solids", "masses"):
        if isinstance(data.get(group), list):
            new[group] = [reader.complete(entry, f"{group}[{index}]") for index, entry in enumerate(data[group])]
    if isinstance(data.get("water"), dict):
        new["water"] = reader.complete({"kind": WATER} | data["water"], "water")
        new["water"].pop("kind")
    if "around" in data["domain"]:
        with keyed("domain"):
            new["domain"] = with_elevations(domain, new)
    if reader.lower is not None and reader.crs is not None:
        new["domain"] = {**new["domain"], "crs": reader.crs}
    return new


def file_of(data: Entry, key: str) -> str:
    """The file, as a scene names it, that gave one of its keys a value; empty where none did."""
    found = re.match(r"(\w+)(?:\[(\d+)\])?\.(\w+)", key)
    if found is None:
        return ""
    group, number, name = found.groups()
    entry = data.get(group, {}) if number is None else data[group][int(number)]
    named = FILES.get(WATER if group == "water" else entry.get("kind", ""), "")
    file = entry.get(named) if name == named or name not in entry else None
    return file if isinstance(file, str) else ""


class Reader:
    """Reads the files of one scene; remembers where its terrain's raster lies, and in which reference system."""

    def __init__(self, domain: Domain, folder: Path, given: bool) -> None:
        """given: whether the scene itself names a reference system, not a raster in it."""
        self.whose = "domain.crs" if given else "the scene's other raster"
        self.folder, self.size, self.cell, self.crs = folder, domain.size, domain.cell, domain.crs
        self.lower = None if domain.origin is None else domain.origin[::2]  # in plan [m], in map coordinates
        self.offset: tuple[float, float] | None = None if self.lower is None else (0.0, 0.0)
        if domain.crs is not None:
            from datasets.exchange.rasters import known_system

            self.crs = known_system(domain.crs)

    def complete(self, entry: Any, key: str) -> Any:
        """A solid or a mass with what its files hold; what is neither as it is."""
        if not isinstance(entry, dict) or not isinstance(entry.get("kind", ""), str):
            return entry
        entry, kind = dict(entry), entry.get("kind", "box")
        if kind != WATER:
            check_kind(kind, Solid if key.startswith("solids") else Mass, key, len(self.size))
        if key.startswith("masses") and kind != "box":
            refuse(entry, ("lower", "size"), key, f"no such key of a {kind}")
        name = FILES.get(kind, "")
        if isinstance(entry.get(name), str):
            path = self.folder / entry.pop(name)
            scale, at = placement(entry, key)
            with naming(path, f"{key}.{name}"):
                if kind == "mesh":
                    vertices, triangles = read_mesh(path)
                    vertices = scale * vertices + np.array(at or [0.0, 0.0, 0.0], np.float64)
                    vertices, triangles = outward(vertices, triangles, "")
                    content = {"vertices": vertices.tolist(), "triangles": triangles.tolist()}
                elif kind == INFLOW:
                    require(at is None, f"{key}.at", "no such key beside a hydrograph", "one")
                    columns = read_columns(path, ("time", "discharge", "speed"), dimension=len(self.size))
                    content = {"hydrograph": np.stack([*columns.values()], axis=1).tolist()}
                elif len(self.size) == 3:
                    content = self.field(path, at, "heights" if kind == "terrain" else name)
                elif kind in ("terrain", WATER):
                    columns = read_columns(path, ("x", "y"), ("friction",))
                    points = np.stack([columns["x"], columns["y"]], axis=1) + np.array(at or (0.0, 0.0))
                    content = {"points" if kind == "terrain" else name: points.tolist()}
                    if "friction" in columns:
                        content["friction"] = columns["friction"].tolist()
                else:
                    raise InputError("expected a number; a raster only of a layer in 3D")
            refuse(entry, tuple(content), key, "no such key beside a file that has it")
            entry |= content
        refuse(entry, ("scale", "at"), key)
        for name in BED if kind == "terrain" and len(self.size) == 3 else ():
            if isinstance(entry.get(name), str):
                path = self.folder / entry[name]
                with naming(path, f"{key}.{name}"):
                    entry[name] = self.at_posts(path, entry)
        return entry

    def at_posts(self, path: Path, terrain: Entry) -> Any:
        """A raster of a coefficient of the bed, which lies as the terrain's, at the posts of a terrain, bilinear: rows
        as of its heights, or the one number that all have. Raises InputError for posts in the box without a value."""
        from scipy.ndimage import map_coordinates

        from datasets.exchange.rasters import read_raster, same_system

        raster = read_raster(path, coefficients=True)
        require(same_system(self.crs, raster), "", f"the reference system of the terrain, {self.crs}", raster.crs)
        shift = self.offset or (-raster.corner[0], -raster.corner[1])
        ground = posts_of(terrain)
        if ground is None:
            raise InputError("expected a terrain with heights on a grid beneath it, got none")
        posts, _ = ground
        grid = zip(posts, (raster.x, raster.z), shift, raster.spacing, strict=True)
        axes = [(post - moved - centres[0]) / step for post, centres, moved, step in grid]
        places = np.array(np.meshgrid(*axes, indexing="ij"))
        values = map_coordinates(raster.values, places, order=1, mode="nearest")
        # Beside a hole that of its own cell.
        values = np.where(np.isnan(values), map_coordinates(raster.values, places, order=0, mode="nearest"), values)
        counts = zip(axes, raster.values.shape, strict=True)
        within = [(axis > -0.5 - NEARLY) & (axis < n - 0.5 + NEARLY) for axis, n in counts]
        values[~np.logical_and.outer(*within)] = np.nan
        values = np.round(self.around_box(posts, values)[1], 9)  # so that one value stays one
        return float(values[0, 0]) if np.ptp(values) == 0.0 else values.tolist()

    def field(self, path: Path, at: list[float] | None, name: str) -> Entry:
        """A raster as keys of a solid or a mass: of a terrain what lies in and around the box, of a layer where it is.
        Its corner stands `at` a place [m], else where its file says on a map, else beside the terrain's, else at x = z
        = 0. Raises InputError for holes of a terrain in the box, and for another reference system."""
        # Half a second, which a scene without rasters does not wait.
        from datasets.exchange.rasters import read_raster, same_system

        raster = read_raster(path)
        terrain, surface, offset = name == "heights", name != "thickness", self.offset
        self.crs = self.crs or raster.crs
        require(same_system(self.crs, raster), "", f"the reference system of {self.whose}, {self.crs}", raster.crs)
        if at is not None or offset is None or (terrain and self.lower is None):
            x, z = at or (0.0, 0.0)
            offset = float(x) - raster.corner[0], float(z) - raster.corner[1]
        axes = [axis + shift for axis, shift in zip((raster.x, raster.z), offset, strict=True)]
        values = raster.values
        if surface:
            axes, values = self.around_box(axes, values)
            self.offset = offset if terrain and self.lower is None else self.offset
        else:
            values = np.nan_to_num(values, nan=0.0)  # a cell without data, or without material, is no layer
            require(bool(values.any()), "", "a raster with some thickness", "none")
            parts = [np.flatnonzero(values.any(axis=1 - axis)) for axis in (0, 1)]
            ranges = [slice(part[0], part[-1] + 1) for part in parts]
            axes = [axis[part] for axis, part in zip(axes, ranges, strict=True)]
            values = values[ranges[0], ranges[1]]
        origin = [float(axis[0]) for axis in axes]
        entry: Entry = {"origin": origin, "spacing": list(raster.spacing), name: values.tolist()}
        if terrain and self.lower is None:
            entry |= {"corner": [-offset[0], -offset[1]], "crs": raster.crs}
        return entry

    def around_box(self, axes: list[Floats], values: Floats) -> tuple[list[Floats], Floats]:
        """What of a terrain [X, Z] lies in and around the box, two values an axis at least; there without holes. Holes
        beyond the box have the elevation of the nearest value. Raises InputError for those in it."""
        parts, margin = [], BEYOND * self.cell
        lower = (0.0, 0.0) if self.lower is None else self.lower
        for axis, start, length in zip(axes, lower, self.size[::2], strict=True):
            low = max(0, int(np.searchsorted(axis, start - margin, side="right")) - 1)
            high = min(len(axis), int(np.searchsorted(axis, start + length + margin)) + 1)
            parts.append(slice(min(low, len(axis) - 2), max(high, low + 2)))
        x, z = axes = [axis[part] for axis, part in zip(axes, parts, strict=True)]
        values = values[parts[0], parts[1]]
        holes = np.isnan(values)
        if not holes.any():
            return axes, values
        # The cells of the raster that reach into the box.
        halves = [0.5 * (axis[1] - axis[0]) - TOUCHING for axis in axes]
        sides = zip(axes, halves, lower, self.size[::2], strict=True)
        inside = [(axis > start - half) & (axis < start + length + half) for axis, half, start, length in sides]
        missing = np.argwhere(holes & np.logical_and.outer(*inside))
        for i, k in missing[:1]:
            where = f"{len(missing)} cells without data, the first at x = {x[i]:.10g}, z = {z[k]:.10g}"
            raise InputError(f"expected a raster without holes in the box, got {where}")
        require(not holes.all(), "", "a raster with values around the box", "none")
        return axes, filled(values)


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
