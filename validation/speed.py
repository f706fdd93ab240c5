"""python -m validation.speed mpm --out DIR: how fast, on what, and what for."""

import sys
import tempfile
import time
from pathlib import Path
from typing import Literal

from datasets.command_line import run
from datasets.errors import InputError
from datasets.files import write_text
from datasets.obstacle3d import OBSTACLE3D
from mpm.generate import generate
from mpm.processors import processors
from validation import gains, rates
from validation.speed_page import page
from validation.timing import in_turn

NEEDS_ROUNDS = 2
"""Rounds of the shortest measurements, which tell the smallest differences apart, in one of the others."""


def command(subject: Literal["mpm"], /, *, out: Path, rounds: int = 3, trajectories: int = 20) -> None:
    """Measure how fast the MPM is, over sizes, dimensions, threads and precisions, and what it saves; three minutes.

    Parameters
    ----------
    subject
        What is measured: mpm.
    out
        Folder for speed.md.
    rounds
        How often everything is measured, in turn; the tables give the median and the range.
    trajectories
        How many of Obstacle3D are generated to estimate the whole; none with 0.
    """
    if rounds < 1:
        raise InputError(f"expected at least 1 round, got {rounds}", key="--rounds")
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
    print(text)


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


if __name__ == "__main__":
    sys.exit(run(command, "python -m validation.speed"))
