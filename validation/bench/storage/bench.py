"""`python -m validation.bench storage`: sizes and reading times of trajectories, memory of runs that stream them."""

import dataclasses
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from datasets.definitions import read_definition
from datasets.library import read_scene
from datasets.scene import Scene
from datasets.trajectory import Trajectory
from mpm.simulation import Options, simulate
from validation.report.memory import peak, reset_peak, resident
from validation.report.page import Page
from validation.report.process import isolated

SCENES = ("column-tall-42", "layers-10", "baffles-2")
DATASET = "obstacle3d"
"""A definition whose first scene is stored too."""
STREAMED, QUICK = "baffles-2", "column-tall-42"
SUFFIXES = {"NPZ": ".npz", "HDF5": ".h5"}
MIB = 2**20

Row = dict[str, str | float]


def bench(out: Path, *, quick: bool = False, keep: Path, repeats: int = 5) -> str:
    """repeats: of each reading, in turns; the median counts."""
    scenes = {name: read_scene(name) for name in ((QUICK,) if quick else SCENES)}
    if not quick:
        (first,) = read_definition(DATASET).entries(seed=0, count=1)
        scenes[f"{DATASET}, the first"] = first.scene
    with TemporaryDirectory(dir=keep) as folder:
        rows = [stored(name, scene, Path(folder), 1 if quick else repeats) for name, scene in scenes.items()]
        name = QUICK if quick else STREAMED
        used = [memory_row(name, Path(folder), stream=stream) for stream in (False, True)]
    ratios, speeds = ([float(row[key]) for row in rows] for key in ("HDF5 / NPZ", "HDF5 [MB/s]"))
    errors = [float(row["largest error [cells]"]) for row in rows]
    page = Page(
        "Storage",
        command=f"python -m validation.bench storage --repeats {repeats}",
        conclusion=[
            f"Compressed trajectories take {min(ratios):.2f} to {max(ratios):.2f} of the bytes, positions within "
            f"{max(errors):.1e} cells, and are read at {min(speeds):.0f} to {max(speeds):.0f} MB a second.",
            f"`{name}` takes {used[0]['above the start [MiB]']:.0f} MiB with its frames in memory and "
            f"{used[1]['above the start [MiB]']:.0f} MiB with `--stream`; the largest difference of any position is "
            f"{used[1]['difference [m]']:g} m.",
        ],
        quick=quick,
    )
    page.section("Trajectories")
    page.text("""
        `python -m mpm.run SCENE --out DIR` writes NPZ, with `--compress` HDF5, and so does `mpm.generate`; see
        `datasets.compressed`. Whole trajectories are read by `Trajectory.load`, files in the system's cache, in turns.
    """)
    page.table(
        rows,
        formats={
            "NPZ [MB]": ".1f",
            "HDF5 [MB]": ".1f",
            "HDF5 / NPZ": ".3f",
            "largest error [cells]": ".1e",
            "written in [s]": ".2f",
            "NPZ [MB/s]": ".0f",
            "HDF5 [MB/s]": ".0f",
        },
    )
    page.section("Memory of a run")
    page.text("""
        The greatest resident size while a scene runs above that before, each in a process of its own; kernels are
        compiled before.
    """)
    page.table(used, formats={"above the start [MiB]": ".0f", "frames [MiB]": ".0f", "difference [m]": "g"})
    return page.write(out / "storage.md")


def stored(name: str, scene: Scene, folder: Path, repeats: int) -> Row:
    """A trajectory in both formats."""
    flow = simulate(scene)
    paths = {kind: folder / f"flow{suffix}" for kind, suffix in SUFFIXES.items()}
    written = {kind: seconds_of(partial(flow.save, path)) for kind, path in paths.items()}
    reads: dict[str, list[float]] = {kind: [] for kind in paths}
    for _ in range(repeats):
        for kind, path in paths.items():
            reads[kind].append(seconds_of(partial(Trajectory.load, path)))
    sizes = {kind: path.stat().st_size / 1.0e6 for kind, path in paths.items()}
    error = np.abs(Trajectory.load(paths["HDF5"]).positions - flow.positions).max() / scene.domain.cell
    megabytes = flow.positions.nbytes / 1.0e6
    return {
        "scene": name,
        "NPZ [MB]": sizes["NPZ"],
        "HDF5 [MB]": sizes["HDF5"],
        "HDF5 / NPZ": sizes["HDF5"] / sizes["NPZ"],
        "largest error [cells]": float(error),
        "written in [s]": written["HDF5"],
        "NPZ [MB/s]": megabytes / float(np.median(reads["NPZ"])),
        "HDF5 [MB/s]": megabytes / float(np.median(reads["HDF5"])),
    }


def seconds_of(work: Callable[[], object]) -> float:
    """Seconds that it took."""
    began = time.perf_counter()
    work()
    return time.perf_counter() - began


def memory_row(name: str, folder: Path, *, stream: bool) -> Row:
    """A run with its frames in memory or on disk."""
    extra, size, difference = isolated(memory_of, name, folder, stream)
    return {
        "scene": name,
        "frames": "on disk" if stream else "in memory",
        "frames [MiB]": size / MIB,
        "above the start [MiB]": extra / MIB,
        "difference [m]": difference,
    }


def memory_of(name: str, folder: Path, stream: bool) -> tuple[int, int, float]:
    """Bytes of a run above those before it, bytes of its frames, and how far it is from one of frames in memory [m]."""
    scene = read_scene(name)
    options: Options = {"stream": folder} if stream else {}
    simulate(dataclasses.replace(scene, duration=2.0 * scene.frame_dt), **options)
    reset_peak()
    before = resident() or peak()
    flow = simulate(scene, **options)
    extra = max(0, peak() - before)
    return extra, flow.positions.nbytes, float(np.abs(flow.positions - simulate(scene).positions).max())
