"""A process ends with its parent, by Linux's signal and by the watching thread alone; a signal waits, or breaks off."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import psutil
import pytest

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


@pytest.mark.parametrize("platform", ["linux", "elsewhere"])
def test_a_child_ends_with_a_killed_parent(platform: str, tmp_path: Path) -> None:
    (tmp_path / "parent.py").write_text(SPAWNED.format(platform=platform))
    command = [sys.executable, str(tmp_path / "parent.py")]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    with subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True) as parent:
        assert parent.stdout is not None
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
        # Asked before it began: it does not begin.
        with pytest.raises(KeyboardInterrupt), stop.at_once():
            pytest.fail("began")
