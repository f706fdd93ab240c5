"""python -m datasets.maps TRAJECTORY --out DIR: the deposit as rasters, outlines and pictures; in 2D as a profile."""

import sys
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from shapely import MultiPolygon

from datasets.command_line import run
from datasets.files import make_folder, replacing, write_json
from datasets.maps.files import (
    LOCAL,
    Georeference,
    draw_map,
    draw_profile,
    georeference,
    outline,
    write_outlines,
    write_raster,
)
from datasets.maps.plan import PlanMaps, maps_of
from datasets.trajectory import Trajectory, read_trajectory

PROFILE, SUMMARY, OUTLINES = "profile.csv", "maps.json", "outline.geojson"


class Kind(NamedTuple):
    """What one of the maps shows, in which unit and colours (of matplotlib)."""

    title: str
    unit: str
    colours: str


KINDS = {
    "thickness": Kind("thickness of the deposit", "m", "YlOrBr"),
    "depth": Kind("largest depth of the flow", "m", "YlGnBu"),
    "velocity": Kind("largest velocity of the flow", "m/s", "plasma"),
}
"""Attributes of `PlanMaps`, and the names of their files."""


def write_maps(trajectory: Trajectory, maps: PlanMaps, folder: Path, location: Georeference) -> None:
    """Write the maps of a trajectory in 3D into `folder`: rasters, pictures, outlines, and maps.json.

    Raises WorkFailed.
    """

    said = summary(trajectory, maps, location)
    for name, kind in KINDS.items():
        values = getattr(maps, name)
        if values is None:
            continue
        write_raster(folder / f"{name}.tif", values, maps.cell, location, name=kind.title, unit=kind.unit)
        label, title = f"{kind.title} [{kind.unit}]", heading(name, said)
        draw_map(folder / f"{name}.png", maps, values, location, label=label, colours=kind.colours, title=title)
    write_outlines(folder / OUTLINES, outlines(maps, location), maps.threshold, location)
    write_json(folder / SUMMARY, said)


def write_profile(trajectory: Trajectory, maps: PlanMaps, folder: Path) -> None:
    """Write the profile of a trajectory in 2D into `folder`: a CSV, a picture, and maps.json.

    Columns x and height of profile.csv are those of a measured profile of `equivalent` heights.
    """

    said = summary(trajectory, maps, LOCAL)
    columns = {
        "x": maps.grid.axes[0],
        "height": maps.thickness,
        "surface": maps.ground + maps.thickness,
        "ground": maps.ground,
        "largest_depth": maps.depth,
        "largest_velocity": maps.velocity,
    }
    known = {name: column for name, column in columns.items() if column is not None}
    rows = np.stack(list(known.values()), axis=1)
    with replacing(folder / PROFILE) as part:
        np.savetxt(part, rows, fmt="%.9g", delimiter=",", header=",".join(known), comments="")
    draw_profile(folder / "profile.png", maps, [heading(name, said) for name in ("thickness", "velocity")])
    write_json(folder / SUMMARY, said)


def outlines(maps: PlanMaps, location: Georeference) -> dict[str, MultiPolygon]:
    """The polygons of the deposit, of all that the flow covered, and of the release where it is known."""

    shown = {"deposit": maps.thickness, "covered": maps.depth, "release": maps.start}
    return {
        name: outline(values, maps.cell, location, maps.threshold)
        for name, values in shown.items()
        if values is not None
    }


def summary(trajectory: Trajectory, maps: PlanMaps, location: Georeference) -> dict[str, Any]:
    """What the maps come to: location, resolution, volume, area, extent and largest values, as plain numbers."""

    flat, covered = trajectory.scene.dimension == 2, maps.thickness > maps.threshold
    said: dict[str, Any] = {
        "time": float(trajectory.time[-1]),
        "cell": maps.cell,
        "threshold": maps.threshold,
        "volume": maps.volume,
        "left": maps.left,
    }
    if flat:
        said["length"] = float(maps.areas[covered].sum())
        ends = np.minimum(maps.grid.axes[0] + 0.5 * maps.cell, trajectory.scene.domain.size[0])
        said["extent"] = float(ends[covered].max()) if covered.any() else None
    else:
        found = outlines(maps, location)
        said |= {f"area_{name}": polygons.area for name, polygons in found.items()}
        # Single particles that rolled on are islands of their own.
        largest = max(found["deposit"].geoms, key=lambda polygon: polygon.area, default=None)
        said["extent"] = None if largest is None else largest.bounds[2] - location.east
        said |= {"east": location.east, "north": location.north, "crs": location.crs}
    for name in KINDS:
        values = getattr(maps, name)
        said[f"{name}_max"] = None if values is None else float(f"{values.max():.6g}")
    return said


def heading(name: str, said: dict[str, Any]) -> str:
    """What stands above a picture."""
    kind, largest = KINDS[name], said[f"{name}_max"]
    parts = [kind.title]
    if name == "thickness":
        unit = "m³" if "area_deposit" in said else "m²"
        parts = [f"{kind.title}, t = {said['time']:g} s", f"volume {said['volume']:.4g} {unit}"]
    if largest is not None:
        parts.append(f"largest {largest:.3g} {kind.unit}")
    if name == "thickness" and said["extent"] is not None:
        parts.append(f"extent x = {said['extent']:.4g} m")
    return "; ".join(parts)


def command(
    trajectory: Path,
    /,
    *,
    out: Path,
    cell: float | None = None,
    threshold: float | None = None,
) -> None:
    """Write what a flow left, seen from above: thickness, largest depth and velocity, outlines; in 2D a profile.

    Parameters
    ----------
    trajectory
        A trajectory (NPZ), or the folder of a run that holds one.
    out
        Folder for the results.
    cell
        Edge of a cell of the maps, in 2D distance of the stations [m]; that of the scene's grid unless given.
    threshold
        Thickness [m] above which the ground counts as covered; the spacing of the particles unless given.
    """

    flow = read_trajectory(trajectory)
    make_folder(out)
    location = georeference(flow.scene)
    maps = maps_of(flow, flow.scene.domain.cell if cell is None else cell, threshold=threshold, progress=True)
    if flow.scene.dimension == 2:
        write_profile(flow, maps, out)
    else:
        write_maps(flow, maps, out, location)
    print(f"{heading('thickness', summary(flow, maps, location))}, written to {out}")


if __name__ == "__main__":
    sys.exit(run(command, "python -m datasets.maps"))
