"""One large terrain, from its raster to maps: a section of the page of speeds."""

import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from datasets import maps
from datasets.files import make_folder
from datasets.flow.trajectory import open_trajectory
from datasets.scene import Scene
from datasets.scene.library import read_scene
from inverse.answer import peak_memory_mib
from mpm import Recording
from mpm.arrays.layout import node_shape
from validation.bench.measuring import Found, once, recorded
from validation.bench.page import Row
from validation.runs import Run

CELL = 0.375
"""Of the grid [m]."""
EVERY = 5
"""Frames from one that is kept for the maps to the next."""
FLOW = "flow.h5"


def slide() -> Scene:
    """`hillside` on other cells, its layer a little thicker, its soil as soft as its speed allows."""
    scene = read_scene("hillside").with_cell(CELL)
    soil, layer = replace(scene.material, young=6.0e6), replace(scene.masses[0], thickness=6.25)
    return replace(scene, material=soil, masses=(layer,), duration=8.0, step_fraction=0.9)


def flow(folder: Path) -> Found:
    """The run whose frames go to a file."""
    found = recorded(slide, Recording(frames=EVERY), folder / FLOW)
    return found | {"nodes": " x ".join(map(str, node_shape(slide().domain)))}


def mapped(folder: Path) -> Found:
    """The maps of that run."""
    began, trajectory = time.perf_counter(), open_trajectory(folder / FLOW)
    make_folder(folder / "maps")
    maps.write(trajectory, maps.maps_of(trajectory, CELL, progress=True), folder / "maps")
    disk = sum(path.stat().st_size for path in (folder / "maps").iterdir()) / 2**20
    seconds = time.perf_counter() - began
    return {"seconds": seconds, "memory": peak_memory_mib(), "disk": disk, "frames": len(trajectory.time)}


def measured(keep: Path) -> dict[str, Found]:
    """Both stages by name, each in a process of its own; what is in `keep` is not done again."""
    folder = keep / f"terrain-{Run(scene=slide()).digest}"
    make_folder(folder)
    return {name: once(folder / f"{name}.json", work, folder) for name, work in (("flow", flow), ("maps", mapped))}


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
        | {f"{key} [MiB]": f"{took[key]:.0f}" if key in took else "-" for key in ("memory", "disk")}
        for stage, took in stages.items()
    ]


def sentence(found: Mapping[str, Found]) -> str:
    """For the conclusion."""
    flow, maps = found["flow"], found["maps"]
    seconds = flow["before"] + flow["seconds"] + maps["seconds"]
    return f"A terrain of {flow['particles']:,} particles takes {seconds:.0f} s from the raster to the maps."
