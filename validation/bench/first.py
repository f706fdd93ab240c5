"""CPU seconds until the first frame of shipped scenes: what the first run of a kind costs, which compiles."""

import os
import time
from collections.abc import Mapping
from dataclasses import replace
from tempfile import TemporaryDirectory

from tqdm import tqdm

from datasets.library import read_scene
from datasets.scene import Baffle, Scene
from mpm import LAST, simulate
from validation.report.measuring import isolated
from validation.report.page import Page, between

CACHE = "TI_OFFLINE_CACHE_FILE_PATH"
"""Variable by which Taichi keeps compiled kernels in another folder than the user's."""

Starts = Mapping[str, tuple[float, float]]
"""CPU seconds of the first run of a scene, and of the second one, which finds the kernels on disk."""


def scenes() -> dict[str, Scene]:
    """By what they are: shipped scenes of each kind of kernel."""
    column, baffle = read_scene("column-short-21"), Baffle(lower=(0.6, 0.0), size=(0.05, 0.1))
    return {
        "2D column (`column-short-21`)": column,
        "2D, the same with a baffle": replace(column, baffles=(baffle,), baffle_friction=0.385),
        "2D terrain (`flume-35`)": read_scene("flume-35"),
        "3D body (`baffles-2` without baffles)": replace(read_scene("baffles-2"), baffles=()),
        "3D baffles (`baffles-2`)": read_scene("baffles-2"),
        "3D terrain (`valley-3d`)": read_scene("valley-3d"),
    }


def started(scene: Scene, folder: str) -> float:
    """CPU seconds of this process, a new one with its kernels in `folder`, up to the end of a frame of a scene."""
    os.environ[CACHE] = folder
    simulate(replace(scene, duration=scene.frame_dt), record=LAST, threads=1)
    seconds = time.process_time()
    # Taichi writes its kernels when it ends, to which a worker of a pool does not come.
    import taichi as ti

    ti.reset()
    return seconds


def first_runs(*, quick: bool) -> Starts:
    """Of each scene, one after the other in processes of their own; quick: of the first one alone."""
    found = {}
    for name, scene in tqdm(list(scenes().items())[: 1 if quick else None], desc="first runs", unit="scene"):
        with TemporaryDirectory() as folder:
            found[name] = isolated(started, scene, folder), isolated(started, scene, folder)
    return found


def add_section(text: Page, starts: Starts) -> None:
    """What first runs take, on the page of speeds."""
    kinds = {kind: [first for name, (first, _) in starts.items() if name.startswith(kind)] for kind in ("2D", "3D")}
    said = " and ".join(f"{between(values, '.0f')} s of CPU in {kind}" for kind, values in kinds.items() if values)
    text.section("First runs")
    text.text(f"""
        The first run of a kind of scene takes {said} until the end of its first frame; it compiles the kernel, which
        stays on disk. Seconds of CPU of a process, imports included, with an empty folder for kernels and once more
        with what the first run left there; one thread.
    """)
    text.table(
        [
            {"scene": name, "first run [s]": f"{first:.1f}", "second run [s]": f"{second:.1f}"}
            for name, (first, second) in starts.items()
        ]
    )
