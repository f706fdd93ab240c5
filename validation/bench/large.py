"""One large terrain, from its raster to maps: a section of the page of speeds."""

import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from datasets import maps
from datasets.files import make_folder
from datasets.flow.array_files import FrameWriter
from datasets.flow.trajectory import open_trajectory
from datasets.scene import Scene
from datasets.scene.library import read_scene
from inverse.answer import peak_memory_mib
from mpm import Recording, simulate
from mpm.arrays.layout import node_shape
from validation.bench.measuring import once
from validation.bench.page import Row
from validation.runs import Run

CELL = 0.375
"""Of the grid [m]."""
EVERY = 5
"""Frames from one that is kept for the maps to the next."""

Found = Mapping[str, Any]
"""What a stage came to and took: particles, steps, seconds, memory and disk [bytes]."""


def slide(cell: float) -> Scene:
    """`hillside` on cells of another size [m], its layer a little thicker, its soil as soft as its speed allows."""
    scene = read_scene("hillside").with_cell(cell)
    soil, layer = replace(scene.material, young=6.0e6), replace(scene.masses[0], thickness=6.25)
    return replace(scene, material=soil, masses=(layer,), duration=8.0, step_fraction=0.9)


def flow(cell: float, folder: Path) -> Found:
    """The run whose frames go to a file."""
    began, scene, path = time.perf_counter(), slide(cell), folder / f"{cell:g}.h5"
    with FrameWriter(path) as file:
        found = simulate(scene, record=Recording(frames=EVERY), file=file, progress=True)
        file.put(**found.arrays())
    summary = found.summary
    return {
        "particles": summary["particles"],
        "steps": summary["steps"],
        "seconds": summary["wall_s"],
        "before": time.perf_counter() - began - summary["wall_s"] - summary["compile_s"],
        "memory": peak_memory_mib() * 2**20,
        "disk": path.stat().st_size,
        "nodes": " x ".join(map(str, node_shape(scene.domain))),
    }


def mapped(cell: float, folder: Path) -> Found:
    """The maps of that run."""
    began, trajectory = time.perf_counter(), open_trajectory(folder / f"{cell:g}.h5")
    make_folder(folder / "maps")
    maps.write(trajectory, maps.maps_of(trajectory, cell, progress=True), folder / "maps")
    disk = sum(path.stat().st_size for path in (folder / "maps").iterdir())
    seconds = time.perf_counter() - began
    return {"seconds": seconds, "memory": peak_memory_mib() * 2**20, "disk": disk, "frames": len(trajectory.time)}


def measured(keep: Path) -> dict[str, Found]:
    """Both stages by name, each in a process of its own; what is in `keep` is not done again."""
    folder = keep / f"large-{Run(scene=slide(CELL)).digest}"
    make_folder(folder)
    stages = {"flow": flow, "maps": mapped}
    return {name: once(folder / f"{name}.json", work, CELL, folder) for name, work in stages.items()}


def rows(found: Mapping[str, Found]) -> list[Row]:
    """What each stage takes."""
    flow, maps = found["flow"], found["maps"]
    stages = {
        "raster to particles and contact": {"seconds": flow["before"]},
        f"run of {flow['steps']:,} steps, every {EVERY}th frame to HDF5": flow,
        f"maps of {maps['frames']} frames": maps,
    }
    return [
        {"stage": stage, "seconds": f"{took['seconds']:.1f}"}
        | {f"{key} [MiB]": f"{took[key] / 2**20:.0f}" if key in took else "-" for key in ("memory", "disk")}
        for stage, took in stages.items()
    ]


def sentence(found: Mapping[str, Found]) -> str:
    """For the conclusion."""
    flow, maps = found["flow"], found["maps"]
    seconds = flow["before"] + flow["seconds"] + maps["seconds"]
    return f"A terrain of {flow['particles']:,} particles takes {seconds:.0f} s from the raster to the maps."
