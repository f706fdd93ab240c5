"""`python -m inverse` from end to end with a tiny model, where no MPM is needed."""

import json
import re
from pathlib import Path

import pytest

from datasets.command_line import run
from datasets.scene.library import read_scene
from gns import checkpoint
from gns.simulator import Simulator
from inverse import Parameter, Problem, invert, read_problem
from inverse.__main__ import main
from inverse.forward.mpm import MpmForward
from inverse.inversion import of_numbers
from inverse.observations import ToeSettings
from tests.inverse.flows import simulator_of
from tests.refusals import refused
from tests.validation.loop.flows import wedge

SCENE = """
duration = 0.08
domain = { size = [0.4, 0.2], cell = 0.01 }
material = { friction_deg = 30.0 }
masses = [{ lower = [0.01, 0.0], size = [0.06, 0.04] }]
baffles = [{ lower = [0.12, 0.0], size = [0.03, 0.02] }]
"""
PROBLEM = """
scene = "scene.toml"
unknowns = [
  { name = "masses[0].velocity_x", initial = 0.5, lower = 0.0, upper = 1.5 },
  { name = "baffles[0].height", initial = 0.02, lower = 0.01, upper = 0.05 },
]
observations = [{ OBSERVED }]
"""
PASSED = 'kind = "passed", line = 0.1, value = 0.0'
TOE = 'kind = "toe", values = [0.12, 0.01]'


def files(folder: Path, simulator: Simulator, observed: str) -> tuple[Path, Path]:
    """The problem and the weights, on disk."""
    checkpoint.save(folder / "tiny.safetensors", simulator.float(), {})
    (folder / "scene.toml").write_text(SCENE)
    (folder / "problem.toml").write_text(PROBLEM.replace("OBSERVED", observed))
    return folder / "problem.toml", folder / "tiny.safetensors"


@pytest.mark.parametrize("observed", [PASSED, TOE])
def test_an_inversion(tmp_path: Path, observed: str) -> None:
    problem, weights = files(tmp_path, simulator_of(2), observed)
    out = tmp_path / "out"
    arguments = [str(problem), "--out", str(out), "--model", str(weights)]
    assert run(main, "inverse", arguments) == 0
    result = json.loads((out / "result.json").read_text())
    assert result["unknowns"].keys() == {"masses[0].velocity_x", "baffles[0].height"}
    assert result["certainty"].keys() == result["unknowns"].keys()
    assert 14 < len(result["iterations"]) < 60
    assert result["loss"]["surrogate"] <= result["loss"]["initial"]
    assert result["seconds"]["mpm"] < 0.1
    assert (out / "deposit.png").exists()


def test_the_mpm_with_its_adjoint_and_without(tmp_path: Path) -> None:
    """Of the velocity of a slide: both find the target's front, and the same velocity within their half-widths."""
    # Of the kernels that test_fields.py needs too.
    soil = "friction_deg = 30.0, cohesion = 200.0, tension_cutoff = 100.0"
    scene, problem = (re.sub(".*baffles.*\n", "", text) for text in (SCENE, PROBLEM))
    (tmp_path / "scene.toml").write_text(scene.replace("friction_deg = 30.0", soil))
    (tmp_path / "problem.toml").write_text(problem.replace("OBSERVED", 'kind = "front", value = 0.13'))
    results = []
    for forward in ("adjoint", "mpm"):
        out = tmp_path / forward
        arguments = [str(tmp_path / "problem.toml"), "--forward", forward, "--out", str(out)]
        assert run(main, "inverse", arguments) == 0
        results.append(json.loads((out / "result.json").read_text()))
    ours, theirs = (result["unknowns"]["masses[0].velocity_x"] for result in results)
    widths = [result["certainty"]["masses[0].velocity_x"] for result in results]
    assert abs(ours - theirs) < max(widths) < 0.5
    assert all(result["loss"]["mpm"] < 1e-5 for result in results)
    assert all(result["flows"] < 25 for result in results)


def test_every_run_of_the_mpm_is_counted(tmp_path: Path) -> None:
    """The twin's own flow too, as the report says."""
    case = wedge(tmp_path)
    result = of_numbers(case.problem, case.target, MpmForward(case.problem, case.target.observation, case.mpm))
    assert result.run_count == len(case.mpm.scenes) + 1


def test_a_problem_built_in_python(tmp_path: Path) -> None:
    """The call is the command: the same answer, whether the problem was written down or built."""
    problem, weights = files(tmp_path, simulator_of(2), TOE)
    read = read_problem(str(problem))
    built = Problem(
        name="built",
        scene=read_scene(str(tmp_path / "scene.toml")),
        parameters=(
            Parameter(name="masses[0].velocity_x", initial=0.5, lower=0.0, upper=1.5),
            Parameter(name="baffles[0].height", initial=0.02, lower=0.01, upper=0.05),
        ),
        observations=(ToeSettings(values=(0.12, 0.01)),),
        optimiser=read.optimiser,
    )
    results = [invert(case, forward="gns", model=weights) for case in (read, built, str(problem))]
    assert results[0].unknowns == results[1].unknowns == results[2].unknowns
    refused(invert, read, forward="mmp", said="forward: expected one of gns, mpm, adjoint, got 'mmp'")
    assert results[0].unknowns != dict(zip(read.names, read.initial, strict=True))
