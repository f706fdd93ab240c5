"""Robust designs: exact ones of a response that is known, what the MPM says, mistakes in a line."""

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import norm

from datasets import Baffle, Mass, Scene, Solid, Trajectory, write_scene
from datasets.scene.library import read_scene
from datasets.scene.particles import initial_particles
from inverse import Correlation, Parameter, Prior
from inverse.answer import Verdict
from inverse.posterior import Matrix, Row
from mpm import ALL, Recording
from mpm.output.outcome import MOVING
from tests.refusals import refused
from tests.scenes import flow_of, scene_of
from validation import find_design
from validation.design.__main__ import main
from validation.design.predictor import in_batches, on_processors, predicted
from validation.design.problem import Budget, DesignProblem, Limit, read_design
from validation.design.race import Race, raced
from validation.design.search import designed

SCENE = scene_of(
    Mass(lower=(0.0, 0.0), size=(0.2, 0.2), velocity=(2.5, 0.0)),
    baffles=(Baffle(lower=(0.5, 0.0), size=(0.06, 0.1)), Baffle(lower=(0.8, 0.0), size=(0.06, 0.1))),
    floor_friction=0.4,
    duration=0.4,
    frame_dt=0.005,
    step_fraction=0.9,
)
HEIGHTS = tuple(Parameter(name=f"baffles[{index}].height", lower=0.04, upper=0.24) for index in (0, 1))
FRICTION = Parameter(name="friction_deg", lower=18.0, upper=42.0, prior=Prior(kind="normal", mean=30.0, deviation=3.0))
FLOOR = Parameter(name="floor_friction", lower=0.3, upper=0.5)
SCATTER, PRICES = 0.005, {"baffles[0].height": 1.0, "baffles[1].height": 2.0}


def problem_of(**changes: object) -> DesignProblem:
    """Two heights under an uncertain angle; the front is to stay below 0.7 m in 95 % of the flows."""
    limit = Limit(quantity="front", below=0.7)
    defaults = {"variables": HEIGHTS, "uncertain": (FRICTION,), "limit": limit, "cost": PRICES}
    return DesignProblem(**{"name": "known", "scene": SCENE, **defaults, **changes})


class Known:
    """y = 0.9 - h_0 - 1.5 h_1 - 0.01 (phi - 30) + e: the first barrier is the cheaper one, and enough."""

    def __init__(self, problem: DesignProblem) -> None:
        self.problem, self.rng = problem, np.random.default_rng(problem.budget.seed + 100)

    def __call__(self, points: Matrix, first: int = 0) -> Row:
        one, other, angle = self.problem.box.at(points).T
        scatter = self.rng.normal(scale=SCATTER, size=len(points))
        return np.asarray(0.9 - one - 1.5 * other - 0.01 * (angle - 30.0) + scatter)


@pytest.mark.parametrize("seed", range(3))
def test_the_cheapest_design_of_a_known_response_is_found(seed: int) -> None:
    problem = problem_of(budget=Budget(runs=50, seed=seed))
    result = designed(problem, Known(problem))
    # Exactly: 0.9 - h_0 - 1.5 * 0.04 + z s = 0.7 with s^2 = (0.01 * 3)^2 + SCATTER^2, but for the cut at the bounds.
    exact = 0.14 + norm.ppf(problem.required) * np.hypot(0.03, SCATTER)
    assert result.design["baffles[0].height"] == pytest.approx(exact, abs=0.008)
    assert result.design["baffles[1].height"] == pytest.approx(0.04, abs=0.004)
    assert result.verdict is Verdict.CONFIRMED
    assert result.spent <= problem.runs
    true = norm.cdf((result.design["baffles[0].height"] + 1.5 * result.design["baffles[1].height"] - 0.2) / 0.0304)
    assert true == pytest.approx(problem.required, abs=0.015)
    # Flows that still move may yet exceed the limit.
    allowed = problem.allowed - result.exceeding
    verdicts = [replace(result, moving=moving).verdict for moving in (allowed, allowed + 1)]
    assert verdicts == [Verdict.CONFIRMED, Verdict.UNCONFIRMED]


def test_the_most_reliable_design_is_found_where_nothing_has_a_cost() -> None:
    problem = problem_of(cost={}, variables=(Parameter(name="baffles[0].height", lower=0.04, upper=0.24),))

    def respond(points: Matrix, first: int) -> Row:
        height, angle = problem.box.at(points).T
        return np.asarray(0.65 + 5.0 * (height - 0.1) ** 2 - 0.01 * (angle - 30.0))

    result = designed(problem, respond)
    assert result.design["baffles[0].height"] == pytest.approx(0.1, abs=0.03)
    assert result.reliability.expected == pytest.approx(norm.cdf(0.05 / 0.03), abs=0.02)


def test_a_limit_that_no_design_keeps_is_unreachable() -> None:
    problem = problem_of(limit=Limit(quantity="front", below=0.3), budget=Budget(runs=40, checks=40))
    result = designed(problem, Known(problem))
    assert result.verdict is Verdict.UNREACHABLE
    # What the best design gives: 0.9 - 0.24 - 1.5 * 0.24 = 0.3 at the mean angle.
    assert min(result.design.values()) > 0.22
    assert result.exceeding == pytest.approx(20, abs=12)
    low, high = result.interval
    assert low < 1.0 - result.exceeding / 40 < high


def test_flows_of_a_failed_check_inform_a_second_design() -> None:
    """The first check's flows go further than those before: only then is the response known."""
    problem = problem_of(budget=Budget(runs=40, checks=60))
    response, checks = Known(problem), list[int]()

    def respond(points: Matrix, first: int) -> Row:
        checks.extend([first] if len(points) == 60 else [])
        return response(points, first) + (0.05 if len(points) == 60 else 0.0)

    result = designed(problem, respond)
    assert len(checks) == 2
    assert result.spent <= problem.runs
    assert len(result.search.runs) == result.spent + 120


def test_draws_are_those_of_the_prior() -> None:
    lognormal = Prior(kind="lognormal", mean=0.4, deviation=0.05)
    floor = replace(FLOOR, lower=0.05, upper=2.0, prior=lognormal)
    problem = problem_of(uncertain=(FRICTION, floor, Parameter(name="wall_friction", lower=0.1, upper=0.3)))
    drawn = problem.box.lower[2:] + problem.box.range[2:] * problem.draws(4000, np.random.default_rng(0))
    np.testing.assert_allclose(drawn.mean(axis=0), [30.0, 0.4, 0.2], rtol=2e-3)
    np.testing.assert_allclose(drawn.std(axis=0), [3.0, 0.05, 0.2 / np.sqrt(12.0)], rtol=1e-2)
    pair = Correlation(between=("friction_deg", "floor_friction"), coefficient=-0.6)
    pairs = problem_of(uncertain=(FRICTION, floor), correlations=(pair,)).draws(4000, np.random.default_rng(0))
    assert np.corrcoef(pairs.T)[0, 1] == pytest.approx(-0.6, abs=0.04)


PROBLEM = """
scene = "scene.toml"
variables = [{ name = "baffles[0].height", lower = 0.04, upper = 0.24 }]
uncertain = [{ name = "floor_friction", lower = 0.3, upper = 0.5 }]
limit = { quantity = "front", below = 0.7 }
cost = { "baffles[0].height" = 1.0 }
"""


@pytest.fixture
def file(tmp_path: Path) -> Path:
    """A problem as a file."""
    write_scene(SCENE, tmp_path / "scene.toml")
    path = tmp_path / "problem.toml"
    path.write_text(PROBLEM)
    return path


def test_a_posterior_is_uncertain_jointly(file: Path) -> None:
    angle = np.random.default_rng(0).normal(30.0, 2.0, 500)
    samples = np.stack([angle, 100.0 + 10.0 * (30.0 - angle)], axis=1)
    weights = np.where(angle > 30.0, 1.0, 0.0)
    np.savez(file.parent / "posterior.npz", names=["friction_deg", "cohesion"], samples=samples, weights=weights)
    file.write_text('posterior = "posterior.npz"\n' + PROBLEM)
    problem = read_design(file)
    assert [parameter.name for parameter in problem.uncertain] == ["floor_friction", "friction_deg", "cohesion"]
    drawn = problem.box.lower[1:] + problem.box.range[1:] * problem.draws(200, np.random.default_rng(0))
    assert drawn[:, 1].min() >= 30.0
    assert np.corrcoef(drawn[:, 1], drawn[:, 2])[0, 1] == pytest.approx(-1.0)
    assert abs(np.corrcoef(drawn[:, 0], drawn[:, 1])[0, 1]) < 0.3
    assert drawn[:, 1].mean() == pytest.approx(angle[angle > 30.0].mean(), abs=0.1)
    (file.parent / "result.json").write_text(json.dumps({"angle": {"friction_deg": "slope"}}))
    refused(read_design, file, said="material.angle: expected slope, as in the inversion")


def test_a_posterior_goes_to_the_solid_that_it_is_of(file: Path) -> None:
    """A wall stands before the bed in this scene, and its friction is its own."""
    wall = Solid(name="wall", lower=(0.9, 0.0), size=(0.05, 0.1), friction=0.2)
    bed = Solid(name="bed", kind="terrain", points=((0.0, 0.0), (1.0, 0.0)), friction=0.2)
    write_scene(replace(SCENE, solids=(wall, bed)), file.parent / "scene.toml")
    samples = np.linspace(0.3, 0.5, 50)[:, None]
    np.savez(file.parent / "posterior.npz", names=["solids[0].friction"], samples=samples, weights=np.full(50, 0.02))
    (file.parent / "result.json").write_text(json.dumps({"solids": [["bed", "terrain"]], "verdict": "ambiguous"}))
    lines = [line for line in PROBLEM.splitlines() if not line.startswith("uncertain")]
    file.write_text("\n".join(['posterior = "posterior.npz"', *lines]))
    problem = read_design(file)
    assert problem.uncertain[-1].name == "solids[1].friction"
    assert list(problem.remarks) == [
        "solids[0].friction of the inversion is solids[1].friction of this scene",
        "the answer of the inversion is ambiguous",
    ]


def test_a_limit_is_on_the_map_where_the_box_is() -> None:
    there = replace(SCENE, domain=replace(SCENE.domain, origin=(5000.0, 100.0)))
    problem = problem_of(scene=there, limit=Limit(quantity="front", below=5000.7))
    response = Known(problem)
    assert designed(problem, lambda *given: 5000.0 + response(*given)).verdict is Verdict.CONFIRMED
    said = "limit.below: expected a number in (5000, 5001), an x on the map, as the origin of the box, got 0.7"
    refused(problem_of, scene=there, said=said)


@pytest.mark.parametrize(
    ("old", "new", "line"),
    [
        ('"baffles[0].height", l', '"baffles[5].height", l', "variables[0].name: expected an index below 2"),
        ("lower = 0.04", "lower = 0.4", "variables[0].upper: expected a value above 0.4"),
        ("lower = 0.04", "lower = 0.04, initial = 0.1", "variables[0].initial: expected no start"),
        ("lower = 0.04", "lower = 0.04, prior = { kind = 'uniform' }", "variables[0].prior: expected no prior"),
        ("upper = 0.5", "upper = 0.5, spacing = [0.1, 0.1]", "uncertain[0].spacing: expected a number"),
        ('name = "floor_friction"', 'name = "baffles[0].height"', "variables[0].name: expected each number once"),
        ("upper = 0.5", "upper = 0.5, prior = { kind = 'normal', mean = 0.4 }", "uncertain[0].prior.deviation"),
        ("upper = 0.5", "upper = 0.5, prior = { kind = 'beta' }", "uncertain[0].prior.kind: expected"),
        ('quantity = "front"', 'quantity = "force"', "limit.quantity: expected 'front', 'runout' or 'impact_force'"),
        ("below = 0.7", "below = 1.7", "limit.below: expected a number in (0, 1)"),
        ("below = 0.7", "below = 0.7, probability = 95.0", "limit.probability: expected a probability"),
        ("below = 0.7", "below = 0.7, window = 0.1", "limit.quantity: expected impact_force beside solid"),
        ('"front"', '"impact_force", solid = "wall"', "limit.solid: expected one of baffles[0], baffles[1]"),
        ('"baffles[0].height" = 1.0', 'height = 1.0', "cost.height: expected one of the variables baffles[0].height"),
        ("cost =", "budget = { checks = 5 }\ncost =", "budget.checks: expected an integer from 20 to 1000000, got 5"),
        ("cost =", "budget = { checks = 1000000000000000000 }\ncost =", "checks: expected an integer from 20 to"),
        ("scene =", 'posterior = "none.npz"\nscene =', "none.npz: expected"),
        ("upper = 0.24", "upper = 1.4", "variables[0].upper: expected a scene that can be simulated"),
    ],
)  # fmt: skip
def test_a_mistake_is_one_line(file: Path, old: str, new: str, line: str) -> None:
    assert old in PROBLEM
    file.write_text(PROBLEM.replace(old, new, 1))
    assert str(file.parent) in str(refused(read_design, file, said=line))


def test_the_shipped_problem_is_read() -> None:
    problem = read_design("two-barriers")
    assert len(problem.variables) == 4
    assert problem.allowed == 5
    assert 0.96 < problem.required < 0.98


def at_rest(scenes: Sequence[Scene], /, *, record: Recording = ALL) -> list[Trajectory]:
    """In place of the MPM: sand that stays where it is, and is said to move."""
    summary = {"front": 0.2, "remarks": [f"{MOVING} t = 0.1 s"]}
    return [flow_of(scene, initial_particles(scene).positions[None], summary=summary) for scene in scenes]


def test_flows_that_still_move_are_counted(tmp_path: Path) -> None:
    """The check of a design whose flows end before they rest."""
    problem = problem_of(budget=Budget(runs=20, checks=20))
    result = find_design(problem, tmp_path, simulate=at_rest)
    assert (result.exceeding, result.moving, result.verdict) == (0, 20, Verdict.UNCONFIRMED)
    assert "20 of these flows still move and may yet exceed it" in (tmp_path / "report.md").read_text()


def test_a_force_is_that_of_the_solid() -> None:
    """Of 600 N/m for 0.02 s and of 300 N/m for as long, later."""
    time = np.array([0.0, 0.1, 0.12, 0.2, 0.22, 0.4])
    impulse = np.zeros((6, 2, 2))
    impulse[2:, 0, 0], impulse[4:, 1, 0] = 12.0, 6.0
    flow = flow_of(SCENE, np.zeros((6, 5, 2)), time=time, solid_impulse=impulse)
    limits = (("baffles[0]", 0.0), ("baffles[1]", 0.0), (None, 0.0), (None, 0.04))
    kept = [Limit(quantity="impact_force", below=1.0, solid=name, window=time).kept(flow) for name, time in limits]
    assert [record.summary["impact_force"] for record in kept] == pytest.approx([600.0, 300.0, 600.0, 300.0])
    assert len(kept[0].positions) == len(kept[0].time) == 1


@pytest.mark.slow
def test_a_design_for_an_impact_force_and_again_from_its_runs(file: Path) -> None:
    force = 'quantity = "impact_force", solid = "baffles[1]", window = 0.04, below = 700.0'
    file.write_text(PROBLEM.replace('quantity = "front", below = 0.7', force))
    out = file.parent / "out"
    main(str(file), out=out)
    written = json.loads((out / "design.json").read_text())
    # A low barrier lets through what strikes the second one, a higher one than needed costs more.
    assert 0.05 < written["design"]["baffles[0].height"] < 0.2
    assert written["probability"]["mpm"] >= 0.95
    assert {"report.md", "design.png", "mpm"} <= {path.name for path in out.iterdir()}
    again = find_design(file, out, simulate=lambda scenes, record: pytest.fail("no flow is run again"))
    assert again.design == pytest.approx(written["design"])
    assert [len(np.load(path)["positions"]) for path in (out / "mpm").rglob("*.npz")] == [1] * (len(again.search.runs))


@pytest.mark.parametrize("seed", range(3))
def test_the_race_finds_the_cheapest_design_of_a_known_response(seed: int) -> None:
    problem = problem_of(budget=Budget(checks=40, seed=seed))
    race = Race(problem, Known(problem))
    race.run(10_000)
    best = race.problem.named(race.best.design)
    strength = best["baffles[0].height"] + 1.5 * best["baffles[1].height"]
    exact = 0.2 + 0.0304 * norm.ppf(problem.required)
    assert exact - 0.012 < strength < exact + 0.03
    assert best["baffles[1].height"] == pytest.approx(0.04, abs=0.015)
    assert 10_000 <= race.spent < 10_600


def test_errors_of_the_predictor_are_those_of_the_design() -> None:
    """One that is 0.06 m too low and scatters is found out by the first runs of the MPM."""
    problem = problem_of(budget=Budget(checks=40, pairs=12, predictions=4000))
    response, rng = Known(problem), np.random.default_rng(0)

    def predict(points: Matrix) -> Row:
        return response(points) - 0.06 + rng.normal(scale=0.01, size=len(points))

    result = raced(problem, predict, response)
    assert result.verdict is Verdict.CONFIRMED
    assert result.race.errors.mean() == pytest.approx(0.06, abs=0.015)
    assert result.spent in (52, 92)
    assert result.design["baffles[0].height"] + 1.5 * result.design["baffles[1].height"] > 0.23


@pytest.mark.slow
def test_batches_and_processes_predict_what_single_flows_do() -> None:
    column = read_scene("column-short-21")
    scenes = [column, replace(column, material=replace(column.material, friction_deg=35.0))]
    single = [predicted("front", scene) for scene in scenes]
    assert single[0] > single[1] + 0.05
    assert in_batches("cpu", "front", scenes) == pytest.approx(single, abs=1.0e-3)
    assert on_processors("front", scenes) == pytest.approx(single, abs=1.0e-3)


def test_no_design_that_is_predicted_keeps_the_limit() -> None:
    problem = problem_of(limit=Limit(quantity="front", below=0.2), budget=Budget(checks=20, predictions=2000))
    response = Known(problem)
    assert raced(problem, response, response).verdict is Verdict.UNREACHABLE


@pytest.mark.slow
def test_a_design_by_the_mpm_on_larger_cells(tmp_path: Path) -> None:
    limit, budget = Limit(quantity="front", below=0.75), Budget(checks=20, predictions=1000)
    problem = problem_of(surrogate="coarse", limit=limit, budget=budget)
    result = find_design(problem, tmp_path)
    written = json.loads((tmp_path / "design.json").read_text())
    assert written["predictions"] >= 1000
    assert written["runs"] in (28, 48)
    assert len(written["pairs"]["mpm"]) == len(written["pairs"]["predicted"])
    assert result.design.keys() == written["design"].keys()
    assert "predictions" in (tmp_path / "report.md").read_text()
