"""`python -m validation.bench adjoint`: what a gradient of the MPM's adjoint costs, and how it agrees with differences.

Price: seconds of a run and of a gradient, both on one thread, in turns; the median of the repetitions. Agreement: the
Jacobian of the deposit's shares (mean x of equal parts of the particles, in the order of x) with respect to the ten
layers' velocities, by the adjoint and by central differences, each averaged over jitter seeds:

    cosine = A : B / (|A| |B|),    length = |A| / |B|        of the Jacobians A (adjoint) and B (differences)
"""

import dataclasses
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from datasets.library import read_scene
from datasets.scene import Scene
from mpm.adjoint.gradient import pull_back
from mpm.adjoint.tape import Tape
from mpm.arrays.layout import Precision
from mpm.output.request import LAST
from mpm.simulation import simulate, simulate_many
from validation.report.page import Page

Floats = NDArray[np.float64]

STEP = 0.15
"""Of the central differences [m/s]."""
PRICED: tuple[tuple[str, Precision], ...] = (("layers-10", "f32"), ("layers-10", "f64"), ("baffles-2", "f32"))
"""Scenes, as they ship, and precisions of the table of prices."""
COARSE = 0.02
"""Cell [m] of the ten layers with `--quick`."""


def bench(out: Path, *, quick: bool = False, keep: Path, seeds: int = 16, shares: int = 20, repeats: int = 3) -> str:
    """seeds: jitters over which both Jacobians are averaged; shares: of the deposit; repeats: of each timing."""
    if quick:
        seeds, shares, repeats = 2, 4, 1
    prices = [price(name, precision, repeats, quick=quick) for name, precision in PRICED[: 1 if quick else None]]
    layers = scene_of("layers-10", quick=quick)
    kinds = {"as shipped": layers, "without damping": dataclasses.replace(layers, damping=0.0)}
    rows = [{"flow": kind, **agreement(scene, seeds, shares)} for kind, scene in kinds.items()]
    ratios = [float(row["gradient / run"]) for row in prices]
    page = Page(
        "The MPM's own adjoint",
        command=f"python -m validation.bench adjoint --seeds {seeds} --shares {shares} --repeats {repeats}",
        conclusion=[
            f"A gradient costs {min(ratios):.1f} to {max(ratios):.1f} times a run on the same thread, for any number "
            "of unknowns.",
            *(
                f"Ten layers {row['flow']}: cosine {row['cosine']:.4f} to central differences, length "
                f"{row['length']:.3f}; without an average over seeds {row['cosine, one seed']:.3f}."
                for row in rows
            ),
        ],
        quick=quick,
    )
    page.section("Price")
    page.text("""
        A run of the solver, and a run with checkpoints, its replay and its reverse; on one thread, in turns. Memory is
        that of checkpoints, one segment's states and adjoints, beside the arrays of the run.
    """)
    page.table(
        prices,
        formats={"run [s]": ".2f", "gradient [s]": ".2f", "gradient / run": ".2f", "memory [MiB]": ".0f"},
    )
    page.section("Agreement")
    page.text(f"""
        The Jacobian of {shares} equal shares of the deposit with respect to ten velocities, averaged over {seeds}
        jitter seeds, beside central differences of {STEP:g} m/s of the same seeds. Differences over a finite step see
        the flow's corners blurred; the adjoint sees one side of each. The sign of local damping has a bounded slope
        in the reverse (`mpm.adjoint.grid`), and adjoints of lone particles that swing on their own are cut
        (`mpm.adjoint.tape.CUT`); "cut" is their share.
    """)
    page.table(
        rows,
        formats={
            "cosine": ".4f",
            "length": ".3f",
            "cosine, one seed": ".3f",
            "cosine, worst share": ".3f",
            "cut": ".1e",
        },
    )
    return page.write(out / "adjoint.md")


def scene_of(name: str, *, quick: bool) -> Scene:
    """A shipped scene, with `quick` in coarse cells."""
    scene = read_scene(name)
    domain = dataclasses.replace(scene.domain, cell=COARSE) if quick else scene.domain
    return dataclasses.replace(scene, domain=domain)


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


def agreement(scene: Scene, seeds: int, shares: int) -> dict[str, float]:
    """A row of the table of agreements."""
    ours, theirs, cut = [], [], []
    for seed in tqdm(range(seeds), unit="seed"):
        own = dataclasses.replace(scene, seed=seed)
        jacobian, lost = by_adjoint(own, shares)
        ours.append(jacobian)
        theirs.append(by_differences(own, shares))
        cut.append(lost)
    mean, reference = np.mean(ours, axis=0), np.mean(theirs, axis=0)
    return {
        "cosine": cosine(mean, reference),
        "length": float(np.linalg.norm(mean) / np.linalg.norm(reference)),
        "cosine, worst share": min(cosine(row, other) for row, other in zip(mean, reference, strict=True)),
        "cosine, one seed": float(np.mean([cosine(each, reference) for each in ours])),
        "cut": float(np.mean(cut)),
    }


def cosine(a: Floats, b: Floats) -> float:
    """Of two arrays as vectors."""
    return float(np.sum(a * b) / (np.linalg.norm(a) * np.linalg.norm(b)))


def by_adjoint(scene: Scene, shares: int) -> tuple[Floats, float]:
    """Jacobian of the shares with respect to the masses' velocities along x [s], [shares, masses]; what was cut."""
    tape = Tape([scene], [scene.frames - 1], precision="f32", threads=1, outputs=shares)
    positions = tape.positions()
    adjoints = np.zeros((shares, *positions.shape))
    for share, members in enumerate(np.array_split(np.argsort(positions[-1, :, 0], kind="stable"), shares)):
        adjoints[share, -1, members, 0] = 1.0 / len(members)
    gradients = pull_back(tape, list(adjoints))
    rows = [each.of_mass(each.velocities)[:, 0] for each in gradients]
    return np.array(rows), max(each.cut for each in gradients)


def by_differences(scene: Scene, shares: int) -> Floats:
    """The same by central differences of STEP, the runs side by side."""
    masses = range(len(scene.masses))
    scenes = [pushed(scene, mass, sign * STEP) for sign in (1.0, -1.0) for mass in masses]
    numbers = []
    for run in simulate_many(scenes, record=LAST):
        parts = np.array_split(np.sort(run.positions[-1, :, 0].astype(np.float64)), shares)
        numbers.append([part.mean() for part in parts])
    ahead, behind = np.split(np.array(numbers), 2)
    return np.asarray((ahead - behind).T / (2.0 * STEP))


def pushed(scene: Scene, mass: int, change: float) -> Scene:
    """`scene` with one mass faster along x by `change` [m/s]."""
    masses = list(scene.masses)
    velocity = masses[mass].velocity or (0.0,) * scene.dimension
    masses[mass] = dataclasses.replace(masses[mass], velocity=(velocity[0] + change, *velocity[1:]))
    return dataclasses.replace(scene, masses=tuple(masses))
