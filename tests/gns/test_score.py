"""How far a rollout may be from the MPM: scores, calibrated bands, and the command."""

import math
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from scipy.spatial import cKDTree

import gns
from datasets import command_line
from datasets.flow import measures
from datasets.flow.measures import AFTER, creep, summary
from gns import card, checkpoint
from gns.score import Score, calibrated, evaluate, score, table, validation_score
from gns.settings import ModelSettings
from gns.simulator import Simulator
from gns.surroundings.state import Conditions, State
from gns.training.samples import Flow, flows_of
from tests.gns.conftest import NORMALISATION, spreading
from tests.refusals import refused, refused_by
from validation.bench.stability.exact_solutions import FreeFlight


def scored(**errors: Any) -> Score:
    """Of a flow without errors but these."""
    perfect = {"front": 0.0, "profile": 0.0, "height": 0.0, "thickness": 0.0, "overlap": 1.0}
    return Score(**{"released": True, "at_wall": False, **perfect, **errors})


def scores_of(errors: np.ndarray) -> list[Score]:
    """Of flows with these errors of the front, and half of them of the profile [-]."""
    return [scored(front=float(error), profile=0.5 * abs(float(error))) for error in errors]


def test_bands_are_conformal_quantiles() -> None:
    # Of the rank ceil((n + 1) level) = 10, 16, 19.
    errors = 0.01 * np.arange(1.0, 20.0) * (-1.0) ** np.arange(19)
    calibration = calibrated(scores_of(errors))
    assert list(calibration.front.values()) == pytest.approx([0.10, 0.16, 0.19])
    assert list(calibration.profile.values()) == pytest.approx([0.05, 0.08, 0.095])
    assert calibration.flows == 19
    # Of fewer flows than the level asks for by Student's law, which is the normal law of many and 12.7 sigma of one.
    assert calibrated(scores_of(errors[:1])).front["0.95"] == pytest.approx(0.01 * 12.706, rel=1e-3)
    # Fronts that a wall holds make no band narrower.
    held = scored(front=0.02, at_wall=True)
    assert calibrated([*scores_of(errors), *[held] * 40]) == calibration
    assert calibrated([held]).flows == 1


@pytest.mark.parametrize(("heavy", "count"), [(False, 60), (True, 60), (False, 8)])
def test_new_flows_are_within_as_often_as_the_level_says(heavy: bool, count: int) -> None:
    rng = np.random.default_rng(1)

    def drawn(number: int) -> np.ndarray:
        return 0.03 * (rng.standard_t(3, number) if heavy else rng.normal(size=number))

    shares = []
    for _ in range(300):
        band, errors = calibrated(scores_of(drawn(count))).front, np.abs(drawn(200))
        shares.append([np.mean(errors <= band[f"{level:g}"]) for level in card.LEVELS])
    # Split conformal prediction: level to level + 1 / (n + 1).
    half = 0.5 / (count + 1)
    assert np.mean(shares, axis=0) == pytest.approx(np.add(card.LEVELS, half), abs=0.02 + half)


@pytest.fixture
def model(settings: ModelSettings, dataset: Path, tmp_path: Path) -> Path:
    """A tiny model, and its card."""
    path = tmp_path / "model.safetensors"
    torch.manual_seed(0)
    checkpoint.save(path, Simulator(settings, NORMALISATION), {})
    scenes = [spreading(angle, duration=0.1).scene for angle in (20.0, 40.0)]
    card.write(path, card.describe(checkpoint.load(path).simulator, {}, {dataset.name: scenes}))
    return path


def test_a_calibrated_model_predicts_a_band(model: Path, dataset: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene = replace(spreading(30.0).scene, duration=0.1)
    refused(gns.predict, scene, model=model, said="model.json: calibration: expected a calibration")
    assert command_line.run(score, "score", [str(dataset), "--model", str(model), "--keep"]) == 0
    said, model_card = capsys.readouterr().out, card.read(model)
    calibration = model_card.calibration(scene)
    assert calibration.flows == 2
    assert model_card.scores in said
    assert f"{dataset.name}, test" in model_card.scores
    assert "released at rest | 1" in model_card.scores

    prediction = gns.predict(scene, model=model, level=0.8)
    rollout = gns.simulate(scene, model=model)
    rear, front = measures.ends(rollout.positions[-1], rollout.volumes)
    assert (prediction.front, prediction.extent) == pytest.approx((front, front - rear))
    assert prediction.half_width == pytest.approx(calibration.front["0.8"] * (front - rear))
    assert prediction.profile_error == pytest.approx(calibration.profile["0.8"] * (front - rear))
    assert prediction.warning is None
    assert "slope_deg 20" in (gns.predict(replace(scene, slope_deg=20.0), model=model).warning or "")
    for level, got in ((0.9, "0.9"), ("0.95", "'0.95'")):
        refused(gns.predict, scene, model=model, level=level, said=f"level: expected one of 0.5, 0.8, 0.95, got {got}")


def test_what_is_not_calibrated(model: Path, dataset: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    said = partial(refused_by, capsys, score, "--model", model, "--keep")
    assert "expected at least one dataset" in said()
    assert "--threads" in said(dataset, "--threads", "0")
    assert f"expected datasets that the model was trained on, {dataset.name}, got other" in said(tmp_path / "other")
    card.card_path(model).unlink()
    assert "expected the model's card" in said(dataset)
    # Without --keep no card is asked for.
    assert "expected trajectories in test" in refused_by(capsys, score, tmp_path, "--model", model)
    assert command_line.run(score, "score", [str(dataset), "--model", str(model)]) == 0


def test_a_table_has_mean_amounts_and_the_worst_of_what_is_known() -> None:
    many = [scored(front=0.01, overlap=0.9, creep=0.002), scored(front=-0.03, overlap=0.8), scored()]
    amounts = summary(many)
    assert (amounts["front"], amounts["overlap in plan"]) == ("1.3 % (-3.0)", "90.0 % (80.0)")
    assert amounts["creep"] == "2.0 mm/s (2.0)"
    # A front at a wall is right of any model; of flows of which none rests nothing is known of the creep.
    row = table([replace(flow_score, creep=math.nan, at_wall=True) for flow_score in many]).splitlines()[-1]
    start, flows, held, front, profile, *_, creeps = (cell.strip() for cell in row.strip("|").split("|"))
    assert (start, flows, held, front, profile, creeps) == ("released at rest", "3", "3", "-", "0.0 % (0.0)", "-")
    assert calibrated(many).errors["overlap"] == pytest.approx(0.9)
    assert "creep" not in calibrated([scored()]).errors


def test_creep_is_the_speed_after_the_flow() -> None:
    # Fast while it flows, for ten steps of 0.1 s; then half of the particles move at 3 mm/s, the others do not.
    steps = np.arange(10 * AFTER + 1)
    way = np.where(steps <= 10, 0.5 * steps, 5.0 + 3.0e-4 * (steps - 10))
    positions = np.zeros((len(steps), 2, 2))
    positions[:, 0, 0], positions[:, 1, 0] = way, np.minimum(way, 5.0)
    assert creep(positions, 0.1) == pytest.approx(3.0e-3 / math.sqrt(2.0))


def flying(flow: Flow) -> Flow:
    """Free flight, as the model steps it: its displacement changes by -g dt^2 a step."""
    flight = FreeFlight(velocity=(1e-3 / flow.step, 1e-2 / flow.step), gravity=(0.0, -9.81), step=flow.step)
    start = flow.positions[0] + np.array([0.2, 0.1], np.float32)
    positions = start + flight.displacement(flow.step * np.arange(16))[:, None]
    velocity0 = np.full_like(start, 1.0) * np.array([0.1, 1.0], np.float32)
    return replace(flow, positions=positions.astype(np.float32), velocity0=velocity0)


def test_flight_is_right_and_a_collapse_wrong(simulator: Simulator, settings: ModelSettings, dataset: Path) -> None:
    flows = flows_of(dataset, "valid", settings)
    wrong = evaluate(simulator, [flows[1]])[0]
    # With all particles, so that nothing is missing of the cloud.
    simulator.settings = replace(settings, particles_per_cell=4)
    right = evaluate(simulator, [flying(flows[0])])[0]
    assert not right.released
    assert abs(right.front) < 2e-3
    assert right.profile < 2e-3
    assert wrong.released
    assert wrong.front < -0.1
    assert wrong.profile > 0.1
    assert validation_score([wrong]) > validation_score([right])


def test_sand_that_lies_flat_is_scored_as_wrong_though_its_front_is_right(
    simulator: Simulator, settings: ModelSettings, dataset: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    flow = flows_of(dataset, "valid", settings)[1]
    assert math.isnan(evaluate(simulator, [flow])[0].creep)
    # With a moment more, at rest.
    flow = replace(flow, positions=np.concatenate((flow.positions, flow.positions[-1:])))

    def rolled(flat: bool) -> Score:
        def unroll(_: Simulator, state: State, conditions: Conditions, steps: int, **named: bool) -> torch.Tensor:
            _, which = cKDTree(flow.positions[0]).query(state.positions.numpy())
            end = torch.from_numpy(np.array(flow.positions[-1])[which])
            if flat:
                end[:, 1] = 5.0e-6
            return end.expand(steps + 1, -1, -1)

        monkeypatch.setattr("gns.simulator.unroll", unroll)
        simulator.settings = replace(settings, particles_per_cell=4)
        return evaluate(simulator, [flow])[0]

    right, flat = rolled(False), rolled(True)
    assert abs(flat.front) < 0.01
    assert flat.profile < 0.01
    assert (right.height, right.thickness, right.overlap) == pytest.approx((0.0, 0.0, 1.0), abs=1e-3)
    assert flat.height < -0.99
    assert flat.thickness > 0.4
    assert (right.creep, flat.creep) == (0.0, 0.0)
    assert validation_score([flat]) > validation_score([right]) + 0.4
