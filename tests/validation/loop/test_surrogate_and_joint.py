"""The loop on joint observations; and where a learned surrogate is in the emulator's trend."""

import dataclasses
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from datasets.command_line import WorkFailed
from datasets.errors import InputError
from datasets.scene import Domain, Mass, Scene, Solid
from gns import card, checkpoint
from gns.settings import ModelSettings
from gns.simulator import Normalisation, Simulator
from inverse import deposits
from inverse.forward.gns import GnsForward
from inverse.found import Verdict
from inverse.observations import Observation, Values
from inverse.parameters import Vector
from inverse.parameters.parameter import Parameter
from inverse.problem import Problem, read_problem
from inverse.result import Result
from inverse.settings import ObservationSettings, Surrogate, TargetSettings
from inverse.target import read_target
from tests.validation.loop.flows import SHAPE, Case, FakeMpm, TwinAngles, length, wedge
from validation.loop import surrogate
from validation.loop.__main__ import print_outcome
from validation.loop.solve import solve
from validation.loop.surrogate import choose, learned
from validation.loop.task import Task

FRONT = float(np.quantile(SHAPE, 0.995))
JOINT = (
    ObservationSettings(kind="front", noise="1%"),
    ObservationSettings(kind="profile", noise="3%"),
    ObservationSettings(kind="passed", line=0.4, noise=0.01),
    ObservationSettings(kind="front", times=(0.5, 1.0), noise=0.005),
)


@pytest.fixture(autouse=True)
def small_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(deposits, "RESOLUTION", 40)


def alone(problem: Problem, mpm: FakeMpm, out: Path) -> Result:
    return solve(dataclasses.replace(problem, surrogate=Surrogate.NONE), out, simulate=mpm)


def joint(case: Any, observations: tuple[ObservationSettings, ...], **changes: Any) -> Problem:
    return dataclasses.replace(case.problem, observations=observations, **changes)


def test_joint_observations_find_it_together(tmp_path: Path) -> None:
    case = wedge(tmp_path, truth=24.0, scatter=0.002)
    result = alone(joint(case, JOINT), case.mpm, tmp_path)
    assert result.verdict is Verdict.CONFIRMED
    assert result.certainty is not None
    assert abs(result.unknowns["friction_deg"] - 24.0) <= result.certainty["friction_deg"] < 2.0
    stored = json.loads((tmp_path / "result.json").read_text())["observation"]
    assert [part["name"] for part in stored["parts"]] == ["front", "profile", "passed", "front 2"]
    # In their own units, not in standard deviations.
    assert stored["mpm"][0] == pytest.approx(length(24.0) * FRONT, rel=0.02)
    assert "| front 2" in (tmp_path / "report.md").read_text()


def test_contradictions_widen_the_half_width(tmp_path: Path) -> None:
    case = wedge(tmp_path, truth=24.0, scatter=0.0005)
    parts = tuple(
        ObservationSettings(kind="front", value=FRONT * (length(24.0) + error), noise=0.004)
        for error in (-0.03, 0.0, 0.03)
    )
    result = alone(joint(case, parts, target=TargetSettings()), case.mpm, tmp_path)
    assert result.verdict is Verdict.UNCONFIRMED
    assert result.certainty is not None
    assert result.answers[0].fit is not None
    assert result.answers[0].fit.factor > 3.0
    # 12 mm a degree: the half-width is that of the 30 mm by which they differ, not of the 4 mm that were stated.
    assert 0.8 < result.certainty["friction_deg"] < 6.0
    assert abs(result.unknowns["friction_deg"] - 24.0) < result.certainty["friction_deg"]
    with pytest.raises(WorkFailed, match="unconfirmed"):
        print_outcome(result, tmp_path)
    assert "times worse than noise" in (tmp_path / "report.md").read_text()


@pytest.mark.slow
def test_a_ridge_of_answers_is_one_ambiguous_answer(tmp_path: Path) -> None:
    names = ["masses[0].friction_deg", "masses[1].friction_deg"]
    scene = Scene(
        domain=Domain(size=(1.2, 0.4), cell=0.01),
        material=wedge(tmp_path).problem.scene.material,
        masses=(Mass(lower=(0.0, 0.0), size=(0.3, 0.1)), Mass(lower=(0.0, 0.1), size=(0.3, 0.1))),
    )
    problem = Problem(
        name="twins",
        folder=tmp_path,
        scene=scene,
        parameters=tuple(Parameter(name=name, initial=30.0, lower=12.0, upper=52.0) for name in names),
        observations=(ObservationSettings(kind="profile"),),
        target=TargetSettings(twin=True, seed=7, truth=dict.fromkeys(names, 25.0)),
    )
    result = alone(problem, TwinAngles(scatter=0.001), tmp_path)
    assert result.verdict is Verdict.AMBIGUOUS
    assert result.certainty is not None
    assert min(result.certainty.values()) > 8.0
    assert sum(result.unknowns.values()) == pytest.approx(50.0, abs=1.5)
    # The sum is known from 12 + 38 to 38 + 12 degrees.
    np.testing.assert_allclose(result.samples.sum(axis=1), 50.0, atol=3.0)
    assert np.ptp(result.samples[:, 0]) > 20.0
    report = (tmp_path / "report.md").read_text()
    assert "Not identifiable: `masses[0].friction_deg`, `masses[1].friction_deg`" in report
    assert "**Identifiable**: `masses[0].friction_deg` and `masses[1].friction_deg` up or down together" in report


@dataclass(frozen=True)
class Level:
    """A card in place of a model's own: trained on level floors."""

    ranges: tuple[()] = ()


@pytest.fixture
def model(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The file of a tiny model with a card."""
    settings = ModelSettings(body_length=0.2, width=8, layers=1, rounds=1, grid_channels=4, grid_layers=1)
    scales = Normalisation(displacement=0.003, acceleration=0.01, friction_mean=0.6, friction_std=0.2)
    checkpoint.save(tmp_path / "tiny.safetensors", Simulator(settings, scales), {})
    monkeypatch.setattr(card, "read", lambda path: Level())
    monkeypatch.setattr(
        surrogate, "outside", lambda scene, _: [f"slope_deg {scene.slope_deg:g}"] if scene.slope_deg else []
    )
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
        ({"solids": (WALL,)}, "solids[0].friction", "expected baffles and terrain alone"),
        ({"open_sides": ("x+",)}, None, "expected a closed box"),
    ],
)
def test_whether_it_knows_the_flow_follows_from_the_problem(
    model: Path, changes: dict[str, Any], unknown: str | None, expected: str | None
) -> None:
    shipped = read_problem("friction-tall-42")
    problem = dataclasses.replace(
        shipped,
        scene=dataclasses.replace(shipped.scene, **changes),
        parameters=shipped.parameters if unknown is None else (PARAMETERS[unknown],),
        observations=(ObservationSettings(kind="front", value=0.5),),
        target=TargetSettings(),
    )
    target = read_target(problem, FakeMpm().run)
    forward, reason = learned(problem, target, model)
    assert isinstance(forward, GnsForward if expected is None else type(None))
    assert (expected or "") in reason


def task(case: Case, out: Path, surrogate: Surrogate) -> Task:
    return dataclasses.replace(case, problem=dataclasses.replace(case.problem, surrogate=surrogate)).task(out)


def test_a_surrogate_is_asked_where_it_costs_less_than_it_saves(tmp_path: Path) -> None:
    case = wedge(tmp_path)

    def load(*asked: object) -> tuple[Any, str]:
        return Kink(case.target.observation), ""

    auto = task(case, tmp_path, Surrogate.AUTO)
    found, reason = choose(auto, 100.0, model=None, load=load)
    assert found is not None
    assert len(found.points) == 12
    assert "it is cheaper (12 predictions" in reason
    found, reason = choose(auto, 1e-9, model=None, load=load)
    assert found is None
    assert "would cost more than it saves" in reason
    assert choose(task(case, tmp_path, Surrogate.NONE), 100.0, model=None, load=load)[1] == "the problem asks for none"
    asked = task(case, tmp_path, Surrogate.GNS)
    assert choose(asked, 1e-9, model=None, load=load)[0] is not None
    with pytest.raises(InputError, match="expected auto or none, it was not trained"):
        choose(asked, 1.0, model=None, load=lambda *_: (None, "it was not trained on it"))


def test_the_loop_with_a_surrogate_in_its_trend(tmp_path: Path) -> None:
    """A response with a kink, which the surrogate has too but for its size: the trend with it predicts better."""
    case = wedge(tmp_path, truth=30.0, mpm=Kinked(scatter=0.001))
    case = dataclasses.replace(
        case,
        problem=dataclasses.replace(case.problem, surrogate=Surrogate.GNS),
        surrogate=Kink(case.target.observation),
    )
    result = case.solve(tmp_path / "out")
    assert result.verdict is Verdict.CONFIRMED
    assert result.iterations[0]["with_surrogate"]
    assert abs(result.unknowns["friction_deg"] - 30.0) < 1.0
    result.save(tmp_path / "out")
    assert "Surrogate: the problem asks for it (12 predictions" in (tmp_path / "out" / "report.md").read_text()


class Kinked(FakeMpm):
    """Deposits that shorten three times as fast beyond 25 degrees."""

    def x(self, scene: Scene) -> NDArray[np.float64]:
        angle = scene.material.friction_deg
        scatter = np.random.default_rng(scene.seed).normal() * self.scatter
        return np.asarray((1.0 - 0.004 * (angle - 12.0) - 0.012 * max(0.0, angle - 25.0) + scatter) * SHAPE)


@dataclass(frozen=True)
class Kink:
    """The same with half of the kink, as a surrogate."""

    observation: Observation

    def observe(self, parameters: Sequence[Vector], /) -> list[Values]:
        found = []
        for (angle,) in parameters:
            x = torch.from_numpy((1.0 - 0.006 * max(angle - 25.0, 0.0)) * SHAPE)
            positions = torch.stack([x, 0.1 * torch.ones_like(x)], dim=1)
            found.append(self.observation.smooth(positions, torch.ones(len(x))).numpy())
        return found
