"""python -m datasets.maps TRAJECTORY --out DIR: the deposit as rasters, outlines and pictures; in 2D as a profile."""

import dataclasses
import sys
from pathlib import Path
from typing import Any

import numpy as np

from datasets.command_line import run
from datasets.files import make_folder, replacing, write_json
from datasets.maps.files import (
    LOCAL,
    Georeference,
    draw_maps,
    draw_profile,
    georeference,
    outline,
    write_outlines,
    write_raster,
)
from datasets.maps.plan import PlanMaps, maps_of
from datasets.trajectory import Trajectory, read_trajectory

KINDS = {
    "thickness": ("thickness of the deposit", "m", "YlOrBr"),
    "depth": ("largest depth of the flow", "m", "YlGnBu"),
    "velocity": ("largest velocity of the flow", "m/s", "plasma"),
}
"""Attributes of `PlanMaps`, and the names of their files: what they show, its unit, colours of matplotlib."""


def write(trajectory: Trajectory, maps: PlanMaps, folder: Path, location: Georeference = LOCAL) -> dict[str, Any]:
    """Write the maps of a trajectory into `folder`, and maps.json, what they come to, which is returned.

    Raises WorkFailed.
    """
    own = write_profile(maps, folder) if trajectory.scene.dimension == 2 else write_plan(maps, folder, location)
    found = {name: getattr(maps, name) for name in KINDS}
    said = {
        "time": float(trajectory.time[-1]),
        "cell": maps.cell,
        "threshold": maps.threshold,
        "volume": maps.volume,
        "left": maps.left,
        **own,
        **{f"{name}_max": None if values is None else float(f"{values.max():.6g}") for name, values in found.items()},
    }
    write_json(folder / "maps.json", said)
    return said


def write_plan(maps: PlanMaps, folder: Path, location: Georeference) -> dict[str, Any]:
    """In 3D: rasters and pictures, and outlines as GeoJSON. Returns areas, extent and location."""
    shown = {"deposit": maps.thickness, "covered": maps.depth, "release": maps.start}
    outlines = {
        name: outline(values, maps.cell, location, maps.threshold)
        for name, values in shown.items()
        if values is not None
    }
    known = {name: kind for name, kind in KINDS.items() if getattr(maps, name) is not None}
    for name, (title, unit, _) in known.items():
        write_raster(folder / f"{name}.tif", getattr(maps, name), maps.cell, location, name=title, unit=unit)
    draw_maps(folder / "maps.png", maps, location, known)
    write_outlines(folder / "outline.geojson", outlines, maps.threshold, location)
    # Single particles that rolled on are islands of their own.
    largest = max(outlines["deposit"].geoms, key=lambda polygon: polygon.area, default=None)
    return {
        **{f"area_{name}": polygons.area for name, polygons in outlines.items()},
        "extent": None if largest is None else largest.bounds[2] - location.east,
        **dataclasses.asdict(location),
    }


def write_profile(maps: PlanMaps, folder: Path) -> dict[str, Any]:
    """In 2D: profile.csv, whose x and height are those of a measured profile, and a picture. Returns the extent."""
    (x,) = maps.grid.axes
    columns = {
        "x": x,
        "height": maps.thickness,
        "surface": maps.ground + maps.thickness,
        "ground": maps.ground,
        "largest_depth": maps.depth,
        "largest_velocity": maps.velocity,
    }
    known = {name: column for name, column in columns.items() if column is not None}
    with replacing(folder / "profile.csv") as part:
        rows = np.stack(list(known.values()), axis=1)
        np.savetxt(part, rows, fmt="%.9g", delimiter=",", header=",".join(known), comments="")
    draw_profile(folder / "profile.png", maps)
    covered = maps.thickness > maps.threshold
    return {
        "length": float(maps.areas[covered].sum()),
        "extent": float(np.minimum(x + 0.5 * maps.cell, x[-1])[covered].max()) if covered.any() else None,
    }


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
    maps = maps_of(flow, flow.scene.domain.cell if cell is None else cell, threshold=threshold, progress=True)
    said = write(flow, maps, out, georeference(flow.scene))
    extent = "" if said["extent"] is None else f", extent x = {said['extent']:.4g} m"
    deposit = f"volume {maps.volume:.4g}, largest thickness {said['thickness_max']:.3g} m{extent}"
    print(f"t = {said['time']:g} s: {deposit}, written to {out}")


if __name__ == "__main__":
    sys.exit(run(command, "python -m datasets.maps"))
