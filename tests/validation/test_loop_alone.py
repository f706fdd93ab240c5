"""The loop on the MPM alone, of one observation and of several; and what fits without being told."""

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from datasets.command_line import WorkFailed
from datasets.scene import Domain, Mass, Scene
from datasets.trajectory import Trajectory
from inverse.forward.gns import GnsSource
from inverse.forward.linearised import MpmSource
from inverse.observations.measurements import prepare
from inverse.observations.target import observation_of
from inverse.parameters.parameters import with_unknowns
from inverse.problem import (
    LoopSettings,
    MeasurementSettings,
    Observable,
    ObservationSettings,
    Problem,
    Surrogate,
    TargetSettings,
    Unknown,
    read_problem,
)
from inverse.result import Verdict
from inverse.settings import Measurable
from tests.validation.conftest import SHAPE, FakeMpm, at_rest, length
from validation.loop.__main__ import finish, solve
from validation.loop.result import Solved
from validation.loop.runs import KeptRuns
from validation.loop.source import choose


def alone(problem: Problem, mpm: Any, out: Path) -> Solved:
    observation, target = prepare(problem, mpm.run)
    source = MpmSource(problem, observation, KeptRuns(out / "mpm", mpm, prefix="slope-"))
    return solve(problem, target, observation, out, source, mpm, alone="none was asked for")


@pytest.mark.parametrize("kind", [Observable.FRONT, Observable.PROFILE])
@pytest.mark.parametrize("truth", [16.0, 42.0])
def test_the_mpm_alone_finds_the_truth(make_case: Any, tmp_path: Path, kind: Observable, truth: float) -> None:
    case = make_case(truth=truth, kind=kind, scatter=0.001)
    outcome = alone(case.problem, case.mpm, tmp_path)
    finish(outcome, tmp_path)
    result = outcome.result
    assert result.verdict is Verdict.CONFIRMED
    assert result.certainty is not None
    assert abs(result.unknowns["friction_deg"] - truth) <= max(0.2, 1.5 * result.certainty["friction_deg"])
    assert len(result.checks) <= case.problem.loop.mpm_runs
    assert "No learned surrogate proposes: none was asked for" in (tmp_path / "report.md").read_text()


SEVERAL = (
    MeasurementSettings(kind=Measurable.FRONT, noise="1%"),
    MeasurementSettings(kind=Measurable.PROFILE, noise="3%"),
    MeasurementSettings(kind=Measurable.PASSED, line=0.4, noise=0.01),
    MeasurementSettings(kind=Measurable.FRONT_OVER_TIME, times=(0.5, 1.0), noise=0.005),
)


def several(case: Any, **changes: Any) -> Problem:
    settings = {"observation": ObservationSettings(kind=Observable.SEVERAL), "observations": SEVERAL}
    return dataclasses.replace(case.problem, **(settings | changes))


def test_several_observations_find_it_together(make_case: Any, tmp_path: Path) -> None:
    case = make_case(truth=24.0, scatter=0.002)
    outcome = alone(several(case), case.mpm, tmp_path)
    finish(outcome, tmp_path)
    result = outcome.result
    assert result.verdict is Verdict.CONFIRMED
    assert result.certainty is not None
    assert abs(result.unknowns["friction_deg"] - 24.0) <= result.certainty["friction_deg"] < 2.0
    stored = json.loads((tmp_path / "result.json").read_text())["observation"]
    assert [part["name"] for part in stored["parts"]] == ["front", "profile", "passed", "front-over-time"]
    # In their own units, not in standard deviations.
    assert stored["mpm"][0] == pytest.approx(length(24.0) * np.quantile(SHAPE, 0.995), rel=0.02)
    assert "| front-over-time |" in (tmp_path / "report.md").read_text()


def test_better_measurements_count_more(make_case: Any, tmp_path: Path) -> None:
    """Two fronts that contradict each other: the answer lies by the one with a tenth of the noise."""
    case = make_case(truth=24.0, scatter=0.0005)
    middle, factor = float(length(24.0)), float(np.quantile(SHAPE, 0.995))
    parts = tuple(
        MeasurementSettings(kind=Measurable.FRONT, value=factor * value, noise=noise)
        for value, noise in ((middle, 0.004), (middle + 0.05, 0.04))
    )
    problem = several(case, observations=parts, target=TargetSettings())
    result = alone(problem, case.mpm, tmp_path).result
    assert result.unknowns["friction_deg"] == pytest.approx(24.0, abs=0.25)


def test_what_contradicts_itself_is_answered_with_a_wider_half_width(make_case: Any, tmp_path: Path) -> None:
    case = make_case(truth=24.0, scatter=0.0005)
    factor = float(np.quantile(SHAPE, 0.995))
    parts = tuple(
        MeasurementSettings(kind=Measurable.FRONT, value=factor * (length(24.0) + off), noise=0.004)
        for off in (-0.03, 0.0, 0.03)
    )
    outcome = alone(several(case, observations=parts, target=TargetSettings()), case.mpm, tmp_path)
    result = outcome.result
    assert result.verdict is Verdict.UNCONFIRMED
    assert result.certainty is not None
    assert result.discrepancy is not None
    assert result.discrepancy > 3.0
    # 12 mm a degree: the half-width speaks of the 30 mm by which they differ, not of the 4 mm that were stated.
    assert 0.8 < result.certainty["friction_deg"] < 6.0
    assert abs(result.unknowns["friction_deg"] - 24.0) < result.certainty["friction_deg"]
    with pytest.raises(WorkFailed, match="unconfirmed"):
        finish(outcome, tmp_path)
    assert "times worse than the stated noise" in (tmp_path / "report.md").read_text()


class Twins(FakeMpm):
    """Deposits that know of the sum of two angles alone."""

    def run(self, scene: Scene) -> Trajectory:
        self.scenes.append(scene)
        angles = [scene.material_of(mass).friction_deg for mass in scene.masses]
        chance = np.random.default_rng([scene.seed, round(1e6 * sum(angles))]).normal() * self.scatter
        return at_rest((length(0.5 * sum(angles)) + chance) * SHAPE, scene)


def test_what_fits_without_being_told_has_a_verdict_of_its_own(make_case: Any, tmp_path: Path) -> None:
    column = make_case().problem
    names = ["masses[0].friction_deg", "masses[1].friction_deg"]
    scene = Scene(
        domain=Domain(size=(1.2, 0.4), cell=0.01),
        material=column.scene.material,
        masses=(Mass(lower=(0.0, 0.0), size=(0.3, 0.1)), Mass(lower=(0.0, 0.1), size=(0.3, 0.1))),
    )
    problem = Problem(
        name="twins",
        folder=tmp_path,
        scene=with_unknowns(scene, names, [30.0, 30.0]),
        unknowns=tuple(Unknown(name=name, initial=30.0, lower=12.0, upper=52.0) for name in names),
        observation=ObservationSettings(kind=Observable.PROFILE),
        target=TargetSettings(hidden=True, seed=7, truth=dict.fromkeys(names, 25.0)),
        loop=LoopSettings(seeds=8),
    )
    outcome = alone(problem, Twins(scatter=0.001), tmp_path)
    result = outcome.result
    assert result.verdict is Verdict.NOT_IDENTIFIABLE
    assert result.certainty is not None
    assert min(result.certainty.values()) > 20.0
    assert sum(result.unknowns.values()) == pytest.approx(50.0, abs=1.5)
    with pytest.raises(WorkFailed, match="not-identifiable"):
        finish(outcome, tmp_path)
    report = (tmp_path / "report.md").read_text()
    assert "It fits, but is not identifiable" in report
    assert "**Told**: `masses[0].friction_deg` and `masses[1].friction_deg` up or down together" in report


def test_who_proposes_follows_from_the_problem(tmp_path: Path) -> None:
    shipped = read_problem("friction-tall-42")

    def chosen(problem: Problem) -> tuple[object, str | None]:
        observation = observation_of(problem)
        return choose(problem, observation, FakeMpm(), memory_gib=0.1)

    source, why = chosen(shipped)
    assert isinstance(source, GnsSource)
    assert why is None
    source, why = chosen(dataclasses.replace(shipped, surrogate=Surrogate.NONE))
    assert isinstance(source, MpmSource)
    assert why == "none was asked for"
    source, why = chosen(dataclasses.replace(shipped, scene=dataclasses.replace(shipped.scene, damping=0.0)))
    assert isinstance(source, MpmSource)
    assert why == "flow2d.pt is outside of its training range: damping 0 (trained: 0.12)"
    floor = Unknown(name="floor_friction", initial=0.4, lower=0.1, upper=0.8)
    source, why = chosen(dataclasses.replace(shipped, unknowns=(floor,)))
    assert isinstance(source, MpmSource)
    assert why == "it knows nothing of floor_friction"
    source, why = chosen(dataclasses.replace(shipped, scene=dataclasses.replace(shipped.scene, slope_deg=20.0)))
    assert isinstance(source, MpmSource)
    assert "slope_deg 20" in (why or "")
