"""Solid: a fixed rigid body of the scene, by its shape, its friction and what it bears in tension.

In TOML a shape may come from a file (`datasets.geometry.files`); a `Solid` always holds the numbers themselves, so that
a scene is complete without its files.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

from datasets.errors import InputError
from datasets.records import Record

Vector = tuple[float, ...]
Rows = tuple[Vector, ...]
Triangles = tuple[tuple[int, int, int], ...]

KINDS: dict[int, tuple[str, ...]] = {2: ("box", "polygon", "terrain"), 3: ("box", "terrain", "mesh")}
"""Kinds of solids in two and in three dimensions."""
KEYS: dict[tuple[str, int], tuple[str, ...]] = {
    ("box", 2): ("lower", "size"),
    ("box", 3): ("lower", "size"),
    ("polygon", 2): ("vertices",),
    ("terrain", 2): ("points",),
    ("terrain", 3): ("origin", "spacing", "heights"),
    ("mesh", 3): ("vertices", "triangles"),
}
"""Keys that give the shape of a kind, all of them needed."""
FARTHEST = 1.0e9
"""Lengths [m], times [s], speeds [m/s] and coefficients beyond this are none; it keeps their powers finite."""
CONTACTS = ("coulomb", "no-slip")


@dataclass(frozen=True, kw_only=True)
class Solid(Record):
    """A fixed rigid body; which keys give its shape depends on its kind (`KEYS`).

    For example:

        Solid(kind="polygon", vertices=((0.5, 0.0), (0.9, 0.0), (0.7, 0.2)), friction=0.4)
        Solid(kind="terrain", points=((0.0, 0.5), (1.0, 0.0), (2.0, 0.0)))  # solid below this line
    """

    name: str | None = None
    """What it is called in records; `solids[I]` where absent."""
    kind: str = "box"
    """`box`, `polygon` (2D), `terrain` (solid below a line or a surface) or `mesh` (3D)."""
    lower: Vector | None = None
    """Lower corner of a box before it is turned [m]."""
    size: Vector | None = None
    """Extent of a box [m]."""
    turned_deg: float = 0.0
    """Turn of a box about its centre [deg]: in 2D from x to y, in 3D about the vertical, from x to z."""
    vertices: Rows | None = None
    """Corners of a simple polygon in either orientation, or of the triangles of a mesh [m], shape [V, D]."""
    triangles: Triangles | None = None
    """The three vertices of each triangle of a mesh, counted from 0; closed, in either orientation."""
    points: Rows | None = None
    """Ground line of a terrain in 2D from small to large x [m], shape [P, 2]."""
    origin: Vector | None = None
    """x and z of the first height of a terrain in 3D [m]."""
    spacing: Vector | None = None
    """Distance between its heights along x and z [m]."""
    heights: Rows | None = None
    """Elevation y of a terrain in 3D [m], linear on triangles: rows along x of columns along z, shape [X, Z]."""
    corner: Vector | None = None
    """Easting and northing of x = 0, z = 0 in the coordinates of the raster that a terrain in 3D came from [m]."""
    crs: str | None = None
    """Reference system of these coordinates, as an authority's code or in WKT, where the raster named one."""
    friction: float | Vector | Rows = 0.0
    """Coulomb coefficient [-]: a number, or one per vertex, point or height, linear between them."""
    contact: str = "coulomb"
    """`coulomb` or `no-slip`."""
    adhesion: float = 0.0
    """Tension that the surface bears [Pa]."""


def check_solid(solid: Solid, key: str, dimension: int) -> None:
    """Raise InputError for a solid that is none in `dimension` dimensions; what needs the box is `datasets.scene`'s."""

    def require(ok: bool, name: str, expected: str, got: object) -> None:
        if not ok:
            raise InputError(f"expected {expected}, got {got}", key=f"{key}.{name}")

    kinds = KINDS[dimension]
    require(solid.kind in kinds, "kind", f"{', '.join(kinds)} in {dimension}D", repr(solid.kind))
    needed = KEYS[solid.kind, dimension]
    for name in sorted({name for names in KEYS.values() for name in names}):
        given = getattr(solid, name) is not None
        if name in needed and not given:
            files = {"terrain": " or a file", "mesh": " or a file"}.get(solid.kind, "")
            raise InputError(f"expected `{'`, `'.join(needed)}`{files} of a {solid.kind}", key=f"{key}.{name}")
        require(given == (name in needed), name, f"no such key of a {solid.kind}", "one")
    require(usual(solid.turned_deg), "turned_deg", f"an angle within {FARTHEST:g}", solid.turned_deg)
    require(solid.turned_deg == 0.0 or solid.kind == "box", "turned_deg", "a turn of a box alone", solid.kind)
    require(solid.contact in CONTACTS, "contact", " or ".join(map(repr, CONTACTS)), repr(solid.contact))
    require(0.0 <= solid.adhesion <= 1.0e15, "adhesion", "a tension of at least 0 Pa, up to 1e15", solid.adhesion)
    check_friction(solid, key)
    if solid.kind == "box":
        check_vectors(((solid.lower or ()), (solid.size or ())), ("lower", "size"), key, dimension)
        require(min(solid.size or (0.0,)) > 0.0, "size", "positive lengths in m", list(solid.size or ()))
    if solid.points is not None:
        check_ground_line(solid.points, f"{key}.points")
    if solid.vertices is not None:
        minimum = 3 if dimension == 2 else 4
        require(len(solid.vertices) >= minimum, "vertices", f"at least {minimum} vertices", len(solid.vertices))
        check_vectors(solid.vertices, [f"vertices[{index}]" for index in range(len(solid.vertices))], key, dimension)
    if solid.triangles is not None:
        most = len(solid.vertices or ())
        for index, triangle in enumerate(solid.triangles):
            require(
                all(0 <= corner < most for corner in triangle) and len(set(triangle)) == 3,
                f"triangles[{index}]",
                f"three different vertices of the {most}, counted from 0",
                list(triangle),
            )
    for name in ("corner", "crs"):
        require(
            getattr(solid, name) is None or solid.heights is not None, name, "no such key but of a terrain in 3D", "one"
        )
    if solid.corner is not None:
        check_vectors((solid.corner,), ("corner",), key, 2)
    if solid.heights is not None:
        check_vectors((solid.origin or (), solid.spacing or ()), ("origin", "spacing"), key, 2)
        require(min(solid.spacing or (0.0,)) > 0.0, "spacing", "positive lengths in m", list(solid.spacing or ()))
        check_rows(solid.heights, f"{key}.heights")


def usual(number: float) -> bool:
    """Whether a number is finite, and no larger than a length can be."""
    return abs(number) <= FARTHEST


def check_friction(solid: Solid, key: str) -> None:
    """Raise InputError for friction that is negative or does not fit the shape."""
    friction = solid.friction
    message = "a coefficient of at least 0"
    if isinstance(friction, int | float):
        if not (0.0 <= friction <= FARTHEST):
            raise InputError(f"expected {message}, got {friction}", key=f"{key}.friction")
        return
    if solid.contact != "coulomb":
        raise InputError("expected a single number, or none, of a surface without slip", key=f"{key}.friction")
    along = solid.points or (solid.vertices if solid.kind == "polygon" else None) or solid.heights
    if along is None:
        raise InputError(f"expected a single number of a {solid.kind}", key=f"{key}.friction")
    if solid.heights is not None:
        fits = all(isinstance(row, tuple) for row in friction) and [len(row) for row in friction] == [  # type: ignore[arg-type]
            len(row) for row in along
        ]
        if not fits:
            raise InputError("expected a coefficient for every height, in the same rows", key=f"{key}.friction")
        values = [value for row in friction for value in row]  # type: ignore[union-attr]
    else:
        if len(friction) != len(along) or not all(isinstance(value, int | float) for value in friction):
            raise InputError(
                f"expected {len(along)} coefficients, one for each point, got {len(friction)}", key=f"{key}.friction"
            )
        values = list(friction)
    bad = next((value for value in values if not 0.0 <= value <= FARTHEST), None)
    if bad is not None:
        raise InputError(f"expected {message}, got {bad}", key=f"{key}.friction")


def check_vectors(vectors: Sequence[Sequence[float]], names: Sequence[str], key: str, dimension: int) -> None:
    """Raise InputError unless every vector has `dimension` finite components."""
    for vector, name in zip(vectors, names, strict=True):
        if len(vector) != dimension or not all(map(usual, vector)):
            raise InputError(
                f"expected {dimension} lengths in m within {FARTHEST:g}, got {list(vector)}", key=f"{key}.{name}"
            )


def check_ground_line(points: Rows, key: str) -> None:
    """Raise InputError unless the points of a ground line go from small to large x, at least two of them."""
    if len(points) < 2:
        raise InputError(f"expected at least 2 points, got {len(points)}", key=key)
    check_vectors(points, [f"points[{index}]" for index in range(len(points))], key.rpartition(".")[0], 2)
    for index, (first, second) in enumerate(itertools.pairwise(points)):
        if first == second:
            raise InputError(f"expected different points, got {list(first)} twice", key=f"{key}[{index + 1}]")
        if second[0] < first[0]:
            raise InputError(
                f"expected x not to fall from point to point, got {second[0]:g} after {first[0]:g}",
                key=f"{key}[{index + 1}]",
            )


def check_rows(rows: Rows, key: str) -> None:
    """Raise InputError unless `rows` are at least two of as many finite numbers, at least two."""
    if len(rows) < 2 or len(rows[0]) < 2:
        raise InputError("expected at least 2 x 2 heights", key=key)
    for index, row in enumerate(rows):
        if len(row) != len(rows[0]):
            raise InputError(
                f"expected {len(rows[0])} heights as in the first row, got {len(row)}", key=f"{key}[{index}]"
            )
        if not all(map(usual, row)):
            raise InputError(f"expected heights in m within {FARTHEST:g}", key=f"{key}[{index}]")
