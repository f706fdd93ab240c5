"""`python -m validation.bench problems`: solved once, beside criteria and the paper's figures."""

import csv
import json
import subprocess
from pathlib import Path
from typing import Any

import pytest

from inverse.problem import PROBLEMS, read_problem
from validation.bench import problems
from validation.bench.__main__ import main
from validation.bench.problems import Criteria, Outcome


def result(name: str, off: float = 0.002) -> dict[str, Any]:
    """What a loop might have left of a shipped problem."""
    problem = read_problem(name)
    truth = {number.name: number.start + 0.1 * (number.bounds[1] - number.start) for number in problem.numbers}
    unknowns = {name: value * (1.0 + off) for name, value in truth.items()}
    return {
        "verdict": "confirmed",
        "unknowns": unknowns,
        "certainty": {name: 0.005 * abs(value) for name, value in truth.items()},
        "interval": {name: [0.995 * value, 1.005 * value] for name, value in unknowns.items()},
        "truth": truth,
        "error_pct": {"front": 0.1},
        "loss": {"mpm": 4e-5},
        "mpm_runs": [{}] * 3,
        "seconds": {"mpm": 4.0, "total": 50.0, "processors": 80.0},
        "surrogate": {"asked": False, "reason": "the problem asks for none"},
    }


@pytest.fixture
def loop(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """In place of the loop: leaves a result at once. The names that it was asked for."""
    called: list[str] = []

    def fake(arguments: list[str], **_: Any) -> subprocess.CompletedProcess[str]:
        name, out = arguments[3], Path(arguments[5])
        called.append(name)
        out.mkdir(parents=True, exist_ok=True)
        content = result(name)
        if arguments[7] == "gns":
            prediction = {"unknowns": content["unknowns"], "mpm_error": {"misfit": 5e-4, "front_pct": 4.2}}
            content |= {"surrogate": {"asked": True, **prediction}, "mpm_runs": [{}]}
        (out / "result.json").write_text(json.dumps(content))
        (out / "unknowns.png").write_bytes(b"\x89PNG")
        return subprocess.CompletedProcess(arguments, 0)

    monkeypatch.setattr(subprocess, "run", fake)
    return called


def call(tmp_path: Path, *only: str) -> int:
    flags = [flag for name in only for flag in ("--only", name)]
    return main(["problems", "--keep", str(tmp_path / "runs"), "--out", str(tmp_path / "docs"), *flags])


def test_results_are_gathered_once(tmp_path: Path, loop: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    names = ("friction-tall-42", "velocity-layers-10")
    assert call(tmp_path, *names) == 0
    assert loop == [names[0], names[0], names[1], names[1]]
    said = capsys.readouterr().out
    assert "4 of 4 answers to 2 problems meet all of their criteria." in said
    assert "The 95 % intervals contain 22 of 22 true values." in said
    assert (tmp_path / "docs" / "pictures" / "velocity-layers-10-unknowns.png").exists()
    assert (tmp_path / "docs" / "pictures" / "problems.png").stat().st_size > 10_000
    with (tmp_path / "docs" / "problems.csv").open(newline="") as file:
        lines = list(csv.DictReader(file))
    assert len(lines) == 2 * (1 + 10)
    assert {line["paper_misfit_m2"] for line in lines if line["problem"] == "velocity-layers-10"} == {"0.00087"}
    assert {line["surrogate_misfit_m2"] for line in lines if line["way"] == problems.LED} == {"0.0005"}
    (tmp_path / "runs" / names[0] / problems.KEY).write_text("of another problem")
    kept = tmp_path / "runs" / names[0] / "kept.npz"
    kept.touch()
    assert call(tmp_path, *names) == 0
    assert loop[4:] == [names[0]], "the other results are kept"
    assert not kept.exists(), "runs for another problem would cost this one no seconds"
    assert call(tmp_path, "nothing") == 2


def test_what_could_not_be_run_fails(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(subprocess, "run", lambda arguments, **_: subprocess.CompletedProcess(arguments, 2))
    assert call(tmp_path, "friction-tall-42") == 1
    assert (tmp_path / "docs" / "problems.md").exists()


def test_every_criterion_can_be_missed() -> None:
    problem, base = read_problem("friction-tall-42"), result("friction-tall-42", off=0.02)
    criteria = Criteria(front_error_pct=0.3, unknown_error_pct=1.0, loss=1e-4, inside=True)
    assert len(Outcome(problem=problem, criteria=criteria, result=base).missed) == 2
    worse = base | {"verdict": "unreachable", "error_pct": {"front": 0.4}, "loss": {"mpm": 1e-3}}
    assert len(Outcome(problem=problem, criteria=criteria, result=worse).missed) == 5
    good = result("friction-tall-42")
    assert Outcome(problem=problem, criteria=criteria, result=good).missed == []
    # An interval beyond the criterion promises less than it.
    wide = base | {"certainty": {"friction_deg": 5.0}, "interval": {"friction_deg": [27.0, 47.0]}}
    assert Outcome(problem=problem, criteria=criteria, result=wide).missed == []
    # A second answer that holds the true value counts, where the first does not.
    low = {name: 0.9 * value for name, value in base["truth"].items()}
    high = {name: 1.1 * value for name, value in base["truth"].items()}
    second = {"unknowns": base["truth"], "interval": {name: [low[name], high[name]] for name in low}}
    lax = Criteria(inside=True)
    assert len(Outcome(problem=problem, criteria=lax, result=base).missed) == 1
    both = base | {"answers": [{"unknowns": base["unknowns"], "interval": base["interval"]}, second]}
    assert Outcome(problem=problem, criteria=lax, result=both).missed == []


def test_every_shipped_problem_has_criteria() -> None:
    named = [name for family in problems.FAMILIES for name in family.problems]
    assert sorted(named) == sorted(path.stem for path in PROBLEMS.glob("*.toml"))
    assert problems.PAPER.keys() <= set(named)
