"""The loop on joint observations."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from datasets import Mass
from inverse import Parameter, Problem, Result, TargetSettings
from inverse.answer import Verdict
from inverse.observations import FrontSettings, PassedSettings, ProfileSettings
from inverse.settings import Surrogate
from tests.validation.loop.flows import FRONT, FakeMpm, TwinAngles, length, wedge
from validation.loop.solve import solve

JOINT = (
    FrontSettings(noise="1%"),
    ProfileSettings(noise="3%"),
    PassedSettings(line=0.4, noise=0.01),
    FrontSettings(times=(0.5, 1.0), noise=0.005),
)


def alone(problem: Problem, mpm: FakeMpm, out: Path) -> Result:
    return solve(replace(problem, surrogate=Surrogate.NONE), out, simulate=mpm)


def test_joint_observations_find_it_together(tmp_path: Path) -> None:
    case = wedge(tmp_path, truth=24.0, scatter=0.002)
    result = alone(replace(case.problem, observations=JOINT), case.mpm, tmp_path)
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
    result = alone(problem, TwinAngles(scatter=0.001), tmp_path)
    assert result.verdict is Verdict.AMBIGUOUS
    assert min(result.certainty.values()) > 8.0
    assert sum(result.unknowns.values()) == pytest.approx(50.0, abs=1.5)
    # The sum is known from 12 + 38 to 38 + 12 degrees.
    np.testing.assert_allclose(result.samples.sum(axis=1), 50.0, atol=3.0)
    assert np.ptp(result.samples[:, 0]) > 20.0
