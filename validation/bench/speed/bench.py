"""python -m validation.bench.speed.bench mpm|gns|memory --out DIR: how fast, on what, and what for."""

import sys
from pathlib import Path
from typing import Literal

from datasets.command_line import run
from datasets.errors import InputError
from validation.bench.speed import gns as speed_gns
from validation.bench.speed import memory
from validation.bench.speed import mpm as speed_mpm

FLAGS = {
    "mpm": {"--rounds", "--trajectories"},
    "gns": {"--rounds", "--longest", "--threads"},
    "memory": {"--full", "--threads"},
}
"""What may be said of each subject."""


def command(
    subject: Literal["mpm", "gns", "memory"],
    /,
    *,
    out: Path,
    rounds: int | None = None,
    trajectories: int | None = None,
    longest: float | None = None,
    threads: int | None = None,
    full: bool = False,
) -> None:
    """Measure how fast the MPM is, how fast the learned simulator is, or what memory its gradient takes.

    mpm: over sizes, dimensions, threads and precisions, and what it saves; three minutes. gns: seconds and memory of a
    step beside a textbook's network, over sizes; four minutes. memory: of a gradient over points and steps; five.

    Parameters
    ----------
    subject
        What is measured: mpm, gns or memory.
    out
        Folder for speed.md, speed-gns.md or memory.md.
    rounds
        mpm, gns: how often everything is measured, in turn; the tables give the median and the range. 3 unless given.
    trajectories
        mpm: how many of Obstacle3D are generated to estimate the whole, 20 unless given; none with 0.
    longest
        gns: steps of the textbook's that would take longer [s] are left out; 5 unless given.
    threads
        gns, memory: threads of PyTorch; 1 unless given.
    full
        memory: the gradients of many minutes too, 20,000 points through 400 steps among them.
    """
    given = {
        "--rounds": rounds,
        "--trajectories": trajectories,
        "--longest": longest,
        "--threads": threads,
        "--full": full or None,
    }
    for key, value in given.items():
        if value is None:
            continue
        if key not in FLAGS[subject]:
            raise InputError(f"expected one of {', '.join(sorted(FLAGS[subject]))} for {subject}", key=key)
        if key in ("--rounds", "--threads") and value < 1:
            raise InputError(f"expected at least 1, got {value}", key=key)
    if longest is not None and not longest > 0.0:
        raise InputError(f"expected a positive number of seconds, got {longest:g}", key="--longest")
    threads, rounds = threads or 1, rounds or 3
    if subject == "mpm":
        wanted = speed_mpm.TRAJECTORIES if trajectories is None else trajectories
        print(speed_mpm.measure(out, rounds=rounds, trajectories=wanted))
    elif subject == "gns":
        longest = speed_gns.LONGEST if longest is None else longest
        print(speed_gns.measure(out, rounds=rounds, longest=longest, threads=threads))
    else:
        print(memory.measure(out, full=full, threads=threads))


if __name__ == "__main__":
    sys.exit(run(command, "python -m validation.bench.speed.bench"))
