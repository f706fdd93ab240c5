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
CHILD = """
import sys, time
from datasets import processes
sys.platform = {platform!r}
processes.{function}()
print("child", flush=True)
time.sleep(60.0)
"""
PARENT = """
import subprocess, sys, time
from datasets.processes import parent_environment
child = subprocess.Popen([sys.executable, "-c", {child!r}], stdout=subprocess.PIPE, env=parent_environment())
child.stdout.readline()
print(child.pid, flush=True)
time.sleep(60.0)
"""
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
@pytest.mark.parametrize("kind", ["end_with_stated_parent", "spawned"])
def test_a_child_ends_with_a_killed_parent(kind: str, platform: str, tmp_path: Path) -> None:
    if kind == "spawned":
        text = SPAWNED.format(platform=platform)
    else:
        text = PARENT.format(child=CHILD.format(platform=platform, function=kind))
    (tmp_path / "parent.py").write_text(text)
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    with subprocess.Popen(
        [sys.executable, str(tmp_path / "parent.py")], env=environment, stdout=subprocess.PIPE, text=True
    ) as parent:
        assert parent.stdout is not None
        child = psutil.Process(int(parent.stdout.readline()))
        assert child.is_running()
        parent.kill()
    _, alive = psutil.wait_procs([child], timeout=10.0)
    assert all(process.status() == psutil.STATUS_ZOMBIE for process in alive)


def test_another_parent_than_the_stated_one_is_not_followed() -> None:
    code = CHILD.format(platform="linux", function="end_with_stated_parent").replace("time.sleep(60.0)", "")
    code += "import threading; assert len(threading.enumerate()) == 1"
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "TALUS_PARENT": "1"}
    assert subprocess.run([sys.executable, "-c", code], env=environment, check=False).returncode == 0


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
