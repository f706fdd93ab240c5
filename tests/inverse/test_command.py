"""`python -m inverse` from end to end with a tiny model, where no MPM is needed."""

import json
from pathlib import Path
from typing import Any

import pytest

from datasets.command_line import run
from datasets.library import read_scene
from gns import checkpoint
from inverse import ObservationSettings, Parameter, Problem, invert, read_problem
from inverse.__main__ import main

SCENE = """
duration = 0.08
[domain]
size = [0.4, 0.2]
cell = 0.01
[material]
friction_deg = 30.0
[[masses]]
lower = [0.01, 0.0]
size = [0.06, 0.04]
[[baffles]]
lower = [0.12, 0.0]
size = [0.03, 0.02]
"""
PROBLEM = """
scene = "scene.toml"
[[unknowns]]
name = "masses[0].velocity_x"
initial = 0.5
lower = 0.0
upper = 1.5
[[unknowns]]
name = "baffles[0].height"
initial = 0.02
lower = 0.01
upper = 0.05
[[observations]]
KIND
TARGET
[optimiser]
method = "METHOD"
max_iterations = 3
"""
PASSED = ('kind = "passed"\nline = 0.1', "value = 0.0")
TOE = ('kind = "toe"', "values = [0.12, 0.01]")


@pytest.mark.parametrize("observed", [PASSED, TOE])
def test_an_inversion(
    tmp_path: Path,
    make_simulator: Any,
    observed: tuple[str, str],
) -> None:
    checkpoint.save(tmp_path / "tiny.safetensors", make_simulator(2).float(), {})
    (tmp_path / "scene.toml").write_text(SCENE)
    text = PROBLEM.replace("KIND", observed[0]).replace("TARGET", observed[1]).replace("METHOD", "lbfgs-b")
    (tmp_path / "problem.toml").write_text(text)
    out = tmp_path / "out"
    arguments = [str(tmp_path / "problem.toml"), "--out", str(out), "--model", str(tmp_path / "tiny.safetensors")]
    assert run(main, "inverse", [*arguments, "--gradient", "fd"]) == 2
    assert run(main, "inverse", arguments) == 0
    result = json.loads((out / "result.json").read_text())
    assert result["unknowns"].keys() == {"masses[0].velocity_x", "baffles[0].height"}
    assert result["certainty"].keys() == result["unknowns"].keys()
    assert 14 < len(result["iterations"]) < 60
    assert result["loss"]["surrogate"] <= result["loss"]["initial"]
    assert result["seconds"]["mpm"] < 0.1
    assert "m/s" in (out / "report.md").read_text()
    assert (out / "deposit.png").exists()


def test_the_mpm_by_its_adjoint_and_by_differences(tmp_path: Path) -> None:
    """Of the velocity of a slide: the first gradients agree, and the adjoint's search gets nearer to the target."""
    (tmp_path / "scene.toml").write_text(SCENE.split("[[baffles]]")[0])
    unknowns, rest = PROBLEM.split("[[observations]]")
    head = unknowns.split("[[unknowns]]")
    text = "[[unknowns]]".join(head[:2]) + "step = 0.05\n[[observations]]" + rest
    text = text.replace("KIND", 'kind = "front"').replace("TARGET", "value = 0.13").replace("METHOD", "lbfgs-b")
    (tmp_path / "problem.toml").write_text(text)
    results = []
    for gradient in ("ad", "fd"):
        out = tmp_path / gradient
        arguments = [str(tmp_path / "problem.toml"), "--forward", "mpm", "--gradient", gradient, "--out", str(out)]
        assert run(main, "inverse", arguments) == 0
        results.append(json.loads((out / "result.json").read_text()))
    ours, theirs = (each["iterations"][0]["gradient"]["masses[0].velocity_x"] for each in results)
    # The adjoint is of the smooth front, differences are of the exact one.
    assert ours == pytest.approx(theirs, rel=0.3)
    assert results[0]["loss"]["mpm"] < 0.2 * results[0]["loss"]["initial"]


def test_a_problem_built_in_python(tmp_path: Path, make_simulator: Any) -> None:
    """The call is the command: the same answer, whether the problem was written down or built."""
    checkpoint.save(tmp_path / "tiny.safetensors", make_simulator(2).float(), {})
    (tmp_path / "scene.toml").write_text(SCENE)
    text = PROBLEM.replace("KIND", TOE[0]).replace("TARGET", TOE[1]).replace("METHOD", "lbfgs-b")
    (tmp_path / "problem.toml").write_text(text)
    read = read_problem(str(tmp_path / "problem.toml"))
    built = Problem(
        name="built",
        scene=read_scene(str(tmp_path / "scene.toml")),
        parameters=(
            Parameter(name="masses[0].velocity_x", initial=0.5, lower=0.0, upper=1.5),
            Parameter(name="baffles[0].height", initial=0.02, lower=0.01, upper=0.05),
        ),
        observations=(ObservationSettings(kind="toe", values=(0.12, 0.01)),),
        optimiser=read.optimiser,
    )
    results = [invert(each, model=tmp_path / "tiny.safetensors") for each in (read, built)]
    assert results[0].unknowns == results[1].unknowns
    assert results[0].unknowns != dict(zip(read.names, read.initial, strict=True))
