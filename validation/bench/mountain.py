"""`python -m validation.bench mountain --data DIR`: a slide of three kilometres beside other codes (ISeeSnow)."""

import csv
import math
import time
from collections.abc import Mapping
from functools import partial
from pathlib import Path

import numpy as np

from datasets.errors import require
from datasets.exchange.rasters import Raster, read_raster
from datasets.files import make_folder, reading
from datasets.flow.trajectory import open_trajectory
from datasets.maps import maps_of
from datasets.scene import Scene
from datasets.scene.grid_field import Floats
from datasets.scene.library import scene_from
from inverse.answer import peak_memory_mib
from mpm import Recording
from validation.bench.measuring import Found, once, recorded
from validation.bench.page import Keep, Out, Row, between, write_page
from validation.runs import Run, kept

CASE = "CoulombOnly"
CODES = ("com1DFA", "samosat", "MPM", "RAMMSUSER", "TITAN2D", "TRENT2D")
"""Whose peaks are in the data."""
ALIKE = ("com1DFA", "MPM")
"""Codes of particles, which the speeds are compared with."""
SECTIONS = (1500.0, 2000.0, 2500.0, 3000.0, 3250.0, 3500.0, 3750.0, 4000.0)
"""Cross-sections [m], by their easting."""
BOX_END = 4600.0
"""Easting at which the box ends [m]."""
MOVES = 1.0
"""Peak speed [m/s] from which a cell counts as reached."""
COVERED = 0.1
"""Thickness [m] from which the speed of a cell counts: a particle alone in a cell of 5 m is less."""
EVERY = 2
"""Frames from one that is kept for the maps to the next."""


def bed_cosine(ground: Raster) -> Floats:
    """Cosine of the slope, shape [X, Z]: thickness normal to the bed over the vertical one."""
    along, across = np.gradient(ground.values, *ground.spacing)
    return np.asarray(1.0 / np.sqrt(1.0 + along**2 + across**2))


def scene_of(data: Path, cell: float) -> Scene:
    """The slide on cells of this edge [m]."""
    parameters = data / f"simulationParameterValues_{CASE}.csv"
    with reading(parameters, "the parameters of ISeeSnow"):
        (values,) = csv.DictReader(parameters.open(encoding="utf-8"))
    ground, release = read_raster(data / f"DEM_{CASE}.asc"), read_raster(data / "release1HSField5m.tif")
    vertical = np.nan_to_num(release.values) / bed_cosine(ground)
    rows, columns = (np.flatnonzero(vertical.any(axis=axis)) for axis in (1, 0))
    window = vertical[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    west, south, post = float(ground.x[0]), float(ground.z[0]), ground.spacing[0]
    first = [float(ground.x[rows[0]]), float(ground.z[columns[0]])]
    # The surface of the flow at its highest place, and room for what is thrown up.
    top = float(ground.values.max()) + 20.0
    lengths = [BOX_END - west, top, float(ground.z[-1]) - south]
    table = {
        "duration": 120.0,
        "frame_dt": 0.25,
        "open_sides": ["x-", "x+", "z-", "z+"],
        "domain": {
            "size": [cell * math.floor(length / cell + 1.0e-6) for length in lengths],
            "cell": cell,
            "origin": [west, 0.0, south],
        },
        "material": {"friction_deg": 30.0, "density": 200.0},
        "masses": [{"kind": "layer", "thickness": window.tolist(), "origin": first, "spacing": [post] * 2}],
        "solids": [{"kind": "terrain", "file": f"DEM_{CASE}.asc", "friction": float(values["mu"])}],
    }
    return scene_from(table, data)


def slid(data: Path, cell: float, folder: Path) -> Found:
    """The peaks of a run, and what it takes."""
    path = folder / f"{cell:g}.h5"
    took = recorded(partial(scene_of, data, cell), Recording(frames=EVERY, until_rest=True), path)
    began = time.perf_counter()
    ground = read_raster(data / f"DEM_{CASE}.asc")
    maps = maps_of(open_trajectory(path), ground.spacing[0], threshold=COVERED, progress=True)
    assert maps.velocity is not None, "frames beside one another tell it"
    found = peaks(maps.corner[0] + maps.grid.axes[0], maps.velocity, float(maps.normal_depth.max()))
    return found | took | {"maps": time.perf_counter() - began, "memory": peak_memory_mib()}


def peaks(eastings: Floats, speed: Floats, thickness: float) -> Found:
    """What codes are compared by; speed: [m/s], shape [X, Z], on square cells whose middles have `eastings` [m]."""
    reached, cell = speed > MOVES, float(eastings[1] - eastings[0])
    return {
        "furthest": float(eastings[np.flatnonzero(reached.any(axis=1))[-1]]),
        "speeds": [float(speed[int((x - eastings[0]) / cell + 0.5)].max()) for x in SECTIONS],
        "area": float(reached.sum()) * cell**2 / 1.0e4,
        "thickness": thickness,
    }


def bench(*, out: Out, data: Path, keep: Keep = None, cells: tuple[float, ...] = (4.0, 2.0)) -> str:
    """Measure a slide of three kilometres on a raster of 300,000 posts: how far, how fast, at what price.

    Parameters
    ----------
    data
        Folder of the comparison's case CoulombOnly: terrain, release, parameters and peaks of other codes.
    cells
        Edges of the grid's cells [m], coarse ones first.
    """
    require(all(0.5 <= cell <= 10.0 for cell in cells), "--cells", "edges from 0.5 to 10 m", list(cells))
    others, found = dict[str, Found](), dict[float, Found]()
    for code in CODES:
        speed, thickness = (read_raster(data / f"peak-{kind}-{code}.tif") for kind in ("speed", "thickness"))
        others[code] = peaks(speed.x, np.nan_to_num(speed.values), float(np.nanmax(thickness.values)))
    with kept(keep) as folder:
        for cell in cells:
            place = folder / f"mountain-{Run(scene=scene_of(data, cell)).digest}"
            make_folder(place)
            found[cell] = once(place / "peaks.json", slid, data, cell, place)
    codes = {f"**Talus, {cell:g} m**": each for cell, each in found.items()} | others
    flags = f" --data DIR --cells {' --cells '.join(f'{cell:g}' for cell in found)}"
    rows, costs = [row(name, each) for name, each in codes.items()], [cost(*each) for each in found.items()]
    return write_page(out, "mountain", conclusion(found, others), flags=flags, codes=rows, costs=costs)


def conclusion(found: Mapping[float, Found], others: Mapping[str, Found]) -> list[str]:
    finest = found[min(found)]
    alike = np.array([others[code]["speeds"] for code in ALIKE])
    apart = np.abs(finest["speeds"] / alike.mean(axis=0) - 1.0)
    return [
        f"On cells of {min(found):g} m the flow reaches x = {finest['furthest']:.0f} m; the six other codes reach"
        f" {between([each['furthest'] for each in others.values()], '.0f')} m.",
        f"Its peak speeds over {len(SECTIONS)} cross-sections are within {apart.max():.0%} of the mean of"
        f" {' and '.join(ALIKE)}, {apart.mean():.0%} on average.",
        f"Its greatest thickness is {finest['thickness']:.1f} m, those of the others are"
        f" {between([each['thickness'] for each in others.values()], '.1f')} m.",
        f"The run takes {finest['seconds']:.0f} s and {finest['memory']:.0f} MiB for {finest['particles']:,} particles,"
        f" and {finest['before']:.1f} s before its first step.",
    ]


def cost(cell: float, took: Found) -> Row:
    """What a run takes on cells of this edge [m]."""
    return {
        "cell [m]": f"{cell:g}",
        "particles": f"{took['particles']:,}",
        "steps": f"{took['steps']:,}",
        "before the first step [s]": f"{took['before']:.1f}",
        "compilation [s]": f"{took['compile']:.1f}",
        "run [s]": f"{took['seconds']:.0f}",
        "million particle-steps/s": f"{took['particles'] * took['steps'] / took['seconds'] / 1e6:.1f}",
        "maps [s]": f"{took['maps']:.0f}",
        "memory [MiB]": f"{took['memory']:.0f}",
    }


def row(name: str, each: Found) -> Row:
    speeds = {f"at {x:.0f} m": f"{speed:.1f}" for x, speed in zip(SECTIONS, each["speeds"], strict=True)}
    first = {"code": name, "furthest x [m]": f"{each['furthest']:.0f}"}
    return first | speeds | {"thickness [m]": f"{each['thickness']:.1f}", "area [ha]": f"{each['area']:.1f}"}
