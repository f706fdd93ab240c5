"""Scores: nothing wrong with a model that is right, and the table of them."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from datasets import command_line
from datasets.training.samples import Flow, load_flows
from gns import checkpoint
from gns.score import Score, evaluate, score, table, validation_score
from gns.settings import ModelSettings
from gns.simulator import Simulator


def flying(flow: Flow) -> Flow:
    """Free flight, as the model steps it: its displacement changes by -g dt^2 a step."""
    step = np.arange(16)[:, None, None]
    fall = -9.81 * flow.step**2 * step * (step + 1) / 2
    start = flow.positions[0] + np.array([0.2, 0.1], np.float32)
    positions = start + step * np.array([1e-3, 1e-2]) + fall * np.array([0.0, 1.0])
    velocity0 = np.full_like(start, 1.0) * np.array([0.1, 1.0], np.float32)
    return dataclasses.replace(flow, positions=positions.astype(np.float32), velocity0=velocity0)


def test_free_flight_is_scored_as_right_and_a_collapse_as_wrong(
    simulator: Simulator, settings: ModelSettings, dataset: Path
) -> None:
    flows = load_flows(dataset, "valid", step=settings.step, dimension=2, spacing=settings.cell)
    wrong = evaluate(simulator, [flows[1]])[0]
    # With all particles, so that nothing is missing of the cloud.
    simulator.settings = dataclasses.replace(settings, particles_per_cell=4)
    right = evaluate(simulator, [flying(flows[0])])[0]
    assert not right.released
    assert abs(right.front_error) < 2e-3
    assert right.profile_error < 2e-3
    assert wrong.released
    assert wrong.front_error < -0.1
    assert wrong.profile_error > 0.1
    assert validation_score([wrong]) > validation_score([right])


def test_the_table_keeps_kinds_of_start_apart() -> None:
    scores = [Score(released=True, front_error=error, profile_error=0.25) for error in (-0.03, 0.04)]
    lines = table([*scores, Score(released=False, front_error=0.1, profile_error=0.25)]).splitlines()
    assert len(lines) == 4
    cells = [cell.strip() for cell in lines[2].strip("|").split("|")]
    assert cells == ["released at rest", "2", "3.5 %", "+0.5 %", "+4.0 %", "25.0 %"]


def test_the_command_prints_the_table(
    simulator: Simulator, dataset: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    checkpoint.save(tmp_path / "model.safetensors", simulator, {})
    model = ["--model", str(tmp_path / "model.safetensors")]
    assert command_line.run(score, "score", [str(dataset), *model]) == 0
    assert "released at rest | 1" in capsys.readouterr().out
    assert command_line.run(score, "score", [str(tmp_path), *model]) == 2
    assert "expected trajectories in test" in capsys.readouterr().err
