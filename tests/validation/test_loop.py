"""The loop with a flow whose truth is a formula: it finds it although the surrogate is wrong, and says so when not."""

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from datasets.command_line import WorkFailed
from datasets.trajectory import Trajectory
from inverse.problem import LoopSettings, Observable, TargetSettings
from inverse.result import Purpose, Verdict
from validation.loop import answers
from validation.loop.__main__ import finish, solve
from validation.loop.result import Solved

RESULT_KEYS = {
    "problem",
    "verdict",
    "unknowns",
    "certainty",
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


def solved(case: Any, out: Path) -> Solved:
    return solve(case.problem, case.target, case.observation, out, case.source, case.mpm)


@pytest.mark.parametrize("kind", [Observable.FRONT, Observable.RUNOUT, Observable.PROFILE])
@pytest.mark.parametrize("truth", [16.0, 24.0, 42.0])
@pytest.mark.parametrize(("steepness", "offset"), [(1.0, 1.0), (3.0, 1.1), (1.0 / 3.0, 0.9), (1.0 / 3.0, 1.1)])
def test_a_wrong_surrogate_still_finds_the_truth(
    make_case: Any, tmp_path: Path, kind: Observable, truth: float, steepness: float, offset: float
) -> None:
    case = make_case(truth=truth, kind=kind, steepness=steepness, offset=offset)
    result = solved(case, tmp_path).result
    assert result.verdict is Verdict.CONFIRMED
    assert len(result.checks) <= case.problem.loop.mpm_runs
    assert result.unknowns["friction_deg"] == pytest.approx(truth, rel=0.01)


def test_a_surrogate_that_answers_the_wrong_way_round_is_turned(make_case: Any, tmp_path: Path) -> None:
    result = solved(make_case(truth=27.0, steepness=-0.5), tmp_path).result
    assert result.verdict is Verdict.CONFIRMED
    assert result.unknowns["friction_deg"] == pytest.approx(27.0, rel=0.01)


@pytest.mark.parametrize("seed", range(6))
def test_the_truth_is_found_through_the_mpms_scatter(make_case: Any, tmp_path: Path, seed: int) -> None:
    settings = TargetSettings(hidden=True, seed=100 + seed, truth={"friction_deg": 24.0})
    case = make_case(settings=settings, scatter=0.002, steepness=0.4, offset=1.08)
    result = solved(case, tmp_path).result
    # 12 mm a degree: a scatter of 2 mm is 0.17 degrees for the target alone.
    assert abs(result.unknowns["friction_deg"] - 24.0) < 0.7
    assert result.certainty is not None
    assert 0.1 < result.certainty["friction_deg"] < 1.2
    assert result.verdict is Verdict.CONFIRMED


@pytest.mark.parametrize(("straight", "ensembles"), [(0.5, 1), (0.1, 2)])
def test_an_ensemble_that_points_far_away_is_made_again_there(
    make_case: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, straight: float, ensembles: int
) -> None:
    monkeypatch.setattr(answers, "STRAIGHT", straight)
    # The surrogate alone ends 0.7 degrees off: near enough to leave the rest to the ensemble.
    found = solved(make_case(truth=40.0, offset=1.004, scatter=0.0005), tmp_path)
    members = [run for run in found.result.mpm_runs if run.purpose is Purpose.ENSEMBLE]
    assert len(members) == 32 * ensembles
    assert found.certainty is not None
    reach = 0.2 if ensembles == 2 else 1.0
    assert abs(found.certainty.centre[0] - found.result.answer[0]) < reach
    assert found.result.unknowns["friction_deg"] == pytest.approx(40.0, abs=0.2)


@pytest.mark.parametrize(("beyond", "bound"), [(5.0, 12.0), (60.0, 52.0)])
@pytest.mark.parametrize("steepness", [1.0, 0.3])
def test_a_target_that_no_angle_reaches_is_unreachable(
    make_case: Any, tmp_path: Path, beyond: float, bound: float, steepness: float
) -> None:
    from_formula = 1.0 - 0.02 * (beyond - 12.0) + 0.00015 * (beyond - 12.0) ** 2
    case = make_case(settings=TargetSettings(value=from_formula), steepness=steepness)
    outcome = solved(case, tmp_path)
    assert outcome.result.verdict is Verdict.UNREACHABLE
    assert outcome.result.unknowns["friction_deg"] == pytest.approx(bound)
    assert outcome.result.certainty is None
    # Not on the surrogate's word: the MPM has been asked on the bound and beside it.
    assert len({run.unknowns["friction_deg"] for run in outcome.result.mpm_runs}) >= 2
    with pytest.raises(WorkFailed, match="unreachable"):
        finish(outcome, tmp_path)
    assert "Nothing within the bounds" in (tmp_path / "report.md").read_text()


def test_a_spent_budget_is_unconfirmed(make_case: Any, tmp_path: Path) -> None:
    loop = LoopSettings(mpm_runs=1)
    case = make_case(truth=42.0, steepness=1.0 / 3.0, offset=1.1, loop=loop)
    outcome = solved(case, tmp_path)
    assert outcome.result.verdict is Verdict.UNCONFIRMED
    assert len(outcome.result.checks) == 1
    with pytest.raises(WorkFailed, match="unconfirmed"):
        finish(outcome, tmp_path)
    assert json.loads((tmp_path / "result.json").read_text())["verdict"] == "unconfirmed"


@pytest.mark.parametrize("runs", range(2, 9))
def test_no_budget_is_overspent(make_case: Any, tmp_path: Path, runs: int) -> None:
    case = make_case(truth=42.0, steepness=1.0 / 3.0, offset=1.1, scatter=0.003, loop=LoopSettings(mpm_runs=runs))
    assert len(solved(case, tmp_path).result.checks) <= runs


@pytest.mark.parametrize("after", [0, 1, 3, 5, 9])
def test_what_ran_before_a_kill_is_not_run_again(make_case: Any, tmp_path: Path, after: int) -> None:
    hard: dict[str, Any] = {"truth": 42.0, "steepness": 1.0 / 3.0, "offset": 1.1}
    whole = make_case(**hard)
    unbroken = solved(whole, tmp_path / "whole").result
    case = make_case(**hard)
    case.mpm.killed_after = after
    with pytest.raises(KeyboardInterrupt):
        solved(case, tmp_path / "killed")
    kept = len(list((tmp_path / "killed" / "mpm").glob("*.npz")))
    case.mpm.killed_after = 10**6
    resumed = solved(case, tmp_path / "killed").result
    np.testing.assert_array_equal(resumed.answer, unbroken.answer)
    assert resumed.certainty == unbroken.certainty
    # The ensemble runs side by side: what a kill left of one call is lost, every finished call is kept.
    assert len(case.mpm.scenes) == len(whole.mpm.scenes) + after - kept
    assert kept >= min(after, len(unbroken.checks) - 1)


def test_a_second_run_asks_the_mpm_nothing(make_case: Any, tmp_path: Path) -> None:
    case = make_case(truth=20.0)
    solved(case, tmp_path)
    case.mpm.scenes.clear()
    solved(case, tmp_path)
    assert case.mpm.scenes == []


def test_every_run_is_kept_with_its_scene(make_case: Any, tmp_path: Path) -> None:
    case = make_case(truth=20.0, steepness=0.5)
    result = solved(case, tmp_path).result
    for run in result.mpm_runs:
        trajectory = Trajectory.load(tmp_path / run.file)
        assert trajectory.scene.material.friction_deg == run.unknowns["friction_deg"]
        np.testing.assert_allclose(case.observation.exact(trajectory.positions[-1]), run.observation)
        # A hundredth of the size, and an ensemble is asked for its deposits alone.
        assert len(trajectory.time) == (1 if run.purpose is Purpose.ENSEMBLE else 2)


@pytest.mark.parametrize("kind", [Observable.FRONT, Observable.PROFILE])
def test_result_and_report_say_what_the_design_promises(make_case: Any, tmp_path: Path, kind: Observable) -> None:
    case = make_case(truth=24.0, steepness=0.5, kind=kind)
    outcome = solved(case, tmp_path)
    finish(outcome, tmp_path)
    result = json.loads((tmp_path / "result.json").read_text())
    assert result.keys() == RESULT_KEYS
    assert result["verdict"] == "confirmed"
    assert result["truth"] == {"friction_deg": 24.0}
    assert result["error_pct"]["friction_deg"] == pytest.approx(
        100.0 * abs(result["unknowns"]["friction_deg"] - 24.0) / 24.0
    )
    assert abs(result["error_pct"]["front"]) < 0.5
    assert result["seconds"].keys() == {"forward", "backward", "per_iteration", "mpm", "total"}
    assert result["loss"]["mpm"] < result["loss"]["initial"]
    assert len(result["iterations"]) == len(outcome.result.evaluations)
    assert result["peak_memory_mib"] > 1.0
    numbers = [result["observation"][name] for name in ("target", "surrogate", "mpm")]
    assert all(isinstance(number, float if kind is Observable.FRONT else list) for number in numbers)
    report = (tmp_path / "report.md").read_text()
    assert "The MPM confirms" in report
    for picture in ("deposit.png", "iterations.png"):
        assert f"({picture})" in report
        assert (tmp_path / picture).read_bytes().startswith(b"\x89PNG")


def test_the_inversion_never_sees_the_truth(make_case: Any, tmp_path: Path) -> None:
    case = make_case(truth=24.0, steepness=0.5)
    blind = dataclasses.replace(case.target, truth=None)
    seen = solved(case, tmp_path / "seen").result
    unseen = solve(case.problem, blind, case.observation, tmp_path / "unseen", case.source, case.mpm).result
    np.testing.assert_array_equal(seen.answer, unseen.answer)
    # Nor does the scene's own angle lead there: every run had another.
    other = dataclasses.replace(case.problem, scene=case.problem.scene.with_friction_deg(50.0))
    third = solve(other, case.target, case.observation, tmp_path / "other", case.source, case.mpm).result
    np.testing.assert_array_equal(seen.answer, third.answer)


def test_a_number_alone_is_enough(make_case: Any, tmp_path: Path) -> None:
    case = make_case(settings=TargetSettings(value=0.79), steepness=0.5)
    outcome = solved(case, tmp_path)
    finish(outcome, tmp_path)
    assert outcome.result.verdict is Verdict.CONFIRMED
    assert json.loads((tmp_path / "result.json").read_text())["truth"] is None


def test_a_measured_profile_is_met(make_case: Any, tmp_path: Path) -> None:
    case = make_case(truth=24.0, kind=Observable.PROFILE)
    assert case.target.deposit is not None
    rows = zip(case.observation.stations, case.observation.heights(case.target.deposit), strict=True)
    (tmp_path / "seen.csv").write_text("x,height\n" + "".join(f"{x},{height}\n" for x, height in rows))
    measured = make_case(kind=Observable.PROFILE, settings=TargetSettings(csv="seen.csv"), steepness=0.5)
    result = solved(measured, tmp_path / "out").result
    assert result.verdict is Verdict.CONFIRMED
    assert result.unknowns["friction_deg"] == pytest.approx(24.0, rel=0.01)
