"""Break a command off: by SIGKILL at a moment of its work, or by a disk of a size; then let it go on. Linux alone."""

import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from datasets.command_line import WorkFailed
from datasets.files import PART
from datasets.lock import LOCK
from datasets.records import Record
from validation.bench.faults.commands import Command, Digest

ORPHANS = 5.0
"""Seconds after which no process of a killed command may be left."""
LIMIT = 300.0
"""Seconds after which a command hangs."""
PAGE = 4096
"""Bytes in which a disk in memory counts."""


@dataclass(frozen=True, kw_only=True)
class Killed(Record):
    """A command that got SIGKILL."""

    moment: float
    """Share of its work, from when it held its folder to its end."""
    working: bool
    """It had not come to its end before."""
    orphans: int
    """Processes of it that were left after ORPHANS."""
    last_s: float
    """Seconds after which its last process had ended."""
    left: int
    """Files that were still being written, or locks, once it had gone on to its end."""
    same: bool
    """It then had the results of one that was never broken off."""


@dataclass(frozen=True, kw_only=True)
class Full(Record):
    """A command on a disk that was too small."""

    size: int
    """Of the disk [bytes]."""
    full: bool
    """The disk was full before the end."""
    stated: bool
    """It said so in one line, with exit status 1 and no traceback."""
    left: int
    same: bool
    """As of `Killed`, once the disk was larger."""


def finish(command: Command, out: Path) -> float:
    """Run a command to its end; seconds from when it held its folder. Raises WorkFailed."""
    process = start(command, out)
    seconds = -wait_for_work(process, out)
    _, error = process.communicate(timeout=LIMIT)
    seconds += time.monotonic()
    if process.returncode not in command.ended:
        raise WorkFailed(f"{command.title} ended with status {process.returncode}: {error.splitlines()[-1:]}")
    return seconds


def kill(command: Command, out: Path, moment: float, work_s: float, expected: Digest) -> Killed:
    """Run a command, kill it after the share `moment` of its `work_s` seconds, run it again. Raises WorkFailed."""
    shutil.rmtree(out, ignore_errors=True)
    process = start(command, out)
    began = wait_for_work(process, out)
    time.sleep(max(0.0, moment * work_s - (time.monotonic() - began)))
    working = process.poll() is None
    process.send_signal(signal.SIGKILL)
    process.communicate()
    orphans, last_s = wait_for_orphans(process.pid)
    finish(command, out)
    return Killed(
        moment=moment,
        working=working,
        orphans=orphans,
        last_s=last_s,
        left=len(unfinished(out)),
        same=command.result(out) == expected,
    )


def kill_other(command: Command, out: Path, wait_s: float, victim: Callable[[], int]) -> Digest:
    """Run a command, kill the process that `victim` names while it works, and return its results."""
    shutil.rmtree(out, ignore_errors=True)
    process = start(command, out)
    wait_for_work(process, out)
    time.sleep(wait_s)
    os.kill(victim(), signal.SIGKILL)
    _, error = process.communicate(timeout=LIMIT)
    if process.returncode not in command.ended:
        raise WorkFailed(f"{command.title} ended with status {process.returncode}: {error.splitlines()[-1:]}")
    return command.result(out)


def fill(command: Command, disk: Path, size: int, enough: int, expected: Digest) -> Full:
    """Run a command on a disk of `size` bytes, then again on one of `enough`. Raises WorkFailed."""
    with mounted(disk, size):
        out = disk / "out"
        process = start(command, out)
        _, error = process.communicate(timeout=LIMIT)
        lines = error.replace("\r", "\n").strip().splitlines()
        full = "No space left" in error
        stated = process.returncode == 1 and lines[-1].startswith("talus: ") and "No space left" in lines[-1]
        run("mount", "-o", f"remount,size={enough}", str(disk))
        finish(command, out)
        return Full(
            size=size,
            full=full,
            stated=stated and "Traceback" not in error,
            left=len(unfinished(out)),
            same=command.result(out) == expected,
        )


def start(command: Command, out: Path) -> "subprocess.Popen[str]":
    """A command in a session of its own, so that its processes are known."""
    return subprocess.Popen(
        [sys.executable, *command.arguments(out)],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


def wait_for_work(process: "subprocess.Popen[str]", out: Path) -> float:
    """Wait until a command holds its folder, or ends; the time of it on the monotonic clock [s]."""
    while process.poll() is None and not (out.exists() and next(out.rglob(LOCK), None)):
        time.sleep(0.002)
    return time.monotonic()


def wait_for_orphans(session: int) -> tuple[int, float]:
    """How many processes of a session are left after ORPHANS seconds, and when the last one had ended [s].

    Those that are left are ended.
    """
    began = time.monotonic()
    while (elapsed := time.monotonic() - began) < ORPHANS:
        if not members(session):
            return 0, elapsed
        time.sleep(0.01)
    orphans = members(session)
    for number in orphans:
        os.kill(number, signal.SIGKILL)
    return len(orphans), ORPHANS


def members(session: int) -> list[int]:
    """Numbers of the processes of a session, without those that have ended and are not yet waited for."""
    found = []
    for path in Path("/proc").glob("[0-9]*/stat"):
        try:
            # Behind the name, which stands in parentheses: state, parent, process group, session.
            fields = path.read_text(encoding="utf-8").rpartition(")")[2].split()
        except (FileNotFoundError, ProcessLookupError):
            continue
        if int(fields[3]) == session and fields[0] != "Z":
            found.append(int(path.parent.name))
    return found


def unfinished(out: Path) -> list[Path]:
    """Parts of files, and locks, in a folder of results."""
    return [path for path in out.rglob(".*") if path.name.startswith((PART, LOCK))]


def used(folder: Path) -> int:
    """Bytes that the files of a folder take on a disk in memory."""
    return sum(-(-path.stat().st_size // PAGE) * PAGE for path in folder.rglob("*") if path.is_file())


@contextmanager
def mounted(disk: Path, size: int) -> Iterator[None]:
    """A disk in memory of `size` bytes. Raises WorkFailed where this process may not mount one."""
    disk.mkdir(parents=True, exist_ok=True)
    run("mount", "-t", "tmpfs", "-o", f"size={size}", "talus", str(disk))
    try:
        yield
    finally:
        run("umount", str(disk))


def run(*command: str) -> None:
    """Run a command of the system. Raises WorkFailed."""
    try:
        subprocess.run(command, check=True, capture_output=True, text=True)
    except (OSError, subprocess.CalledProcessError) as error:
        raise WorkFailed(f"{' '.join(command)}: {getattr(error, 'stderr', None) or error}") from None
