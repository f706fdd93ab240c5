"""Exit statuses, one line for a mistake, signals that wait or break off, and children that end with their parent."""

import errno
import os
import signal
import subprocess
import sys
from pathlib import Path

import psutil
import pytest

from datasets.command_line import run
from datasets.errors import InputError, WorkFailed
from datasets.processes import Terminated, stopping

ROOT = Path(__file__).parents[2]
SPAWNED = """
import sys, time
from multiprocessing import get_context
from datasets import processes

def work(pipe):
    sys.platform = {platform!r}
    processes.end_with_parent()
    pipe.send(None)
    time.sleep(60.0)

if __name__ == "__main__":
    here, there = get_context("spawn").Pipe()
    child = get_context("spawn").Process(target=work, args=(there,))
    child.start()
    here.recv()
    print(child.pid, flush=True)
    time.sleep(60.0)
"""


def command(scene: str, *, out: Path, count: int = 1) -> int | None:
    """Do what `scene` says."""
    match scene:
        case "wrong":
            raise InputError("expected better", where="scene.toml", key="masses[0]")
        case "failing":
            raise WorkFailed("the points left the domain")
        case "interrupted":
            raise KeyboardInterrupt
        case "terminated":
            signal.raise_signal(signal.SIGTERM)
        case "full":
            raise OSError(errno.ENOSPC, "No space left on device", "out/a.npz")
        case "status":
            return 1
    return None


@pytest.mark.parametrize(
    ("arguments", "status", "line"),
    [
        (["good", "--out", "x"], 0, ""),
        (["status", "--out", "x"], 1, ""),
        (["failing", "--out", "x"], 1, "talus: the points left the domain\n"),
        (["wrong", "--out", "x"], 2, "talus: scene.toml: masses[0]: expected better\n"),
        (["interrupted", "--out", "x"], 130, "talus: interrupted; what was finished is kept\n"),
        (["terminated", "--out", "x"], 143, "talus: interrupted; what was finished is kept\n"),
        (["full", "--out", "x"], 1, "talus: out/a.npz: No space left on device; what was finished is kept\n"),
        (["good"], 2, "--out"),
        (["good", "--out", "x", "--cuont", "3"], 2, "--count"),
        (["good", "--out", "x", "--count", "few"], 2, "few"),
        (["good", "--out", "x", "--count", "8.5"], 2, "expected an integer, got 8.5"),
    ],
)
def test_exit_status(arguments: list[str], status: int, line: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(command, "do", arguments) == status
    error = capsys.readouterr().err
    assert line in error
    assert error.count("\n") == (1 if line else 0)


@pytest.mark.parametrize("mistake", [ZeroDivisionError(), FileNotFoundError(errno.ENOENT, "No such file", "a.npz")])
def test_a_mistake_of_ours_keeps_its_traceback(mistake: Exception) -> None:
    def broken() -> None:
        """Fail."""
        raise mistake

    with pytest.raises(type(mistake)):
        run(broken, "do", [])


@pytest.mark.parametrize("platform", ["linux", "elsewhere"])
def test_a_child_ends_with_a_killed_parent(platform: str, tmp_path: Path) -> None:
    (tmp_path / "parent.py").write_text(SPAWNED.format(platform=platform))
    command = [sys.executable, str(tmp_path / "parent.py")]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    with subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True) as parent:
        child = psutil.Process(int(parent.stdout.readline()))
        assert child.is_running()
        parent.kill()
    _, alive = psutil.wait_procs([child], timeout=10.0)
    assert all(process.status() == psutil.STATUS_ZOMBIE for process in alive)


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """The time that `stopping` sees [s]."""
    now = [0.0]
    monkeypatch.setattr("datasets.processes.time.monotonic", lambda: now[0])
    return now


def test_a_signal_is_kept_and_a_second_one_breaks_off(clock: list[float]) -> None:
    before = signal.getsignal(signal.SIGTERM)
    with stopping() as stop:
        assert (stop(), stop.status) == (False, 0)
        signal.raise_signal(signal.SIGTERM)
        signal.raise_signal(signal.SIGINT)  # The same one, handed on.
        assert (stop(), stop.status) == (True, 143)
        clock[0] = 2.0
        with pytest.raises(Terminated):
            signal.raise_signal(signal.SIGINT)
    assert signal.getsignal(signal.SIGTERM) is before


def test_what_is_saved_is_broken_off_at_once() -> None:
    with stopping() as stop:
        with pytest.raises(KeyboardInterrupt), stop.at_once():
            signal.raise_signal(signal.SIGINT)
        with pytest.raises(KeyboardInterrupt), stop.at_once():  # asked before it began: it does not begin
            pytest.fail("began")


def test_a_script_that_starts_processes_needs_no_guard(tmp_path: Path) -> None:
    lines = (
        "from multiprocessing import get_context",
        "from datasets.processes import without_main",
        'print("script", flush=True)',
        "with without_main():",
        '    process = get_context("spawn").Process(target=print, args=("process",))',
        "    process.start()",
        "process.join()",
    )
    (tmp_path / "script.py").write_text("\n".join(lines))
    run = subprocess.run([sys.executable, tmp_path / "script.py"], capture_output=True, text=True, check=True)
    assert run.stdout.split() == ["script", "process"]
