"""The keys of the shape of a solid or a mass, and their checks."""

import itertools
from collections.abc import Sequence

from datasets.errors import require
from datasets.scene.parts import INFLOW, Mass, Rows, Solid, Water
from datasets.schema import FARTHEST

KEYS: dict[tuple[type, str, int], tuple[tuple[str, ...], tuple[str, ...]]] = {
    (Solid, "box", 2): (("lower", "size"), ()),
    (Solid, "polygon", 2): (("vertices",), ()),
    (Solid, "terrain", 2): (("points",), ()),
    (Solid, "box", 3): (("lower", "size"), ()),
    (Solid, "terrain", 3): (("origin", "spacing", "heights"), ("corner", "crs")),
    (Solid, "mesh", 3): (("vertices", "triangles"), ()),
    (Mass, "box", 2): ((), ()),
    (Mass, "polygon", 2): (("vertices",), ()),
    (Mass, "layer", 2): (("thickness",), ("outline",)),
    (Mass, INFLOW, 2): (("section", "hydrograph"), ("direction", "discharge_factor")),
    (Mass, "box", 3): ((), ()),
    (Mass, "mesh", 3): (("vertices", "triangles"), ()),
    (Mass, "layer", 3): (("thickness",), ("origin", "spacing", "outline")),
    (Mass, INFLOW, 3): (("section", "hydrograph"), ("direction", "discharge_factor")),
}
"""Kind of a solid or mass -> required and optional keys, in addition to the box around a mass."""


def usual(number: float) -> bool:
    """Whether a number is finite and within the largest length."""
    return abs(number) <= FARTHEST


def check_kind(kind: str, group: type, key: str, dimension: int) -> None:
    """Raise InputError unless `group`, solids or masses, has a kind of this name."""
    kinds = [name for owner, name, axes in KEYS if (owner, axes) == (group, dimension)]
    require(kind in kinds, f"{key}.kind", f"{', '.join(kinds)} in {dimension}D", repr(kind))


def check_shape(shape: Solid | Mass, key: str, dimension: int) -> None:
    """Raise InputError unless a solid or a mass has exactly the keys of its kind, and a valid shape."""
    check_kind(shape.kind, type(shape), key, dimension)
    forms = {form: keys for form, keys in KEYS.items() if isinstance(shape, form[0])}
    needed, optional = KEYS[type(shape), shape.kind, dimension]
    for name in sorted({name for keys in forms.values() for part in keys for name in part}):
        given = getattr(shape, name) is not None
        files = " or a file" * (shape.kind in ("terrain", "mesh", INFLOW))
        expected = f"`{'`, `'.join(needed)}`{files} of a{'n' * (shape.kind == INFLOW)} {shape.kind}"
        require(given or name not in needed, f"{key}.{name}", expected, "none")
        require(not given or name in (*needed, *optional), f"{key}.{name}", f"no such key of kind {shape.kind}", "one")
    if shape.vertices is not None:
        check_rows(shape.vertices, f"{key}.vertices", dimension, least=dimension + 1)
    count = len(shape.vertices or ())
    for index, triangle in enumerate(shape.triangles or ()):
        ok = all(0 <= corner < count for corner in triangle) and len(set(triangle)) == 3
        expected = f"three different vertices of the {count}, counted from 0"
        require(ok, f"{key}.triangles[{index}]", expected, list(triangle))
    if isinstance(shape, Mass) and shape.outline is not None:
        check_rows(shape.outline, f"{key}.outline", dimension - 1, least=dimension)


def check_vector(vector: Sequence[float], key: str, dimension: int) -> None:
    """Raise InputError unless a vector has `dimension` finite components."""
    ok = len(vector) == dimension and all(map(usual, vector))
    require(ok, key, f"{dimension} lengths in m within {FARTHEST:g}", list(vector)[:dimension])


def check_rows(rows: Rows, key: str, width: int, *, least: int = 1) -> None:
    """Raise InputError unless there are at least `least` rows of `width` finite numbers each."""
    require(len(rows) >= least, key, f"at least {least} rows of {width} numbers", len(rows))
    for index, row in enumerate(rows):
        check_vector(row, f"{key}[{index}]", width)


def check_grid(shape: Solid | Mass | Water, values: Rows | None, key: str, name: str, what: str) -> None:
    """Raise InputError unless `values` in key `name` are numbers on a grid in x and z, for a surface 2 x 2 or more; or,
    without any, if there is a grid. what: these values, in words."""
    for part in ("origin", "spacing"):
        gridded = (getattr(shape, part) is None) == (values is None)
        require(gridded, f"{key}.{part}", f"x and z of {what}, and only of that", "others")
    if values is None:
        return
    least = 1 if name == "thickness" else 2
    check_vector(shape.origin or (), f"{key}.origin", 2)
    check_vector(shape.spacing or (), f"{key}.spacing", 2)
    enough = len(values) > 0 and len(values[0]) >= least
    require(enough, f"{key}.{name}", f"at least {least} x {least} numbers", "fewer")
    check_rows(values, f"{key}.{name}", len(values[0]), least=least)


def check_solid(solid: Solid, key: str, dimension: int) -> None:
    """Raise InputError for a solid that is invalid in `dimension` dimensions, wherever it lies."""
    check_shape(solid, key, dimension)
    turned = solid.turned_deg
    require(usual(turned) and (turned == 0.0 or solid.kind == "box"), f"{key}.turned_deg", "a turn of a box", turned)
    if solid.kind == "box":
        check_vector(solid.lower or (), f"{key}.lower", dimension)
        check_vector(solid.size or (), f"{key}.size", dimension)
    if solid.points is not None:
        check_rows(solid.points, f"{key}.points", 2, least=2)
    for index, (first, second) in enumerate(itertools.pairwise(solid.points or ()), 1):
        place, rises = f"{key}.points[{index}]", second[0] >= first[0]
        require(first != second, place, "different points", f"{list(first)} twice")
        require(rises, place, "x not to fall from point to point", f"{second[0]:g} after {first[0]:g}")
    if solid.heights is not None:
        check_grid(solid, solid.heights, key, "heights", "a terrain")
    if solid.corner is not None:
        check_vector(solid.corner, f"{key}.corner", 2)
    corners = solid.vertices if solid.kind == "polygon" else None
    for name, places in (("friction", solid.points or corners or solid.heights), ("turbulence", solid.heights)):
        values, place = getattr(solid, name), f"{key}.{name}"
        if not isinstance(values, tuple):
            continue
        slips = solid.contact == "coulomb" or name == "turbulence"
        require(slips, place, "a single number, or none, of a surface without slip", "more")
        require(places is not None, place, f"a single number of a {solid.kind}", "more")
        counts = [len(row) if isinstance(row, tuple) else 0 for row in values]
        expected = [len(row) if solid.heights else 0 for row in places or ()]
        said = "a coefficient for every height, in the same rows" if solid.heights else f"{len(expected)} coefficients"
        require(counts == expected, place, said, f"{len(counts)} rows" if any(counts) else len(counts))
