"""A process that is to end with its parent does, by Linux's signal and by the watching thread alone."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from validation.bench.faults.breaking import wait_for_orphans

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
@pytest.mark.parametrize("kind", ["end_with_parent", "end_with_stated_parent", "spawned"])
def test_a_child_ends_with_a_killed_parent(kind: str, platform: str, tmp_path: Path) -> None:
    if kind == "spawned":
        text = SPAWNED.format(platform=platform)
    else:
        text = PARENT.format(child=CHILD.format(platform=platform, function=kind))
    (tmp_path / "parent.py").write_text(text)
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    with subprocess.Popen(
        [sys.executable, str(tmp_path / "parent.py")],
        env=environment,
        stdout=subprocess.PIPE,
        text=True,
        start_new_session=True,
    ) as parent:
        assert parent.stdout is not None
        child = int(parent.stdout.readline())
        os.kill(child, 0)
        session = os.getsid(child)
        parent.kill()
    assert wait_for_orphans(session) == (0, pytest.approx(0.0, abs=4.0))


def test_another_parent_than_the_stated_one_is_not_followed() -> None:
    code = CHILD.format(platform="linux", function="end_with_stated_parent").replace("time.sleep(60.0)", "")
    code += "import threading; assert len(threading.enumerate()) == 1"
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "TALUS_PARENT": "1"}
    assert subprocess.run([sys.executable, "-c", code], env=environment, check=False).returncode == 0
