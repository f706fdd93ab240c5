"""`python -m validation.bench speed`: rates, baffles, first runs, price of a gradient, networks, a large terrain."""

import os
import statistics
import time
from collections.abc import Mapping, Sequence
from dataclasses import astuple, dataclass, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray

from datasets import maps
from datasets.files import make_folder
from datasets.flow.trajectory import open_trajectory
from datasets.processes import processors
from datasets.scene import Baffle, Domain, Mass, Scene
from datasets.scene.library import read_scene
from datasets.scene.material import Material
from datasets.scene.particles import particle_count
from inverse.answer import peak_memory_mib
from mpm import LAST, Recording, simulate, simulate_many
from mpm.adjoint.gradient import gradient
from mpm.arrays.layout import Precision, node_shape
from mpm.simulation import LARGE, Options
from validation.bench.measuring import Found, Spread, isolated, once, recorded, reset_peak, seconds_of, turns
from validation.bench.network import NETWORK, PER_NODE, network_rows
from validation.bench.page import Keep, Out, Rounds, Row, between, formatted, write_page
from validation.plots import BLUE, ORANGE, figure
from validation.runs import Run, kept

CUBE = 0.375
"""Edge of the column in 3D [m]."""
GRADIENT_MIB = 1024.0
"""Memory that a gradient may take: enough for the checkpoints of the largest scene priced."""
CACHE = "TI_OFFLINE_CACHE_FILE_PATH"
"""Variable by which Taichi keeps compiled kernels in another folder than the user's."""
PRICED = "column-tall-42"
FINER = ((1, 0.5), (2, 0.25), (2, 0.5), (4, 0.0625))
"""How many times finer than the shipped column's the cells are, and duration [s], of runs whose gradient is priced."""
CELL, EVERY, FLOW = 0.375, 5, "flow.h5"
"""Of the large terrain: cells [m], frames from one that is kept for the maps to the next, file of the flow."""


@dataclass(frozen=True, kw_only=True)
class Case:
    """A column on some grid, alone or with copies side by side."""

    dimension: int
    cells: int
    """Per metre."""
    scenes: int
    frames: int
    """That are timed, from the start of the flow."""
    corrected: bool = False
    """Whether gaps are remembered."""

    @property
    def particles(self) -> int:
        """Of one scene."""
        return particle_count(column(self.dimension, self.cells, 1))

    @property
    def text(self) -> str:
        return f"{self.scenes} x {self.particles:,} particles in {self.dimension}D"


CASES = (
    Case(dimension=2, cells=100, scenes=1, frames=400),
    Case(dimension=2, cells=100, scenes=8, frames=200),
    Case(dimension=2, cells=280, scenes=1, frames=20),
    Case(dimension=2, cells=560, scenes=1, frames=4),
    Case(dimension=2, cells=1770, scenes=1, frames=1),
    Case(dimension=3, cells=32, scenes=1, frames=100),
    Case(dimension=3, cells=32, scenes=1, frames=100, corrected=True),
    Case(dimension=3, cells=32, scenes=8, frames=50),
    Case(dimension=3, cells=64, scenes=1, frames=20),
    Case(dimension=3, cells=106, scenes=1, frames=5),
    Case(dimension=3, cells=106, scenes=1, frames=5, corrected=True),
)


PRICE = {"particles": ",", "steps": ",", "run [s]": ".2f", "gradient [s]": ".2f", "runs per gradient": ".1f"}
"""What a gradient by the adjoint takes, beside the run that it is of, on one thread and without compilation: forms of
the columns. The memory is the greatest resident size of the process above what it held before the gradient."""
Mode = tuple[Precision, int]
"""Precision and threads; no threads: a GPU."""
Rates = Mapping[tuple[Case, Mode], Spread]
"""Million particle-steps a second."""


def column(dimension: int, cells: int, frames: int) -> Scene:
    """The paper's tall column at 42 degrees, or a cube of its 3D sand at the left wall, on `cells` cells per metre."""
    if dimension == 2:
        scene = replace(read_scene("column-tall-42"), domain=Domain(size=(1.0, 1.0), cell=1.0 / cells))
    else:
        edge, start = round(CUBE * cells) / cells, round((0.5 - CUBE / 2) * cells) / cells
        scene = Scene(
            domain=Domain(size=(1.0, 1.0, 1.0), cell=1.0 / cells),
            material=Material(friction_deg=35.0),
            masses=(Mass(lower=(0.0, 0.0, start), size=(edge, edge, edge)),),
            floor_friction=0.43,
            wall_friction=0.43,
            step_fraction=0.9,
        )
    return replace(scene, duration=frames * scene.frame_dt)


def modes(case: Case) -> list[Mode]:
    """How a case is run: a small scene on one thread, copies on all, a large one on one and on all; last in f64."""
    most = processors() if case.scenes > 1 or case.particles >= LARGE else 1
    fewest = most if case.scenes > 1 else 1
    return [*(("f32", threads) for threads in sorted({fewest, most})), ("f64", most)]


def rate(case: Case, mode: Mode) -> float:
    """Million particle-steps a second of a run, without compilation."""
    precision, threads = mode
    scene = column(case.dimension, case.cells, case.frames)
    scene = replace(scene, volume_correction=True) if case.corrected else scene
    scenes = [replace(scene, seed=seed) for seed in range(case.scenes)]
    place: Options = {"precision": precision, "threads": threads}
    if not threads:
        place = {"precision": precision, "arch": "cuda"}
        # On a GPU the first frame compiles.
        simulate_many([replace(scene, duration=scene.frame_dt) for scene in scenes], **place)
    summaries = [flow.summary for flow in simulate_many(scenes, **place)]
    return float(sum(each["particles"] * each["steps"] for each in summaries) / summaries[0]["wall_s"] / 1.0e6)


def behind_baffles() -> dict[str, Scene]:
    """By name: the paper's short column, which runs against a baffle, and the shipped scenes with baffles in 3D."""
    baffle = Baffle(lower=(0.6, 0.0), size=(0.05, 0.1))
    column = replace(read_scene("column-short-21"), baffles=(baffle,), baffle_friction=0.385)
    return {"column-short-21": column} | {name: read_scene(name) for name in ("baffles-2", "baffles-5")}


def baffle_row(name: str, scene: Scene, rounds: int) -> Row:
    """Nanoseconds of a particle-step on one thread, with baffles and without, in turn."""

    def nanoseconds(scene: Scene) -> float:
        summary = simulate(scene, record=LAST, threads=1).summary
        return float(1.0e9 * summary["wall_s"] / (summary["particles"] * summary["steps"]))

    work = {"with [ns]": scene, "without [ns]": replace(scene, baffles=())}
    found = turns({key: partial(nanoseconds, each) for key, each in work.items()}, rounds, name)
    ratio = Spread([one / other for one, other in zip(*found.values(), strict=True)])
    counts = {"particles": f"{particle_count(scene):,}", "baffles": str(len(scene.baffles))}
    times = {key: f"{Spread(each):.1f}" for key, each in found.items()}
    return {"scene": f"`{name}`"} | counts | times | {"ratio": f"{ratio:.3f}"}


def started(scene: Scene, folder: str) -> float:
    """CPU seconds of this process, a new one with its kernels in `folder`, up to the end of a frame of a scene."""
    os.environ[CACHE] = folder
    simulate(replace(scene, duration=scene.frame_dt), record=LAST, threads=1)
    seconds = time.process_time()
    # Taichi writes its kernels when it ends, to which a worker of a pool does not come.
    import taichi as ti

    ti.reset()
    return seconds


def first_runs() -> list[Row]:
    """Scenes of each kind of kernel: a first run, which compiles, and a second one, which finds the kernels on disk."""
    scenes = {name: read_scene(name) for name in ("column-short-21", "flume-35", "valley-3d")}
    scenes |= {f"{name}, baffles": scene for name, scene in behind_baffles().items() if name != "baffles-5"}
    scenes["baffles-2, no baffles"] = replace(read_scene("baffles-2"), baffles=())
    rows: list[Row] = []
    for name, scene in scenes.items():
        with TemporaryDirectory() as folder:
            seconds = {f"{which} run [s]": f"{isolated(started, scene, folder):.1f}" for which in ("first", "second")}
        rows.append({"scene": f"{name} ({scene.dimension}D)"} | seconds)
    return rows


def mean_x(positions: NDArray[np.float64], _: NDArray[np.float64]) -> tuple[float, NDArray[np.float64], None]:
    """The mean x of the deposit [m], and its derivative."""
    slope = np.zeros_like(positions)
    slope[..., 0] = 1.0 / positions.shape[1]
    return float(positions[..., 0].mean()), slope, None


def price(scene: Scene, repeats: int) -> Found:
    """Of one scene in this process, the median of `repeats` turns; kernels are compiled on a short flow before."""
    short = replace(scene, duration=0.02)
    simulate(short, record=LAST, threads=1)
    gradient(short, mean_x, threads=1)
    before = reset_peak()
    work = {
        "run": partial(seconds_of, partial(simulate, scene, record=LAST, threads=1)),
        "gradient": partial(seconds_of, partial(gradient, scene, mean_x, threads=1, memory_mib=GRADIENT_MIB)),
    }
    run, own = (statistics.median(seconds) for seconds in turns(work, repeats, "gradient").values())
    return {
        "particles": particle_count(scene),
        "steps": simulate(scene, record=LAST, threads=1).summary["steps"],
        "run [s]": run,
        "gradient [s]": own,
        "runs per gradient": own / run,
        "memory [MiB]": max(0.0, peak_memory_mib() - before / 2**20),
    }


def slide() -> Scene:
    """`hillside` on other cells, its layer a little thicker, its soil as soft as its speed allows."""
    scene = read_scene("hillside").with_cell(CELL)
    soil, layer = replace(scene.material, young=6.0e6), replace(scene.masses[0], thickness=6.25)
    return replace(scene, material=soil, masses=(layer,), duration=8.0, step_fraction=0.9)


def slid(folder: Path) -> Found:
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


def large_terrain(keep: Path) -> list[Found]:
    """Run and maps, each in a process of its own; what is in `keep` is not done again."""
    folder = keep / f"terrain-{Run(scene=slide()).digest}"
    make_folder(folder)
    return [once(folder / f"{work.__name__}.json", work, folder) for work in (slid, mapped)]


def bench(*, out: Out, keep: Keep = None, rounds: Rounds = 2) -> str:
    """Measure rates over sizes and at baffles, gradients, steps of networks, a large terrain; needs a quiet machine.

    KEEP has the stages of the large terrain; other times are of one command.
    """
    # Taichi starts anew for another precision or number of threads.
    keys = sorted(((case, mode) for case in CASES for mode in modes(case)), key=lambda key: key[1])
    timed = turns({key: partial(rate, *key) for key in keys}, rounds, "rates")
    rates = {key: Spread(found) for key, found in timed.items()}
    solids = [baffle_row(name, each, 3 * rounds) for name, each in behind_baffles().items()]
    whole = read_scene(PRICED)
    finer = [replace(whole.with_cell(whole.domain.cell / times), duration=duration) for times, duration in FINER]
    prices = [isolated(price, scene, rounds) for scene in finer]
    networks = network_rows(rounds=rounds)
    with kept(keep) as folder:
        flow, drawn = large_terrain(folder)
    seconds = flow["before"] + flow["seconds"] + drawn["seconds"]
    draw(out / "speed.png", rates)
    return write_page(
        out,
        "speed",
        [
            *conclusion(rates, prices, networks),
            f"A terrain of {flow['particles']:,} particles takes {seconds:.0f} s from the raster to the maps.",
        ],
        flags=f" --rounds {rounds}",
        large=LARGE,
        rates=rate_rows(rates),
        baffles=solids,
        starts=first_runs(),
        priced=PRICED,
        prices=formatted(prices, PRICE | {"memory [MiB]": ".0f"}),
        networks=formatted(networks, NETWORK),
        cell=CELL,
        particles=flow["particles"],
        nodes=flow["nodes"],
        terrain=terrain_rows(flow, drawn),
    )


def conclusion(rates: Rates, prices: Sequence[Found], networks: Sequence[Found]) -> list[str]:
    largest = max(prices, key=lambda each: float(each["memory [MiB]"]))
    ratios = between([each["runs per gradient"] for each in prices], ".1f")
    steps = between([each[PER_NODE] for each in networks], ".0f")
    best = {dimension: best_rates(rates, dimension) for dimension in dict.fromkeys(case.dimension for case, _ in rates)}
    return [
        *(
            f"In {dimension}D the MPM computes {between(own.values(), '.0f')} million particle-steps per second, for"
            f" {between(own, ',')} particles."
            for dimension, own in best.items()
        ),
        f"A gradient by the adjoint takes as long as {ratios} runs, for any number of unknowns, and at most"
        f" {largest['memory [MiB]']:.0f} MiB ({largest['particles']:,} particles, {largest['steps']:,} steps).",
        f"A step of the shipped networks with its gradient takes {steps} µs per node, on one thread.",
    ]


def terrain_rows(flow: Found, drawn: Found) -> list[Row]:
    """What each stage takes."""
    stages = {
        "raster to particles and contact": {"seconds": flow["before"]},
        f"run of {flow['steps']:,} steps, every {EVERY}th frame to HDF5": flow,
        f"maps of {drawn['frames']} frames": drawn,
    }
    return [
        {"stage": stage, "seconds": f"{took['seconds']:.1f}"}
        | {f"{key} [MiB]": f"{took[key]:.0f}" if key in took else "-" for key in ("memory", "disk")}
        for stage, took in stages.items()
    ]


def best_rates(rates: Rates, dimension: int) -> dict[int, float]:
    """The highest median rate in single precision, by particles of a scene."""
    found: dict[int, float] = {}
    for (case, (precision, _)), each in rates.items():
        if case.dimension == dimension and precision == "f32" and not case.corrected:
            found[case.particles] = max(each.median, found.get(case.particles, 0.0))
    return dict(sorted(found.items()))


def rate_rows(rates: Rates) -> list[Row]:
    rows: list[Row] = []
    used = sorted({mode for _, mode in rates})
    for case in sorted({case for case, _ in rates}, key=astuple):
        row = {
            "": f"{case.dimension}D" + ", gaps remembered" * case.corrected,
            "particles": f"{case.particles:,}",
            "scenes": str(case.scenes),
        }
        for precision, threads in used:
            place = f"{threads} thread{'s' * (threads > 1)}" if threads else "GPU"
            found = rates.get((case, (precision, threads)))
            row[f"{precision}, {place}"] = f"{found:.1f}" if found else "-"
        rows.append(row)
    return rows


def draw(path: Path, rates: Rates) -> None:
    with figure(path) as axes:
        axis = axes[0, 0]
        for dimension, colour in ((2, BLUE), (3, ORANGE)):
            best = best_rates(rates, dimension)
            axis.plot(list(best), list(best.values()), "o-", color=colour, label=f"{dimension}D")
        axis.set(xscale="log", xlabel="particles of a scene", ylabel="million particle-steps per second")
        axis.set_ylim(bottom=0.0)
        axis.legend()
