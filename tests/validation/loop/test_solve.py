"""The loop on flows whose truth is a formula: every answer, how certain each is, or that there is none; priors."""

import importlib.util
import json
import math
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import h5py
import numpy as np
import pytest

from datasets import Mass, Scene, Trajectory
from datasets.errors import InputError, WorkFailed
from datasets.lock import locked
from inverse import Parameter, Prior, Problem, TargetSettings, inference_data, plot, report, save
from inverse.answer import Purpose, Verdict
from inverse.observations import FrontSettings, PassedSettings, ProfileSettings
from inverse.posterior.settings import CONSTANTS
from inverse.report import summary
from inverse.search.inference import begun, narrowed
from tests.inverse.test_fields import files
from tests.scenes import scene_of
from tests.validation.loop.flows import FRONT, WIDTH, Case, FakeMpm, Folded, layers, length, wedge
from validation.loop import verdict
from validation.loop.solve import print_outcome, solve


@pytest.mark.parametrize(("kind", "truth"), [("front", 13.0), ("front", 42.0), ("profile", 24.0)])
def test_the_truth_is_found_through_the_scatter_of_the_mpm(tmp_path: Path, kind: str, truth: float) -> None:
    result = wedge(tmp_path, truth=truth, kind=kind, scatter=0.002).solve(tmp_path)
    assert result.verdict is Verdict.CONFIRMED
    # 20 to 8 mm a degree: a scatter of 2 mm is 0.1 to 0.25 degrees for the target alone.
    slope = 0.02 - 0.0003 * (truth - 12.0)
    # Half-widths are 1.96 of it where the scatter is known; by a dozen runs that is known to a fifth.
    assert 1.2 * 0.002 / slope < result.certainty["friction_deg"] < 5.0 * 0.002 / slope
    assert abs(result.unknowns["friction_deg"] - truth) < 2.0 * result.certainty["friction_deg"]


def test_an_answer_that_moves_at_every_check_is_checked_twice(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(verdict, "CLOSE", -1.0)
    result = wedge(tmp_path, scatter=0.002).solve(tmp_path)
    assert result.verdict is Verdict.CONFIRMED
    assert [run.purpose for run in result.mpm_runs].count(Purpose.CHECK) == 2 * CONSTANTS.checks


@pytest.mark.slow
def test_half_widths_hold_the_truth_as_often_as_they_say(tmp_path: Path) -> None:
    """Of thirty twins 95 % are 28.5, and 26 or fewer have a probability of 0.06 at most by chance."""
    inside = 0
    for seed in range(30):
        case = wedge(tmp_path, seed=1000 + seed, truth=14.0 + 1.2 * seed, scatter=0.002)
        case = replace(case, problem=replace(case.problem, scene=replace(case.problem.scene, seed=5000 + seed)))
        inside += len(case.solve(tmp_path / str(seed)).inside)
    assert inside >= 26


@pytest.mark.parametrize("seed", [1, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (2, 3))])
def test_flows_that_scatter_more_elsewhere_do_not_widen_the_half_width(tmp_path: Path, seed: int) -> None:
    case = wedge(tmp_path, mpm=FakeMpm(scatter=0.002, uneven=30.0), truth=22.0, seed=seed, noise=0.002)
    # Twenty runs from 20 to 24 degrees, nine over the whole box.
    state = begun(case.task(tmp_path).search()).ran(np.linspace(0.2, 0.3, 20)[:, None]).informed()
    whole, local = (stage.knowledge.posterior for stage in (state, narrowed(state)))
    assert 15 < local.near.sum() < whole.near.sum()
    # In degrees: noise and scatter over the slope of the length.
    exact = math.hypot(0.002 / FRONT, 0.002) / (0.02 - 0.0003 * (22.0 - 12.0))
    wide, narrow = (40.0 * float(posterior.samples.covariance[0, 0]) ** 0.5 for posterior in (whole, local))
    assert narrow < 2.0 * exact < wide
    assert abs(40.0 * local.samples.mean[0] - 10.0) < 4.0 * exact


@pytest.mark.parametrize(("count", "seed", "widest"), [(2, 3, 0.06), pytest.param(10, 4, 0.2, marks=pytest.mark.slow)])
def test_layers_that_overlap_are_identified(tmp_path: Path, count: int, seed: int, widest: float) -> None:
    """Over seeds of the target's jitter the widest half-width is 0.10 to 0.13 of the range at ten layers."""
    result = layers(tmp_path, count=count, scatter=0.002, bend=0.03, seed=seed).solve(tmp_path)
    assert result.verdict is Verdict.CONFIRMED
    errors = [abs(result.unknowns[name] - true) for name, true in (result.target.truth or {}).items()]
    widths = [result.certainty[name] for name in result.unknowns]
    assert np.max(np.divide(errors, widths)) < 2.0
    assert max(widths) < widest * WIDTH
    assert len(result.mpm_runs) <= result.problem.loop.budget(count)


@pytest.mark.parametrize(("beyond", "bound"), [(5.0, 12.0), pytest.param(60.0, 52.0, marks=pytest.mark.slow)])
def test_a_target_outside_the_bounds_is_unreachable(tmp_path: Path, beyond: float, bound: float) -> None:
    result = wedge(tmp_path, value=length(beyond), scatter=0.001).solve(tmp_path)
    assert result.verdict is Verdict.UNREACHABLE
    assert result.unknowns["friction_deg"] == pytest.approx(bound, abs=0.5)
    save(result, tmp_path)
    with pytest.raises(WorkFailed, match="unreachable"):
        print_outcome(result, tmp_path)


def test_a_bound_is_the_reason_of_many_numbers_too(tmp_path: Path) -> None:
    """By the factor of their misfit the interval is wider, and its median is no longer at the bound."""
    case = wedge(tmp_path, value=length(5.0), scatter=0.001)
    fronts = tuple(FrontSettings(value=value, noise=0.004) for value in np.linspace(0.98, 1.02, 6) * length(5.0))
    problem = replace(case.problem, observations=fronts)
    result = solve(problem, tmp_path, simulate=case.mpm)
    assert result.verdict is Verdict.UNREACHABLE
    assert result.answers[0].fit.applied > 2.0
    assert result.unknowns["friction_deg"] > 12.0 + 0.02 * 40.0


@pytest.mark.parametrize(
    ("cells", "said"), [(0.0014, ""), (0.004, "cells of 0.0025 m (64 times the work)"), (1.0, "falls with the cell")]
)
def test_finer_cells_are_advised_where_they_help(cells: float, said: str) -> None:
    fit, problem = SimpleNamespace(noise=0.001, cells=cells), SimpleNamespace(scene=scene_of(cell=0.01))
    answer = SimpleNamespace(fit=fit, checks=[SimpleNamespace(seconds=0.0)])
    result: Any = SimpleNamespace(answers=[answer], problem=problem, target=SimpleNamespace(cell=None))
    text = report.finer(result)
    assert said in text
    assert bool(said) == bool(text)


def test_every_answer_is_named_and_what_would_decide(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Fronts as far at 22 and at 38 degrees: two answers, and a height between the front and the wall decides."""
    case = wedge(tmp_path, truth=22.0, mpm=Folded(scatter=0.002))
    result = case.solve(tmp_path)
    assert result.verdict is Verdict.AMBIGUOUS
    angles = sorted(float(answer.parameters[0]) for answer in result.answers)
    assert angles == pytest.approx([22.0, 38.0], abs=1.0)
    assert sum(answer.weight for answer in result.answers) == pytest.approx(1.0)
    assert all(0.2 < answer.weight < 0.8 for answer in result.answers)
    assert all(result.target.misfit(answer.observation) < 0.003**2 for answer in result.answers)
    save(result, tmp_path)
    print_outcome(result, tmp_path)
    said = capsys.readouterr().out
    assert said.startswith("wedge: ambiguous")
    assert "the height around x =" in said
    # The profile tells the two apart.
    identified = wedge(tmp_path, truth=22.0, mpm=Folded(scatter=0.002), kind="profile").solve(tmp_path / "profile")
    assert identified.verdict is Verdict.CONFIRMED
    assert identified.unknowns["friction_deg"] == pytest.approx(22.0, abs=1.0)


def test_what_ran_before_a_kill_is_not_run_again(tmp_path: Path) -> None:
    after = 17
    whole, case = (wedge(tmp_path, truth=42.0, scatter=0.003) for _ in range(2))
    unbroken = whole.solve(tmp_path / "whole")
    case.mpm.killed_after = after
    with pytest.raises(KeyboardInterrupt):
        case.solve(tmp_path / "killed")
    stored = len(list((tmp_path / "killed" / "mpm").glob("*.npz")))
    case.mpm.killed_after = 10**6
    resumed = case.solve(tmp_path / "killed")
    np.testing.assert_array_equal(resumed.answer, unbroken.answer)
    np.testing.assert_array_equal(resumed.samples, unbroken.samples)
    assert (resumed.certainty, resumed.verdict) == (unbroken.certainty, unbroken.verdict)
    # What a kill left of one call is lost, every finished call is stored.
    assert len(case.mpm.scenes) == len(whole.mpm.scenes) + after - stored
    case.mpm.scenes.clear()
    assert case.solve(tmp_path / "killed").certainty == unbroken.certainty
    assert case.mpm.scenes == []


def test_a_folder_that_another_process_writes_into_is_refused(tmp_path: Path) -> None:
    with locked(tmp_path), pytest.raises(WorkFailed, match="writes here since"):
        solve("friction-tall-42", tmp_path)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("kind", ["front", "profile"])
def test_result_report_and_runs_are_what_the_design_promises(tmp_path: Path, kind: str) -> None:
    case = wedge(tmp_path, truth=24.0, kind=kind, scatter=0.001)
    outcome = case.solve(tmp_path / "first")
    # Saved elsewhere: complete.
    out = tmp_path / "saved"
    save(outcome, out)
    result = json.loads((out / "result.json").read_text())
    (answer,) = result["answers"]
    assert (answer["unknowns"], answer["half_widths"]) == (result["unknowns"], result["certainty"])
    assert (answer["weight"], answer["misfit"]) == (pytest.approx(1.0), result["loss"]["mpm"])
    assert result["verdict"] == "confirmed"
    assert result["truth"] == {"friction_deg": 24.0}
    error = 100.0 * abs(result["unknowns"]["friction_deg"] - 24.0) / 24.0
    assert result["error_pct"]["friction_deg"] == pytest.approx(error)
    assert result["seconds"].keys() == {"mpm", "processors", "total"}
    assert [iteration["mpm_runs"] for iteration in result["iterations"]] == sorted(
        iteration["mpm_runs"] for iteration in outcome.iterations
    )
    numbers = [result["observation"][name] for name in ("target", "mpm")]
    assert all(isinstance(number, float if kind == "front" else list) for number in numbers)
    with np.load(out / "posterior.npz", allow_pickle=False) as file:
        assert file["names"].tolist() == ["friction_deg"]
        assert file["weights"].sum() == pytest.approx(1.0)
        mean = float(file["weights"] @ file["samples"][:, 0])
        assert len(file["samples"]) == len(file["weights"])
    assert mean == pytest.approx(result["unknowns"]["friction_deg"], abs=result["certainty"]["friction_deg"])
    for mpm_run in outcome.mpm_runs:
        trajectory = Trajectory.load(out / mpm_run.file)
        assert trajectory.scene.material.friction_deg == mpm_run.parameters[0]
        np.testing.assert_allclose(case.target.observation.observe(trajectory), mpm_run.numbers)
        assert len(trajectory.time) == 1
    assert {run.purpose for run in outcome.mpm_runs} == {Purpose.WAVE, Purpose.CHECK}
    assert result["remarks"] == ["the sand still moves"]
    for picture in ("deposit.png", "posterior.png"):
        assert (out / picture).read_bytes().startswith(b"\x89PNG")
    assert len(plot(outcome).axes) == 3


def test_the_error_of_the_cells_counts_for_what_was_measured(tmp_path: Path) -> None:
    """Cells of 10 mm shorten the deposit by 2 %; one that was measured was not made of cells."""
    twin = wedge(tmp_path, truth=24.0, mpm=FakeMpm(scatter=0.001, shortened=2.0)).solve(tmp_path / "twin")
    true = length(24.0) * FRONT
    measured = wedge(tmp_path, value=true, mpm=FakeMpm(scatter=0.001, shortened=2.0)).solve(tmp_path / "seen")
    assert twin.certainty["friction_deg"] < 0.4
    assert abs(twin.unknowns["friction_deg"] - 24.0) < 0.5
    # 16 mm in a slope of 16 mm a degree.
    assert 0.8 < abs(measured.unknowns["friction_deg"] - 24.0) < measured.certainty["friction_deg"] < 4.0
    # By runs on half the cells, which change half as much as all of it.
    assert measured.answers[0].fit.cells == pytest.approx(0.02 * true, rel=0.2)


@pytest.mark.parametrize(
    ("thickness", "factors"),
    [
        (0.1, (2.0, 0.5)),
        (0.05, (0.5, 2.0)),
        (((0.001, 0.3), (0.0, 0.2)), (2.0, 0.5)),
        (((0.05, 0.09), (0.0, 0.0)), (0.5, 2.0)),
    ],
)
def test_the_error_of_the_cells_of_a_thin_layer_needs_smaller_ones(thickness: Any, factors: tuple[float, ...]) -> None:
    """Of one of less than two cells of 0.05 m, in the mean of where there is any."""
    grid = {} if isinstance(thickness, float) else {"origin": (0.25, 0.25), "spacing": (0.5, 0.5)}
    scene = scene_of(Mass(kind="layer", thickness=thickness, **grid), size=(1.0, 1.0, 1.0), cell=0.05)
    assert tuple(verdict.other_cells(scene, 3)) == factors
    assert verdict.other_cells(scene_of(), 3) == {0.5: 3}


LACKING = "a run needs more memory than is free"


@pytest.mark.parametrize(
    ("thickness", "length", "fits", "cells"),
    [
        (0.05, 1.0, True, [0.025]),
        (0.05, 1.0, False, [0.025, 0.1]),
        (0.3, 1.0, True, [0.1]),
        (0.3, 1.05, True, [0.025]),
        (0.3, 1.05, False, [0.025]),
    ],
)
def test_other_cells_that_fit_the_box_and_the_memory(
    thickness: float, length: float, fits: bool, cells: list[float]
) -> None:
    """A box 21 cells long divides only into smaller ones; if they need too much memory, the report says so."""
    scene = scene_of(Mass(kind="layer", thickness=thickness), size=(length, 1.05, 1.0), cell=0.05)
    made: list[list[float]] = []

    def compared(_: Any, scenes: Sequence[Scene], purpose: Purpose) -> tuple[str, ...]:
        made.append([each.domain.cell for each in scenes])
        if scenes[0].domain.cell < 0.05 and not fits:
            raise InputError(LACKING)
        return (purpose.value,)

    check = SimpleNamespace(parameters=np.zeros(1), trajectory=SimpleNamespace(scene=scene))
    task: Any = SimpleNamespace(
        problem=SimpleNamespace(scene_at=lambda _: scene),
        target=SimpleNamespace(cell=None),
        on_cells=lambda scene, factor: scene.with_cell(factor * scene.domain.cell),
        compared=compared,
    )
    answer: Any = SimpleNamespace(checks=(check, check))
    runs, remark = verdict.on_other_cells(task, answer)
    assert made == [[cell] * (1 if cell < 0.05 else 2) for cell in cells]
    assert runs == (() if remark else ("cells",))
    said = "domain.size: expected a positive whole number of cells of 0.1 m, up to 1e+09 m, got [1.05, 1.1, 1.0]; "
    assert remark == ("" if runs else f"no interval includes the error of the cells: {said}{LACKING}")


def test_a_report_says_that_the_error_of_the_cells_is_missing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    case = wedge(tmp_path, value=0.6, scatter=0.001)

    def needy(scene: Scene) -> Trajectory:
        if scene.domain.cell < 0.01:
            raise InputError(LACKING)
        return run(scene)

    run = case.mpm.run
    monkeypatch.setattr(case.mpm, "run", needy)
    said = f"At the answer: no interval includes the error of the cells: {LACKING}."
    assert said in summary(case.solve(tmp_path / "out"))


def test_fields_are_left_to_the_adjoint(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[Problem] = []
    monkeypatch.setattr("inverse.inversion.invert", lambda problem, model: asked.append(problem))
    solve(files(tmp_path))
    assert [unknown.settings.name for unknown in asked[0].fields] == ["velocity_x"]


def test_joint_observations_find_it_together(tmp_path: Path) -> None:
    case = wedge(tmp_path, truth=24.0, scatter=0.002)
    of_deposit = FrontSettings(noise="1%"), ProfileSettings(noise="3%"), PassedSettings(line=0.4, noise=0.01)
    observed = (*of_deposit, FrontSettings(times=(0.5, 1.0), noise=0.005))
    problem = replace(case.problem, observations=observed)
    result = solve(problem, tmp_path, simulate=case.mpm)
    assert result.verdict is Verdict.CONFIRMED
    assert abs(result.unknowns["friction_deg"] - 24.0) <= result.certainty["friction_deg"] < 2.0
    stored = json.loads((tmp_path / "result.json").read_text())["observation"]
    assert [part["name"] for part in stored["parts"]] == ["front", "profile", "passed", "front 2"]
    # In their own units, not in standard deviations.
    assert stored["mpm"][0] == pytest.approx(length(24.0) * FRONT, rel=0.02)


@pytest.mark.slow
def test_a_ridge_of_answers_is_one_ambiguous_answer(tmp_path: Path) -> None:
    names = ["masses[0].friction_deg", "masses[1].friction_deg"]
    masses = tuple(Mass(lower=(0.0, 0.1 * row), size=(0.3, 0.1)) for row in range(2))
    one = wedge(tmp_path, kind="profile").problem
    problem = replace(
        one,
        name="twins",
        scene=replace(one.scene, masses=masses),
        parameters=tuple(Parameter(name=name, initial=30.0, lower=12.0, upper=52.0) for name in names),
        target=TargetSettings(twin=True, seed=7, truth=dict.fromkeys(names, 25.0)),
    )
    result = solve(problem, tmp_path, simulate=FakeMpm(scatter=0.001))
    assert result.verdict is Verdict.AMBIGUOUS
    assert min(result.certainty.values()) > 8.0
    assert sum(result.unknowns.values()) == pytest.approx(50.0, abs=1.5)
    # The sum is known from 12 + 38 to 38 + 12 degrees.
    np.testing.assert_allclose(result.samples.sum(axis=1), 50.0, atol=3.0)
    assert np.ptp(result.samples[:, 0]) > 20.0


NOISE, PER_DEGREE = 0.06, 0.0164  # of the front [m], and how much of it a degree is


def case_of(folder: Path, prior: Prior, **changes: float) -> Case:
    case = wedge(folder, truth=27.0, scatter=0.002, **changes)
    (parameter,) = case.problem.parameters
    parameters = (replace(parameter, initial=None, prior=prior),)
    return replace(case, problem=replace(case.problem, parameters=parameters))


def test_a_prior_counts_as_much_as_a_measurement(tmp_path: Path) -> None:
    case = case_of(tmp_path, Prior(kind="normal", mean=24.0, deviation=3.0), noise=NOISE)
    outcome = case.solve(tmp_path / "out")
    save(outcome, tmp_path / "out")
    noise = NOISE / PER_DEGREE
    assert outcome.certainty["friction_deg"] == pytest.approx(1.96 * 3.0 * noise / np.hypot(3.0, noise), rel=0.3)
    result = json.loads((tmp_path / "out" / "result.json").read_text())
    assert result["prior"] == {"friction_deg": {"kind": "normal", "mean": 24.0, "deviation": 3.0}}
    assert result["correlations"] == []
    with h5py.File(tmp_path / "out" / "posterior.nc") as file:
        assert set(file) == {"posterior", "prior", "posterior_predictive", "observed_data"}
        samples, drawn = file["posterior/friction_deg"], file["prior/friction_deg"]
        assert samples.attrs["units"] == drawn.attrs["units"] == "deg"
        assert (samples.shape, drawn.shape) == ((2, 1500), (1, 3000))
        assert [axis[0].name for axis in samples.dims] == ["/posterior/chain", "/posterior/draw"]
        weighed = outcome.posterior.samples.weights @ outcome.samples[:, 0]
        assert samples[...].mean() == pytest.approx(weighed, abs=0.02)
        assert drawn[...].std() == pytest.approx(3.0, rel=0.1)
        front, shown = file["observed_data/front"][...], file["posterior_predictive/front"]
        np.testing.assert_allclose(front, case.target.values)
        assert shown.shape == (2, 1500, 1)
        # What is not known of the angle, and the noise of another measurement.
        assert shown[...].std() == pytest.approx(np.hypot(NOISE, PER_DEGREE * samples[...].std()), rel=0.3)


@pytest.mark.parametrize("mean", [24.0, 40.0])
def test_a_surrogate_leads_with_a_prior_that_may_contradict_the_deposit(tmp_path: Path, mean: float) -> None:
    case = case_of(tmp_path, Prior(kind="normal", mean=mean, deviation=2.0))
    result = case.led(1.02).solve(tmp_path)
    assert result.verdict is Verdict.CONFIRMED
    assert abs(result.unknowns["friction_deg"] - 27.0) < 2.0 * result.certainty["friction_deg"] < 2.5


READING = """
import matplotlib
matplotlib.use("Agg")
import arviz
found = arviz.from_netcdf("posterior.nc")
arviz.plot_pair(found)
assert float(arviz.summary(found, round_to="none").r_hat.max()) < 1.1
assert found.posterior["masses[0].velocity_x"].attrs["units"] == "m/s"
"""


@pytest.mark.slow
def test_arviz_plots_it_as_it_is(tmp_path: Path) -> None:
    inference_data.write(layers(tmp_path, scatter=0.002).solve(tmp_path), tmp_path / "posterior.nc")
    with h5py.File(tmp_path / "posterior.nc") as file:
        # A deposit has too many numbers.
        assert set(file) == {"posterior", "prior"}
    if importlib.util.find_spec("arviz") is None:
        pytest.skip("arviz is in the extra dev")
    subprocess.run([sys.executable, "-W", "ignore", "-c", READING], cwd=tmp_path, check=True)
