"""Where a surrogate leads: its answers, what the MPM says of them, and what the MPM alone would find."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from datasets import Domain, Solid
from gns import card, checkpoint
from inverse import Parameter, TargetSettings, read_problem
from inverse.answer import Purpose, Verdict
from inverse.forward import gns
from inverse.forward.gns import GnsForward
from inverse.observations import FrontSettings
from inverse.search.inference import begun
from inverse.settings import LoopSettings, Surrogate
from inverse.target import read_target
from tests.inverse.flows import simulator_of
from tests.refusals import refused
from tests.validation.loop.flows import Case, FakeMpm, Folded, Formula, layers, length, wedge
from validation.loop import surrogate
from validation.loop.solve import run
from validation.loop.surrogate import choose, learned
from validation.loop.task import Task
from validation.loop.verdict import judged, nearer


@pytest.mark.parametrize(("kind", "factor"), [("front", 1.03), ("profile", 0.97)])
def test_the_mpm_corrects_an_answer_within_the_band_by_few_runs(tmp_path: Path, kind: str, factor: float) -> None:
    case = wedge(tmp_path, truth=24.0, kind=kind, scatter=0.002)
    result = case.led(factor).solve(tmp_path / "out")
    assert result.verdict is Verdict.CONFIRMED
    assert len(result.mpm_runs) <= 10
    predicted, width = (result.surrogate[key]["friction_deg"] for key in ("unknowns", "half_widths"))
    # Its own answer is off by its error, 16 mm a degree, and by no more than its band.
    assert predicted - 24.0 == pytest.approx((factor - 1.0) * length(24.0) / 0.0164, abs=0.5)
    assert abs(predicted - 24.0) < width < 4.0
    assert abs(result.unknowns["friction_deg"] - 24.0) < 2.0 * result.certainty["friction_deg"] < 1.5
    assert result.mpm_runs[0].purpose is Purpose.CHECK
    # By two runs there: that of a flow without scatter.
    there = FakeMpm().run(case.problem.scene_at(np.array([predicted]), 0))
    misfit = case.target.misfit(case.target.observation.observe(there))
    assert result.surrogate["mpm_error"]["misfit"] == pytest.approx(misfit, rel=0.4, abs=3e-5)


@pytest.mark.parametrize(
    ("truth", "factor"), [(27.0, 0.8), pytest.param(27.0, 1.2, marks=pytest.mark.slow), (12.5, 0.97)]
)
def test_a_surrogate_beyond_its_band_or_on_a_bound_costs_no_truth(tmp_path: Path, truth: float, factor: float) -> None:
    case = wedge(tmp_path, truth=truth, scatter=0.002)
    result = case.led(factor).solve(tmp_path)
    assert result.verdict is Verdict.CONFIRMED
    assert abs(result.unknowns["friction_deg"] - truth) < 2.0 * result.certainty["friction_deg"] < 2.0
    assert len(result.mpm_runs) <= 30
    assert truth > 20.0 or result.surrogate["unknowns"]["friction_deg"] == 12.0


@pytest.mark.slow
@pytest.mark.parametrize(("factor", "band"), [(1.03, 0.05), (0.85, 0.02)])
def test_many_parameters_take_few_runs_and_lose_no_truth(tmp_path: Path, factor: float, band: float) -> None:
    case = layers(tmp_path, count=7, scatter=0.001, bend=0.05)
    result = case.led(factor, band=band).solve(tmp_path)
    assert result.verdict in (Verdict.CONFIRMED, Verdict.AMBIGUOUS)
    assert len(result.mpm_runs) <= 26
    assert len(result.inside) >= 6


def test_each_of_two_answers_is_checked(tmp_path: Path) -> None:
    case = wedge(tmp_path, truth=22.0, mpm=Folded(scatter=0.002))
    result = case.led(1.02).solve(tmp_path)
    assert result.verdict is Verdict.AMBIGUOUS
    angles = sorted(float(answer.parameters[0]) for answer in result.answers)
    assert angles == pytest.approx([22.0, 38.0], abs=1.0)
    assert len(result.surrogate["answers"]) == 2
    assert len(result.mpm_runs) <= 24


def test_of_two_answers_that_the_mpm_refuses_the_nearer_stands(tmp_path: Path) -> None:
    """A profile that rises towards the front fits nowhere."""
    case = wedge(tmp_path, kind="profile", scatter=0.002)
    misfit = replace(case, target=replace(case.target, values=case.target.values[::-1].copy()))
    judgement = judged(begun(misfit.task(tmp_path).search()).informed())
    for ratio, verdict, nearest in (
        (0.5, Verdict.UNCONFIRMED, "whole"),
        (2.0, Verdict.UNCONFIRMED, "led"),
        (2.0, Verdict.UNREACHABLE, "whole"),
    ):
        (answer, *_), fit = judgement.answers, judgement.answers[0].fit
        fit = replace(fit, ratio=ratio * fit.ratio)
        whole = replace(judgement, answers=(replace(answer, fit=fit),), verdict=verdict)
        assert (nearer(judgement.search, whole) is whole) == (nearest == "whole")


@pytest.fixture
def model(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The file of a tiny model with a card: trained on level floors, 95 % of its fronts within 4 % of the extent."""
    calibration = card.Calibration(front={"0.95": 0.04}, profile={"0.95": 0.02}, flows=40)
    level = SimpleNamespace(ranges=(), calibration=lambda scene: calibration)
    checkpoint.save(tmp_path / "tiny.safetensors", simulator_of(2).float(), {})
    monkeypatch.setattr(card, "read", lambda path: level)
    monkeypatch.setattr(gns, "outside", lambda scene, _: [f"slope_deg {scene.slope_deg:g}"] * (scene.slope_deg > 0))
    monkeypatch.setattr(card, "warning", lambda path, scene: None)
    return tmp_path / "tiny.safetensors"


PARAMETERS = {
    name: Parameter(name=name, initial=initial, lower=0.5 * initial, upper=1.5 * initial)
    for name, initial in (("floor_friction", 0.4), ("solids[0].friction", 0.4), ("young", 1e6), ("damping", 0.1))
}
GROUND = Solid(kind="terrain", points=((0.0, 0.0), (1.0, 0.0)), friction=0.4)
WALL = Solid(lower=(0.8, 0.0), size=(0.05, 0.1), friction=0.4)


@pytest.mark.parametrize(
    ("changes", "unknown", "expected"),
    [
        ({}, None, None),
        ({}, "floor_friction", None),
        ({}, "damping", None),
        ({"solids": (GROUND,)}, "solids[0].friction", None),
        ({}, "young", "young is no input of it"),
        ({"slope_deg": 20.0}, None, "tiny.safetensors was not trained on such a flow: slope_deg 20"),
        ({"solids": (WALL,)}, "solids[0].friction", "expected only baffles and terrain"),
        ({"open_sides": ("x+",)}, None, "expected a closed box"),
    ],
)
def test_which_flows_it_knows(model: Path, changes: dict[str, Any], unknown: str | None, expected: str | None) -> None:
    shipped = read_problem("friction-tall-42")
    problem = replace(
        shipped,
        scene=replace(shipped.scene, **changes),
        parameters=shipped.parameters if unknown is None else (PARAMETERS[unknown],),
        observations=(FrontSettings(value=0.5),),
        target=TargetSettings(),
    )
    target = read_target(problem, FakeMpm().run)
    forward, reason = learned(problem, target, model)
    assert isinstance(forward, GnsForward if expected is None else type(None))
    assert forward is None or forward.band.front == 0.04
    assert (expected or "") in reason


def test_a_wide_band_does_not_lead(model: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    problem = read_problem("friction-tall-42")
    target = read_target(problem, FakeMpm().run)
    monkeypatch.setattr(surrogate, "shipped", lambda dimension: model)
    assert learned(problem, target, None)[0] is not None
    monkeypatch.setattr(surrogate, "WIDEST", 0.03)
    assert learned(problem, target, None) == (None, "its band is 4% of the extent, more than 3%")
    assert learned(problem, target, model)[0] is not None


def task(case: Case, out: Path, surrogate: Surrogate) -> Task:
    return replace(case, problem=replace(case.problem, surrogate=surrogate)).task(out)


def test_a_surrogate_is_asked_where_a_run_of_the_mpm_is_dear(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    case = wedge(tmp_path)
    monkeypatch.setattr(surrogate, "learned", lambda *_: (Formula(case.target.observation, case.mpm), ""))
    auto, asked = (task(case, tmp_path, kind) for kind in (Surrogate.AUTO, Surrogate.GNS))
    chosen, reason = choose(auto)
    assert chosen is None
    assert "less than 5 predictions" in reason
    assert choose(task(case, tmp_path, Surrogate.NONE))[1] == "the problem asks for none"
    assert choose(asked)[0] is not None
    # On a processor a million times slower.
    monkeypatch.setattr(gns, "SPEED", {2: 35.0})
    chosen, reason = choose(auto)
    assert chosen is not None
    assert "a run of the MPM takes" in reason
    monkeypatch.setattr(surrogate, "learned", lambda *_: (None, "it was not trained on it"))
    refused(choose, asked, said="expected auto or none, it was not trained")


def test_runs_on_larger_cells_lead_to_few_on_those_of_the_scene(tmp_path: Path) -> None:
    case = wedge(tmp_path, truth=24.0, mpm=FakeMpm(scatter=0.001, shortened=2.0))
    loop = LoopSettings(mpm_runs=6)
    case = replace(case, problem=replace(case.problem, loop=loop))
    result = run(task(case, tmp_path, Surrogate.COARSE))
    assert result.verdict is Verdict.CONFIRMED
    # Cells of 20 mm shorten a deposit by 2 % more than those of 10 mm do: 1 degree.
    coarse, corrected = result.surrogate["unknowns"]["friction_deg"], result.unknowns["friction_deg"]
    assert 0.5 < 24.0 - coarse < 1.5
    assert abs(corrected - 24.0) < 2.0 * result.certainty["friction_deg"] < 1.5
    cells = [scene.domain.cell for scene in case.mpm.scenes]
    assert cells.count(0.01) == len(result.mpm_runs) <= 6
    assert cells.count(0.02) == result.surrogate["predictions"]
    # Found again by a command that was cut short.
    assert run(task(case, tmp_path, Surrogate.COARSE)).unknowns == result.unknowns
    assert len(case.mpm.scenes) == len(cells)


def test_larger_cells_must_fit_the_box(tmp_path: Path) -> None:
    case = wedge(tmp_path)
    narrow = replace(case.problem.scene, domain=Domain(size=(1.21, 0.4), cell=0.01))
    case = replace(case, problem=replace(case.problem, scene=narrow))
    refused(choose, task(case, tmp_path, Surrogate.COARSE), said="cell")


def test_a_model_that_is_given_and_not_asked_is_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(surrogate, "learned", lambda *_: (None, "it is of flows in 3D"))
    run(task(wedge(tmp_path), tmp_path, Surrogate.AUTO), model=tmp_path / "other")
    assert "the surrogate is not used: it is of flows in 3D" in capsys.readouterr().err.splitlines()
