"""`python -m validation.bench mountain --data DIR`: kilometre-long slides compared with other codes (ISeeSnow).

`datasets.site` makes each scene from a raster and a release polygon, as a user would.
"""

import csv
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from datasets import site
from datasets.errors import InputError, WorkFailed, require
from datasets.exchange.rasters import Raster, read_raster, write_raster
from datasets.files import make_folder, read_toml, reading
from datasets.flow.trajectory import open_trajectory
from datasets.maps import maps_of
from datasets.scene.grid_field import Floats
from datasets.scene.library import read_scene
from datasets.schema import Record, from_mapping
from inverse.answer import peak_memory_mib
from mpm import Recording, simulate
from validation.bench.measuring import Found, once, recorded
from validation.bench.page import Keep, Out, Row, between, formatted, tables, write_page
from validation.run_store import kept

PARAMETERS = "simulationParameterValues_{}.csv"
MOVES = 1.0  # peak speed [m/s] from which a cell counts as reached
COVERED = 0.1  # thickness [m] from which the speed of a cell counts: a single particle in a cell of 5 m is less
EVERY = 2  # frames between two that are kept for the maps
NEAREST = "com1DFA"  # the code of the cell-by-cell comparison
ALIKE = ("com1DFA", "MPM")  # particle codes, with which speeds are compared if the data have them


@dataclass(frozen=True, kw_only=True)
class Slide(Record):
    """A case of the comparison."""

    codes: tuple[str, ...]  # codes whose peaks are in the data
    axis: int  # direction of the flow: 0 along easting, 1 along northing
    onward: int  # 1 if coordinates increase along the flow, else -1
    sections: tuple[float, ...]  # coordinates of the cross-sections [m]
    cells: tuple[float, ...]  # edges of the grid's cells [m] that are affordable, coarse ones first
    internal_friction: float = 45.0
    """[deg], above the slope, because Voellmy's law assumes a layer without internal shear."""


SLIDING, STEEP = 0.35, 35.0  # friction of the bed of avaSlide, and angle of internal friction there [deg]
RAISED = ((5.0, 0.0), (2.5, 0.0), (5.0, 1234.56))
"""Cells [m] on which avaSlide runs, and the height by which its ground is raised [m]."""
LINES = {"cell [m]": "g", "ground raised by [m]": "g", "particles": ",", "slope of the energy line": ".4f"}
LINES |= {"of a point": ".4f", "off by": "+.1%"}
COSTS = {"case": "", "cell [m]": "g", "particles": ",", "steps": ",", "before the first step [s]": ".1f"}
COSTS |= {"compilation [s]": ".1f", "run [s]": ".0f", "million particle-steps/s": ".1f", "maps [s]": ".0f"}
COSTS |= {"memory [MiB]": ".0f"}  # forms of the columns
CASES = {name: from_mapping(Slide, table) for name, table in read_toml(Path(__file__).with_suffix(".toml")).items()}


def written_scene(data: Path, cell: float, folder: Path) -> Path:
    """The scene file of a case's folder on cells of this edge [m], made in `folder`."""
    with reading(data / PARAMETERS.format(data.name), "the parameters of ISeeSnow"):
        (values,) = csv.DictReader((data / PARAMETERS.format(data.name)).read_text(encoding="utf-8").splitlines())
    site.command(
        only(data, "DEM_*.*"),
        release=only(data, "*.shp"),
        out=folder / f"{cell:g}.toml",
        thickness=float(values["releaseThickness"]),
        friction=float(values["mu"]),
        turbulence=float(values["xi"]) if values["xi"] else None,
        internal_friction=CASES[data.name].internal_friction,
        cell=cell,
    )
    return folder / f"{cell:g}.toml"


def only(folder: Path, pattern: str) -> Path:
    """The file of a folder whose name is like `pattern`. Raises InputError unless there is one."""
    paths = sorted(folder.glob(pattern))
    if len(paths) != 1:
        raise InputError(f"expected one file {pattern}, there are {len(paths)}", where=str(folder))
    return paths[0]


def slid(data: Path, cell: float, folder: Path) -> Found:
    """The peaks of a run, and its cost."""
    case, path, scene = CASES[data.name], folder / f"{cell:g}.h5", written_scene(data, cell, folder)
    took = recorded(lambda: read_scene(scene), Recording(frames=EVERY, until_rest=True), path)
    began, beside = time.perf_counter(), read_raster(data / f"peak-speed-{NEAREST}.tif")
    maps = maps_of(open_trajectory(path), beside.spacing[0], threshold=COVERED, progress=True)
    assert maps.velocity is not None, "frames beside one another tell it"
    x, z = (first + axis for first, axis in zip(maps.corner, maps.grid.axes, strict=True))
    result = peaks(case, (x, z), maps.velocity, float(maps.normal_depth.max())) | alike(maps.velocity, (x, z), beside)
    return result | took | {"maps": time.perf_counter() - began, "memory": peak_memory_mib()}


def energy_line(data: Path, cell: float, raised: float, folder: Path) -> Found:
    """The energy line of the centre of mass on avaSlide, whose ground is `raised` [m], and that of a sliding point."""
    dem, release = only(data, "*.asc"), only(data, "*.shp")
    ground, path = read_raster(dem), folder / f"slide-{cell:g}-{raised:g}.toml"
    corner = [float(axis[0]) - 0.5 * ground.spacing[0] for axis in (ground.x, ground.z)]
    raster = path.with_suffix(".tif")
    write_raster(raster, ground.values + raised, ground.spacing[0], corner, None, "elevation", "m")
    site.command(raster, release=release, out=path, friction=SLIDING, internal_friction=STEEP, cell=cell)
    flow = simulate(read_scene(path), record=Recording(until_rest=True), progress=True)
    start, end = (flow.positions[frame].mean(axis=0, dtype=np.float64) for frame in (0, -1))
    east, _, north = start + flow.scene.domain.corner
    middle = int(np.abs(ground.z - north).argmin())
    point = sliding_point(ground.x, ground.values[:, middle] + raised, float(east), SLIDING)
    slope = (start[1] - end[1]) / float(np.hypot(*(end - start)[[0, 2]]))
    return {"slope": float(slope), "point": point, "particles": flow.summary["particles"]}


def sliding_point(x: Floats, height: Floats, start: float, friction: float) -> float:
    """Slope of the energy line of a point that slides along a profile from rest at `start` [m], to where it rests [-].

        d(v^2 / 2 g) = -dy - mu (dx + v^2 / g dtheta)

    with the angle theta of the profile: the force that turns the point upwards presses it on the bed like its weight.
    """
    x, height = np.append(start, x[x > start]), np.append(np.interp(start, x, height), height[x > start])
    steps, falls = np.diff(x), -np.diff(height)
    turns = np.diff(-np.arctan2(falls, steps), prepend=-np.arctan2(falls[0], steps[0]))
    energy = 0.0
    for number, (step, fall, turn) in enumerate(zip(steps, falls, turns, strict=True)):
        energy *= np.exp(-2.0 * friction * max(0.0, turn))
        gain = fall - friction * step
        if energy + gain < 0.0:
            part = energy / -gain
            return float((height[0] - height[number] + part * fall) / (x[number] + part * step - start))
        energy += gain
    raise WorkFailed("the point slides off the profile")


def alike(ours: Floats, places: Sequence[Floats], beside: Raster) -> Found:
    """Cell-by-cell comparison of a run's speeds with another code's: plan overlap and median ratio."""
    both = zip((beside.x, beside.z), places, strict=True)
    nearest = [np.abs(axis[:, None] - place[None]).argmin(axis=0) for axis, place in both]
    theirs = beside.values[np.ix_(*nearest)]
    here, there = ours > MOVES, theirs > MOVES
    # Cells that the other code reached outside our box count as missed.
    missed = int((beside.values > MOVES).sum()) - int(there.sum())
    common = here & there
    overlap = common.sum() / ((here | there).sum() + max(0, missed))
    return {"overlap": float(overlap), "faster": float(np.median(ours[common] / theirs[common]))}


def peaks(case: Slide, places: Sequence[Floats], speed: Floats, thickness: float) -> Found:
    """The compared quantities; speed: [m/s], shape [X, Z], on square cells with centres at `places` [m]."""
    along, reached = places[case.axis], speed > MOVES
    moved = np.asarray(reached.any(axis=1 - case.axis))
    cell = float(along[1] - along[0])
    sections = [speed.take(int(np.abs(along - at).argmin()), axis=case.axis) for at in case.sections]
    return {
        "furthest": float(case.onward * (case.onward * along[moved]).max()),
        "speeds": [float(section.max()) for section in sections],
        "area": float(reached.sum()) * cell**2 / 1.0e4,
        "thickness": thickness,
    }


def bench(
    *,
    out: Out,
    data: Path,
    keep: Keep = None,
    case: tuple[str, ...] = tuple(CASES),
    cells: tuple[float, ...] = (),
    slide: Path | None = None,
) -> str:
    """Measure kilometre-long slides on rasters of some 300,000 posts: reach, speed and cost.

    Args:
        data: Folder of the comparison, with a folder for each case, or of one case: terrain, release, parameters and
            peaks of other codes.
        case: Cases to measure.
        cells: Edges of the grid's cells [m], coarse ones first; default: those of each case.
        slide: Folder of avaSlide (AvaFrame) with its raster and its release; default: avaSlide is left out.
    """
    require(all(0.5 <= cell <= 10.0 for cell in cells), "--cells", "edges from 0.5 to 10 m", list(cells))
    require(set(case) <= set(CASES), "--case", f"some of {', '.join(CASES)}", list(case))
    single = (data / PARAMETERS.format(data.name)).exists()
    folders = {data.name: data} if single else {name: data / name for name in case}
    beside, conclusion, costs, lines = list[str](), list[str](), list[Found](), list[Found]()
    with kept(keep) as folder:
        for name, place in folders.items():
            others, by_cell = dict[str, Found](), dict[float, Found]()
            for code in CASES[name].codes:
                speed, thick = (read_raster(place / f"peak-{kind}-{code}.tif") for kind in ("speed", "thickness"))
                thickest = float(np.nanmax(thick.values))
                others[code] = peaks(CASES[name], (speed.x, speed.z), np.nan_to_num(speed.values), thickest)
            make_folder(folder / name)
            for cell in cells or CASES[name].cells:
                by_cell[cell] = once(folder / name / f"{cell:g}.json", slid, place, cell, folder / name)
            codes = {f"**Talus, {cell:g} m**": result for cell, result in by_cell.items()} | others
            rows = [row(CASES[name], code, result) for code, result in codes.items()]
            beside.append(f"### {name}\n\n{tables([rows])}")
            for cell, took in by_cell.items():
                particles, steps, seconds = took["particles"], took["steps"], took["seconds"]
                rate = particles * steps / seconds / 1e6
                parts = took["before"], took["compile"], seconds, rate, took["maps"], took["memory"]
                costs.append(dict(zip(COSTS, (name, cell, particles, steps, *parts), strict=True)))
            conclusion.append(compared(name, by_cell[min(by_cell)], others))
        if slide is not None:
            make_folder(place := folder / "avaSlide")
            for cell, raised in RAISED:
                result = once(place / f"{cell:g}-{raised:g}.json", energy_line, slide, cell, raised, place)
                slopes = result["slope"], result["point"], result["slope"] / result["point"] - 1.0
                lines.append(dict(zip(LINES, (cell, raised, result["particles"], *slopes), strict=True)))
            off = max(abs(line["off by"]) for line in lines)
            conclusion.append(f"avaSlide: the slope of the energy line is within {off:.1%} of that of a sliding point.")
    seconds, memory = (max(row[key] for row in costs) for key in ("run [s]", "memory [MiB]"))
    conclusion.append(f"The longest run takes {seconds:.0f} s; no run needs more than {memory:.0f} MiB.")
    flags = " --data DIR" + "".join(f" --cells {cell:g}" for cell in cells) + " --slide DIR" * (slide is not None)
    tabled = {"costs": formatted(costs, COSTS), "lines": formatted(lines, LINES) or "Not run."}
    return write_page(out, "mountain", conclusion, flags=flags, codes="\n\n".join(beside), **tabled)


def compared(name: str, finest: Found, others: Mapping[str, Found]) -> str:
    """A sentence of the conclusion."""
    near = np.array([others[code]["speeds"] for code in ALIKE if code in others]).mean(axis=0)
    apart = np.abs(np.array(finest["speeds"]) / near - 1.0)
    return (
        f"{name}: the flow reaches {finest['furthest']:.0f} m, that of the {len(others)} other codes"
        f" {between([peak['furthest'] for peak in others.values()], '.0f')} m; its peak speeds over cross-sections are"
        f" within {apart.max():.0%} of {' and '.join(code for code in ALIKE if code in others)},"
        f" {apart.mean():.0%} on average, and {finest['overlap']:.0%} of the area that either covers is common with"
        f" {NEAREST}."
    )


def row(case: Slide, name: str, result: Found) -> Row:
    """The row of a code's peaks, with the cell-by-cell comparison if there is one."""
    speeds = zip(case.sections, result["speeds"], strict=True)
    return {
        "code": name,
        "reach [m]": f"{result['furthest']:.0f}",
        **{f"{at:.0f} m": f"{speed:.1f}" for at, speed in speeds},
        "thickness [m]": f"{result['thickness']:.1f}",
        "area [ha]": f"{result['area']:.1f}",
        f"overlap with {NEAREST}": f"{result['overlap']:.2f}" if "overlap" in result else "",
        f"speed over {NEAREST}'s": f"{result['faster']:.2f}" if "faster" in result else "",
    }
