"""python -m datasets.maps TRAJECTORY --out DIR: a deposit in 3D as rasters, outlines and pictures."""

import dataclasses
import sys
from pathlib import Path
from typing import Any

from datasets.command_line import run
from datasets.files import make_folder, write_json
from datasets.maps.files import (
    LOCAL,
    Georeference,
    draw_maps,
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
    found = {name: getattr(maps, name) for name in KINDS}
    said = {
        "time": float(trajectory.time[-1]),
        "cell": maps.cell,
        "threshold": maps.threshold,
        "volume": maps.volume,
        "left": maps.left,
        **{f"area_{name}": polygons.area for name, polygons in outlines.items()},
        "extent": None if largest is None else largest.bounds[2] - location.east,
        **dataclasses.asdict(location),
        **{f"{name}_max": None if values is None else float(f"{values.max():.6g}") for name, values in found.items()},
    }
    write_json(folder / "maps.json", said)
    return said


def command(
    trajectory: Path,
    /,
    *,
    out: Path,
    cell: float | None = None,
    threshold: float | None = None,
) -> None:
    """Write what a flow left, seen from above: thickness, largest depth and velocity, outlines.

    Parameters
    ----------
    trajectory
        A trajectory (NPZ) in 3D, or the folder of a run that holds one.
    out
        Folder for the results.
    cell
        Edge of a cell of the maps [m]; that of the scene's grid unless given.
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
