"""What `python -m validation.bench.speed.bench mpm` measures: rates, what a scene does not need, shortcuts, a training set."""

import tempfile
import time
from pathlib import Path

from datasets.definitions.obstacle3d import OBSTACLE3D
from datasets.errors import InputError
from datasets.files import write_text
from mpm.generate import generate
from mpm.process import processors
from validation.bench.speed import gains, rates
from validation.bench.speed.page import page
from validation.report.timing import in_turn

NEEDS_ROUNDS = 2
"""Rounds of the shortest measurements, which tell the smallest differences apart, in one of the others."""
TRAJECTORIES = 20
"""Trajectories of Obstacle3D that are generated unless told otherwise."""


def measure(out: Path, *, rounds: int, trajectories: int) -> str:
    """Measure everything, leave OUT/speed.md, and return it. Raises InputError."""
    if not 0 <= trajectories <= OBSTACLE3D.size:
        raise InputError(f"expected 0 to {OBSTACLE3D.size} trajectories, got {trajectories}", key="--trajectories")
    begin = time.perf_counter()
    text = page(
        in_turn(rates.runs(rates.CASES), rounds, "rates"),
        in_turn(gains.need_runs(), NEEDS_ROUNDS * rounds, "needs"),
        in_turn(gains.shortcut_runs(), rounds, "shortcuts"),
        rounds=rounds,
        training=generation(trajectories) if trajectories else "",
    )
    text += f"\nAll of this took {time.perf_counter() - begin:.0f} s.\n"
    write_text(out / "speed.md", text)
    return text


def generation(count: int) -> str:
    """Generate some of Obstacle3D, and say what all of it would take."""
    jobs = processors()
    with tempfile.TemporaryDirectory() as folder:
        begin = time.perf_counter()
        generate(OBSTACLE3D, Path(folder), seed=0, count=count, jobs=jobs)
        seconds = time.perf_counter() - begin
        size = sum(path.stat().st_size for path in Path(folder).rglob("*.npz"))
    one, one_size, whole = seconds / count, size / count, OBSTACLE3D.size
    return f"""\
## A training set in 3D

`python -m mpm.generate obstacle3d --count {count} --jobs {jobs}`, with the start of the processes and the statistics:
{seconds:.0f} s and {size / 1.0e9:.2f} GB, {one:.2f} s and {one_size / 1.0e6:.0f} MB a trajectory.
All {whole:,} would take {one * whole / 60.0:.0f} minutes and {one_size * whole / 1.0e9:.0f} GB.
"""
