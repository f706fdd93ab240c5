"""The whole thing: our MPM, the shipped surrogate, a secret angle that is found again. Minutes."""

import json
from pathlib import Path

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
