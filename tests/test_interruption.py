"""Kills and full disks in the middle of commands: the same command afterwards gives the same results.

What a training promises is less: given again with --resume, it goes on to its end. Linux alone, whose /proc shows the
processes that are left; a full disk is one in memory, which takes the right to mount one.
"""

import os
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import pytest

from tests import breaking
from tests.breaking import Digest, orphans, start, unfinished, wait_for_work
from tests.gns.conftest import TINY

pytestmark = [pytest.mark.slow, pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="expects Linux")]
MOMENTS = 4
"""Of each command and signal, evenly over its work: with three commands and three signals about forty kills."""
DISKS = 5  # sizes of a full disk of each command: fifteen in all
ENOUGH = 2**28  # bytes of a disk on which every command has room
PAGE = 4096  # bytes in which a disk in memory counts


def finished(arguments: list[str], out: Path) -> float:
    """Run a command to its end; seconds from when it held its folder."""
    process = start(arguments)
    began = wait_for_work(process, out)
    _, error = process.communicate(timeout=breaking.LIMIT)
    # A loop without a confirmed answer ends with 1.
    assert process.returncode in (0, 1), error
    assert "Traceback" not in error
    return time.monotonic() - began


@dataclass(frozen=True, kw_only=True)
class Command:
    """A command, which goes on where it was broken off when it is given again."""

    arguments: Callable[[Path], list[str]]  # what to hand to Python, for results in a folder
    result: Callable[[Path], Digest]  # what is to be the same, of the results in a folder
    expected: Digest  # that of a run that was never broken off
    seconds: float  # of its work, from when it held its folder
    size: int  # what it writes [bytes]

    def check(self, out: Path) -> None:
        """Give it again: nothing is left over, and the results are those of a run that was never broken off."""
        finished(self.arguments(out), out)
        assert unfinished(out) == []
        assert self.result(out) == self.expected


@pytest.fixture(scope="module", params=["generate", "train", "loop"])
def command(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Command:
    """A small command of every kind that leaves files from which it goes on."""
    folder = tmp_path_factory.mktemp(request.param)
    for name in ("blocks", "scene", "problem"):
        (folder / f"{name}.toml").write_text(getattr(breaking, name.upper()))
    generate = ["-m", "mpm.generate", str(folder / "blocks.toml"), "--jobs", "2"]
    if request.param == "train":
        made = start([*generate, "--out", str(folder / "dataset")])
        made.communicate(timeout=breaking.LIMIT)
        assert made.returncode == 0

    def train(out: Path) -> list[str]:
        resume = ["--resume"] if (out / "last.pt").exists() else []
        flags = [str(folder / "dataset"), "--out", str(out), *TINY, "--updates", "12", "--validations", "4"]
        return ["-m", "gns.train", *flags, *resume]

    problem = str(folder / "problem.toml")
    arguments, result = {
        "generate": (lambda out: [*generate, "--out", str(out)], breaking.dataset_files),
        "train": (train, breaking.trained),
        "loop": (lambda out: ["-m", "validation.loop", problem, "--out", str(out)], breaking.answer),
    }[request.param]
    # The first run may compile kernels.
    finished(arguments(folder / "first"), folder / "first")
    seconds, whole = finished(arguments(folder / "whole"), folder / "whole"), folder / "whole"
    size = sum(-(-path.stat().st_size // PAGE) * PAGE for path in whole.rglob("*") if path.is_file())
    return Command(arguments=arguments, result=result, expected=result(whole), seconds=seconds, size=size)


@pytest.mark.parametrize("moment", range(MOMENTS))
@pytest.mark.parametrize("kill", [signal.SIGKILL, signal.SIGTERM, signal.SIGINT])
def test_a_command_that_is_killed_goes_on(command: Command, kill: signal.Signals, moment: int, tmp_path: Path) -> None:
    out = tmp_path / "out"
    process = start(command.arguments(out))
    began = wait_for_work(process, out)
    time.sleep(max(0.0, (moment + 0.5) / MOMENTS * command.seconds - (time.monotonic() - began)))
    if kill == signal.SIGINT:  # a terminal sends Ctrl-C to all of them
        os.killpg(process.pid, kill)
    else:
        process.send_signal(kill)
    _, error = process.communicate(timeout=breaking.LIMIT)
    assert orphans(process.pid) == []
    if kill != signal.SIGKILL and process.returncode == -kill:  # it was done, and closing down
        assert command.result(out) == command.expected
    elif kill != signal.SIGKILL and process.returncode not in (0, 1):
        assert process.returncode == 128 + kill
        # Python's own process that watches over semaphores may say something after it.
        assert any(line.startswith("talus: interrupted") for line in error.splitlines())
        assert unfinished(out) == []
    command.check(out)


@pytest.mark.parametrize("share", [(number + 0.5) / DISKS for number in range(DISKS)])
def test_a_full_disk_is_stated_in_a_line(command: Command, share: float, tmp_path: Path) -> None:
    with mounted(tmp_path / "disk", int(share * command.size)) as disk:
        out = disk / "out"
        process = start(command.arguments(out))
        _, error = process.communicate(timeout=breaking.LIMIT)
        lines = error.replace("\r", "\n").strip().splitlines()
        assert process.returncode == 1
        assert "Traceback" not in error
        assert lines[-1].startswith("talus: ")
        assert "No space left" in lines[-1]
        system("mount", "-o", f"remount,size={ENOUGH}", str(disk))
        command.check(out)


@contextmanager
def mounted(disk: Path, size: int) -> Iterator[Path]:
    """A disk in memory of `size` bytes; the test is skipped where this process may not mount one."""
    disk.mkdir(parents=True)
    try:
        system("mount", "-t", "tmpfs", "-o", f"size={size}", "talus", str(disk))
    except (OSError, subprocess.CalledProcessError):
        pytest.skip("expects the right to mount a disk")
    try:
        yield disk
    finally:
        system("umount", str(disk))


def system(*command: str) -> None:
    """Run a command of the system."""
    subprocess.run(command, check=True, capture_output=True, text=True)
