"""`python -m validation.bench speed`: rates, baffles, water, first runs, the cost of a gradient, networks, a terrain.

And `gpu`: rates of the MPM and a step of the network on a GPU, compared with the processor.
"""

import os
import time
from collections.abc import Mapping, Sequence
from dataclasses import astuple, dataclass, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray

from datasets import maps
from datasets.errors import InputError
from datasets.files import make_folder, read_toml
from datasets.flow.trajectory import open_trajectory
from datasets.geometry.placement import remembers_gaps
from datasets.processes import processors
from datasets.scene import Baffle, Domain, Mass, Scene
from datasets.scene.library import read_scene
from datasets.scene.material import Material
from datasets.scene.particles import particle_count
from inverse.answer import peak_memory_mib
from mpm import LAST, Recording, simulate, simulate_many
from mpm.adjoint.gradient import gradient
from mpm.arrays.layout import Precision
from mpm.simulation import LARGE, Options
from validation.bench.measuring import Found, Spread, isolated, once, recorded, reset_peak, seconds_of, turns
from validation.bench.page import Keep, Out, Rounds, Row, between, formatted, write_page
from validation.run_store import Run, kept

CUBE = 0.375  # edge of the body in 3D [m]
GRADIENT_MIB = 1024.0  # memory that a gradient may take: enough for the checkpoints of the largest scene priced
STARTED = ("column-short-21", "flume-35", "baffles-2", "valley-3d")
"""Shipped scenes with several kinds of kernels: box only, terrain, baffles; in 2D, then 3D."""
WET = "cube"  # the water-filled scene of `featured`, whose kernel is the longest
PRICED = "column-tall-42"
FINER = ((1, 0.5), (2, 0.25), (2, 0.5), (4, 0.0625))
"""How many times finer than the shipped column's the cells are, and duration [s], of runs whose gradient is priced."""
CELL, EVERY = 0.375, 5  # of the large terrain: cells [m], frames from one that is kept for the maps to the next
BODIES = {2: (0.01, (0.4,), (0.2, 1.5, 15.0)), 3: (0.03, (0.3, 0.3), (0.3, 1.2, 4.8))}
"""By dimension: cells, height (in 3D and width) and lengths of the bodies of which a network makes a step [m]."""
PER_NODE = "µs per node"
NETWORK = {"nodes": ",", "forward [s]": ".4f", "with gradient [s]": ".4f", PER_NODE: ".0f"}
PRICE = {"particles": ",", "steps": ",", "run [s]": ".2f", "gradient [s]": ".2f", "runs per gradient": ".1f"}
PRICE |= {"memory [MiB]": ".0f"}
TERRAIN = {"particles": ",", "steps": ",", "before": ".1f", "seconds": ".1f", "maps": ".1f"}
TERRAIN |= {"memory": ".0f", "disk": ".0f"}  # forms of the columns


@dataclass(frozen=True)
class Workload:
    """A row of `speed.toml`: a column on some grid, alone or with copies side by side."""

    dimension: int
    cells: int  # per metre
    scenes: int
    frames: int  # that are timed, from the start of the flow

    @property
    def particles(self) -> int:
        """Of one scene."""
        return particle_count(column(self.dimension, self.cells, 1))

    @property
    def text(self) -> str:
        return f"{self.scenes} x {self.particles:,} particles in {self.dimension}D"


CASES, ON_GPU = ([Workload(*row) for row in rows] for rows in read_toml(Path(__file__).with_suffix(".toml")).values())
Mode = tuple[Precision, int]  # precision and threads; no threads: a GPU
Rates = Mapping[tuple[Workload, Mode], Spread]  # million particle-steps a second


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


def modes(case: Workload) -> list[Mode]:
    """How a case is run: a small scene on one thread, copies on all, a large one on one and on all; last in f64."""
    most = processors() if case.scenes > 1 or case.particles >= LARGE else 1
    fewest = most if case.scenes > 1 else 1
    return [*(("f32", threads) for threads in sorted({fewest, most})), ("f64", most)]


def rate(case: Workload, mode: Mode) -> float:
    """Million particle-steps a second of a run, without compilation."""
    precision, threads = mode
    scene = column(case.dimension, case.cells, case.frames)
    scenes = [replace(scene, seed=seed) for seed in range(case.scenes)]
    place: Options = {"precision": precision, "threads": threads}
    if not threads:
        place = {"precision": precision, "arch": "cuda"}
        # On a GPU, the first frame includes compilation.
        simulate_many([replace(scene, duration=scene.frame_dt) for scene in scenes], **place)
    summaries = [flow.summary for flow in simulate_many(scenes, **place)]
    return float(sum(summary["particles"] * summary["steps"] for summary in summaries) / summaries[0]["wall_s"] / 1.0e6)


def featured() -> dict[str, tuple[str, Scene, Scene]]:
    """Name -> feature whose cost is measured, scene with it, and the same scene without it. The paper's short column,
    which runs against a baffle, shipped scenes with baffles in 3D, and the cube of sand, full of water and dry, in
    steps as scenes have them unless they say otherwise: longer ones take more sweeps."""
    baffle = Baffle(lower=(0.6, 0.0), size=(0.05, 0.1))
    short = replace(read_scene("column-short-21"), baffles=(baffle,), baffle_friction=0.385)
    baffled = {"column-short-21": short} | {name: read_scene(name) for name in ("baffles-2", "baffles-5")}
    priced = {}
    for name, scene in baffled.items():
        count, without = len(scene.baffles), replace(scene, baffles=(), volume_correction=remembers_gaps(scene))
        priced[name] = (f"{count} baffle{'s' * (count > 1)}", scene, without)
    cube = replace(column(3, 32, 200), step_fraction=Scene.step_fraction)
    dry = replace(cube, material=replace(cube.material, young=2.0e6), masses=(replace(cube.masses[0], k0=0.5),))
    wet = replace(dry, material=replace(dry.material, saturated=True, permeability=1.0e-3))
    return priced | {"cube": ("water", wet, dry)}


def feature_row(name: str, feature: str, scene: Scene, without: Scene, rounds: int) -> Row:
    """Nanoseconds per particle-step on one thread, for a scene and for the scene `without` its feature, in turn."""

    def nanoseconds(scene: Scene) -> float:
        summary = simulate(scene, record=LAST, threads=1).summary
        return float(1.0e9 * summary["wall_s"] / (summary["particles"] * summary["steps"]))

    work = {"with [ns]": scene, "without [ns]": without}
    timed = turns({key: partial(nanoseconds, variant) for key, variant in work.items()}, rounds, name)
    ratio = Spread([one / other for one, other in zip(*(spread.values for spread in timed.values()), strict=True)])
    row = {"scene": f"`{name}`", "particles": f"{particle_count(scene):,}", "feature": feature}
    return row | {key: f"{spread:.1f}" for key, spread in timed.items()} | {"ratio": f"{ratio:.3f}"}


def started(scene: Scene, folder: str) -> float:
    """CPU seconds of this new process up to the end of a scene's first frame; its kernels are cached in `folder`."""
    os.environ["TI_OFFLINE_CACHE_FILE_PATH"] = folder
    simulate(replace(scene, duration=scene.frame_dt), record=LAST, threads=1)
    seconds = time.process_time()
    # Taichi writes its kernels on exit, which the worker of a pool never reaches.
    import taichi as ti

    ti.reset()
    return seconds


def started_row(name: str, scene: Scene) -> Row:
    """A first run, which compiles, and a second one, which finds the kernels on disk."""
    with TemporaryDirectory() as folder:
        seconds = {f"{which} run [s]": f"{isolated(started, scene, folder):.1f}" for which in ("first", "second")}
    return {"scene": f"`{name}` ({scene.dimension}D{', water' if scene.material.saturated else ''})"} | seconds


def mean_x(positions: NDArray[np.float64], _: NDArray[np.float64]) -> tuple[float, NDArray[np.float64], None]:
    """The mean x of the deposit [m], and its derivative."""
    slope = np.zeros_like(positions)
    slope[..., 0] = 1.0 / positions.shape[1]
    return float(positions[..., 0].mean()), slope, None


def price(scene: Scene, rounds: int) -> Found:
    """Cost of a scene's gradient compared with a run, medians of `rounds` turns in this process. A short flow compiles
    the kernels first. The memory is the largest increase of the resident size."""
    short = replace(scene, duration=0.02)
    simulate(short, record=LAST, threads=1)
    gradient(short, mean_x, threads=1, memory_mib=GRADIENT_MIB)
    before = reset_peak()
    work = {
        "run": partial(seconds_of, partial(simulate, scene, record=LAST, threads=1)),
        "gradient": partial(seconds_of, partial(gradient, scene, mean_x, threads=1, memory_mib=GRADIENT_MIB)),
    }
    run, adjoint = (seconds.median for seconds in turns(work, rounds, "gradient").values())
    return {
        "particles": particle_count(scene),
        "steps": simulate(scene, record=LAST, threads=1).summary["steps"],
        "run [s]": run,
        "gradient [s]": adjoint,
        "runs per gradient": adjoint / run,
        "memory [MiB]": max(0.0, peak_memory_mib() - before / 2**20),
    }


def network_rows(*, rounds: int, device: str = "cpu") -> list[Found]:
    """A row for each shipped model and body length: seconds of a step on one thread, medians of rounds."""
    # Imported here: processes that only measure a gradient do not need PyTorch.
    import torch

    import gns
    from gns.library import models
    from gns.surroundings.initial import initial_state

    def row(path: Path, length: float) -> Found:
        simulator = gns.load(path)
        # A model scales every scene to the body of its training data; unscaled, a longer body has more nodes.
        simulator.settings = replace(simulator.settings, body_length=None)
        simulator.to(device)
        initial = initial_state(body(simulator.settings.dimension, length), simulator.settings)
        state, conditions = initial.state.to(device), initial.conditions.to(device)
        friction = conditions.friction.clone().requires_grad_()
        conditions = replace(conditions, friction=friction)

        def step(gradient: bool) -> None:
            with torch.set_grad_enabled(gradient):
                moved = simulator(state, conditions).positions.sum()
                # Conversion to a number waits for the GPU.
                float(torch.autograd.grad(moved, friction)[0].sum() if gradient else moved)

        timed = [[seconds_of(partial(step, kind)) for _ in range(1 + rounds)] for kind in (False, True)]
        forward, both = (Spread(seconds[1:]) for seconds in timed)
        nodes = len(initial.indices)
        result = {"model": f"`{path.stem}`", "nodes": nodes, "forward [s]": forward, "with gradient [s]": both}
        return result | {PER_NODE: 1.0e6 * both.median / nodes}

    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    rows = [row(path, length) for path in models() for length in BODIES[gns.load(path).settings.dimension][2]]
    torch.set_num_threads(threads)
    return rows


def body(dimension: int, length: float) -> Scene:
    """A body of sand of this length [m], at rest at the left wall of a box."""
    cell, across, _ = BODIES[dimension]
    return Scene(
        domain=Domain(size=(length + 0.6, 1.5 * across[0], *across[1:]), cell=cell),
        material=Material(friction_deg=30.0),
        masses=(Mass(lower=(0.0,) * dimension, size=(length, *across)),),
        floor_friction=0.4,
    )


def slide() -> Scene:
    """`hillside` on other cells, with a slightly thicker layer and soil as soft as its speed allows."""
    scene = read_scene("hillside").with_cell(CELL)
    soil, layer = replace(scene.material, young=6.0e6), replace(scene.masses[0], thickness=6.25)
    return replace(scene, material=soil, masses=(layer,), duration=8.0, step_fraction=0.9)


def terrain(folder: Path) -> Found:
    """Cost of the slide from the raster to the maps; frames and maps go to `folder`."""
    costs = recorded(slide, Recording(frames=EVERY), folder / "flow.h5")
    began, trajectory = time.perf_counter(), open_trajectory(folder / "flow.h5")
    make_folder(folder / "maps")
    maps.write(trajectory, maps.maps_of(trajectory, CELL, progress=True), folder / "maps")
    return costs | {"maps": time.perf_counter() - began}


def bench(*, out: Out, keep: Keep = None, rounds: Rounds = 2) -> str:
    """Measure rates over sizes, baffles, water, first runs, gradients, networks and a terrain, on an idle machine.

    KEEP stores the large terrain; the other times come from one command.
    """
    # Taichi restarts for another precision or number of threads.
    keys = sorted(((case, mode) for case in CASES for mode in modes(case)), key=lambda key: key[1])
    rates = turns({key: partial(rate, *key) for key in keys}, rounds, "rates")
    priced_features = featured()
    features = [feature_row(name, *priced, 3 * rounds) for name, priced in priced_features.items()]
    wet = priced_features[WET][1]
    whole = read_scene(PRICED)
    finer = [replace(whole.with_cell(whole.domain.cell / times), duration=duration) for times, duration in FINER]
    prices = [isolated(price, scene, rounds) for scene in finer]
    networks = network_rows(rounds=rounds)
    with kept(keep) as folder:
        make_folder(place := folder / f"terrain-{Run(scene=slide()).digest}")
        large = once(place / "terrain.json", terrain, place)
    return write_page(
        out,
        "speed",
        conclusion(rates, prices, networks, large),
        flags=f" --rounds {rounds}",
        large=LARGE,
        rates=rate_rows(rates),
        features=features,
        starts=[started_row(*kind) for kind in [*((name, read_scene(name)) for name in STARTED), (WET, wet)]],
        priced=PRICED,
        prices=formatted(prices, PRICE),
        networks=formatted(networks, NETWORK),
        cell=CELL,
        every=EVERY,
        terrain=formatted([{key: large[key] for key in TERRAIN}], TERRAIN),
    )


def gpu(*, out: Out, rounds: Rounds = 2) -> str:
    """Measure rates over sizes and steps of the networks on a GPU, in turn with all processors of the same machine.

    Raises InputError without a GPU.
    """
    # Imported here: processes that only measure a gradient do not need PyTorch.
    from torch import cuda

    if not cuda.is_available():
        raise InputError("expected a GPU that torch can use, there is none", where="bench gpu")
    threads = processors()
    modes: list[Mode] = [("f32", threads), ("f32", 0), ("f64", 0)]
    rates = turns({(case, mode): partial(rate, case, mode) for mode in modes for case in ON_GPU}, rounds, "rates")
    beside = [network_rows(rounds=rounds, device=device) for device in ("cpu", "cuda")]
    gains = {case: rates[case, ("f32", 0)].median / rates[case, ("f32", threads)].median for case in ON_GPU}
    least, most = sorted(gains, key=gains.__getitem__)[:: len(ON_GPU) - 1]
    best = {size: max(rates[case, ("f32", 0)].median for case in ON_GPU if case.dimension == size) for size in (2, 3)}
    on_cpu, on_gpu = ([row[PER_NODE] for row in rows] for rows in beside)
    said = [
        f"One {cuda.get_device_name()} computes up to {best[2]:.0f} million particle-steps per second in 2D and"
        f" {best[3]:.0f} million in 3D.",
        f"Beside {threads} threads of the same machine it is {gains[least]:.1f} times as fast for {least.text} and"
        f" {gains[most]:.1f} times for {most.text}.",
        f"A step of the networks with its gradient takes {between(on_gpu, '.0f')} µs per node on the GPU, and"
        f" {between(on_cpu, '.0f')} µs on one thread.",
    ]
    networks = [row | {f"GPU, {key}": other[key] for key in list(row)[3:]} for row, other in zip(*beside, strict=True)]
    forms = NETWORK | {f"GPU, {key}": form for key, form in NETWORK.items()}
    flags, table = f" --rounds {rounds}", rate_rows(rates)
    return write_page(out, "gpu", said, flags=flags, rates=table, networks=formatted(networks, forms))


def conclusion(rates: Rates, prices: Sequence[Found], networks: Sequence[Found], large: Found) -> list[str]:
    greatest = max(prices, key=lambda row: float(row["memory [MiB]"]))
    ratios = between([row["runs per gradient"] for row in prices], ".1f")
    steps = between([row[PER_NODE] for row in networks], ".0f")
    best = {dimension: best_rates(rates, dimension) for dimension in (2, 3)}
    sentence = "In {}D the MPM computes {} million particle-steps per second, for {} particles."
    return [
        *(sentence.format(d, between(by_size.values(), ".0f"), between(by_size, ",")) for d, by_size in best.items()),
        f"A gradient by the adjoint takes as long as {ratios} runs, for any number of unknowns, and at most"
        f" {greatest['memory [MiB]']:.0f} MiB ({greatest['particles']:,} particles, {greatest['steps']:,} steps).",
        f"A step of the shipped networks with its gradient takes {steps} µs per node, on one thread.",
        f"A terrain of {large['particles']:,} particles takes"
        f" {large['before'] + large['seconds'] + large['maps']:.0f} s from the raster to the maps.",
    ]


def best_rates(rates: Rates, dimension: int) -> dict[int, float]:
    """The highest median rate in single precision, by particles of a scene."""
    best: dict[int, float] = {}
    for (case, (precision, _)), spread in rates.items():
        if case.dimension == dimension and precision == "f32":
            best[case.particles] = max(spread.median, best.get(case.particles, 0.0))
    return dict(sorted(best.items()))


def rate_rows(rates: Rates) -> list[Row]:
    places = {
        mode: f"{mode[0]}, " + (f"{mode[1]} thread{'s' * (mode[1] > 1)}" if mode[1] else "GPU")
        for mode in sorted({mode for _, mode in rates})
    }
    return [
        {"": f"{case.dimension}D", "particles": f"{case.particles:,}", "scenes": str(case.scenes)}
        | {head: f"{rates[case, mode]:.1f}" if (case, mode) in rates else "-" for mode, head in places.items()}
        for case in sorted({case for case, _ in rates}, key=astuple)
    ]
