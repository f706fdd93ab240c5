"""python -m datasets.maps TRAJECTORY --out DIR: the deposit as rasters, outlines and pictures; in 2D as a profile."""

import csv
import io
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from datasets.command_line import listed, run
from datasets.exchange.rasters import (
    LOCAL,
    Georeference,
    Ring,
    area,
    georeference,
    outline,
    write_outlines,
    write_raster,
)
from datasets.files import make_folder, write_json, write_text
from datasets.maps.pictures import draw_map, draw_profile
from datasets.maps.plan import PlanMaps, map_edges, maps_of, station_edges
from datasets.trajectory import Trajectory, read_trajectory

Floats = NDArray[np.float64]

FORMATS = {2: ("csv", "png"), 3: ("tif", "asc", "png", "geojson")}
"""What a trajectory in 2D and in 3D can be written as."""
PROFILE, SUMMARY, OUTLINES = "profile.csv", "maps.json", "outline.geojson"
COLUMNS = ("x", "height", "surface", "ground", "largest_depth", "largest_velocity")


@dataclass(frozen=True, kw_only=True)
class Kind:
    """One of the maps."""

    name: str
    """Of its files."""
    title: str
    """What it shows."""
    unit: str
    colours: str
    """Colour map of matplotlib."""
    values: Callable[[PlanMaps], Floats | None]
    """Its values."""


KINDS = (
    Kind(
        name="thickness",
        title="thickness of the deposit",
        unit="m",
        colours="YlOrBr",
        values=lambda maps: maps.thickness,
    ),
    Kind(name="depth", title="largest depth of the flow", unit="m", colours="YlGnBu", values=lambda maps: maps.depth),
    Kind(
        name="velocity",
        title="largest velocity of the flow",
        unit="m/s",
        colours="plasma",
        values=lambda maps: maps.velocity,
    ),
)


def write_maps(
    trajectory: Trajectory, maps: PlanMaps, folder: Path, formats: tuple[str, ...], location: Georeference
) -> None:
    """Write the maps of a trajectory in 3D into `folder`, in `formats` of `FORMATS`, and maps.json.

    Raises WorkFailed.
    """
    cell, said = float(maps.edges[0][1]), summary(trajectory, maps, location)
    for kind in KINDS:
        values = kind.values(maps)
        if values is None:
            continue
        if "tif" in formats:
            path = folder / f"{kind.name}.tif"
            write_raster(path, values, cell, location, kind="tif", name=kind.title, unit=kind.unit)
        if "asc" in formats:
            path = folder / f"{kind.name}.asc"
            write_raster(path, values, cell, location, kind="asc", name=kind.title, unit=kind.unit)
        if "png" in formats:
            draw_map(
                folder / f"{kind.name}.png",
                maps,
                values,
                trajectory.scene,
                location,
                label=f"{kind.title} [{kind.unit}]",
                colours=kind.colours,
                title=heading(kind, maps, said),
            )
    if "geojson" in formats:
        write_outlines(folder / OUTLINES, dict(outlines(maps, location)), maps.threshold, location)
    write_json(folder / SUMMARY, said)


def write_profile(trajectory: Trajectory, maps: PlanMaps, folder: Path, formats: tuple[str, ...]) -> None:
    """Write the profile of a trajectory in 2D into `folder`, in `formats` of `FORMATS`, and maps.json.

    Columns x and height of profile.csv are those of a `[target] csv` of `equivalent` heights.
    """
    said = summary(trajectory, maps, LOCAL)
    if "csv" in formats:
        text = io.StringIO(newline="")
        writer = csv.writer(text, lineterminator="\n")
        velocity = maps.velocity
        columns = [*maps.coordinates, maps.thickness, maps.ground + maps.thickness, maps.ground, maps.depth]
        writer.writerow(COLUMNS if velocity is not None else COLUMNS[:-1])
        for row in zip(
            *(column.tolist() for column in [*columns, *([] if velocity is None else [velocity])]), strict=True
        ):
            writer.writerow([f"{value:.9g}" for value in row])
        write_text(folder / PROFILE, text.getvalue())
    if "png" in formats:
        titles = [heading(KINDS[0], maps, said), heading(KINDS[2], maps, said)]
        draw_profile(folder / "profile.png", maps, titles)
    write_json(folder / SUMMARY, said)


def outlines(maps: PlanMaps, location: Georeference) -> Iterator[tuple[str, list[list[Ring]]]]:
    """Name and polygons of the deposit, of all that the flow covered, and of the release where it is known."""
    cell = float(maps.edges[0][1])
    for name, values in (("deposit", maps.thickness), ("covered", maps.depth), ("release", maps.start)):
        if values is not None:
            yield name, outline(values, cell, location, maps.threshold)


def summary(trajectory: Trajectory, maps: PlanMaps, location: Georeference) -> dict[str, Any]:
    """What the maps come to: location, resolution, volume, area, extent and largest values, as plain numbers."""
    flat = trajectory.scene.dimension == 2
    covered = np.flatnonzero((maps.thickness > maps.threshold).reshape(len(maps.coordinates[0]), -1).any(axis=1))
    said: dict[str, Any] = {
        "time": float(trajectory.time[-1]),
        "cell": float(maps.edges[0][-2] - maps.edges[0][-3]) if flat else float(maps.edges[0][1]),
        "threshold": maps.threshold,
        "volume": maps.volume,
        "left": maps.left,
    }
    if flat:
        said["length"] = float(maps.areas[maps.thickness > maps.threshold].sum())
        said["extent"] = float(maps.edges[0][covered[-1] + 1]) if len(covered) else None
    else:
        found = dict(outlines(maps, location))
        said |= {f"area_{name}": area(polygons) for name, polygons in found.items()}
        # Single particles that rolled on are islands of their own.
        largest = max(found["deposit"], key=lambda polygon: area([polygon]), default=None)
        said["extent"] = None if largest is None else max(x for x, _ in largest[0]) - location.east
        said |= {"east": location.east, "north": location.north, "crs": location.crs}
    for kind in KINDS:
        values = kind.values(maps)
        said[f"{kind.name}_max"] = None if values is None else float(f"{values.max():.6g}")
    return said


def heading(kind: Kind, maps: PlanMaps, said: dict[str, Any]) -> str:
    """What stands above a picture."""
    power = "m³" if "area_deposit" in said else "m²"
    parts = [f"{kind.title}, t = {said['time']:g} s" if kind.name == "thickness" else kind.title]
    if kind.name == "thickness":
        parts.append(f"volume {maps.volume:.4g} {power}")
    if "area_deposit" in said:
        parts.append(f"area {said['area_deposit' if kind.name == 'thickness' else 'area_covered']:.4g} m²")
    parts.append(f"largest {said[f'{kind.name}_max']:.3g} {kind.unit}")
    if kind.name == "thickness" and said["extent"] is not None:
        parts.append(f"extent x = {said['extent']:.4g} m")
    return "; ".join(parts)


def command(
    trajectory: Path,
    /,
    *,
    out: Path,
    cell: float | None = None,
    threshold: float | None = None,
    formats: str | None = None,
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
    formats
        Any of tif, asc, png and geojson, in 2D of csv and png, separated by commas; all unless given.
    """
    flow = read_trajectory(trajectory)
    known = FORMATS[flow.scene.dimension]
    chosen = known if formats is None else listed(formats, known, "--formats")
    length = flow.scene.domain.cell if cell is None else cell
    edges = station_edges(flow.scene, length) if flow.scene.dimension == 2 else map_edges(flow.scene, length)
    make_folder(out)
    location = georeference(flow.scene)
    maps = maps_of(flow, edges, threshold=threshold, progress=True)
    if flow.scene.dimension == 2:
        write_profile(flow, maps, out, chosen)
    else:
        write_maps(flow, maps, out, chosen, location)
    print(f"{heading(KINDS[0], maps, summary(flow, maps, location))}, written to {out}")


if __name__ == "__main__":
    sys.exit(run(command, "python -m datasets.maps"))
