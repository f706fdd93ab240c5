"""python -m datasets.maps TRAJECTORY --out DIR: a flow in 3D seen from above, as rasters, outlines and pictures.

The maps give the thickness of the deposit and the largest depth and velocity of each cell, in the coordinates of the
terrain's raster if the scene has one. The volume V_p of a particle is shared linearly between the cells around it, by
the weights w of `datasets.scene.grid_field` at the cell centres. With A_c the area of a cell,

    h_c = 1 / A_c  sum_p w_c(x_p) V_p,    v_c = | sum_p w_c(x_p) V_p v_p | / sum_p w_c(x_p) V_p

So sum_c h_c A_c = sum_p V_p exactly. A layer of evenly spaced particles has an even thickness if the cell is a whole
number of spacings long. Thickness is measured along y, which is vertical on a terrain and normal to the floor of a
tilted box (`slope_deg`). It uses the volume at the initial density, without dilation. The velocity v_c is the mean over
the depth. The thickness normal to the bed is h_c cos(slope), with the slope of the terrain.

Particles that cross several cells from one frame to the next would leave gaps in the largest values and steps in the
times of arrival. The maps therefore also evaluate moments between two frames, where a particle follows the cubic
(Hermite) of its positions and velocities at both.
"""

import math
import sys
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely import MultiPolygon, Polygon
from shapely.geometry.polygon import orient
from tqdm import tqdm

from datasets.command_line import run
from datasets.errors import naming, require
from datasets.files import make_folder, replacing, write_json, write_text
from datasets.flow.fields import FlowFields
from datasets.flow.trajectory import Trajectory, open_trajectory, trajectory_file
from datasets.geometry.ground import Integers, elevation, slopes_in_plan
from datasets.geometry.placement import tops_beneath
from datasets.geometry.surface import surface_of
from datasets.scene import Mass, Scene
from datasets.scene.grid_field import Floats, Grid

KINDS = {
    "thickness": ("thickness of the deposit", "m", "YlOrBr"),
    "depth": ("largest depth of the flow", "m", "YlGnBu"),
    "normal_depth": ("largest depth normal to the bed", "m", "YlGnBu"),
    "velocity": ("largest velocity of the flow", "m/s", "plasma"),
    "arrival": ("time of arrival", "s", "viridis"),
}
"""Attribute of `PlanMaps` and name of its file -> title, unit, matplotlib colours."""
MEASURED: dict[str, Literal["normal", "vertical"]] = {KINDS[name][0]: "vertical" for name in ("thickness", "depth")}
MEASURED |= {KINDS["normal_depth"][0]: "normal"}
"""Title, which is the description of a raster's band -> how the map measures a thickness."""
BETWEEN = 8  # most moments evaluated from one frame to the next: as many as cells that fast particles cross
FAST = 0.99  # quantile of the particles' displacements that counts as fast, so that no single grain decides
COLOURS = 9  # number of colours of a map in QGIS
OUTSIDE = 1.0e-6  # share of the box by which rounding may put a particle beyond a wall
CLOSE = 1.0e-6  # distance beyond its edge at which a map falls to 0 [cells]
WIDTH, HIGHEST = 9.0, 9.0  # width and largest height of a picture [inches]
CONTOURS = 12  # approximate number of contour lines of the ground

Singles = NDArray[np.float32]


@dataclass(frozen=True, kw_only=True)
class PlanMaps:
    """The maps of a flow, over X cells along x and Z along z."""

    grid: Grid  # of the cell centres along x and z [m]
    thickness: Floats  # of the deposit in the last frame [m], shape [X, Z]
    start: Floats | None  # thickness at the start [m]; None if the trajectory does not hold it
    depth: Floats  # largest thickness at any time [m]
    normal_depth: Floats  # largest thickness normal to the terrain [m]
    velocity: Floats | None  # largest velocity [m/s] at thicknesses above the threshold; None if none is known
    arrival: Floats  # first time [s] at which the thickness exceeds the threshold; NaN if it never does
    ground: Floats  # elevation of the highest solid, else of the floor of the box, at the cell centre [m]
    threshold: float  # thickness [m] above which a cell counts as covered
    volume: float  # of the particles in the box in the last frame [m^3]
    left: float  # volume of the particles that have left the box by then [m^3]
    corner: tuple[float, ...] = (0.0, 0.0)  # easting and northing of x = z = 0 [m]: x runs to the east, z to the north
    crs: str | None = None  # their reference system, as an authority's code or in WKT; None in box coordinates

    @property
    def cell(self) -> float:
        """Edge of a cell [m]."""
        return self.grid.spacing[0]


def maps_of(trajectory: Trajectory, cell: float, *, threshold: float | None = None, progress: bool = False) -> PlanMaps:
    """The maps of `trajectory` over square cells of edge `cell` [m]; the last may extend beyond the box. threshold:
    [m], above which a cell counts as covered; default: the particle spacing, at most half the least thickness released.
    Raises InputError for a threshold that is not positive, for a flow in 2D, and for cells smaller than the particle
    spacing or longer than a side of the box."""
    scene, fields, volumes = trajectory.scene, FlowFields(trajectory), trajectory.volumes
    if threshold is None:
        threshold = min(fields.spacing, 0.5 * min(least_thickness(mass) for mass in scene.masses))
    require(threshold > 0.0, "--threshold", "a thickness above 0 m", f"{threshold:g}")
    require(scene.dimension == 3, "", "a trajectory in 3D, a flow in 2D has no plan")
    sides, least = scene.domain.size[::2], scene.particle_spacing
    expected = f"a length from {least:g} m, the spacing of the particles, to {min(sides):g} m, the box"
    require(least * (1.0 - 1.0e-9) <= cell <= min(sides), "--cell", expected, f"{cell:g} m")
    grid = Grid((0.5 * cell,) * 2, (cell,) * 2, tuple(math.ceil(side / cell - 1.0e-6) for side in sides))
    depth, fastest, arrival = np.zeros(grid.count), np.zeros(grid.count), np.full(grid.count, np.nan)
    start, known, sums = None, False, np.zeros((*grid.nodes, 4))
    limits = np.outer((-OUTSIDE, 1.0 + OUTSIDE), scene.domain.size)
    for time, cells, moving in plan_sums(fields, limits, cell, sums, progress):
        if time == 0.0:
            start = sums[..., 0] / cell**2
        volume, *momentum = sums.reshape(-1, 4)[cells].T
        depth[cells] = np.maximum(depth[cells], volume / cell**2)
        covered, known = volume / cell**2 > threshold, known or moving
        arrival[cells] = np.where(np.isnan(arrival[cells]) & covered, time, arrival[cells])
        fastest[cells] = np.maximum(fastest[cells], np.where(covered, np.linalg.norm(momentum, axis=0) / volume, 0.0))
    last, here = trajectory.positions[-1], trajectory.entered(float(trajectory.time[-1]))
    inside = ((last >= limits[0]) & (last <= limits[1])).all(axis=1) & here
    corner, crs = map_corner(scene)
    return PlanMaps(
        grid=grid,
        thickness=sums[..., 0] / cell**2,
        start=start,
        depth=depth.reshape(grid.nodes),
        normal_depth=depth.reshape(grid.nodes) / np.hypot(1.0, np.hypot(*slopes_in_plan(scene, grid))),
        velocity=fastest.reshape(grid.nodes) if known else None,
        arrival=arrival.reshape(grid.nodes),
        ground=ground(scene, grid) + float(scene.domain.corner[1]),
        threshold=threshold,
        volume=float(volumes[inside].sum()),
        left=float(volumes[here & ~inside].sum()),
        corner=corner,
        crs=crs,
    )


def plan_sums(
    fields: FlowFields, limits: Floats, cell: float, sums: Floats, progress: bool
) -> Iterator[tuple[float, Integers, bool]]:
    """Times [s], the cells that hold material then, and whether velocities are known; `sums` as of `add_to_plan`.
    The times are those of the frames and, if the flow crosses several cells between two frames, times between them."""
    from datasets.flow.plan import add_to_plan  # compiled on import, for which --help need not wait

    flow, touched, used = fields.trajectory, np.zeros(sums[..., 0].size, np.int64), 0
    begin, places, velocity = moment(fields, 0)
    for frame in tqdm(range(len(flow.time)), desc="maps", unit="frame", disable=not progress):
        end, there, faster = moment(fields, frame)
        count, known = 1, len(faster) > 0
        if known and len(velocity) > 0:
            moved = there - places
            fast = math.sqrt(np.quantile(np.einsum("nk,nk->n", moved, moved), FAST))
            count = min(max(math.ceil(fast / cell), 1), BETWEEN)
        for share in np.arange(1, count + 1) / count:
            time = begin + share * (end - begin)
            motion = (places, there), (velocity, faster), share, end - begin
            sums.reshape(-1, 4)[touched[:used]] = 0.0
            used = add_to_plan(*motion, np.where(flow.entered(time), flow.volumes, 0.0), limits, cell, sums, touched)
            yield time, touched[:used], known
        begin, places, velocity = end, there, faster


def moment(fields: FlowFields, frame: int) -> tuple[float, Singles, Singles]:
    """Time [s], positions [m] and velocities [m/s] of a frame, shape [N, 3]; unknown velocities have shape [0, 3]."""
    flow, velocity = fields.trajectory, fields.velocity(frame)
    known = np.zeros((0, 3)) if velocity is None else velocity
    positions, velocities = (np.ascontiguousarray(values, np.float32) for values in (flow.positions[frame], known))
    return float(flow.time[frame]), positions, velocities


def least_thickness(mass: Mass) -> float:
    """Smallest thickness of a layer, or the height of another body [m]."""
    if mass.kind != "layer":
        return mass.size[1]
    given = np.array(mass.thickness)
    return float(given[given > 0.0].min())


def ground(scene: Scene, grid: Grid) -> Floats:
    """Elevation of the highest solid at each cell of the maps [m]; 0, the floor's, where there is none. A cell beyond
    the box takes the elevation of the nearest place inside."""
    plan = np.minimum(grid.positions, scene.domain.size[::2])
    if not scene.baffles and all(solid.kind == "terrain" for solid in scene.solids):
        return elevation(scene.solids, scene.domain, plan).reshape(grid.nodes)
    surface = surface_of(scene)
    assert surface is not None, "of the solids"
    return tops_beneath(surface, np.insert(plan, 1, np.inf, axis=1), 0.0).reshape(grid.nodes)


def map_corner(scene: Scene) -> tuple[tuple[float, ...], str | None]:
    """Easting and northing of x = z = 0 [m] and their reference system: of a terrain's raster, else of the box."""
    corners = ((solid.corner, solid.crs) for solid in scene.solids if solid.corner is not None)
    east, _, north = scene.domain.corner.tolist()
    return next(corners, ((east, north), scene.domain.crs))


def require_same_place(one: Scene, other: Scene, whose: str = "the other") -> None:
    """Raise InputError unless both boxes have the same place on the map. whose: the name of `one` in the message."""
    places = [scene.domain.corner.tolist() for scene in (one, other)]
    for scene, place in zip((one, other), places, strict=True):
        if scene.dimension == 3:
            place[0], place[2] = map_corner(scene)[0]
    require(places[0] == places[1], "", f"a flow in a box at {places[0]}, as {whose}", f"one at {places[1]}")


def region_above(grid: Grid, values: Floats, threshold: float, corner: Sequence[float] = (0.0, 0.0)) -> MultiPolygon:
    """Polygons with holes where `values` [X, Z] exceed a threshold, with `corner` [m] added. Values are linear between
    cell centres and constant in the outer half of edge cells. Outer rings run anticlockwise, holes clockwise."""
    from contourpy import FillType, contour_generator

    padded = np.pad(np.pad(values, 1, mode="edge"), 1)
    x, z = (
        first + step * np.concatenate([[-CLOSE, 0.0], np.arange(count) + 0.5, [count, count + CLOSE]])
        for first, step, count in zip(corner, grid.spacing, values.shape, strict=True)
    )
    filled = contour_generator(x, z, padded.T, fill_type=FillType.OuterOffset).filled(threshold, np.inf)
    parts = [np.split(points, offsets[1:-1]) for points, offsets in zip(*filled, strict=True)]
    return MultiPolygon([orient(Polygon(outer, holes)) for outer, *holes in parts])


def write_outlines(path: Path, maps: PlanMaps, outlines: dict[tuple[str, float], MultiPolygon]) -> None:
    """Write the outlines of `maps`, by name and threshold [m], as GeoJSON: a MultiPolygon each, with the properties
    `name`, `threshold_m` and `area_m2`, in the rasters' reference system."""
    import pyogrio

    names, thresholds = zip(*outlines, strict=True)
    shapes = [*outlines.values()]
    columns = {"name": names, "threshold_m": thresholds, "area_m2": shapely.area(shapes)}
    with warnings.catch_warnings(), replacing(path) as part:
        # A box in its own coordinates has no reference system; that is no error.
        warnings.simplefilter("ignore")
        options = {"driver": "GeoJSON", "layer": path.stem, "geometry_type": "MultiPolygon", "crs": maps.crs}
        pyogrio.raw.write(part, shapely.to_wkb(shapes), [*map(np.array, columns.values())], [*columns], **options)


def style(colours: str, most: float, unit: str) -> str:
    """The colours of a map from 0 to its largest value, as a QGIS style, which QGIS reads from beside the raster."""
    from matplotlib import colormaps
    from matplotlib.colors import to_hex

    steps = np.linspace(0.0, 1.0, COLOURS)
    items = "".join(
        f'<item value="{step * most:.6g}" label="{step * most:.3g} {unit}" color="{to_hex(colour)}" alpha="255"/>'
        for step, colour in zip(steps, colormaps[colours](steps), strict=True)
    )
    ramp = f'<colorrampshader colorRampType="INTERPOLATED" clip="0">{items}</colorrampshader>'
    renderer = f'<rasterrenderer type="singlebandpseudocolor" band="1" opacity="1" classificationMax="{most:.6g}"'
    shown = f'{renderer} classificationMin="0"><rastershader>{ramp}</rastershader></rasterrenderer>'
    return f"<!DOCTYPE qgis>\n<qgis><pipe>{shown}</pipe></qgis>\n"


def draw_maps(path: Path, maps: PlanMaps) -> None:
    """Draw the covered cells of all maps, one map above the other, over the ground, with the deposit's outline."""
    from matplotlib.figure import Figure

    kinds = {name: kind for name, kind in KINDS.items() if getattr(maps, name) is not None}
    x, z = (axis + first for axis, first in zip(maps.grid.axes, maps.corner, strict=True))
    height = min(HIGHEST, 1.3 + 0.8 * WIDTH * len(z) / len(x))
    figure = Figure(figsize=(WIDTH, height * len(kinds)), layout="constrained")
    panels = figure.subplots(len(kinds), squeeze=False, subplot_kw={"aspect": "equal"})[:, 0]
    for panel, (name, (title, unit, colours)) in zip(panels, kinds.items(), strict=True):
        covered = (maps.thickness if name == "thickness" else maps.depth) > maps.threshold
        if np.ptp(maps.ground) > 0.0:
            panel.contour(x, z, maps.ground.T, levels=CONTOURS, colors="grey", linewidths=0.6)
        shown = np.ma.masked_where(~covered, getattr(maps, name)).T
        image = panel.pcolormesh(x, z, shown, cmap=colours, vmin=0.0, shading="nearest")
        figure.colorbar(image, label=f"{title} [{unit}]")
        if maps.thickness.min() < maps.threshold < maps.thickness.max():
            panel.contour(x, z, maps.thickness.T, levels=[maps.threshold], colors="black", linewidths=1.0)
        panel.set(xlabel="x, easting [m]", ylabel="z, northing [m]")
        panel.ticklabel_format(useOffset=False, style="plain")
    with replacing(path) as part:
        figure.savefig(part, dpi=120)


def write(trajectory: Trajectory, maps: PlanMaps, folder: Path, thresholds: Sequence[float] = ()) -> dict[str, Any]:
    """Write the maps of a trajectory into `folder`, and their summary as maps.json, which is returned. thresholds: [m],
    of outlines in addition to that of the maps. Raises WorkFailed."""
    from datasets.exchange.rasters import write_raster

    shown = {"deposit": maps.thickness, "covered": maps.depth, "release": maps.start}
    levels = sorted({maps.threshold, *thresholds})
    outlines = {
        (name, level): region_above(maps.grid, values, level, maps.corner)
        for name, values in shown.items()
        for level in levels
        if values is not None
    }
    most: dict[str, float | None] = {}
    for name, (title, unit, colours) in KINDS.items():
        values = getattr(maps, name)
        most[name] = float(f"{np.nanmax(values):.6g}") if values is not None and np.isfinite(values).any() else None
        if values is not None:
            write_raster(folder / f"{name}.tif", values, maps.cell, maps.corner, maps.crs, title, unit)
            write_text(folder / f"{name}.qml", style(colours, most[name] or 1.0, unit))
    draw_maps(folder / "maps.png", maps)
    write_outlines(folder / "outline.geojson", maps, outlines)
    # The extent is that of the largest polygon: single particles that rolled on form islands.
    largest = max(outlines["deposit", maps.threshold].geoms, key=lambda polygon: polygon.area, default=None)
    said = {
        "time": float(trajectory.time[-1]),
        "cell": maps.cell,
        "threshold": maps.threshold,
        "volume": maps.volume,
        "left": maps.left,
        **{f"area_{name}": polygons.area for (name, level), polygons in outlines.items() if level == maps.threshold},
        "extent": None if largest is None else largest.bounds[2] - maps.corner[0] + trajectory.scene.domain.corner[0],
        **dict(zip(("east", "north"), maps.corner, strict=True)),
        "crs": maps.crs,
        **{f"{name}_max": value for name, value in most.items()},
    }
    write_json(folder / "maps.json", said)
    return said


def command(trajectory: Path, /, *, out: Path, cell: float | None = None, threshold: tuple[float, ...] = ()) -> None:
    """Write maps of a flow: deposit thickness, largest depth and velocity, time of arrival, outlines.

    Args:
        trajectory: A trajectory (NPZ) in 3D, or the folder of a run that holds one.
        out: Folder for the results.
        cell: Edge of a cell of the maps [m]; default: that of the scene's grid.
        threshold: Thickness [m] above which the ground counts as covered; default: the particle spacing, at most half
            the least thickness released. If given several times, each gets outlines, and the maps use the first.
    """
    flow = open_trajectory(trajectory_file(trajectory), "velocities", sound=True)
    require(all(level > 0.0 for level in threshold), "--threshold", "thicknesses above 0 m", list(threshold))
    make_folder(out)
    edge, first = flow.scene.domain.cell if cell is None else cell, threshold[0] if threshold else None
    with naming(trajectory):
        maps = maps_of(flow, edge, threshold=first, progress=True)
    said = write(flow, maps, out, threshold)
    extent = "" if said["extent"] is None else f", extent x = {said['extent']:.4f} m"
    deposit = f"volume {maps.volume:.4g}, largest thickness {said['thickness_max']:.3g} m{extent}"
    print(f"t = {said['time']:g} s: {deposit}, written to {out}")
    if maps.left > 0.0 and maps.volume == 0.0:
        print("no map of the deposit: all of it left the box")
    elif said["extent"] is None:
        thin = f"no cell of {maps.cell:g} m is thicker than the threshold of {maps.threshold:g} m"
        print(f"no outline of the deposit: {thin}")


if __name__ == "__main__":
    sys.exit(run(command, "python -m datasets.maps"))
