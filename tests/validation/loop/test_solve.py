"""The loop on flows whose truth is a formula: it finds the truth although the surrogate is wrong, or says that not."""

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from datasets.command_line import WorkFailed
from datasets.trajectory import Trajectory
from inverse.report import pictures
from inverse.result import Purpose, Verdict
from inverse.settings import LoopSettings, Method, OptimiserSettings, TargetSettings
from tests.validation.loop.flows import WIDTH, layers, length, true_velocities, wedge
from validation.loop import verdict
from validation.loop.__main__ import print_outcome

RESULT_KEYS = {
    "problem",
    "verdict",
    "unknowns",
    "certainty",
    "answers",
    "identifiability",
    "discrepancy",
    "truth",
    "error_pct",
    "observation",
    "loss",
    "mpm_runs",
    "other_minima",
    "iterations",
    "seconds",
    "peak_memory_mib",
}


@pytest.fixture(autouse=True)
def small_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pictures, "RESOLUTION", 40)


@pytest.mark.parametrize("kind", ["front", "profile"])
@pytest.mark.parametrize("truth", [16.0, 42.0])
@pytest.mark.parametrize(("steepness", "offset"), [(3.0, 1.1), (1.0 / 3.0, 0.9)])
def test_a_wrong_surrogate_leads_to_the_truth(
    tmp_path: Path, kind: str, truth: float, steepness: float, offset: float
) -> None:
    case = wedge(tmp_path, truth=truth, kind=kind, steepness=steepness, offset=offset)
    result = case.solve(tmp_path)
    assert result.verdict is Verdict.CONFIRMED
    assert len(result.checks) <= case.problem.loop.mpm_runs
    assert result.unknowns["friction_deg"] == pytest.approx(truth, rel=0.01)


def test_a_surrogate_whose_slope_has_the_wrong_sign_is_turned(tmp_path: Path) -> None:
    result = wedge(tmp_path, truth=27.0, steepness=-0.5).solve(tmp_path)
    assert result.verdict is Verdict.CONFIRMED
    assert result.unknowns["friction_deg"] == pytest.approx(27.0, rel=0.01)


@pytest.mark.parametrize("seed", range(3))
def test_the_truth_is_found_through_the_scatter_of_the_mpm(tmp_path: Path, seed: int) -> None:
    target = TargetSettings(twin=True, seed=100 + seed, truth={"friction_deg": 24.0})
    result = wedge(tmp_path, target=target, scatter=0.002, steepness=0.4, offset=1.08).solve(tmp_path)
    # 12 mm a degree: a scatter of 2 mm is 0.17 degrees for the target alone.
    assert abs(result.unknowns["friction_deg"] - 24.0) < 0.7
    assert result.certainty is not None
    assert 0.1 < result.certainty["friction_deg"] < 1.2
    assert result.verdict is Verdict.CONFIRMED


@pytest.mark.parametrize(("count", "seed"), [(2, 3), (2, 5), (10, 4)])
def test_a_surrogate_that_mixes_effects_leads_to_the_truth(tmp_path: Path, count: int, seed: int) -> None:
    result = layers(tmp_path, count=count, scatter=0.002, bend=0.03, shift=0.02, seed=seed).solve(tmp_path)
    assert result.verdict is Verdict.CONFIRMED
    assert len(result.checks) <= 8
    assert result.certainty is not None
    errors = [abs(result.unknowns[name] - true) for name, true in (result.target.truth or {}).items()]
    widths = [result.certainty[name] for name in result.unknowns]
    # Their coverage is in test_estimate.py; the errors of ten parameters of one flow are dependent.
    assert np.max(np.divide(errors, widths)) < 2.0
    assert max(widths) < 0.1 * WIDTH
    assert result.loss_mpm is not None
    assert result.mpm_runs[0].loss > 5.0 * result.loss_mpm


def test_without_scatter_the_answer_is_the_truth(tmp_path: Path) -> None:
    result = layers(tmp_path, count=4, bend=0.03).solve(tmp_path)
    assert result.verdict is Verdict.CONFIRMED
    np.testing.assert_allclose(result.answer, true_velocities(4), atol=0.02)


@pytest.mark.parametrize(("allowed", "ensembles"), [(0.5, 1), (1e-6, 2)])
def test_an_ensemble_whose_slopes_change_is_made_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, allowed: float, ensembles: int
) -> None:
    monkeypatch.setattr(verdict, "LINEAR", allowed)
    # The surrogate alone ends 0.7 degrees off.
    result = wedge(tmp_path, truth=40.0, offset=1.004, scatter=0.0005).solve(tmp_path)
    members = [run for run in result.mpm_runs if run.purpose is Purpose.ENSEMBLE]
    assert len(members) >= 32 * ensembles
    assert result.unknowns["friction_deg"] == pytest.approx(40.0, abs=0.2)


@pytest.mark.parametrize(("beyond", "bound", "steepness"), [(5.0, 12.0, 0.3), (60.0, 52.0, 1.0)])
def test_a_target_outside_the_bounds_is_unreachable(
    tmp_path: Path, beyond: float, bound: float, steepness: float
) -> None:
    result = wedge(tmp_path, target=TargetSettings(value=length(beyond)), steepness=steepness).solve(tmp_path)
    assert result.verdict is Verdict.UNREACHABLE
    assert result.unknowns["friction_deg"] == pytest.approx(bound)
    assert result.certainty is None
    # By the MPM: it was run at the bound and beside it.
    assert len({run.unknowns["friction_deg"] for run in result.mpm_runs}) >= 2
    result.save(tmp_path)
    with pytest.raises(WorkFailed, match="unreachable"):
        print_outcome(result, tmp_path)
    assert "No parameters within the bounds" in (tmp_path / "report.md").read_text()


def test_a_front_that_no_velocities_give_is_unreachable(tmp_path: Path) -> None:
    result = layers(tmp_path, kind="front", target=TargetSettings(value=1.5), scatter=0.001).solve(tmp_path)
    assert result.verdict is Verdict.UNREACHABLE
    assert result.unknowns["masses[1].velocity_x"] == pytest.approx(3.0, abs=1e-6)
    assert len(result.checks) <= 8


@pytest.mark.parametrize("runs", [1, 2, 5])
def test_the_budget_is_kept(tmp_path: Path, runs: int) -> None:
    loop = LoopSettings(mpm_runs=runs)
    case = wedge(tmp_path, truth=42.0, steepness=1.0 / 3.0, offset=1.1, scatter=0.003, loop=loop)
    result = case.solve(tmp_path)
    assert len(result.checks) <= runs
    if runs == 1:
        assert result.verdict is Verdict.UNCONFIRMED
        with pytest.raises(WorkFailed, match="unconfirmed"):
            print_outcome(result, tmp_path)


@pytest.mark.parametrize(
    ("make", "hard", "after"),
    [
        (wedge, {"truth": 42.0, "steepness": 1.0 / 3.0, "offset": 1.1}, 1),
        (wedge, {"truth": 42.0, "steepness": 1.0 / 3.0, "offset": 1.1}, 9),
        (layers, {"count": 4, "scatter": 0.002, "bend": 0.05, "shift": 0.03}, 20),
    ],
)
def test_what_ran_before_a_kill_is_not_run_again(tmp_path: Path, make: Any, hard: dict[str, Any], after: int) -> None:
    whole, case = make(tmp_path, **hard), make(tmp_path, **hard)
    unbroken = whole.solve(tmp_path / "whole")
    case.mpm.killed_after = after
    with pytest.raises(KeyboardInterrupt):
        case.solve(tmp_path / "killed")
    stored = len(list((tmp_path / "killed" / "mpm").glob("*.npz")))
    case.mpm.killed_after = 10**6
    resumed = case.solve(tmp_path / "killed")
    np.testing.assert_array_equal(resumed.answer, unbroken.answer)
    assert (resumed.certainty, resumed.verdict) == (unbroken.certainty, unbroken.verdict)
    # What a kill left of one call is lost, every finished call is stored.
    assert len(case.mpm.scenes) == len(whole.mpm.scenes) + after - stored
    case.mpm.scenes.clear()
    assert case.solve(tmp_path / "killed").certainty == unbroken.certainty
    assert case.mpm.scenes == []


@pytest.mark.parametrize("kind", ["front", "profile"])
def test_result_report_and_runs_are_what_the_design_promises(tmp_path: Path, kind: str) -> None:
    case = wedge(tmp_path, truth=24.0, steepness=0.5, kind=kind)
    found = case.solve(tmp_path / "first")
    # Saved elsewhere: complete.
    out = tmp_path / "saved"
    found.save(out)
    result = json.loads((out / "result.json").read_text())
    assert result.keys() == RESULT_KEYS
    (answer,) = result["answers"]
    assert (answer["unknowns"], answer["half_widths"]) == (result["unknowns"], result["certainty"])
    assert (answer["weight"], answer["misfit"]) == (1.0, result["loss"]["mpm"])
    assert result["verdict"] == "confirmed"
    assert result["truth"] == {"friction_deg": 24.0}
    error = 100.0 * abs(result["unknowns"]["friction_deg"] - 24.0) / 24.0
    assert result["error_pct"]["friction_deg"] == pytest.approx(error)
    assert abs(result["error_pct"]["front"]) < 0.5
    assert result["seconds"].keys() == {"forward", "backward", "per_iteration", "mpm", "total"}
    assert result["loss"]["mpm"] < result["loss"]["initial"]
    assert len(result["iterations"]) == len(found.evaluations)
    numbers = [result["observation"][name] for name in ("target", "surrogate", "mpm")]
    assert all(isinstance(number, float if kind == "front" else list) for number in numbers)
    for run in found.mpm_runs:
        trajectory = Trajectory.load(out / run.file)
        assert trajectory.scene.material.friction_deg == run.unknowns["friction_deg"]
        np.testing.assert_allclose(case.target.observation.observe(trajectory), run.observation)
        assert len(trajectory.time) == (1 if run.purpose is Purpose.ENSEMBLE else 2)
    report = (out / "report.md").read_text()
    assert "The MPM confirms" in report
    for picture in ("deposit.png", "iterations.png", "stages.png"):
        assert f"({picture})" in report
        assert (out / picture).read_bytes().startswith(b"\x89PNG")
    figure = found.plot()
    assert "confirmed" in figure.get_suptitle()
    assert len(figure.axes) == 2


def test_neither_truth_nor_the_scenes_own_value_is_used(tmp_path: Path) -> None:
    case = wedge(tmp_path, truth=24.0, steepness=0.5)
    known = case.solve(tmp_path / "known")
    blind = dataclasses.replace(case, target=dataclasses.replace(case.target, truth=None)).solve(tmp_path / "blind")
    other = dataclasses.replace(case.problem, scene=case.problem.scene.with_friction_deg(50.0))
    third = dataclasses.replace(case, problem=other).solve(tmp_path / "other")
    np.testing.assert_array_equal(known.answer, blind.answer)
    np.testing.assert_array_equal(known.answer, third.answer)


def test_a_measured_number_and_a_measured_profile_are_enough(tmp_path: Path) -> None:
    result = wedge(tmp_path, target=TargetSettings(value=0.79), steepness=0.5).solve(tmp_path / "number")
    assert result.verdict is Verdict.CONFIRMED
    case = wedge(tmp_path, truth=24.0, kind="profile")
    observation: Any = case.target.observation
    rows = zip(observation.stations, observation.heights(case.target.deposit), strict=True)
    (tmp_path / "seen.csv").write_text("x,height\n" + "".join(f"{x},{height}\n" for x, height in rows))
    measured = wedge(tmp_path, kind="profile", target=TargetSettings(csv="seen.csv"), steepness=0.5)
    result = measured.solve(tmp_path / "profile")
    assert result.verdict is Verdict.CONFIRMED
    assert result.unknowns["friction_deg"] == pytest.approx(24.0, rel=0.01)


def test_what_a_toe_does_not_constrain_is_not_identifiable(tmp_path: Path) -> None:
    """The furthest tenth of the particles is the last layer's: it does not depend on the first."""
    result = layers(tmp_path, count=4, kind="toe", scatter=0.002, shift=0.05).solve(tmp_path)
    assert result.verdict is Verdict.NOT_IDENTIFIABLE
    assert result.loss_mpm is not None
    assert np.sqrt(result.loss_mpm) <= 0.32 * 0.05
    assert result.certainty is not None
    assert result.certainty["masses[0].velocity_x"] == pytest.approx(WIDTH)
    assert result.identifiability is not None
    assert sum(combination.identifiable for combination in result.identifiability.combinations) == 1
    best, *_, worst = result.identifiability.combinations
    assert best.weights["masses[3].velocity_x"] > 0.8
    assert best.singular_value > 2.0 > worst.singular_value


def test_one_number_of_three_parameters_is_fitted(tmp_path: Path) -> None:
    result = layers(tmp_path, count=3, kind="front", scatter=0.0005, shift=0.05).solve(tmp_path)
    assert result.verdict is Verdict.NOT_IDENTIFIABLE
    assert abs(result.front_error_pct or 0.0) <= 0.3


@pytest.mark.parametrize(("improvable", "expected"), [(True, Verdict.CONFIRMED), (False, Verdict.UNCONFIRMED)])
def test_a_design_is_confirmed_where_the_mpm_shows_it_is_better(
    tmp_path: Path, improvable: bool, expected: Verdict
) -> None:
    target = TargetSettings(minimise=True)
    lower, mixing = (-1.0, 0.2) if improvable else (0.0, 0.0)
    case = layers(tmp_path, count=3, kind="passed", target=target, scatter=0.002, mixing=mixing, lower=lower)
    result = case.solve(tmp_path)
    assert result.verdict is expected
    assert result.begun is not None
    assert len(result.checks) <= 8
    if improvable:
        assert result.found.observation[0] < 0.9 * result.begun.observation[0]
        assert result.certainty is not None
        assert all(0.0 < width <= WIDTH for width in result.certainty.values())
        result.write(tmp_path)
        assert "NaN" not in (tmp_path / "result.json").read_text()


def test_of_multiple_starts_the_best_is_followed_and_others_are_reported(tmp_path: Path) -> None:
    settings = OptimiserSettings(starts=6, max_iterations=30, stop_below=1e-12)
    result = layers(tmp_path, optimiser=settings, lower=-2.0, mixing=0.0, folded=True).solve(tmp_path)
    assert {stage.start for stage in [result.rounds[0], *result.other_starts]} == set(range(6))
    assert 1 <= len(result.other_minima) <= 3
    first = min(result.rounds[0].evaluations, key=lambda each: each.loss)
    assert all(minimum.loss >= first.loss for minimum in result.other_minima)
    assert all(np.max(np.abs(each.parameters - first.parameters)) > 0.02 * WIDTH for each in result.other_minima)
    result.write(tmp_path)
    stored = json.loads((tmp_path / "result.json").read_text())
    initial = next(each for each in stored["iterations"] if (each["round"], each["start"]) == (0, 0))
    assert stored["loss"]["initial"] == pytest.approx(initial["loss"])


@pytest.mark.parametrize(
    ("method", "kind", "expected"),
    [(Method.GAUSS_NEWTON, "toe", Verdict.NOT_IDENTIFIABLE), (Method.ADAM, "deposit", Verdict.CONFIRMED)],
)
def test_the_problems_own_optimiser_comes_first(tmp_path: Path, method: Method, kind: str, expected: Verdict) -> None:
    settings = OptimiserSettings(method=method, max_iterations=25)
    result = layers(tmp_path, kind=kind, optimiser=settings).solve(tmp_path)
    assert result.verdict is expected
    assert len(result.rounds[0].evaluations) <= 25
