"""How far a rollout may be from the MPM: scores, spread of an ensemble, calibrated bands, and the command."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import torch

import gns
from datasets import command_line, measures
from datasets.errors import InputError
from datasets.training.samples import Flow
from gns import card, checkpoint
from gns.library import member_path
from gns.samples import flows_of
from gns.score import Score, evaluate, score, table, validation_score
from gns.settings import ModelSettings
from gns.simulator import Simulator
from gns.uncertainty import LEVELS, calibrated, half_width, predict
from tests.gns.conftest import NORMALISATION, spreading

FLOWS = 20


def drawn(rng: np.random.Generator, count: int, *, heavy: bool = False) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Errors of twice sqrt(s^2 + (0.03 L)^2), Gaussian or with heavy tails, with spreads s and extents L [m]."""
    spreads, extents = 0.01 * np.exp(rng.normal(0.0, 1.0, count)), rng.uniform(0.3, 2.0, count)
    chance = rng.standard_t(3, count) if heavy else rng.normal(size=count)
    return 2.0 * chance * np.hypot(spreads, 0.03 * extents), spreads, extents


def test_bands_are_conformal_quantiles() -> None:
    # Without any spread u = b L: the bands are quantiles of the errors themselves, of the rank ceil((n + 1) level).
    errors, count = 0.01 * np.arange(1.0, 20.0) * (-1.0) ** np.arange(19), np.ones(19)
    found = calibrated(errors, 0.0 * count, count)
    widths = [float(half_width(found, 0.0, 1.0, level)) for level in LEVELS]
    assert widths == pytest.approx([0.10, 0.16, 0.19])
    assert float(half_width(found, 0.0, 3.0, 0.8)) == pytest.approx(0.48)
    with pytest.raises(InputError, match="expected at least 19 flows for a band of 95%, got 18"):
        calibrated(errors[1:], 0.0 * count[1:], count[1:])
    with pytest.raises(InputError, match=r"level: expected one of 0\.5, 0\.8, 0\.95, got 0\.9"):
        half_width(found, 0.0, 1.0, 0.9)


@pytest.mark.parametrize("heavy", [False, True])
def test_new_flows_are_within_as_often_as_the_level_says(heavy: bool) -> None:
    rng = np.random.default_rng(1)
    shares = []
    for _ in range(60):
        found = calibrated(*drawn(rng, 60, heavy=heavy))
        errors, spreads, extents = drawn(rng, 200, heavy=heavy)
        shares.append([np.mean(np.abs(errors) <= half_width(found, spreads, extents, level)) for level in LEVELS])
    # Split conformal prediction: level to level + 1 / 61, less what the one fitted number costs.
    assert np.mean(shares, axis=0) == pytest.approx(LEVELS, abs=0.03)


@pytest.fixture
def model(settings: ModelSettings, tmp_path: Path) -> Path:
    """A tiny model that hardly pushes, its two members, and its card."""
    path = tmp_path / "model.safetensors"
    for number, strength in ((0, 0.02), (1, 0.05), (2, 0.08)):
        torch.manual_seed(number)
        simulator = Simulator(settings, NORMALISATION)
        with torch.no_grad():
            simulator.network.decoder.mlp[-1].weight.normal_(std=strength)
        checkpoint.save(member_path(path, number) if number else path, simulator, {})
    scenes = [spreading(angle, duration=0.1).scene for angle in (20.0, 40.0)]
    card.write(path, card.describe(checkpoint.load(path).simulator, {}, {"columns": scenes}))
    return path


@pytest.fixture(scope="module")
def flows(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Short flows of columns, to calibrate on and to check."""
    folder = tmp_path_factory.mktemp("columns")
    for index in range(FLOWS):
        flow = spreading(20.0 + index, length=0.06, height=0.05 + 0.002 * index, duration=0.05, seed=index)
        for split in ("valid", "test"):
            flow.save(folder / split / f"{index:04d}.npz")
    return folder


def call(model: Path, *arguments: str | Path) -> int:
    return command_line.run(score, "python -m gns.score", ["--model", str(model), *map(str, arguments), "--keep"])


def test_a_calibrated_model_predicts_a_band(model: Path, flows: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene = dataclasses.replace(spreading(30.0).scene, duration=0.1)
    with pytest.raises(InputError, match=r"model\.json: calibration: expected a calibration"):
        predict(scene, model=model)
    assert call(model, flows) == 0
    said = capsys.readouterr().out
    known = card.read(model)
    assert known is not None
    assert known.calibration is not None
    assert known.calibration.flows == FLOWS
    assert known.scores in said
    assert f"{flows.name}, test" in known.scores

    found = predict(scene, model=model, level=0.8)
    deposits = [
        gns.simulate(scene, model=path).positions[-1] for path in (model, member_path(model, 1), member_path(model, 2))
    ]
    fronts = [measures.front(deposit) for deposit in deposits]
    calibration = known.calibration
    spread = float(np.std(fronts[1:], ddof=1))
    assert spread > 0.0
    assert found.front == pytest.approx(fronts[0])
    assert found.spread == pytest.approx(spread, rel=1e-4)
    extent = fronts[0] - gns.simulate(scene, model=model).positions[0, :, 0].min()
    expected = calibration.quantiles["0.8"] * np.hypot(spread, calibration.floor * extent)
    assert found.half_width == pytest.approx(expected, rel=1e-4)
    assert found.warning is None
    steep = dataclasses.replace(scene, slope_deg=20.0)
    assert "slope_deg 20" in (predict(steep, model=model).warning or "")


def test_what_cannot_be_calibrated_is_an_input_error(
    model: Path, flows: Path, settings: ModelSettings, capsys: pytest.CaptureFixture[str]
) -> None:
    def said(*arguments: str | Path) -> str:
        assert call(model, *arguments) == 2
        return capsys.readouterr().err.splitlines()[-1]

    assert "expected at least one dataset" in said()
    wider = Simulator(dataclasses.replace(settings, width=24), NORMALISATION)
    checkpoint.save(member_path(model, 2), wider, {})
    assert "model-2.safetensors: settings: expected the settings of model.safetensors" in said(flows)
    member_path(model, 2).unlink()
    assert "expected at least two members, such as model-1.safetensors, got 1" in said(flows)
    card.card_path(model).unlink()
    assert "expected the model's card" in said(flows)


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
    flows = flows_of(dataset, "valid", settings)
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
