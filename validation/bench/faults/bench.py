"""`python -m validation.bench faults`: kills and full disks at many moments of commands that go on after them."""

import dataclasses
import os
import shutil
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TypeVar

from tqdm import tqdm

from datasets.command_line import WorkFailed
from datasets.errors import InputError
from datasets.files import write_json
from datasets.records import Record, from_mapping, read_json
from validation.bench.faults.breaking import ORPHANS, Full, Killed, fill, finish, kill, kill_other, mounted, used
from validation.bench.faults.commands import Command, Digest, commands
from validation.report.page import GNS, MPM, Page

NAMES = ("generate", "scheduler", "train", "loop", "bench")
MOMENTS, DISKS = 8, 4
WORKERS, RESTART_S = 2, 10.0
"""Of the scheduler; seconds in which one that was killed is back."""
ENOUGH = 2**28
"""Bytes of a disk on which every command has room."""

R = TypeVar("R", bound=Record)


@dataclass(frozen=True, kw_only=True)
class Worker(Record):
    """A run of a scheduler of which a worker got SIGKILL."""

    moment: float
    same: bool


@dataclass(frozen=True, kw_only=True)
class Found:
    """What happened to one command."""

    title: str
    killed: list[Killed]
    full: list[Full]
    workers: list[Worker]


def bench(
    out: Path, *, quick: bool, keep: Path, moments: int = MOMENTS, disks: int = DISKS, only: tuple[str, ...] = NAMES
) -> str:
    """Kill every command at moments of its work and give it disks too small; write OUT/reliability.md.

    Parameters
    ----------
    out
        Folder for reliability.md.
    quick
        One kill of one command.
    keep
        Folder of what was measured; what is there is not measured again.
    moments
        Kills of each command, evenly over its work.
    disks
        Sizes of a full disk of each command, evenly up to what it writes; needs the right to mount one.
    only
        Commands to break off: generate, scheduler, train, loop, bench; the page has all that there are.
    """
    if unknown := [name for name in only if name not in NAMES]:
        raise InputError(f"expected {', '.join(NAMES)}, got {unknown[0]}", where="--only")
    if min(moments, disks) < 1:
        raise InputError(f"expected at least one, got {min(moments, disks)}", where="--moments")
    if not Path("/proc/self/stat").exists():
        raise InputError("expected Linux, whose /proc shows the processes that are left")
    if quick:
        only, moments, disks = only[:1], 1, 1
    found = {}
    with scheduler("scheduler" in only) as (address, workers):
        known = commands(keep / "inputs", address)
        for name in NAMES:
            found[name] = measured(name, known[name], keep, moments, disks, workers, new=name in only)
    flags = "" if (moments, disks) == (MOMENTS, DISKS) else f" --moments {moments} --disks {disks}"
    return page([each for each in found.values() if each.killed], flags, quick=quick).write(out / "reliability.md")


def measured(
    name: str, command: Command, keep: Path, moments: int, disks: int, workers: Callable[[], int], *, new: bool
) -> Found:
    """What `keep` has of a command, and where it is asked for what it lacks."""
    folder, work = keep / name, keep / "work"
    if new:
        shutil.rmtree(work, ignore_errors=True)
        # The first may compile kernels.
        seconds = finish(command, work)
        shutil.rmtree(work)
        seconds = min(seconds, finish(command, work))
        expected, size = command.result(work), used(work)
        shares = [(number + 0.5) / moments for number in range(moments)]
        for number, share in enumerate(tqdm(shares, desc=f"{name}, kills", leave=False, disable=None)):
            path = folder / f"kill-{number + 1:02d}-of-{moments}.json"
            measure(path, partial(kill, command, work, share, seconds, expected))
            if name == "scheduler":
                path = folder / f"worker-{number + 1:02d}-of-{moments}.json"
                measure(path, partial(worker, command, work, share, seconds, expected, workers))
        fills(command, folder, keep / "disk", size, disks, expected)
        shutil.rmtree(work, ignore_errors=True)
    return Found(
        title=command.title,
        killed=stored(folder, "kill", Killed),
        full=stored(folder, "full", Full),
        workers=stored(folder, "worker", Worker),
    )


def fills(command: Command, folder: Path, disk: Path, size: int, disks: int, expected: Digest) -> None:
    """Give a command disks of sizes up to what it writes; none where this process may not mount one."""
    try:
        with mounted(disk, ENOUGH):
            pass
    except WorkFailed:
        return
    for number in tqdm(range(disks), desc="full disks", leave=False, disable=None):
        path = folder / f"full-{number + 1:02d}-of-{disks}.json"
        each = int(size * (number + 0.5) / disks)
        measure(path, partial(fill, command, disk, each, ENOUGH, expected))


def worker(
    command: Command, out: Path, share: float, seconds: float, expected: Digest, workers: Callable[[], int]
) -> Worker:
    """Kill a worker of the scheduler at a share of the work."""
    return Worker(moment=share, same=kill_other(command, out, share * seconds, workers) == expected)


def measure(path: Path, work: Callable[[], Killed | Full | Worker]) -> None:
    """Write what `work` finds to `path` where it is not there yet."""
    if not path.exists():
        write_json(path, dataclasses.asdict(work()))


def stored(folder: Path, name: str, kind: type[R]) -> list[R]:
    """All records of a kind."""
    return [from_mapping(kind, read_json(path) or {}) for path in sorted(folder.glob(f"{name}-*.json"))]


@contextmanager
def scheduler(asked: bool) -> Iterator[tuple[str, Callable[[], int]]]:
    """A scheduler with two workers on this machine, where asked for: address, number of a worker's process."""
    if not asked:
        yield "", os.getpid
        return
    from distributed import Client, LocalCluster

    def one_of_two() -> int:
        # A nanny that its worker died under while it started gives up, now and then: another one takes over.
        try:
            client.wait_for_workers(WORKERS, timeout=RESTART_S)
        except TimeoutError:
            cluster.scale(len(cluster.workers) + WORKERS - len(client.nthreads()))
            client.wait_for_workers(WORKERS)
        return int(next(iter(client.run(os.getpid).values())))

    with (
        LocalCluster(n_workers=WORKERS, threads_per_worker=1, dashboard_address=":0") as cluster,  # type: ignore[no-untyped-call]
        Client(cluster) as client,  # type: ignore[no-untyped-call]
    ):
        yield cluster.scheduler_address, one_of_two


def page(found: Sequence[Found], flags: str = "", *, quick: bool) -> Page:
    """The tables and their conclusion; flags: of the command that measured them."""
    killed = [record for each in found for record in each.killed]
    broken = [record for record in killed if record.working]
    full = [record for each in found for record in each.full if record.full]
    workers = [record for each in found for record in each.workers]
    conclusion = [
        f"{len(broken)} kills (SIGKILL) of {len(found)} commands in the middle of their work: "
        f"{sum(each.same for each in broken)} had the same results to the bit when the command was given again.",
        f"Processes left {ORPHANS:g} s after a kill: {sum(each.orphans for each in killed)}; the last one of all ended "
        f"{max(each.last_s for each in killed):.2f} s after it.",
        f"Unfinished files or locks left: {sum(each.left for each in killed) + sum(each.left for each in full)}.",
    ]
    if full:
        stated = sum(each.stated for each in full)
        conclusion.append(
            f"{len(full)} full disks: {stated} were stated in one line with exit status 1, "
            f"{sum(each.same for each in full)} had the same results once there was room."
        )
    if workers:
        same = sum(each.same for each in workers)
        conclusion.append(f"{len(workers)} kills of a scheduler's worker: {same} runs ended with the same files.")
    result = Page(
        "Reliability",
        command=f"python -m validation.bench faults{flags}",
        conclusion=conclusion,
        packages=MPM | GNS,
        quick=quick,
    )
    result.text(
        "Small commands, each in a session of its own (`validation/bench/faults/commands.py`). A moment is a share of "
        "the work, from when a command holds its folder to its end. The same results: every file of a dataset; weights "
        "and log of a training, without its minutes; verdict, answers and posterior of a loop; stored runs and tables "
        "of a page. A full disk is one in memory of a share of what the command writes, made larger afterwards."
    )
    result.table([row(each) for each in found])
    return result


def row(found: Found) -> dict[str, object]:
    """A line of the table."""
    killed, full = found.killed, [each for each in found.full if each.full]
    return {
        "command": found.title,
        "kills": str(len(killed)),
        "before the end": str(sum(each.working for each in killed)),
        "same results": str(sum(each.same for each in killed)),
        f"processes after {ORPHANS:g} s": str(sum(each.orphans for each in killed)),
        "last one ended after [s]": f"{max(each.last_s for each in killed):.2f}",
        "unfinished files": str(sum(each.left for each in killed)),
        "full disks": str(len(full)),
        "stated in a line": str(sum(each.stated for each in full)),
        "same results later": str(sum(each.same for each in full)),
    }
