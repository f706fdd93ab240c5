"""`python -m validation.bench adjoint`: what a gradient of the MPM's adjoint costs, and how it agrees with differences.

Price: seconds of a run and of a gradient, both on one thread, in turns; the median of the repetitions.
"""

import dataclasses
import json
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from datasets.files import write_json
from datasets.library import read_scene
from datasets.scene import Scene
from mpm.adjoint.gradient import pull_back
from mpm.adjoint.tape import Tape
from mpm.arrays.layout import Precision
from mpm.output.request import LAST
from mpm.simulation import simulate
from validation.bench.adjoint.agreement import agreement, coarse, flows
from validation.bench.adjoint.growth import CASES, QUICK, SCENE, Case, Usage, in_process
from validation.report.page import Page

COSINE, LENGTH = 0.99, 0.05
"""What is asked of a Jacobian: least cosine, greatest error of the length."""
PRICED: tuple[tuple[str, Precision], ...] = (("layers-10", "f32"), ("layers-10", "f64"), ("baffles-2", "f32"))
"""Scenes, as they ship, and precisions of the table of prices."""


def bench(out: Path, *, quick: bool = False, keep: Path, seeds: int = 16, shares: int = 10, repeats: int = 3) -> str:
    """seeds: jitters over which both Jacobians are averaged; shares: of the deposit; repeats: of

    each timing; keep: folder of what is done.
    """
    if quick:
        seeds, shares, repeats = 2, 4, 1
    prices = kept(keep / "price.json", partial(price_rows, repeats, quick=quick))
    grown = [
        kept(keep / f"growth-{number}.json", partial(growth, case))
        for number, case in enumerate(QUICK if quick else CASES)
    ]
    rows = [
        row
        for number, flow in enumerate(flows(seeds, shares, quick=quick))
        for row in kept(keep / f"agreement-{number}.json", partial(agreement, flow))
    ]
    page = Page(
        "The MPM's own adjoint",
        command=f"python -m validation.bench adjoint --seeds {seeds} --shares {shares} --repeats {repeats}",
        conclusion=[price_text(prices), growth_text([Usage(**each) for each in grown]), *agreement_texts(rows)],
        quick=quick,
    )
    page.section("Price")
    page.text("""
        A run of the solver, and a run with checkpoints, its replay and its reverse; on one thread, in turns. Memory is
        that of checkpoints, one segment's states and bars, beside the arrays of the run.
    """)
    page.table(
        prices,
        formats={"run [s]": ".2f", "gradient [s]": ".2f", "gradient / run": ".2f", "memory [MiB]": ".0f"},
    )
    page.section("Particles and steps")
    page.text(f"""
        A gradient of the mean x of `{SCENE}` on its own cells, longer and higher and for longer, on one thread, each in
        a process of its own. "Above the start" is the greatest resident size above that before, "whole" that of the
        process with Python and the compiled kernels. Checkpoints grow with the root of the steps as long as the budget
        allows (`mpm.adjoint.tape`).
    """)
    page.table([growth_row(Usage(**each)) for each in grown])
    page.section("Agreement")
    page.text("""
        Jacobians by the adjoint and by central differences of the same jitter seeds, each averaged over them: mean x of
        equal shares of the deposit in the order of x, or the toe. Differences over a finite step see the flow's corners
        blurred; the adjoint sees one side of each. Where only the finer step agrees, the flow itself bends between the
        two: a block whose speed is that of its neighbours begins to tear off. "Two halves" is the cosine between
        differences of every other seed
        and of the rest: what can be expected. The sign of local damping has a bounded slope in the reverse
        (`mpm.adjoint.grid`), and bars of lone particles that swing on their own are cut (`mpm.adjoint.tape.CUT`); "cut"
        is their share; the flow in 3D has steps at which no particle does (`mpm.adjoint.checks.lone_particle_step`).
    """)
    page.table(
        rows,
        formats={
            "cosine": ".4f",
            "length": ".3f",
            "cosine, one seed": ".3f",
            "differences, two halves of the seeds": ".4f",
            "cut": ".1e",
        },
    )
    return page.write(out / "adjoint.md")


def kept(path: Path, work: Callable[[], Any]) -> Any:
    """What `work` returns, or what it returned when it was done before, as JSON."""
    if not path.exists():
        write_json(path, work())
    return json.loads(path.read_text(encoding="utf-8"))


def price_text(prices: list[dict[str, Any]]) -> str:
    """The price of a gradient in runs."""
    ratios = [float(row["gradient / run"]) for row in prices]
    return (
        f"A gradient costs {min(ratios):.1f} to {max(ratios):.1f} times a run on the same thread, for any number of "
        "unknowns."
    )


def growth_text(grown: list[Usage]) -> str:
    """The smallest and the largest case, and whether the time of a particle's step stays what it was."""
    smallest, largest = min(grown, key=work), max(grown, key=work)
    each = [case.nanoseconds for case in grown]
    texts = [
        f"{case.particles:,} particles and {case.steps:,} steps take {case.extra / 2**20:,.0f} MiB (the whole process "
        f"{case.whole / 2**20:,.0f}) and {case.seconds:.0f} s"
        for case in (smallest, largest)
    ]
    return f"{'; '.join(texts)}: {min(each):.0f} to {max(each):.0f} ns for each particle and step."


def work(case: Usage) -> int:
    """Particles times steps."""
    return case.particles * case.steps


def growth_row(case: Usage) -> dict[str, str]:
    """A case as a line."""
    return {
        "particles": f"{case.particles:,}",
        "steps": f"{case.steps:,}",
        "gradient [s]": f"{case.seconds:.1f}",
        "ns per particle and step": f"{case.nanoseconds:.0f}",
        "tape [MiB]": f"{case.tape / 2**20:,.0f}",
        "above the start [MiB]": f"{case.extra / 2**20:,.0f}",
        "whole [MiB]": f"{case.whole / 2**20:,.0f}",
        "bytes per particle and root of steps": f"{case.extra / (case.particles * case.steps**0.5):.0f}",
    }


def agreement_texts(rows: list[dict[str, Any]]) -> list[str]:
    """How many Jacobians agree as asked, and the least of them."""
    good = [row for row in rows if row["cosine"] >= COSINE and abs(row["length"] - 1.0) <= LENGTH]
    worst = min(rows, key=lambda row: row["cosine"])
    found = [
        f"{len(good)} of {len(rows)} comparisons have a cosine of at least {COSINE:g} to central differences and a "
        f"length within {100.0 * LENGTH:g} %; the least cosine is {worst['cosine']:.4f}, {label(worst)}.",
    ]
    others = [f"{label(row)}: {row['cosine']:.4f}, {row['length']:.3f}" for row in rows if row not in good]
    return found + ([f"Beyond that (cosine, length): {'; '.join(others)}."] if others else [])


def label(row: dict[str, Any]) -> str:
    """A Jacobian and the step of the differences that it is held against."""
    return f"{row['Jacobian']}, {row['step']}"


def scene_of(name: str, *, quick: bool) -> Scene:
    """A shipped scene, with `quick` in coarse cells."""
    scene = read_scene(name)
    return coarse(scene) if quick else scene


def price_rows(repeats: int, *, quick: bool) -> list[dict[str, Any]]:
    """The table of prices."""
    return [price(name, precision, repeats, quick=quick) for name, precision in PRICED[: 1 if quick else None]]


def growth(case: Case) -> dict[str, Any]:
    """A case, measured."""
    return dataclasses.asdict(in_process(case))


def price(name: str, precision: Precision, repeats: int, *, quick: bool) -> dict[str, Any]:
    """A row of the table of prices; the first run and gradient only compile."""
    scene = scene_of(name, quick=quick)
    tapes: list[Tape] = []

    def forward() -> None:
        simulate(scene, record=LAST, precision=precision, threads=1)

    def gradient() -> None:
        tape = Tape([scene], [scene.frames - 1], precision=precision, threads=1)
        tapes[:] = [tape]
        pull_back(tape, [np.full(tape.positions().shape, 1.0 / tape.positions().size)])

    seconds: tuple[list[float], list[float]] = ([], [])
    for _ in range(repeats + 1):
        for work, times in zip((forward, gradient), seconds, strict=True):
            times.append(timed(work))
    run_s, gradient_s = (float(np.median(times[1:])) for times in seconds)
    (tape,) = tapes
    return {
        "scene": name,
        "precision": precision,
        "particles": tape.positions().shape[1],
        "steps": int(tape.steps.sum()),
        "run [s]": run_s,
        "gradient [s]": gradient_s,
        "gradient / run": gradient_s / run_s,
        "memory [MiB]": tape.bytes() / 2**20,
    }


def timed(work: Callable[[], None]) -> float:
    """Seconds that it took."""
    began = time.perf_counter()
    work()
    return time.perf_counter() - began
