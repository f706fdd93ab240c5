"""Seconds and memory of a gradient as the scene grows: the tall column on the same cells, each case a process."""

import json
import signal
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from tqdm import tqdm

from datasets.command_line import WorkFailed
from inverse.forward.gns import MEMORY_GIB
from validation.bench.efficiency.cuts import AD, FD_GNS, FD_MPM
from validation.bench.efficiency.rows import Cost
from validation.bench.efficiency.scene_run import Took, Work

UNKNOWNS = (1, 10)
WHOLE_S = 1.0
"""How long the flow lasts [s]."""


@dataclass(frozen=True, kw_only=True)
class Size:
    """A column and how much of its gradients is run; the rest is multiplied."""

    times: float
    """As long and as high as the paper's."""
    gns_s: float = WHOLE_S
    """Simulated time that the GNS is run for [s]."""
    most_runs: int = 2 * UNKNOWNS[-1]
    """Most runs of the MPM side by side."""


SIZES = (Size(times=1.0), Size(times=2.0), Size(times=5.6, gns_s=0.1, most_runs=2))
"""3,200, 12,800 and 100,352 points."""
QUICK = (Size(times=1.0, gns_s=0.1, most_runs=2),)


@dataclass(frozen=True, kw_only=True)
class Case:
    """What a process of its own runs."""

    work: Work
    times: float
    duration: float = WHOLE_S
    runs: int = 2
    memory_gib: float = MEMORY_GIB


Run = Callable[[Case], Took]


def over_points(run: Run, sizes: Sequence[Size] = SIZES) -> tuple[Cost, ...]:
    """Every gradient in every size, one after the other."""
    found: list[Cost] = []
    with tqdm(total=len(sizes) * 3, desc="points", unit="case", dynamic_ncols=True) as bar:
        for size in sizes:
            for cost in (by_ad, by_gns, by_mpm):
                bar.set_postfix_str(f"{size.times:g} times the column")
                found += cost(run, size)
                bar.update()
    return tuple(found)


def by_ad(run: Run, size: Size) -> list[Cost]:
    """Forward and backward, once, whatever the number of unknowns."""
    whole = size.gns_s >= WHOLE_S
    # What is multiplied keeps no activations: a few steps would keep a larger share of theirs than all do.
    case = Case(work=Work.AD, times=size.times, duration=size.gns_s, memory_gib=MEMORY_GIB if whole else 0.0)
    took = run(case)
    share = WHOLE_S / size.gns_s
    # The states that the missing steps would leave behind.
    states = round(took.steps * (share - 1.0)) * took.state
    measured = "" if whole else f"{took.steps} steps forward and backward"
    return [
        Cost(
            method=AD,
            points=took.points,
            followed=took.followed,
            unknowns=unknowns,
            seconds=(took.forward + took.rest) * share,
            memory=took.extra + states,
            measured=measured,
        )
        for unknowns in UNKNOWNS
    ]


def by_gns(run: Run, size: Size) -> list[Cost]:
    """Rollouts one after the other: one, and two more for each unknown."""
    took = run(Case(work=Work.GNS, times=size.times, duration=size.gns_s))
    part = "one rollout" if size.gns_s >= WHOLE_S else f"{took.steps} steps of one rollout"
    return [
        Cost(
            method=FD_GNS,
            points=took.points,
            followed=took.followed,
            unknowns=unknowns,
            seconds=(1 + 2 * unknowns) * took.forward * WHOLE_S / size.gns_s,
            memory=took.extra,
            measured=part,
        )
        for unknowns in UNKNOWNS
    ]


def by_mpm(run: Run, size: Size) -> list[Cost]:
    """One run, then two more for each unknown side by side."""
    found = []
    known: dict[int, Took] = {}
    for unknowns in UNKNOWNS:
        wanted = 2 * unknowns
        runs = min(wanted, size.most_runs)
        if runs not in known:
            known[runs] = run(Case(work=Work.MPM, times=size.times, runs=runs))
        took = known[runs]
        found.append(
            Cost(
                method=FD_MPM,
                points=took.points,
                followed=took.followed,
                unknowns=unknowns,
                seconds=took.forward + took.rest * wanted / runs,
                # Runs side by side each hold points and frames of their own.
                memory=took.extra * wanted // runs,
                measured="" if runs == wanted else f"{runs} of {wanted} runs side by side",
            )
        )
    return found


def apart(case: Case, model: Path, threads: int) -> Took:
    """Run a case in a process of its own. Raises WorkFailed."""
    arguments = [
        *(case.work.value, f"{case.times:g}"),
        *("--duration", f"{case.duration:g}", "--runs", str(case.runs), "--memory-gib", f"{case.memory_gib:g}"),
        *("--model", str(model), "--threads", str(threads)),
    ]
    done = subprocess.run(
        [sys.executable, "-m", "validation.bench.efficiency.scene_run", *arguments],
        capture_output=True,
        text=True,
        check=False,
    )
    what = f"{case.work}, {case.times:g} times the column"
    if done.returncode == -signal.SIGKILL:
        raise WorkFailed(f"{what}: killed, out of memory")
    if done.returncode != 0:
        raise WorkFailed(f"{what}: {' '.join(done.stderr.strip().splitlines()[-1:])}")
    return Took(**json.loads(done.stdout))
