"""`python -m validation.bench cluster`: overhead of a scheduler for each trajectory, and what large work would take."""

import dataclasses
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from datasets.command_line import WorkFailed
from datasets.errors import InputError
from datasets.files import write_json
from datasets.particles import particle_count
from datasets.records import Record, from_mapping, read_json
from mpm import LAST, simulate
from mpm.process import processors
from mpm.resolution import particle_steps
from validation.bench.speed.rates import CUBE, column
from validation.report.memory import extra
from validation.report.page import Page, signed
from validation.report.process import isolated
from validation.report.timing import spread

WORKERS = (2, 4)
MOST = 0.05
"""Overhead for each trajectory that is asked for."""
LARGE_CELLS = 80
"""Per metre, of the 3D cube that is run on all threads."""
FRAMES = 4
TRAJECTORIES_3D = 100_000
PARTICLES = 100_000_000
SECONDS = 1.0
"""Of flow, of the run of so many particles."""


@dataclass(frozen=True, kw_only=True)
class Generation(Record):
    """A dataset that was made."""

    seconds: float
    size: int
    """Of its trajectories [bytes]."""


@dataclass(frozen=True, kw_only=True)
class LargeRun(Record):
    """A run of one large scene on all threads."""

    particles: int
    rate: float
    """Particle-steps a second."""
    memory: int | None
    """[bytes]."""


Pairs = dict[int, list[tuple[Generation, Generation]]]
"""By number of workers, in every round: by processes of this machine, and by a scheduler's workers."""


def bench(
    out: Path, *, quick: bool, keep: Path, trajectories: int = 12, trajectories_3d: int = 4, rounds: int = 3
) -> str:
    """Generate datasets with and without a scheduler, run a large scene; write OUT/cluster.md, return its conclusion.

    Parameters
    ----------
    out
        Folder for cluster.md.
    quick
        Two trajectories by two workers.
    keep
        Folder of what was measured; what is there is not measured again.
    trajectories
        Of `flow2d` for each number of workers, with a scheduler and without.
    trajectories_3d
        Of `obstacle3d`, on one process for each processor.
    rounds
        In each of which all datasets of `flow2d` are made.
    """
    if min(trajectories, trajectories_3d, rounds) < 1:
        message = f"expected at least one, got {min(trajectories, trajectories_3d, rounds)}"
        raise InputError(message, where="--trajectories")
    count, count_3d, rounds = (2, 1, 1) if quick else (trajectories, trajectories_3d, rounds)
    pairs: Pairs = {workers: [] for workers in (WORKERS[:1] if quick else WORKERS)}
    for number in range(rounds):
        for workers, each in pairs.items():
            name = f"{workers}-{count}-{number}"
            here = generated(keep / f"here-{name}", "flow2d", count, ["--jobs", str(workers)])
            there_known = (keep / f"there-{name}.json").exists()
            with nullcontext("") if there_known else scheduler(workers) as address:
                there = generated(keep / f"there-{name}", "flow2d", count, ["--scheduler", address])
            each.append((here, there))
    cores = processors()
    spatial = generated(keep / f"spatial-{count_3d}", "obstacle3d", count_3d, ["--jobs", str(cores)])
    path = keep / "large.json"
    large = measured_large() if (known := read_json(path)) is None else from_mapping(LargeRun, known)
    write_json(path, dataclasses.asdict(large))
    return page(pairs, count, spatial, count_3d, large, cores, quick=quick).write(out / "cluster.md")


def generated(folder: Path, name: str, count: int, flags: list[str]) -> Generation:
    """A dataset made by a command of its own; as `generation.json` says. Raises WorkFailed."""
    path = folder.with_suffix(".json")
    if (known := read_json(path)) is not None:
        return from_mapping(Generation, known)
    command = [sys.executable, "-m", "mpm.generate", name, "--count", str(count), "--out", str(folder), *flags]
    if subprocess.run(command, check=False, capture_output=True).returncode:
        raise WorkFailed(f"{' '.join(command)} failed")
    made = Generation(
        seconds=(read_json(folder / "generation.json") or {})["wall_s"],
        size=sum(each.stat().st_size for each in folder.rglob("*.npz")),
    )
    write_json(path, dataclasses.asdict(made))
    return made


@contextmanager
def scheduler(workers: int) -> Iterator[str]:
    """Address of a scheduler with workers on this machine."""
    from distributed import LocalCluster

    with LocalCluster(n_workers=workers, threads_per_worker=1, dashboard_address=":0") as cluster:  # type: ignore[no-untyped-call]
        yield cluster.scheduler_address


def measured_large() -> LargeRun:
    """The cube's first frames in a process of its own."""
    return isolated(run_large)


def run_large() -> LargeRun:
    """The cube's first frames, twice: the first run compiles."""
    scene = column(3, LARGE_CELLS, FRAMES)
    simulate(dataclasses.replace(scene, duration=scene.frame_dt), record=LAST)
    rates = []

    def work() -> None:
        summary = simulate(scene, record=LAST).summary
        rates.append(summary["particles"] * summary["steps"] / summary["wall_s"])

    memory = extra(work)
    return LargeRun(particles=particle_count(scene), rate=rates[0], memory=memory)


def page(
    pairs: Pairs,
    count: int,
    spatial: Generation,
    count_3d: int,
    large: LargeRun,
    cores: int,
    *,
    quick: bool,
) -> Page:
    """The table and what follows from it."""
    overheads = {
        workers: spread(there.seconds / here.seconds - 1.0 for here, there in each) for workers, each in pairs.items()
    }
    core_seconds = cores * spatial.seconds / count_3d
    scene = dataclasses.replace(column(3, cells_of(PARTICLES), 1), duration=SECONDS)
    steps = particle_steps(scene)
    hours = steps / large.rate / 3600.0
    memory = None if large.memory is None else large.memory / large.particles
    result = Page(
        "Many machines",
        command="python -m validation.bench cluster",
        conclusion=[
            *(
                f"Overhead of a scheduler for each trajectory, {workers} workers on {cores} cores: "
                f"{signed(each.median)} ({signed(each.minimum)} to {signed(each.maximum)}; asked: at most "
                f"{100 * MOST:g} %)."
                for workers, each in overheads.items()
            ),
            f"Extrapolated: {TRAJECTORIES_3D:,} trajectories of `obstacle3d` take "
            f"{TRAJECTORIES_3D * core_seconds / 3600.0:,.0f} core-hours and "
            f"{TRAJECTORIES_3D * spatial.size / count_3d / 1e12:.2f} TB.",
            f"Extrapolated: {SECONDS:g} s of a 3D flow of {particle_count(scene):,} particles takes {hours:,.0f} h on "
            f"{cores} cores" + ("." if memory is None else f" and {memory * particle_count(scene) / 2**30:,.0f} GiB."),
        ],
        quick=quick,
    )
    result.table(
        [
            {
                "workers": str(workers),
                "trajectories": str(count),
                "processes [s]": ", ".join(f"{here.seconds:.1f}" for here, _ in each),
                "scheduler [s]": ", ".join(f"{there.seconds:.1f}" for _, there in each),
                "overhead": signed(overheads[workers].median),
            }
            for workers, each in pairs.items()
        ]
    )
    result.text(
        f"`mpm.generate flow2d --count {count}` with `--jobs` and with `--scheduler` of as many workers, all on this "
        "machine and in turn; wall time from `generation.json`. Both compile in it; processes start in it, while the "
        "workers of the scheduler were there, which is why these may take less. "
        f"3D: {count_3d} trajectories of `obstacle3d` in {spatial.seconds:.0f} s with `--jobs {cores}`, "
        f"{core_seconds:.1f} core-seconds and {spatial.size / count_3d / 2**20:.1f} MiB each. "
        f"Large: a cube of sand of {CUBE:g} m and {large.particles:,} particles on {cores} threads, "
        f"{large.rate / 1e6:.1f} million particle-steps a second"
        + (". " if memory is None else f", {memory:.0f} bytes a particle. ")
        + f"The run of {particle_count(scene):,} particles is the same cube on smaller cells, {steps:.2g} "
        "particle-steps; that the rate stays the same, and grows with the cores, is assumed. A single run is on one "
        "machine: a scheduler spreads runs, never one run."
    )
    return result


def cells_of(particles: int) -> int:
    """Cells per metre at which the cube has at least so many particles, 8 in a cell."""
    return int(np.ceil((particles / 8.0) ** (1.0 / 3.0) / CUBE))
