"""The loop for several unknowns, with a flow whose truth is a formula and a surrogate that distorts it."""

import dataclasses
import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from torch import Tensor

from datasets.errors import InputError
from datasets.material import Material
from datasets.particles import particle_count
from datasets.scene import Domain, Mass, Scene
from datasets.trajectory import Trajectory
from inverse.observations import deposit as observations
from inverse.observations.deposit import Observation, Values
from inverse.observations.target import read_target
from inverse.parameters.parameters import Vector, kind
from inverse.problem import (
    LoopSettings,
    Method,
    Observable,
    ObservationSettings,
    OptimiserSettings,
    Problem,
    TargetSettings,
    Unknown,
)
from inverse.result import Result, Verdict
from mpm.output.request import ALL, Recording
from tests.validation.conftest import at_rest, kept
from validation.loop.__main__ import solve
from validation.loop.result import Solved

WIDTH = 4.0
"""Of the bounds of each unknown [m/s]."""


@dataclass
class Flow:
    """Deposits by a formula: points moved along x by each layer's velocity, by its neighbours', and by chance."""

    count: int
    """Unknowns."""
    points: int
    scatter: float = 0.0
    """[m]."""
    bend: float = 0.0
    """[m s^2/m^2]."""
    killed_after: int = 10**6
    scenes: list[Scene] = field(default_factory=list)

    def __post_init__(self) -> None:
        stream = np.random.default_rng(5)
        place = (np.arange(self.points) + 0.5) / self.points
        centres = (np.arange(self.count) + 0.5) / self.count
        self.x0 = 0.3 + 0.3 * np.sqrt(place)
        # Broad bumps that overlap: neighbours are told apart less well than all together.
        self.push = 0.05 * np.exp(-(((place[:, None] - centres) * self.count / 1.5) ** 2))
        self.waves = stream.normal(size=(12, self.points)) / np.sqrt(12.0)

    def x(self, unknowns: Vector) -> NDArray[np.float64]:
        return np.asarray(self.x0 + self.push @ unknowns + self.bend * self.push @ unknowns**2)

    def __call__(self, scenes: Sequence[Scene], /, *, record: Recording = ALL) -> list[Trajectory]:
        return [kept(self.run(scene), record) for scene in scenes]

    def run(self, scene: Scene) -> Trajectory:
        if len(self.scenes) >= self.killed_after:
            raise KeyboardInterrupt
        self.scenes.append(scene)
        unknowns = np.array([mass.velocity[0] if mass.velocity else 0.0 for mass in scene.masses])
        chance = np.random.default_rng(scene.seed)
        x = self.x(unknowns) + self.scatter * (chance.normal(size=12) @ self.waves)
        return at_rest(x, scene)


@dataclass(kw_only=True)
class Distorted:
    """The formula of a flow, its causes mixed up; it follows every second point, and needs no first frames."""

    flow: Flow
    observation: Observation
    mixing: float
    strength: float = 1.0
    shift: float = 0.0

    def __post_init__(self) -> None:
        stream = np.random.default_rng(9)
        count = self.flow.count
        self.mix = self.strength * np.eye(count) + self.mixing * stream.normal(size=(count, count)) / np.sqrt(count)
        self.indices = np.arange(0, self.flow.points, 2)

    def predict(self, unknowns: Tensor) -> Tensor:
        push = torch.from_numpy(self.flow.push[self.indices] @ self.mix)
        x = torch.from_numpy(self.flow.x0[self.indices]) + self.shift + push @ unknowns
        return self.observation.smooth(torch.stack([x, 0.1 * torch.ones_like(x)], 1), torch.ones(len(x)))

    def observe(self, unknowns: Sequence[Vector]) -> list[Values]:
        return [self.predict(torch.from_numpy(values)).numpy() for values in unknowns]

    def wanted(self, target: Values) -> Values:
        return self.observation.of_points(target, self.indices)

    def deposit(self, unknowns: Vector) -> NDArray[np.floating]:
        x = self.flow.x(unknowns)[self.indices]
        return np.stack([x, 0.1 * np.ones(len(x))], axis=1)

    def first_frames(self, scene: Scene) -> Scene | None:
        return None

    def start(self, beginning: Trajectory | None) -> "Distorted":
        return self


def layers(count: int) -> Scene:
    height = 0.1 * 2
    masses = tuple(Mass(lower=(0.0, height * index), size=(0.5, height), velocity=(9.0, 0.0)) for index in range(count))
    domain = Domain(size=(2.0, 4.0), cell=0.05)
    return Scene(domain=domain, material=Material(friction_deg=30.0), masses=masses)


def truth_of(count: int) -> Vector:
    return np.linspace(1.5, 0.15, count)


@dataclass(frozen=True, kw_only=True)
class Case:
    problem: Problem
    observation: Observation
    flow: Flow
    source: Any

    def solved(self, out: Path) -> Solved:
        target = read_target(self.problem, self.observation, self.flow.run)
        self.flow.scenes.clear()
        return solve(self.problem, target, self.observation, out, self.source, self.flow)


def case(
    tmp_path: Path,
    *,
    count: int = 2,
    kind: Observable = Observable.DEPOSIT,
    target: TargetSettings | None = None,
    optimiser: OptimiserSettings | None = None,
    loop: LoopSettings | None = None,
    scatter: float = 0.0,
    bend: float = 0.0,
    mixing: float = 0.3,
    strength: float = 1.0,
    shift: float = 0.0,
    seed: int = 3,
    lower: float = -1.0,
) -> Case:
    scene = layers(count)
    names = [f"masses[{index}].velocity_x" for index in range(count)]
    truth = dict(zip(names, truth_of(count).tolist(), strict=True))
    problem = Problem(
        name="layers",
        folder=tmp_path,
        scene=scene,
        unknowns=tuple(Unknown(name=name, initial=0.0, lower=lower, upper=lower + WIDTH) for name in names),
        observation=ObservationSettings(kind=kind, line=0.5 if kind is Observable.PASSED else None),
        target=target or TargetSettings(hidden=True, seed=seed, truth=truth),
        optimiser=optimiser or OptimiserSettings(max_iterations=60, stop_below=1e-9),
        loop=loop or LoopSettings(),
    )
    observation = observations.build(problem.observation, scene)
    flow = Flow(count=count, points=particle_count(scene), scatter=scatter, bend=bend)
    source = Distorted(flow=flow, observation=observation, mixing=mixing, strength=strength, shift=shift)
    return Case(problem=problem, observation=observation, flow=flow, source=source)


@pytest.mark.parametrize("count", [2, 10])
@pytest.mark.parametrize("seed", [3, 4, 5])
def test_a_surrogate_that_mixes_causes_up_still_finds_the_truth(tmp_path: Path, count: int, seed: int) -> None:
    result = case(tmp_path, count=count, scatter=0.002, bend=0.03, shift=0.02, seed=seed).solved(tmp_path).result
    assert result.verdict is Verdict.CONFIRMED
    assert len(result.checks) <= 8
    assert result.certainty is not None
    missed = [abs(result.unknowns[name] - true) for name, true in (result.target.truth or {}).items()]
    widths = [result.certainty[name] for name in result.unknowns]
    # How often they hold is in test_loop_joint.py; ten unknowns of one flow miss together.
    assert np.max(np.divide(missed, widths)) < 2.0
    # Wide enough to hold, narrow enough to tell: a tenth of the range and less.
    assert max(widths) < 0.1 * WIDTH
    # The surrogate alone was much further off.
    assert result.loss_mpm is not None
    assert result.mpm_runs[0].loss > 5.0 * result.loss_mpm


def test_without_scatter_the_answer_is_the_truth(tmp_path: Path) -> None:
    result = case(tmp_path, count=4, bend=0.03).solved(tmp_path).result
    assert result.verdict is Verdict.CONFIRMED
    np.testing.assert_allclose(result.answer, truth_of(4), atol=0.02)


def test_a_toe_is_met_and_what_it_does_not_tell_is_said(tmp_path: Path) -> None:
    """The furthest tenth of the points is the last layer's: it says nothing of the first."""
    result = case(tmp_path, count=4, kind=Observable.TOE, scatter=0.002, shift=0.05).solved(tmp_path).result
    assert result.verdict is Verdict.NOT_IDENTIFIABLE
    assert result.loss_mpm is not None
    assert np.sqrt(result.loss_mpm) <= 0.32 * 0.05
    assert result.certainty is not None
    assert result.certainty["masses[0].velocity_x"] == pytest.approx(WIDTH)
    assert result.identifiability is not None
    assert sum(combination.told for combination in result.identifiability.combinations) == 1
    best, *_, worst = result.identifiability.combinations
    assert best.weights["masses[3].velocity_x"] > 0.8
    assert best.singular_value > 2.0 > worst.singular_value
    stored = json.loads(written(result, tmp_path))["identifiability"]
    assert len(stored["singular_values"]) == len(stored["combinations"]) == 4
    assert stored["half_a_cell"]["masses[3].velocity_x"] > 0.0


def written(result: Result, folder: Path) -> str:
    result.write(folder)
    return (folder / "result.json").read_text()


@pytest.mark.parametrize("kind", [Observable.FRONT, Observable.RUNOUT])
def test_a_length_that_no_velocities_reach_is_unreachable(tmp_path: Path, kind: Observable) -> None:
    hard = case(tmp_path, kind=kind, target=TargetSettings(value=1.5), scatter=0.001)
    result = hard.solved(tmp_path).result
    assert result.verdict is Verdict.UNREACHABLE
    assert result.certainty is None
    # What was nearest: the layer that reaches furthest, as fast as it may.
    assert result.unknowns["masses[1].velocity_x"] == pytest.approx(3.0, abs=1e-6)
    assert len(result.checks) <= 8


def test_one_number_of_several_unknowns_is_met(tmp_path: Path) -> None:
    result = case(tmp_path, count=3, kind=Observable.FRONT, scatter=0.0005, shift=0.05).solved(tmp_path).result
    # One number tells one combination of three unknowns.
    assert result.verdict is Verdict.NOT_IDENTIFIABLE
    assert abs(result.front_error_pct or 0.0) <= 0.3


def test_a_design_is_as_little_as_the_mpm_shows(tmp_path: Path) -> None:
    design = case(
        tmp_path, count=3, kind=Observable.PASSED, target=TargetSettings(least=True), scatter=0.002, mixing=0.2
    )
    outcome = design.solved(tmp_path)
    result = outcome.result
    assert result.verdict is Verdict.CONFIRMED
    assert outcome.begun is not None
    assert outcome.answer.observation[0] < outcome.begun.observation[0] - 0.02
    assert result.mpm is not None
    assert result.mpm[0] < 0.9 * outcome.begun.observation[0]
    assert len(result.checks) <= 8
    assert result.certainty is not None
    assert all(0.0 < width <= WIDTH for width in result.certainty.values())
    assert "NaN" not in written(result, tmp_path)


def test_a_design_that_cannot_be_bettered_is_unconfirmed(tmp_path: Path) -> None:
    stuck = case(
        tmp_path, kind=Observable.PASSED, target=TargetSettings(least=True), mixing=0.0, scatter=0.002, lower=0.0
    )
    assert stuck.solved(tmp_path).result.verdict is Verdict.UNCONFIRMED


@pytest.mark.parametrize("after", [0, 2, 4, 9, 20, 45])
def test_what_ran_before_a_kill_is_not_run_again(tmp_path: Path, after: int) -> None:
    hard: dict[str, Any] = {"count": 4, "scatter": 0.002, "bend": 0.05, "shift": 0.03}
    whole = case(tmp_path, **hard)
    unbroken = whole.solved(tmp_path / "whole").result
    broken = case(tmp_path, **hard)
    target = read_target(broken.problem, broken.observation, broken.flow.run)
    broken.flow.scenes.clear()
    broken.flow.killed_after = after
    with pytest.raises(KeyboardInterrupt):
        solve(broken.problem, target, broken.observation, tmp_path / "killed", broken.source, broken.flow)
    kept = len(list((tmp_path / "killed" / "mpm").glob("*.npz")))
    broken.flow.killed_after = 10**6
    resumed = solve(broken.problem, target, broken.observation, tmp_path / "killed", broken.source, broken.flow).result
    np.testing.assert_array_equal(resumed.answer, unbroken.answer)
    assert resumed.certainty == unbroken.certainty
    assert resumed.verdict is unbroken.verdict
    assert len(broken.flow.scenes) == len(whole.flow.scenes) + after - kept
    # What is lost is less than one call of the MPM, which runs a few scenes side by side.
    assert after - kept < 64
    broken.flow.scenes.clear()
    again = solve(broken.problem, target, broken.observation, tmp_path / "killed", broken.source, broken.flow).result
    assert broken.flow.scenes == []
    assert again.certainty == unbroken.certainty


@dataclass(kw_only=True)
class Folded(Distorted):
    """It knows velocities by their squares alone: two answers, one on either side of 0."""

    def predict(self, unknowns: Tensor) -> Tensor:
        return super().predict(unknowns**2 - 0.2 * unknowns)


def test_of_several_starts_the_best_is_followed_and_others_are_told(tmp_path: Path) -> None:
    settings = OptimiserSettings(starts=6, max_iterations=30, stop_below=1e-12)
    folded = case(tmp_path, count=2, optimiser=settings, lower=-2.0)
    source = Folded(flow=folded.flow, observation=folded.observation, mixing=0.0)
    result = dataclasses.replace(folded, source=source).solved(tmp_path).result
    assert len(result.other_starts) == 5
    assert {stage.start for stage in [result.rounds[0], *result.other_starts]} == set(range(6))
    assert 1 <= len(result.other_minima) <= 3
    first = min(result.rounds[0].evaluations, key=lambda each: each.loss)
    assert all(minimum.loss >= first.loss for minimum in result.other_minima)
    assert all(np.max(np.abs(minimum.unknowns - first.unknowns)) > 0.02 * WIDTH for minimum in result.other_minima)
    stored = json.loads(written(result, tmp_path))
    assert len(stored["other_minima"]) == len(result.other_minima)
    assert {each["start"] for each in stored["iterations"] if each["round"] == 0} == set(range(6))
    # By whichever start it was found.
    assert stored["loss"]["initial"] == pytest.approx(
        next(each["loss"] for each in stored["iterations"] if each["round"] == 0 and each["start"] == 0)
    )


@pytest.mark.parametrize("method", [Method.GAUSS_NEWTON, Method.ADAM])
def test_the_problems_own_optimiser_comes_first(tmp_path: Path, method: Method) -> None:
    asked = case(
        tmp_path,
        count=2,
        kind=Observable.TOE if method is Method.GAUSS_NEWTON else Observable.DEPOSIT,
        optimiser=OptimiserSettings(method=method, max_iterations=25),
    )
    result = asked.solved(tmp_path).result
    # A toe of two layers is the faster one's alone.
    told = method is not Method.GAUSS_NEWTON
    assert result.verdict is (Verdict.CONFIRMED if told else Verdict.NOT_IDENTIFIABLE)
    assert len(result.rounds[0].evaluations) <= 25


@pytest.mark.parametrize(
    ("observed", "target", "key"),
    [
        (Observable.DEPOSIT, TargetSettings(least=True), "target.least"),
        (Observable.PASSED, TargetSettings(least=True, value=0.1), "target"),
    ],
)
def test_a_wrong_design_says_what_is_missing(
    tmp_path: Path, observed: Observable, target: TargetSettings, key: str
) -> None:
    with pytest.raises(InputError) as caught:
        case(tmp_path, kind=observed, target=target)
    assert caught.value.key == key


def test_names_are_those_of_the_scene() -> None:
    assert kind("masses[1].velocity_x").read(layers(2)) == 9.0
