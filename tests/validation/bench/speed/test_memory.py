"""`python -m validation.bench memory`: gradients in processes of their own, and their page."""

import os
import signal
from pathlib import Path

import pytest
import torch
from torch import Tensor

from datasets.command_line import WorkFailed
from gns.model import checkpoint
from gns.model.settings import ModelSettings
from gns.model.simulator import Normalisation, Simulator
from gns.model.state import Conditions, State
from validation.bench.speed import memory
from validation.bench.speed.columns import column
from validation.bench.speed.memory import GradientCase, GradientCost, draw, page, study
from validation.report import plots
from validation.report.memory import reset_peak
from validation.report.process import OutOfMemory, isolated

SETTINGS = ModelSettings(width=8, layers=2, rounds=2, grid_channels=4, grid_layers=1)


@pytest.fixture
def model(tmp_path: Path) -> Path:
    torch.manual_seed(0)
    normalisation = Normalisation(displacement=3.0e-3, acceleration=7.0e-4, friction_mean=0.6, friction_std=0.2)
    checkpoint.save(tmp_path / "tiny.pt", Simulator(SETTINGS, normalisation), {})
    return tmp_path / "tiny.pt"


def cost(nodes: int, steps: int, kept: int = 0, *, extra: int = 10_000_000, seconds: float = 2.0) -> GradientCost:
    return GradientCost(
        case=GradientCase(nodes=nodes, steps=steps, kept=kept),
        forward=0.25 * seconds,
        backward=0.75 * seconds,
        before=400_000_000,
        peak=400_000_000 + extra,
        activations=5_000_000,
    )


def test_a_gradient_is_run_and_kept_steps_take_memory(model: Path) -> None:
    few, kept = (memory.run_case(GradientCase(nodes=1_000, steps=8, kept=kept), model, 1) for kept in (0, 8))
    assert few.forward > 0.0
    assert few.backward > 0.0
    assert few.activations > 1_000 * 8 * 4
    if reset_peak():
        assert few.extra > few.activations
        assert kept.extra > few.extra + 3 * few.activations


def test_a_gradient_that_is_no_number_is_an_error(model: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def unroll(_: Simulator, state: State, conditions: Conditions, *__: object, **___: object) -> Tensor:
        return (conditions.friction * torch.nan)[None, :, None].expand(3, -1, 2)

    monkeypatch.setattr(memory, "unroll", unroll)
    with pytest.raises(WorkFailed, match="no finite number"):
        memory.gradient(checkpoint.load(model).simulator, *column(SETTINGS, 50), 2, 0)


def test_work_in_a_process_returns_raises_or_is_killed(monkeypatch: pytest.MonkeyPatch) -> None:
    assert isolated(os.getpid) != os.getpid()
    with pytest.raises(ZeroDivisionError):
        isolated(divmod, 1, 0)
    with pytest.raises(OutOfMemory):
        isolated(signal.raise_signal, signal.SIGKILL)

    def killed(*_: object) -> GradientCost:
        raise OutOfMemory("killed, out of memory")

    monkeypatch.setattr(memory, "isolated", killed)
    case = GradientCase(nodes=100, steps=5)
    found = memory.in_process(case, model=Path("m.pt"), threads=1)
    assert (found.case, found.left_out) == (case, "killed, out of memory")


def test_what_does_not_fit_into_the_time_is_left_out() -> None:
    ran = []

    def run(case: GradientCase) -> GradientCost:
        ran.append(case)
        return cost(case.nodes, case.steps, seconds=1.0e-3 * case.nodes * case.steps)

    cases = [GradientCase(nodes=100, steps=10), GradientCase(nodes=1_000, steps=400), GradientCase(nodes=200, steps=10)]
    found = study(cases, run, budget=60.0)
    assert ran == [cases[0], cases[2]]
    assert found[1].left_out == "not run, 405 s"
    assert len(study(cases, run, budget=float("inf"))) == 3
    assert len(ran) == 5
    assert GradientCase(nodes=memory.PAPER_NODES, steps=memory.PAPER_STEPS) in memory.LONG


def test_the_page_and_its_picture(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    done = [cost(1_000, 10), cost(1_000, 50, extra=50_000_000), cost(3_000, 10), cost(3_000, 40), cost(3_000, 40, 20)]
    missing = GradientCost(case=GradientCase(nodes=50_000, steps=10), left_out="killed, out of memory")
    text = str(page([*done, missing], model="flow", command="the command"))
    cells = [[cell.strip() for cell in line.split("|")[1:-1]] for line in text.splitlines() if line.startswith("|")]
    assert ["1,000", "10 (2 s)", "-", "50 (2 s)"] in cells
    assert ["50,000", "killed, out of memory", "-", "-"] in cells
    assert ["3,000", "40", "20", "10", "0.5", "1.5", "x 1.00"] in cells
    assert ["1,000", "5", "10", "1.00"] in cells
    assert "not run here (`--full` runs it)" in text
    hardest = str(page([cost(20_000, 400, extra=2_000_000_000, seconds=300.0)], model="flow", command="the command"))
    assert "400 steps of 20,000 nodes takes 2 GB (2.4 GB with the whole process) and 5.0 minutes" in hardest
    assert "--full" not in hardest
    monkeypatch.setattr(plots, "DPI", 30)
    draw(tmp_path / "memory.png", done)
    assert (tmp_path / "memory.png").stat().st_size > 1_000
