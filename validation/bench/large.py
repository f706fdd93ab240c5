"""One large terrain, from its raster to maps and to the friction of its bed: a section of the page of speeds."""

import json
import math
import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from datasets import maps
from datasets.arrays import FrameWriter, read_arrays
from datasets.files import make_folder, write_json
from datasets.library import read_scene
from datasets.memory import spoken
from datasets.scene import Scene
from datasets.trajectory import open_trajectory
from inverse.parameters import Parameter
from inverse.problem import Problem, read_problem
from inverse.settings import LoopSettings, Surrogate, TargetSettings
from mpm import Recording, simulate
from mpm.arrays.features import NODE, features_of
from mpm.arrays.layout import INDEX_LIMIT, node_shape
from mpm.runtime import workers_for
from validation.loop.solve import RUNS, solve
from validation.report.measuring import isolated, resident
from validation.report.page import Page, Row
from validation.runs import SHARE, Run

CELL, QUICK = 0.375, 1.5
"""Of the grid [m]; the search is on cells twice as large."""
EVERY = 5
"""Frames from one that is kept for the maps to the next."""
MPM_RUNS = 6
"""Of the back-analysis at most, besides the target's."""
BED, TRUTH = "solids[0].friction", 0.4
MANY = 1.0e8
"""Particles that the price is extrapolated to."""

Found = Mapping[str, Any]
"""What a stage came to and took: particles, steps, seconds, memory and disk [bytes]."""


def slide(cell: float) -> Scene:
    """`hillside` on cells of another size [m], its layer a little thicker, its soil as soft as its speed allows."""
    scene = read_scene("hillside").with_cell(cell)
    soil, layer = replace(scene.material, young=6.0e6), replace(scene.masses[0], thickness=6.25)
    return replace(scene, material=soil, masses=(layer,), duration=8.0, step_fraction=0.9)


def friction(cell: float) -> Problem:
    """The problem `hillside` on that slope with the friction of its bed in place of the soil's and of the thickness."""
    return replace(
        read_problem("hillside"),
        scene=slide(cell),
        parameters=(Parameter(name=BED, initial=0.45, lower=0.3, upper=0.6),),
        target=TargetSettings(twin=True, truth={BED: TRUTH}),
        surrogate=Surrogate.COARSE,
        loop=LoopSettings(mpm_runs=MPM_RUNS),
    )


def flow(cell: float, folder: Path) -> Found:
    """The run whose frames go to a file."""
    began, scene, path = time.perf_counter(), slide(cell), folder / f"{cell:g}.h5"
    with FrameWriter(path) as file:
        found = simulate(scene, record=Recording(frames=EVERY), file=file, progress=True)
        file.put(**found.arrays())
    summary, nodes, workers = found.summary, node_shape(scene.domain), workers_for(found.summary["particles"])
    features = features_of([scene], "f32", shared=workers > 1)
    grid = NODE * workers * math.prod(nodes) / summary["particles"]
    return {
        **{key: summary[key] for key in ("particles", "steps", "front", "remarks")},
        "seconds": summary["wall_s"],
        "before": time.perf_counter() - began - summary["wall_s"] - summary["compile_s"],
        "memory": resident(peak=True),
        "disk": path.stat().st_size,
        "cell": cell,
        "nodes": " x ".join(map(str, nodes)),
        "most": min(INDEX_LIMIT / features.state.size, 2**31 / grid),
    }


def mapped(cell: float, folder: Path) -> Found:
    began, trajectory = time.perf_counter(), open_trajectory(folder / f"{cell:g}.h5")
    make_folder(folder / "maps")
    said = maps.write(trajectory, maps.maps_of(trajectory, cell, progress=True), folder / "maps")
    disk = sum(path.stat().st_size for path in (folder / "maps").iterdir())
    price = {"seconds": time.perf_counter() - began, "memory": resident(peak=True), "disk": disk}
    return {**said, **price, "frames": len(trajectory.time)}


def inverted(cell: float, folder: Path) -> Found:
    """The back-analysis; seconds are those of the runs in its folder, whichever command made them."""
    result = solve(friction(cell), folder / "friction")
    runs = list((folder / "friction" / RUNS).glob("*.npz"))
    seconds: dict[bool, list[float]] = {True: [], False: []}
    for path in runs:
        summary = json.loads(str(read_arrays(path, "summary")["summary"]))
        seconds[path.name.startswith("coarse-")].append(summary[SHARE])
    return {
        "runs": [len(each) for each in seconds.values()],
        "seconds": [sum(each) for each in seconds.values()],
        "memory": resident(peak=True),
        "disk": sum(path.stat().st_size for path in runs),
        "found": result.unknowns[BED],
        "half_width": result.certainty[BED],
        "coarse_found": (result.surrogate or {})["unknowns"][BED],
        "verdict": result.verdict.value,
    }


def measured(keep: Path, *, quick: bool) -> dict[str, Found]:
    """Every stage by name, each in a process of its own; what is in `keep` is not done again."""
    cell, found = QUICK if quick else CELL, {}
    folder = keep / f"large-{Run(scene=slide(cell)).digest}"
    make_folder(folder)
    stages = {"coarse": (flow, 2.0 * cell), "flow": (flow, cell), "maps": (mapped, cell), "friction": (inverted, cell)}
    for name, (work, on_cells) in stages.items():
        path = folder / f"{name}.json"
        if not path.exists():
            write_json(path, dict(isolated(work, on_cells, folder)))
        found[name] = json.loads(path.read_text())
    return found


def row(stage: str, seconds: float, found: Found) -> Row:
    """A line of the table; memory and disk where `found` has them."""
    sizes = {key: f"{found[key] / 2**20:.0f}" if key in found else "-" for key in ("memory", "disk")}
    return {"stage": stage, "seconds": f"{seconds:.1f}", **{f"{key} [MiB]": size for key, size in sizes.items()}}


def add_section(page: Page, found: Mapping[str, Found]) -> None:
    """The stages in a table, what they found, and what many more particles would take."""
    coarse, flow, maps, bed = (found[name] for name in ("coarse", "flow", "maps", "friction"))
    cell, young = flow["cell"], slide(flow["cell"]).material.young
    page.section("One large terrain, end to end")
    page.text(f"""
        `hillside` on cells of {cell:g} m: {flow["particles"]:,} particles on {flow["nodes"]} nodes; a
        Young's modulus of {young / 1.0e6:g} MPa makes its steps long. All threads; each stage in a process of its own,
        whose greatest resident size is the memory; without compilation. The friction of the bed is looked for by the
        front and four heights of a twin, on cells of {2.0 * cell:g} m first (`surrogate = "coarse"`).
    """)
    (coarse_runs, runs), (coarse_seconds, seconds) = bed["runs"], bed["seconds"]
    rows = [
        row("raster to particles and contact", flow["before"], {}),
        row(f"run of {flow['steps']:,} steps, every {EVERY}th frame to HDF5", flow["seconds"], flow),
        row(f"maps of {maps['frames']} frames", maps["seconds"], maps),
        row(f"friction: {coarse_runs} runs on cells of {2.0 * cell:g} m", coarse_seconds, {}),
        row(f"friction: {runs} runs on cells of {cell:g} m, the twin's too", seconds, bed),
    ]
    page.table(rows)
    page.text(f"""
        Friction {bed["found"]:.3f} ± {bed["half_width"]:.3f}, {bed["verdict"]}; the truth is {TRUTH:g}, by the larger
        cells alone {bed["coarse_found"]:.3f}. The deposit of the first run is up to {maps["thickness_max"]:.1f} m
        thick, its front at x = {flow["front"]:.1f} m. {" ".join(f"It is {each}." for each in flow["remarks"])}
    """)
    more, rate = MANY / flow["particles"], flow["particles"] * flow["steps"] / flow["seconds"]
    each = (flow["memory"] - coarse["memory"]) / (flow["particles"] - coarse["particles"])
    memory, disk = (spoken(size) for size in (flow["memory"] + each * (MANY - flow["particles"]), more * flow["disk"]))
    steps = flow["steps"] * more ** (1.0 / 3.0)
    hours = MANY * steps / rate / 3600.0
    page.text(f"""
        {MANY:,.0f} particles, on as much finer cells, take {memory} of memory, {each:.0f} bytes for each more
        particle with its cells; {steps:,.0f} steps in {hours:.0f} hours at {rate / 1.0e6:.1f} million particle-steps
        a second; {disk} of frames. By the range of its indices such a scene has at most
        {flow["most"] / 1.0e6:.0f} million particles on the processor: a larger one is refused in a line.
    """)


def sentence(found: Mapping[str, Found]) -> str:
    """For the conclusion."""
    flow, friction = found["flow"], found["friction"]
    forward = flow["before"] + flow["seconds"] + found["maps"]["seconds"]
    return (
        f"A terrain of {flow['particles']:,} particles takes {forward:.0f} s from raster to maps, and"
        f" {sum(friction['seconds']):.0f} s for the friction of its bed by {friction['runs'][1]} such runs."
    )
