"""Commands that are broken off in the middle of their work, and what they leave: for tests of resumption."""

import csv
import hashlib
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path

import numpy as np
import psutil

from datasets.files import PART
from datasets.lock import LOCK

ORPHANS = 5.0  # seconds after which no process of a killed command may be left
LIMIT = 300.0  # seconds after which a command hangs
BLOCKS = """
count = 10
split_period = 4
[scene]
duration = { uniform = [0.1, 0.2], step = 0.05 }
domain = { size = [0.8, 0.4], cell = 0.02 }
material = { friction_deg = { uniform = [20.0, 40.0] } }
masses = [{ lower = [{ uniform = [0.0, 0.2] }, 0.0], size = [0.2, 0.2] }]
"""
SCENE = """
duration = 0.25
floor_friction = 0.4
domain = { size = [0.8, 0.4], cell = 0.02 }
material = { friction_deg = 30.0 }
masses = [{ lower = [0.0, 0.0], size = [0.2, 0.2] }]
"""
PROBLEM = """
scene = "scene.toml"
surrogate = "none"
unknowns = [{ name = "friction_deg", initial = 28.0, lower = 20.0, upper = 40.0 }]
observations = [{ kind = "front" }]
target = { twin = true }
loop = { mpm_runs = 12 }
"""
ANSWER = ("verdict", "unknowns", "certainty", "answers", "mpm_runs")
"""Keys of the loop's result that must not depend on how it came about."""
Digest = Mapping[str, str]  # what a command left, by file or key: equal where the results are


def start(arguments: list[str]) -> "subprocess.Popen[str]":
    """`python ARGUMENTS` in a session of its own, so that its processes are known."""
    return subprocess.Popen(
        [sys.executable, *arguments],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        # A shell that runs the tests in the background has it ignored.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )


def wait_for_work(process: "subprocess.Popen[str]", out: Path) -> float:
    """Wait until a command holds its folder, or ends; the time of it on the monotonic clock [s]."""
    while process.poll() is None and not (out.exists() and next(out.rglob(LOCK), None)):
        time.sleep(0.002)
    return time.monotonic()


def orphans(session: int) -> list[int]:
    """Processes of a session that are left after ORPHANS seconds; they are ended."""
    began = time.monotonic()
    while members(session) and time.monotonic() - began < ORPHANS:
        time.sleep(0.01)
    processes = members(session)
    for number in processes:
        os.kill(number, signal.SIGKILL)
    return processes


def members(session: int) -> list[int]:
    """Numbers of the processes of a session, without those that have ended and are not yet waited for."""
    numbers = []
    for process in psutil.process_iter(["status"]):
        with suppress(ProcessLookupError):
            if os.getsid(process.pid) == session and process.info["status"] != psutil.STATUS_ZOMBIE:
                numbers.append(process.pid)
    return numbers


def unfinished(out: Path) -> list[Path]:
    """Parts of files, and locks, in a folder of results."""
    return [path for path in out.rglob(".*") if path.name.startswith((PART, LOCK))]


def digest(content: bytes) -> str:
    """Of the contents of a file or an array."""
    return hashlib.sha256(content).hexdigest()


def dataset_files(out: Path) -> Digest:
    """Every file of a dataset."""
    files = [path for path in sorted(out.rglob("*")) if path.is_file()]
    return {str(path.relative_to(out)): digest(path.read_bytes()) for path in files}


def trained(out: Path) -> Digest:
    """How far a training came."""
    with (out / "log.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    return {"best": str((out / "best.safetensors").exists()), "updates": rows[-1]["updates"]}


def answer(out: Path) -> Digest:
    """What the loop found, and its posterior."""
    result = json.loads((out / "result.json").read_text(encoding="utf-8"))
    with np.load(out / "posterior.npz", allow_pickle=False) as file:
        posterior = {name: digest(file[name].tobytes()) for name in file.files}
    return {key: json.dumps(timeless(result[key])) for key in ANSWER} | posterior


def timeless(value: object) -> object:
    """`value` of a JSON file without its seconds, at any depth."""
    if isinstance(value, dict):
        return {key: timeless(part) for key, part in value.items() if "second" not in key and not key.endswith("_s")}
    if isinstance(value, list):
        return [timeless(part) for part in value]
    return value
