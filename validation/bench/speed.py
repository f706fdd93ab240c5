"""`python -m validation.bench speed`: rates, price of a gradient, a step of the network, a large terrain."""

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
from datasets.scene import Domain, Mass, Scene
from mpm import LAST, simulate, simulate_many
from mpm.adjoint.gradient import gradient
from mpm.arrays.layout import Precision
from mpm.simulation import LARGE, Options
from validation.bench import large
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
LENGTHS = {2: (0.2, 1.5, 15.0), 3: (0.3, 1.2, 4.8)}
"""Of the body of a network's step [m], by dimension: it costs per node, and a longer one has as many neighbours."""
ACROSS = {2: 0.4, 3: 0.3}
"""Its height, in 3D its width too [m]."""


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


def body(dimension: int, length: float) -> Scene:
    """A body of sand at rest at the left wall of a box."""
    across, cell = ACROSS[dimension], 0.01 if dimension == 2 else 0.03
    return Scene(
        domain=Domain(size=(length + 0.6, 1.5 * across, across)[:dimension], cell=cell),
        material=Material(friction_deg=30.0),
        masses=(Mass(lower=(0.0,) * dimension, size=(length, across, across)[:dimension]),),
        floor_friction=0.4,
    )


def network_rows(*, rounds: int, sizes: int, device: str = "cpu") -> list[dict[str, str]]:
    """A row for each model that ships and each of so many sizes: seconds of a step; one thread, medians of rounds."""
    # Here, because `--help` and the processes that price a gradient do without PyTorch.
    import torch

    import gns
    from gns.initial import initial_state
    from gns.library import models

    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    rows = []
    for path in models():
        simulator = gns.load(path)
        # A model scales every scene to the body of its training data; as it is, a longer one has more nodes.
        simulator.settings = replace(simulator.settings, body_length=None)
        for length in LENGTHS[simulator.settings.dimension][:sizes]:
            initial = initial_state(body(simulator.settings.dimension, length), simulator.settings)
            state, conditions = initial.state.to(device), initial.conditions.to(device)
            friction = conditions.friction.clone().requires_grad_()
            conditions = replace(conditions, friction=friction)
            simulator.to(device)

            def forward() -> None:
                with torch.no_grad():
                    float(simulator(state, conditions).positions.sum())  # noqa: B023

            def backward() -> None:
                moved = simulator(state, conditions).positions.sum()  # noqa: B023
                # As a number, which waits for a GPU, as does the one above.
                float(torch.autograd.grad(moved, friction)[0].sum())  # noqa: B023

            forward()
            backward()
            own, both = (Spread([seconds_of(work) for _ in range(rounds)]) for work in (forward, backward))
            rows.append(
                {
                    "model": f"`{path.stem}`",
                    "nodes": f"{len(initial.indices):,}",
                    "forward [s]": own.written(4),
                    "with gradient [s]": both.written(4),
                    "µs per node": f"{1.0e6 * both.median / len(initial.indices):.0f}",
                }
            )
    torch.set_num_threads(threads)
    return rows


def bench(out: Path, *, quick: bool, keep: Path, rounds: int = 2) -> str:
    """Measure rates over sizes, the price of a gradient, a step of the network, a large terrain; needs a quiet machine.

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
    prices = [isolated(price, enlarged(*each), rounds) for each in (((0.5, 0.1),) if quick else SCALES)]
    networks = network_rows(rounds=rounds, sizes=1 if quick else 3)
    terrain = large.measured(keep, quick=quick)
    draw(out / "speed.png", rates, prices)
    return page(rates, prices, networks, terrain, rounds=rounds, quick=quick).write(out / "speed.md")


def page(
    rates: Rates,
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
        all. Medians of rounds in turn, in brackets minimum and maximum. Compilation (0.5 to 3 s the first time, kept on
        disk from then on) is not included.
    """)
    text.table(rate_rows(rates))
    text.text("Other codes on two cores of an AMD EPYC, not in this run (`validation/bench/speed.toml`):")
    others = read_toml(Path(__file__).with_suffix(".toml"))
    text.table(
        [{"": code["name"]} | dict(zip(others["columns"], code["rates"], strict=True)) for code in others["codes"]]
    )
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
