"""The whole thing: our MPM, the shipped surrogate, a secret angle that is found again. Minutes."""

import json
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from datasets.command_line import run
from validation.demo import main as demo

pytestmark = pytest.mark.slow


def test_the_demo_finds_the_angle_and_the_mpm_confirms(tmp_path: Path) -> None:
    assert run(demo, "demo", ["--out", str(tmp_path), "--seed", "11"]) == 0
    result = json.loads((tmp_path / "result.json").read_text())
    assert result["verdict"] == "confirmed"
    assert result["error_pct"]["front"] <= 0.5
    found, truth = result["unknowns"]["friction_deg"], result["truth"]["friction_deg"]
    assert abs(found - truth) <= result["certainty"]["friction_deg"]
    assert result["peak_memory_mib"] < 2048.0


def test_twenty_kills_leave_the_same_result(tmp_path: Path) -> None:
    """At moments from the start of the process to its end: what is stored is whole, and nothing else counts."""

    def solving(out: Path) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-m", "validation.loop", "friction-tall-42", "--out", str(out)]
        return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)

    began = time.perf_counter()
    assert solving(tmp_path / "whole").wait() == 0
    seconds = time.perf_counter() - began
    finished = 0
    for moment in np.linspace(0.05, 0.95, 20):
        process = solving(tmp_path / "killed")
        try:
            process.wait(timeout=moment * seconds)
            finished += 1
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
    assert finished < 20
    assert solving(tmp_path / "killed").wait() == 0
    whole, resumed = (json.loads((tmp_path / name / "result.json").read_text()) for name in ("whole", "killed"))
    for result in (whole, resumed):
        for changing in ("seconds", "peak_memory_mib"):
            del result[changing]
        # The reason without the prices.
        result["surrogate"] = result["surrogate"]["asked"]
        for each in (*result["mpm_runs"], *result["iterations"]):
            each.pop("seconds", None)
    assert resumed == whole
    samples = [np.load(tmp_path / name / "posterior.npz")["samples"] for name in ("whole", "killed")]
    np.testing.assert_array_equal(*samples)
