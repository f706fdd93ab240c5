"""`python -m validation.bench speed`: rates, baffles, first runs, price of a gradient, networks, a large terrain."""

import statistics
from collections.abc import Mapping, Sequence
from dataclasses import astuple, dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from datasets.errors import InputError
from datasets.files import read_toml
from datasets.library import read_scene
from datasets.material import Material
from datasets.particles import particle_count
from datasets.processes import processors
from datasets.scene import Baffle, Domain, Mass, Scene
from mpm import LAST, simulate, simulate_many
from mpm.adjoint.gradient import gradient
from mpm.arrays.layout import Precision
from mpm.simulation import LARGE, Options
from validation.bench import first, large
from validation.bench.network import network_rows
from validation.report.measuring import Spread, isolated, reset_peak, resident, seconds_of, turns
from validation.report.page import GNS, MPM, Page, Row, between
from validation.report.plots import BLUE, ORANGE, figure

CUBE = 0.375
"""Edge of the column in 3D [m]."""
GRADIENT_MIB = 1024.0
"""Memory that a gradient may take: enough for the checkpoints of the largest scene priced."""
PRICED = "column-tall-42"
SCALES: tuple[tuple[float, float], ...] = ((1.0, 0.5), (2.0, 0.5), (2.0, 1.0), (4.0, 0.25))
"""Length and height over the shipped column's, and duration [s], of the runs whose gradient is priced."""


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


@dataclass(frozen=True, kw_only=True)
class Price:
    """What a gradient by the adjoint takes, beside the run that it is of, on one thread."""

    particles: int
    steps: int
    run: float
    """[s], without compilation, as all."""
    gradient: float
    memory: int
    """Greatest resident size of the process above what it held before the gradient [bytes]."""

    @property
    def ratio(self) -> float:
        return self.gradient / self.run


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
    place: Options = (
        {"precision": precision, "threads": threads} if threads else {"precision": precision, "arch": "cuda"}
    )
    if not threads:
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
    times = {key: Spread(each).written(1) for key, each in found.items()}
    return {"scene": f"`{name}`"} | counts | times | {"ratio": ratio.written(3)}


def enlarged(scale: float, duration: float) -> Scene:
    """The shipped column, longer and higher on the same cells, for another duration [s]."""
    scene = read_scene(PRICED)
    (mass,) = scene.masses

    def scaled(lengths: tuple[float, ...]) -> tuple[float, ...]:
        return tuple(round(length * scale, 9) for length in lengths)

    domain = Domain(size=scaled(scene.domain.size), cell=scene.domain.cell)
    return replace(scene, duration=duration, domain=domain, masses=(Mass(lower=mass.lower, size=scaled(mass.size)),))


def mean_x(positions: NDArray[np.float64], _: NDArray[np.float64]) -> tuple[float, NDArray[np.float64], None]:
    """The mean x of the deposit [m], and its derivative."""
    slope = np.zeros_like(positions)
    slope[..., 0] = 1.0 / positions.shape[1]
    return float(positions[..., 0].mean()), slope, None


def price(scene: Scene, repeats: int) -> Price:
    """Of one scene in this process, the median of `repeats` turns; kernels are compiled on a short flow before."""
    short = replace(scene, duration=0.02)
    simulate(short, record=LAST, threads=1)
    gradient(short, mean_x, threads=1)
    reset_peak()
    before = resident()
    work = {
        "run": partial(seconds_of, partial(simulate, scene, record=LAST, threads=1)),
        "gradient": partial(seconds_of, partial(gradient, scene, mean_x, threads=1, memory_mib=GRADIENT_MIB)),
    }
    found = turns(work, repeats, "gradient")
    return Price(
        particles=particle_count(scene),
        steps=int(simulate(scene, record=LAST, threads=1).summary["steps"]),
        run=statistics.median(found["run"]),
        gradient=statistics.median(found["gradient"]),
        memory=max(0, resident(peak=True) - before),
    )


def bench(out: Path, *, quick: bool, keep: Path, rounds: int = 2) -> str:
    """Measure rates over sizes and at baffles, gradients, steps of networks, a large terrain; needs a quiet machine.

    KEEP has the stages of the large terrain; other times are of one command.

    Parameters
    ----------
    quick
        A single frame of two small cases, one small gradient, a coarse terrain.
    rounds
        How often everything is measured, in turn; the tables give the median and the range.
    """
    if rounds < 1:
        raise InputError(f"expected at least 1, got {rounds}", key="--rounds")
    rounds = 1 if quick else rounds
    cases = [replace(each, frames=1) for each in CASES[:2]] if quick else CASES
    # Taichi starts anew for another precision or number of threads.
    keys = sorted(((case, mode) for case in cases for mode in modes(case)), key=lambda key: key[1])
    timed = turns({key: partial(rate, *key) for key in keys}, rounds, "rates")
    rates = {key: Spread(found) for key, found in timed.items()}
    scenes = list(behind_baffles().items())[: 1 if quick else None]
    solids = [baffle_row(name, each, 3 * rounds) for name, each in scenes]
    prices = [isolated(price, enlarged(*each), rounds) for each in (((0.5, 0.1),) if quick else SCALES)]
    starts = first.first_runs(quick=quick)
    networks = network_rows(rounds=rounds, sizes=1 if quick else 3)
    terrain = large.measured(keep, quick=quick)
    draw(out / "speed.png", rates, prices)
    text = page(rates, solids, starts, prices, networks, terrain, rounds=rounds, quick=quick)
    return text.write(out / "speed.md")


def page(
    rates: Rates,
    solids: Sequence[Row],
    starts: first.Starts,
    prices: Sequence[Price],
    networks: Sequence[Mapping[str, str]],
    terrain: Mapping[str, large.Found],
    *,
    rounds: int,
    quick: bool,
) -> Page:
    said = [*conclusion(rates, prices, networks), large.sentence(terrain)]
    text = Page("Speed", f"speed --rounds {rounds}", said, packages=MPM | GNS, quick=quick)
    text.picture("speed.png", "rate of the MPM over particles; a run and its gradient")
    text.section("Million particle-steps a second of the MPM")
    text.text(f"""
        2D: the paper's tall column (42°, damped, cohesive), 4 particles per cell. 3D: a cube of its 3D sand, 8 per
        cell. One scene of fewer than {LARGE:,} particles runs on one thread, copies on a thread each, a larger one on
        all. Medians of rounds in turn, in brackets minimum and maximum. Compilation is not included (see First runs).
    """)
    text.table(rate_rows(rates))
    text.text("Other codes on two cores of an AMD EPYC, not in this run (`validation/bench/speed.toml`):")
    others = read_toml(Path(__file__).with_suffix(".toml"))
    text.table(
        [{"": code["name"]} | dict(zip(others["columns"], code["rates"], strict=True)) for code in others["codes"]]
    )
    text.section("Baffles")
    text.text("""
        Nanoseconds of a particle-step, one thread, in turn with the same scene without its baffles. Part of the ratio
        is the flow's: sand that baffles throw up makes the box of nodes that a step goes through larger.
    """)
    text.table(solids)
    first.add_section(text, starts)
    text.section("A gradient by the adjoint")
    text.text(f"""
        A run of `{PRICED}`, longer and higher on its own cells, and the gradient of its mean x with respect to all that
        it begins with: a run with checkpoints, its replay and its reverse; one thread, each in a process of its own.
        Memory is the greatest resident size above that before.
    """)
    text.table(
        [
            {
                "particles": f"{each.particles:,}",
                "steps": f"{each.steps:,}",
                "run [s]": f"{each.run:.2f}",
                "gradient [s]": f"{each.gradient:.2f}",
                "runs per gradient": f"{each.ratio:.1f}",
                "memory [MiB]": f"{each.memory / 2**20:.0f}",
            }
            for each in prices
        ]
    )
    text.section("A step of the network")
    text.text("Seconds of one step of the shipped models on a body of sand, over its nodes; one thread.")
    text.table(networks)
    large.add_section(text, terrain)
    return text


def conclusion(rates: Rates, prices: Sequence[Price], networks: Sequence[Mapping[str, str]]) -> list[str]:
    """Rates by dimension, the price of a gradient, the network's step."""
    best = {dimension: best_rates(rates, dimension) for dimension in dict.fromkeys(case.dimension for case, _ in rates)}
    large = max(prices, key=lambda each: each.memory)
    runs = between([each.ratio for each in prices], ".1f")
    steps = between([float(each["µs per node"]) for each in networks], ".0f")
    return [
        *(
            f"In {dimension}D the MPM makes {between(own.values(), '.0f')} million particle-steps a second, at"
            f" {between(own, ',')} particles."
            for dimension, own in best.items()
        ),
        f"A gradient by the adjoint takes {runs} runs, for any number of unknowns, and at most"
        f" {large.memory / 2**20:.0f} MiB ({large.particles:,} particles, {large.steps:,} steps).",
        f"A step of the shipped networks takes {steps} µs for each node with its gradient, on one thread.",
    ]


def best_rates(rates: Rates, dimension: int) -> dict[int, float]:
    """The highest median rate in single precision, by particles of a scene."""
    found: dict[int, float] = {}
    for (case, (precision, _)), each in rates.items():
        if case.dimension == dimension and precision == "f32" and not case.corrected:
            found[case.particles] = max(each.median, found.get(case.particles, 0.0))
    return found


def threads_named(threads: int) -> str:
    """The threads of a `Mode`, for the heading of a column."""
    return f"{threads} thread{'s' if threads > 1 else ''}" if threads else "GPU"


def rate_rows(rates: Rates) -> list[Row]:
    """A line per case: its rates by precision and threads."""
    rows: list[Row] = []
    for case in sorted({case for case, _ in rates}, key=astuple):
        row = {
            "": f"{case.dimension}D" + ", gaps remembered" * case.corrected,
            "particles": f"{case.particles:,}",
            "scenes": str(case.scenes),
        }
        cells = {
            f"{precision}, {threads_named(threads)}": rates.get((case, (precision, threads)))
            for _, (precision, threads) in rates
        }
        rows.append(row | {head: each.written(1) if each else "-" for head, each in sorted(cells.items())})
    return rows


def draw(path: Path, rates: Rates, prices: Sequence[Price]) -> None:
    """Rates over particles; seconds of a run and of its gradient over particle-steps."""
    with figure(path, columns=2) as axes:
        left, right = axes[0, 0], axes[0, 1]
        for dimension, colour in ((2, BLUE), (3, ORANGE)):
            best = dict(sorted(best_rates(rates, dimension).items()))
            left.plot(list(best), list(best.values()), "o-", color=colour, label=f"{dimension}D")
        left.set(xscale="log", xlabel="particles of a scene", ylabel="million particle-steps a second")
        left.set_ylim(bottom=0.0)
        left.legend()
        work = [each.particles * each.steps for each in prices]
        right.plot(work, [each.run for each in prices], "o", color=BLUE, label="run")
        right.plot(work, [each.gradient for each in prices], "o", color=ORANGE, label="gradient by the adjoint")
        right.set(xscale="log", yscale="log", xlabel="particles x steps", ylabel="seconds, one thread")
        right.legend()
