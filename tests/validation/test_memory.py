"""`python -m validation.bench.speed.bench memory`: gradients in processes of their own, and what is told of them."""

import json
import subprocess
import sys
from pathlib import Path

import pytest
import torch
from torch import Tensor

from datasets.command_line import WorkFailed, run
from gns.model import checkpoint
from gns.model.settings import ModelSettings
from gns.model.simulator import Simulator
from gns.model.state import Conditions, State
from validation.bench.speed import gradient_run, memory
from validation.bench.speed.gns_rates import UNTRAINED
from validation.bench.speed.gradient_run import Took
from validation.bench.speed.memory import Case, LeftOut, Outcome, study
from validation.bench.speed.memory_page import draw, page, shares

SETTINGS = ModelSettings(width=8, layers=2, rounds=2, grid_channels=4, grid_layers=1)


@pytest.fixture
def model(tmp_path: Path) -> Path:
    torch.manual_seed(0)
    checkpoint.save(tmp_path / "tiny.pt", Simulator(SETTINGS, UNTRAINED), {})
    return tmp_path / "tiny.pt"


def took(points: int, steps: int, kept: int = 0, *, extra: int = 10_000_000, seconds: float = 2.0) -> Took:
    return Took(
        points=points,
        steps=steps,
        kept=kept,
        forward=0.25 * seconds,
        backward=0.75 * seconds,
        before=400_000_000,
        peak=400_000_000 + extra,
        clean=True,
        activations=5_000_000,
    )


def test_a_gradient_is_run_and_its_memory_told(model: Path) -> None:
    few, kept = gradient_run.took(model, 2_000, 12, 0), gradient_run.took(model, 2_000, 12, 12)
    assert (few.points, few.steps, kept.kept) == (2_000, 12, 12)
    assert few.forward > 0.0
    assert few.backward > 0.0
    assert few.activations > 2_000 * 8 * 4
    if few.clean:
        assert few.extra > few.activations
        assert kept.extra > few.extra + 3 * few.activations


def test_a_gradient_that_is_no_number_is_told(model: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def unroll(_: Simulator, state: State, conditions: Conditions, *__: object, **___: object) -> Tensor:
        return (conditions.friction * torch.nan)[None, :, None].expand(3, -1, 2)

    monkeypatch.setattr(gradient_run, "unroll", unroll)
    simulator = checkpoint.load(model).simulator
    with pytest.raises(WorkFailed, match="no finite number"):
        gradient_run.gradient(simulator, *gradient_run.dam(SETTINGS, 50), 2, 0, progress=False)


@pytest.mark.parametrize(
    ("arguments", "named"),
    [(["0", "3"], "POINTS"), (["100", "3", "--kept", "4"], "--kept"), (["100", "3", "--model", "none.pt"], "none.pt")],
)
def test_wrong_input_is_one_line_and_status_2(
    capsys: pytest.CaptureFixture[str], arguments: list[str], named: str
) -> None:
    assert run(gradient_run.command, "gradient_run", arguments) == 2
    assert named in capsys.readouterr().err


def finished(status: int, told: str = "", wrong: str = "") -> subprocess.CompletedProcess[str]:
    return subprocess.CompletedProcess([], status, told, wrong)


def test_a_case_is_a_process_of_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    calls = []

    def fake(arguments: list[str], **_: object) -> subprocess.CompletedProcess[str]:
        calls.append(arguments)
        return finished(0, json.dumps(took(100, 5).__dict__))

    monkeypatch.setattr(memory.subprocess, "run", fake)
    assert memory.apart(Case(points=100, steps=5, kept=2), Path("m.pt"), 1) == took(100, 5)
    (arguments,) = calls
    assert arguments[:5] == [sys.executable, "-m", "validation.bench.speed.gradient_run", "100", "5"]
    assert arguments[5:7] == ["--kept", "2"]


def test_a_process_that_runs_out_of_memory_is_told_and_one_that_fails_ends_it(monkeypatch: pytest.MonkeyPatch) -> None:
    case = Case(points=100, steps=5)
    monkeypatch.setattr(memory.subprocess, "run", lambda *_, **__: finished(-9))
    assert memory.apart(case, Path("m.pt"), 1) == LeftOut(case=case, reason="killed, out of memory")
    monkeypatch.setattr(memory.subprocess, "run", lambda *_, **__: finished(2, wrong="first\ntalus: no such model\n"))
    with pytest.raises(WorkFailed, match="no such model"):
        memory.apart(case, Path("m.pt"), 1)


def test_what_does_not_fit_into_the_time_is_left_out() -> None:
    ran = []

    def fake(case: Case) -> Outcome:
        ran.append(case)
        return took(case.points, case.steps, seconds=1.0e-3 * case.points * case.steps)

    cases = [Case(points=100, steps=10), Case(points=1_000, steps=400), Case(points=200, steps=10)]
    outcomes = study(cases, fake, budget=60.0)
    assert ran == [cases[0], cases[2]]
    assert outcomes[1] == LeftOut(case=cases[1], reason="not run, 405 s")
    assert len(study(cases, fake, budget=float("inf"))) == 3
    assert len(ran) == 5


def test_the_long_cases_hold_the_papers_hardest() -> None:
    assert Case(points=20_000, steps=400) in memory.LONG
    assert {1_000, 50_000} <= {case.points for case in memory.CASES}
    assert max(case.steps for case in memory.CASES) == 400


def test_the_page() -> None:
    done = [took(1_000, 10), took(1_000, 50, extra=50_000_000), took(3_000, 10), took(3_000, 40), took(3_000, 40, 20)]
    text = page(done, [(50_000, 10, "killed, out of memory")], model="flow", threads=1, full=False)
    assert "| 1,000 | 10 (2 s) | - | 50 (2 s) |" in text
    assert "| 50,000 | killed, out of memory | - | - |" in text
    assert "not run here (`--full` runs it)" in " ".join(text.split())
    assert "| 3,000 | 40 | 20 | 10 | 0.5 | 1.5 | x 1.00 |" in text
    assert shares(done)[2] == "| 1,000 | 5 | 10 | 1.00 |"


@pytest.mark.parametrize(("extra", "held"), [(2_000_000_000, "within"), (7_000_000_000, "beyond")])
def test_the_papers_hardest_case_is_judged_by_the_whole_process(extra: int, held: str) -> None:
    text = page([took(20_000, 400, extra=extra, seconds=300.0)], [], model="flow", threads=1, full=True)
    assert f"{held} the 6 GB" in " ".join(text.split())
    assert "in 5.0 minutes" in " ".join(text.split())
    assert "memory --full" in text


def test_the_picture(tmp_path: Path) -> None:
    draw(tmp_path / "memory.png", [took(1_000, 10), took(3_000, 10), took(3_000, 40), took(3_000, 40, 20)])
    assert (tmp_path / "memory.png").stat().st_size > 10_000


@pytest.mark.slow
def test_the_whole_subject_on_a_tiny_model(model: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cases = (Case(points=100, steps=3), Case(points=300, steps=3), Case(points=100, steps=6, kept=6))
    monkeypatch.setattr(memory, "CASES", cases)
    text = memory.measure(tmp_path, full=False, model=model)
    assert (tmp_path / "memory.md").read_text() == text
    assert (tmp_path / "memory.png").exists()
    assert "`tiny`" in text
