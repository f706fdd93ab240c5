"""python -m datasets.site DEM --release FILE --out site.toml: a scene in map coordinates from a raster and a release.

The box contains all ground that the energy line reaches from the release, and a margin around it. The line reaches
ground that is connected with the release and lies below

    z_0 - REACH mu s,    z_0: the top of the release on the highest post around it, s: level distance from it

A thickness T normal to the bed is T / cos(slope) along the vertical, for each cell of the raster.
"""

import math
import os
import shlex
import sys
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import shapely
import tomli_w
from numpy.typing import NDArray
from shapely import Polygon

from datasets.command_line import run
from datasets.errors import InputError, naming, require
from datasets.exchange.map_box import ROUNDING, filled, whole_cells
from datasets.files import write_text
from datasets.scene.checks import warn_if_unlikely
from datasets.scene.grid_field import Floats
from datasets.scene.library import scene_from
from datasets.scene.particles import particle_count, released_volume
from datasets.scene.stiffness import greatest_speed

if TYPE_CHECKING:  # GDAL and SciPy take half a second to import: --help needs neither
    from datasets.exchange.rasters import Raster
    from datasets.exchange.vectors import Feature

Mask = NDArray[np.bool_]

REACH = 0.75
"""Slope of the energy line that bounds the box, over the friction coefficient: fronts outrun a sliding block."""
HOLELESS = ".dem.tif"  # ending of the raster with its holes filled, beside the scene
THICKNESS = ("thickness", "d0")  # attributes of a polygon that may give its thickness [m]
PARTICLES, COLUMNS = 3.0e5, 1.0e7
"""Approximate limits for the default cell: particles of the release, columns of the box; minutes on two processors."""
ACROSS = 2.0  # cells over the thickness of the release, if the box allows it
AROUND = 4  # cells of ground around the reached ground
OVERLAP = 1.0e-3  # share of the release's area in more than one polygon, above which a warning says so
WITHIN = 0.5 - 1.0e-6  # half a cell of the raster, less what rounding adds to a polygon along its edge
TRAVEL = 4.0  # simulated time over the time to cross the box at the largest speed
FRAMES = 100  # smallest number of frames


def site(
    raster: "Raster",
    release: "list[Feature]",
    *,
    thickness: "float | Raster | None",
    vertical: bool,
    bed: dict[str, Any],
    slope: float,
    cell: float | None,
    internal_friction: float = 30.0,
) -> dict[str, Any]:
    """The tables of a scene file without its terrain's path and its times; lengths in m, in map coordinates. thickness:
    one for all polygons, a raster, or None for that of each polygon; bed: its `friction`, perhaps `turbulence`; slope:
    of the energy line. Raises InputError for a release outside the raster or without thickness."""
    given, field = (thickness, None) if isinstance(thickness, float) else (None, thickness)
    thick = [0.0 if field else thickness_of(feature, given) for feature in release]
    ground, covered = filled(raster.values, raster.spacing), np.zeros(raster.values.shape, bool)
    parts, cut, taken = list[Part](), list[bool](), Polygon()
    for feature, depth in zip(release, thick, strict=True):
        shape, taken = feature.polygon.difference(taken), taken.union(feature.polygon)
        for polygon in without_rings(shape):
            parts.append(layer(raster, ground, polygon, field or depth, vertical, covered))
            cut.append(shape.area < feature.polygon.area)
    require(len(parts) > 0, "--release", f"polygons wider than {ROUNDING:g} m", "none")
    twice = sum(feature.polygon.area for feature in release) - taken.area
    if twice > OVERLAP * taken.area:
        said = f"polygons of the release share {twice:.3g} m^2, which count once, for the first polygon"
        warnings.warn(said, stacklevel=2)
    steep = 0.0
    if "turbulence" in bed:
        steep = math.degrees(math.acos(1.0 / np.median(steepness(raster, raster.x, raster.z)[covered])))
    if steep > internal_friction + 1.0:
        said = f"--internal-friction: {internal_friction:g} degrees are less than the {steep:.0f} degrees of the slope"
        shears = "the layer shears inside and its upper part outruns Voellmy's law; 45 degrees hold it together"
        warnings.warn(f"{said} under the release, so {shears}", stacklevel=2)
    top = max(part.top for part in parts)
    lower, upper = reached(raster, covered, top, slope)
    lower[::2], upper[::2] = np.minimum(lower[::2], taken.bounds[:2]), np.maximum(upper[::2], taken.bounds[2:])
    upper[1] = max(upper[1], top)
    volume, plan = sum(part.volume for part in parts), float(np.prod((upper - lower)[::2]))
    mean = float(np.average([part.depth for part in parts], weights=[part.polygon.area for part in parts]))
    # A layer thinner than the particle spacing is one particle thick.
    few = 2.0 * max((volume / PARTICLES) ** (1.0 / 3.0), math.sqrt(taken.area / PARTICLES))
    least = max(min(mean, math.sqrt(taken.area)) / ACROSS, few, math.sqrt(plan / COLUMNS))
    unit = 10.0 ** (math.floor(math.log10(least)) - 1)
    edge = cell or float(f"{math.ceil(least / unit - 1.0e-9) * unit:.6g}")  # rounded up to two digits
    beside = AROUND * edge * np.array([1.0, 0.0, 1.0])
    # Narrower than a particle, where a polygon lies all but within others.
    narrow = [part.polygon.buffer(-0.25 * edge).is_empty and of_cut for part, of_cut in zip(parts, cut, strict=True)]
    if any(narrow):
        lost = sum(part.polygon.area for part, left in zip(parts, narrow, strict=True) if left)
        said = f"overlapping polygons leave strips narrower than {0.5 * edge:g} m, {lost:.3g} m^2, which are dropped"
        warnings.warn(said, stacklevel=2)
    # Posts of the raster stand half a spacing inside its edge.
    ends = [(float(axis[0]), float(axis[-1])) for axis in (raster.x, raster.z)]
    domain = whole_cells(lower - beside, upper + beside, edge, ends, "--cell")
    for low, high, axis in zip(taken.bounds[:2], taken.bounds[2:], (0, 2), strict=True):
        start, end = domain["origin"][axis], domain["origin"][axis] + domain["size"][axis]
        got = f"{low:.10g} to {high:.10g}, where cells of {edge:g} m on the raster lie from {start:.10g} to {end:.10g}"
        inside = start - ROUNDING <= low and high <= end + ROUNDING
        require(inside, "--release", "polygons that lie on the raster, with ground around them", got)
    return {
        "material": {"friction_deg": internal_friction},
        "open_sides": ["x-", "x+", "z-", "z+"],
        "domain": domain | ({} if raster.crs is None else {"crs": raster.crs}),
        "masses": [part.mass for part, left in zip(parts, narrow, strict=True) if not left],
        "solids": [{"name": "terrain", "kind": "terrain", **bed}],
    }


def thickness_of(feature: "Feature", given: float | None) -> float:
    """Thickness of a polygon [m]: the given one, else its attribute. Raises InputError."""
    value = feature.length(*THICKNESS) if given is None else given
    if value is None or not 0.0 < value < math.inf:
        expected = f"a thickness above 0 m, or an attribute {' or '.join(THICKNESS)} of each polygon"
        raise InputError(f"expected {expected}, got {value}", key="--thickness")
    return value


def without_rings(shape: shapely.Geometry) -> list[Polygon]:
    """Polygons cut into adjacent parts without holes, along a north-south line through each hole. Vertices are rounded
    to micrometres, and merged if they are in one place."""
    parts = []
    for polygon in shapely.get_parts(shapely.set_precision(shape, ROUNDING)):
        if polygon.area > 0.0 and polygon.interiors:
            west, south, east, north = polygon.bounds
            middle = float(np.mean(polygon.interiors[0].bounds[::2]))
            for half in (shapely.box(west, south, middle, north), shapely.box(middle, south, east, north)):
                parts += without_rings(polygon.intersection(half))
        elif polygon.area > 0.0:
            parts.append(polygon)
    return parts


class Part(NamedTuple):
    """A part of the release."""

    polygon: Polygon
    mass: dict[str, Any]  # of a scene file
    depth: float  # mean thickness, as it is given, where there is some [m]
    volume: float  # about [m^3]
    top: float  # elevation that none of its places exceeds [m]


def layer(
    raster: "Raster", ground: Floats, polygon: Polygon, thickness: "float | Raster", vertical: bool, covered: Mask
) -> Part:
    """A polygon as a layer. ground: elevations of the raster, holes filled [m], [X, Z]; thickness: a number [m] or a
    raster, whose cells the layer then takes over; covered: [X, Z], gets marks where cells intersect the polygon."""
    box = polygon.bounds
    for axis, spacing, low, high in zip((raster.x, raster.z), raster.spacing, box[:2], box[2:], strict=True):
        within = axis[0] - 0.5 * spacing <= low and high <= axis[-1] + 0.5 * spacing
        got = f"{low:.10g} to {high:.10g} beside {axis[0]:.10g} to {axis[-1]:.10g}"
        require(bool(within), "--release", "polygons that lie on the raster", got)
    near, inside = beside(raster, polygon, WITHIN)
    covered[near] |= inside
    holes = int(np.isnan(raster.values[near][inside]).sum())
    require(holes == 0, "--release", "ground beneath all of it", f"{holes} posts of the raster without data")
    # At its edge the ground is that between the posts of its cells and the next ones.
    near, around = beside(raster, polygon, 2.0 * WITHIN)
    highest = float(ground[near][around].max())
    mass: dict[str, Any] = {"kind": "layer", "outline": [list(place) for place in polygon.exterior.coords[:-1]]}
    if vertical and isinstance(thickness, float):
        mass |= {"thickness": thickness}
        return Part(polygon, mass, thickness, thickness * polygon.area, highest + thickness)
    cells = raster if isinstance(thickness, float) else thickness
    near, inside = beside(cells, polygon, WITHIN)
    here = np.full(inside.shape, thickness) if isinstance(thickness, float) else np.nan_to_num(thickness.values[near])
    here[~inside] = 0.0
    require(bool((here > 0.0).any()), "--thickness", "a thickness above 0 m in each polygon", "none")
    x, z = cells.x[near[0]], cells.z[near[1]]
    rows = np.round(here * (1.0 if vertical else steepness(raster, x, z)), 6)
    mass |= {"thickness": rows.tolist(), "origin": [float(x[0]), float(z[0])], "spacing": list(cells.spacing)}
    volume = float(rows[inside].mean()) * polygon.area
    return Part(polygon, mass, float(here[here > 0.0].mean()), volume, highest + float(rows.max()))


def beside(raster: "Raster", polygon: Polygon, half: float) -> tuple[tuple[slice, slice], Mask]:
    """The posts of a raster, along x and z, that lie in the box around a polygon or within a cell of it, and which of
    them have a cell that intersects the polygon, [X, Z]; half: half the size of this cell, in spacings."""
    ends = zip((raster.x, raster.z), raster.spacing, polygon.bounds[:2], polygon.bounds[2:], strict=True)
    first, second = (
        slice(int(np.searchsorted(axis, low - step)), int(np.searchsorted(axis, high + step, side="right")))
        for axis, step, low, high in ends
    )
    x, z = np.meshgrid(raster.x[first], raster.z[second], indexing="ij")
    half_x, half_z = (half * spacing for spacing in raster.spacing)
    shapely.prepare(polygon)
    return (first, second), shapely.intersects(polygon, shapely.box(x - half_x, z - half_z, x + half_x, z + half_z))


def steepness(raster: "Raster", x: Floats, z: Floats) -> Floats:
    """1 / cos(slope) at places x, z [m], shape [X, Z]: central differences at the posts, one-sided beside holes and at
    the edge, linear between posts; in holes, the value of the nearest post."""
    from scipy.ndimage import map_coordinates

    slopes = [slope_along(raster.values, axis, spacing) for axis, spacing in enumerate(raster.spacing)]
    steep = np.where(np.isnan(raster.values), np.nan, np.sqrt(1.0 + slopes[0] ** 2 + slopes[1] ** 2))
    steep = filled(steep, raster.spacing)
    places = [(at - own[0]) / step for at, own, step in zip((x, z), (raster.x, raster.z), raster.spacing, strict=True)]
    return np.asarray(map_coordinates(steep, np.meshgrid(*places, indexing="ij"), order=1, mode="nearest"))


def slope_along(values: Floats, axis: int, spacing: float) -> Floats:
    """Mean of the slopes to the existing neighbours of each post along an axis, 0 without neighbours, shape [X, Z]."""
    none = np.full_like(np.take(values, [0], axis), np.nan)
    slope = np.diff(values, axis=axis) / spacing
    both = np.stack([np.concatenate([none, slope], axis), np.concatenate([slope, none], axis)])
    return np.asarray(np.nansum(both, axis=0) / np.maximum(np.isfinite(both).sum(axis=0), 1))


def reached(raster: "Raster", release: Mask, top: float, slope: float) -> tuple[Floats, Floats]:
    """Corners [m], shape [3], of the box around the ground that an energy line of a slope reaches from `top` [m]."""
    from scipy.ndimage import distance_transform_edt, label

    distance = distance_transform_edt(~release, sampling=raster.spacing)
    below = np.nan_to_num(raster.values, nan=np.inf) <= top - slope * distance
    parts, _ = label(below | release, structure=np.ones((3, 3)))
    here = np.isin(parts, np.unique(parts[release]))
    plan = [axis[here.any(axis=1 - number)] for number, axis in enumerate((raster.x, raster.z))]
    heights = raster.values[here & ~np.isnan(raster.values)]
    lower, upper = ([function(values) for values in (plan[0], heights, plan[1])] for function in (np.min, np.max))
    return np.array(lower, np.float64), np.array(upper, np.float64)


def without_holes(raster: "Raster", domain: dict[str, Any]) -> Floats | None:
    """The values [X, Z] with holes filled from the nearest posts; None if no hole lies in the box of the scene."""
    sides = zip((raster.x, raster.z), raster.spacing, domain["origin"][::2], domain["size"][::2], strict=True)
    within = [(axis > low - step) & (axis < low + length + step) for axis, step, low, length in sides]
    holes = np.isnan(raster.values) & np.logical_and.outer(*within)
    return filled(raster.values, raster.spacing) if holes.any() else None


def least_of(given: float | Path, flag: str, expected: str, *, zero: bool) -> float:
    """A coefficient, or the smallest value of its raster. Raises InputError below 0, and at 0 unless `zero` is set."""
    from datasets.exchange.rasters import read_raster

    if not isinstance(given, Path):
        require(0.0 <= given < math.inf and (zero or given > 0.0), flag, expected, given)
        return given
    with naming(given, flag), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the scene warns when it reads the file
        least = float(np.nanmin(read_raster(given, coefficients=True).values))
        require(least > 0.0 or (zero and least == 0.0), "", expected, least)
    return least


def command(
    dem: Path,
    /,
    *,
    release: Path,
    out: Path,
    thickness: float | Path | None = None,
    vertical: bool = False,
    friction: float | Path = 0.4,
    turbulence: float | Path | None = None,
    internal_friction: float = 30.0,
    cell: float | None = None,
) -> None:
    """Write a scene in map coordinates from a raster of elevations and the polygons of a release.

    Args:
        dem: Raster of elevations [m] (ESRI ASCII, GeoTIFF and others), in a projected coordinate system or none.
        release: Release polygons: shapefile, GeoPackage, GeoJSON or KML.
        out: The scene to write (TOML).
        thickness: Thickness of the release [m], or a raster of it; default: attribute `thickness` or `d0` of a polygon.
        vertical: Whether the thickness is measured along the vertical, as in maps of Talus; default: normal to the
            ground.
        friction: Coulomb friction coefficient of the ground, or a raster of it.
        turbulence: Voellmy's turbulent coefficient of the ground [m/s^2], or a raster of it; default: none.
        internal_friction: Angle of internal friction of the material [deg].
        cell: Edge of a grid cell [m]; default: half of the mean thickness, or more if the box is large.
    """
    from datasets.exchange.rasters import read_raster, same_system, write_raster
    from datasets.exchange.vectors import LAYER, read_polygons
    from datasets.maps import MEASURED

    for path in (path for path in (dem, release, thickness, friction, turbulence) if isinstance(path, Path)):
        given = Path(str(path).partition(LAYER)[0]).resolve()
        kept = given not in (out.resolve(), out.with_suffix(HOLELESS).resolve())
        require(kept, "--out", f"a name beside which {path} stays as it is", out)
    least = least_of(friction, "--friction", "a coefficient of at least 0", zero=True)
    if turbulence is not None:
        least_of(turbulence, "--turbulence", "a coefficient above 0 m/s^2", zero=False)
    strong = 0.0 < internal_friction < 90.0
    require(strong, "--internal-friction", "an angle above 0 and below 90 degrees", internal_friction)
    require(cell is None or 0.0 < cell < math.inf, "--cell", "a length above 0 m", cell)
    with naming(dem):
        raster = read_raster(dem)
    thick: float | Raster | None = None if isinstance(thickness, Path) else thickness
    if isinstance(thickness, Path):
        with naming(thickness, "--thickness"):
            thick = read_raster(thickness)
            least_thick = float(np.nanmin(thick.values))
            require(least_thick >= 0.0, "", "thicknesses of at least 0 m", least_thick)
            require(same_system(raster.crs, thick), "", f"the reference system of {dem}, {raster.crs}", thick.crs)
            vertical = vertical or MEASURED.get(thick.description) == "vertical"
    with naming(release):
        features = read_polygons(release, raster.crs)
        bed = {"friction": friction} | ({} if turbulence is None else {"turbulence": turbulence})
        options: dict[str, Any] = {"thickness": thick, "vertical": vertical, "bed": bed, "cell": cell}
        table = site(raster, features, slope=REACH * least, internal_friction=internal_friction, **options)
    whole, terrain = without_holes(raster, table["domain"]), table["solids"][0]
    if whole is not None:
        expected, got = "ground without holes, or square cells", " x ".join(f"{edge:g} m" for edge in raster.spacing)
        with naming(dem):
            require(math.isclose(*raster.spacing), "", expected, got)
        dem = out.with_suffix(HOLELESS)
        write_raster(dem, whole, raster.spacing[0], raster.corner, raster.crs, "elevation, holes filled", "m")
        print(f"{dem}: the raster with its holes filled by the nearest posts; nothing should flow there")
    paths = {name: value for name, value in (bed | {"file": dem}).items() if isinstance(value, Path)}
    terrain |= {name: str(path.resolve()) for name, path in paths.items()}
    with naming(release):
        scene = scene_from({"duration": 1.0, "frame_dt": 1.0, **table}, out.resolve().parent)
    warn_if_unlikely(scene)
    terrain |= {name: os.path.relpath(path.resolve(), out.resolve().parent) for name, path in paths.items()}
    size, speed = scene.domain.size, greatest_speed(scene)
    seconds = 10.0 * math.ceil(0.1 * TRAVEL * math.hypot(*size[::2]) / max(speed, 1.0))
    frame_dt = next((step for step in (1.0, 0.5, 0.2) if seconds / step >= FRAMES), 0.1)
    times = {"duration": seconds, "frame_dt": frame_dt}
    head = f"# {release.name} on {dem.name}, by python -m datasets.site; in map coordinates.\n"
    write_text(out, head + tomli_w.dumps({**times, **table}))
    sides, sand = " x ".join(f"{length:g}" for length in size), f"{released_volume(scene):.4g} m^3"
    box = f"a box of {sides} m in cells of {scene.domain.cell:g} m, {seconds:g} s"
    print(f"{out}: {sand} in {particle_count(scene)} particles, {box}, at most {speed:.3g} m/s by the energy line")
    written = shlex.quote(str(out))
    print(f"python -m mpm.run {written} --out DIR --until-rest, then python -m datasets.maps DIR --out MAPS")


if __name__ == "__main__":
    sys.exit(run(command, "python -m datasets.site"))
