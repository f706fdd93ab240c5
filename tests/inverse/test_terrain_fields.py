"""Thickness of a release and friction of a bed as fields: how they enter scenes and rollouts, their derivatives, and
the correction of a surrogate's derivatives by runs.
"""

import dataclasses
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from datasets import Domain, Mass, Material, Scene, Solid, read_scene
from datasets.command_line import run
from datasets.scene.grid_field import Field
from datasets.scene.library import write_scene
from datasets.scene.particles import initial_particles, initial_volumes, released_volume
from gns.settings import ModelSettings
from inverse import read_problem
from inverse.__main__ import main
from inverse.fields.flow import IDLE, WhiteFlow
from inverse.fields.inversion import LED_CHECKS, LED_RUNS, led
from inverse.fields.search import Objective, doubted
from inverse.fields.surrogate import SurrogateFlow, leading
from inverse.forward.gns import Band
from inverse.observations.plan import ThicknessSettings
from mpm.adjoint.gradient import gradient
from tests.inverse.flows import LinearFlow, M, W, target_of
from tests.refusals import refused

RAMP = tuple(tuple(0.3 - 0.3 * x + 0.02 * abs(z) for z in range(-1, 6)) for x in np.linspace(-0.2, 1.0, 7))
FRICTIONS = tuple(tuple(0.2 + 0.05 * ((i + k) % 3) for k in range(7)) for i in range(7))
PLACE: dict[str, Any] = {"origin": (0.1, 0.1), "spacing": (0.1, 0.1), "nodes": (3, 3)}
THICKNESS = Field(quantity="thickness", values=(0.1, 0.12, 0.1) * 3, **PLACE)
SCENE = Scene(
    domain=Domain(size=(0.8, 0.6, 0.6), cell=0.05),
    material=Material(friction_deg=30.0, young=2.0e5),
    masses=(Mass(kind="layer", thickness=0.1, outline=((0.1, 0.1), (0.3, 0.1), (0.3, 0.3), (0.1, 0.3))),),
    solids=(Solid(kind="terrain", origin=(-0.2, -0.2), spacing=(0.2, 0.2), heights=RAMP, friction=FRICTIONS),),
    fields=(THICKNESS,),
    duration=0.2,
    frame_dt=0.02,
    step_fraction=0.6,
)
ZONES = "ncols 2\nnrows 2\nxllcorner 0\nyllcorner 0\ncellsize 0.4\n7 9\n3 3\n"
PROBLEM = """
scene = "scene.toml"
surrogate = "none"
observations = [{ kind = "thickness", cell = 0.1, noise = 0.004 }]
target = { twin = true, seed = 1000 }
optimiser = { seeds = 1, ensemble = 4, max_iterations = 1, derivatives = "differences" }
unknowns = [
  { name = "thickness", spacing = [0.1, 0.1], mean = 0.1, deviation = 0.02, length = 0.2, lower = 0.04, upper = 0.2 },
  { name = "solids[0].friction", zones = "zones.asc", mean = 0.25, deviation = 0.05, lower = 0.05, upper = 0.6 },
]
"""


@pytest.fixture
def path(tmp_path: Path) -> str:
    """Of the problem, beside its scene and zones."""
    write_scene(SCENE, tmp_path / "scene.toml")
    (tmp_path / "zones.asc").write_text(ZONES)
    (tmp_path / "problem.toml").write_text(PROBLEM)
    return str(tmp_path / "problem.toml")


def flat(**changes: Any) -> Scene:
    """The layer on a level floor, in 3D."""
    return dataclasses.replace(SCENE, solids=(), fields=(), floor_friction=0.3, **changes)


def test_a_constant_field_of_thickness_is_the_layer_stretched() -> None:
    thicker = dataclasses.replace(THICKNESS, values=(0.15,) * 9)
    scenes = flat(), dataclasses.replace(flat(), fields=(thicker,))
    layer, stretched = map(initial_particles, scenes)
    np.testing.assert_allclose(stretched.positions, layer.positions * [1.0, 1.5, 1.0], rtol=1e-12)
    np.testing.assert_allclose(stretched.volume, 1.5 * layer.volume, rtol=1e-12)
    np.testing.assert_allclose(stretched.depth, 1.5 * layer.depth, rtol=1e-9)
    same = initial_particles(dataclasses.replace(flat(), fields=(dataclasses.replace(THICKNESS, values=(0.1,) * 9),)))
    np.testing.assert_allclose(same.positions, layer.positions, rtol=1e-12)


def test_the_volume_of_a_field_of_thickness_is_its_integral() -> None:
    # Linear along x, from 0.05 to 0.15 m: exact by the middles of the lattice.
    linear = dataclasses.replace(THICKNESS, values=(0.05,) * 3 + (0.1,) * 3 + (0.15,) * 3)
    scene = dataclasses.replace(flat(), fields=(linear,))
    assert released_volume(scene) == pytest.approx(0.1 * 0.2 * 0.2, rel=1e-12)
    assert initial_volumes(scene).sum() == pytest.approx(released_volume(scene), rel=1e-12)
    np.testing.assert_array_equal(initial_particles(scene).volume, initial_volumes(scene))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"values": (0.1,) * 8 + (0.0,)}, "fields[0].values: expected thicknesses above 0 m"),
        ({"values": (0.4,) * 9}, "fields[0].values: expected a layer below the top of the box"),
        ({"origin": (9.0, 0.1)}, "fields[0].origin: expected places that reach into the box, 0 to 0.8 m, got 9 to 9.2"),
        ({"nodes": (3, 3, 1), "origin": (0.0,) * 3, "spacing": (0.1,) * 3}, "fields[0].origin"),
    ],
)
def test_other_fields_of_thickness_are_refused(change: dict[str, Any], said: str) -> None:
    refused(lambda: dataclasses.replace(SCENE, fields=(dataclasses.replace(THICKNESS, **change),)), said=said)
    box = Mass(lower=(0.1, 0.0, 0.1), size=(0.2, 0.1, 0.2))
    refused(lambda: dataclasses.replace(flat(), masses=(box,), fields=(THICKNESS,)), said="a mass of kind layer")


def test_fields_of_thickness_lie_on_a_map(tmp_path: Path) -> None:
    domain = dataclasses.replace(SCENE.domain, origin=(5000.0, 100.0, 7000.0))
    write_scene(dataclasses.replace(SCENE, domain=domain), tmp_path / "scene.toml")
    assert "5000.1" in (tmp_path / "scene.toml").read_text()
    np.testing.assert_allclose(read_scene(tmp_path / "scene.toml").fields[0].origin, (0.1, 0.1), atol=1e-9)


def test_what_the_unknown_fields_are(path: str) -> None:
    thickness, bed = read_problem(path).fields
    assert (thickness.grid.nodes, bed.grid.nodes) == ((3, 3), (3,))
    np.testing.assert_array_equal(bed.zones.numbers, [3.0, 7.0, 9.0])
    np.testing.assert_allclose(thickness.truth(SCENE), THICKNESS.values)
    # Posts at x and z of 0.2 and below lie in zone 3.
    south = np.array([[FRICTIONS[i][k] for k in range(7)] for i in range(7)])[:, :3]
    assert bed.truth(SCENE)[0] == pytest.approx(south.mean())
    values = np.array([0.3, 0.2, 0.4])
    put = bed.put(SCENE, values)
    assert {round(coefficient, 6) for row in put.solids[0].friction for coefficient in row} == {0.2, 0.3, 0.4}
    np.testing.assert_allclose(bed.on_bed(SCENE, np.random.default_rng(0).uniform(0.0, 0.6, (50, 2))).sum(axis=1), 1.0)
    posts = np.array([[0.0, 0.2], [0.2, 0.4], [0.6, 0.6]])
    shown = [put.solids[0].friction[round(x / 0.2) + 1][round(z / 0.2) + 1] for x, z in posts]
    np.testing.assert_allclose(bed.on_bed(SCENE, posts) @ values, shown, atol=1e-12)


@pytest.mark.parametrize(
    ("before", "after", "said"),
    [
        ('zones = "zones.asc"', "spacing = [0.2, 0.2]", "unknowns[1].length"),
        ("mean = 0.25", "mean = 0.25, length = 0.4", "unknowns[1].length: expected none beside zones"),
        ('name = "thickness"', 'name = "velocity_x"', "unknowns[0].spacing: expected 3 lengths"),
        (", lower = 0.04, upper = 0.2", "", "unknowns[0].lower: expected bounds of a thickness"),
        ("solids[0].friction", "solids[1].friction", "unknowns[1].name: expected an index below 1"),
        ('"thickness", cell = 0.1,', '"front",', "observations[0].kind: expected an observation by the volumes"),
    ],
)
def test_mistakes_are_named(path: str, before: str, after: str, said: str) -> None:
    Path(path).write_text(PROBLEM.replace(before, after, 1))
    refused(read_problem, path, said=said)


def test_a_post_on_the_edge_of_two_cells_belongs_to_the_upper_one(path: str) -> None:
    """Posts from -0.2 m on, every 0.2 m, at the edges of cells: no column is left out. No post lies in zone 5."""
    rows = "1 2 1 2 1 2 1 2 5\n" * 5
    text = f"ncols 9\nnrows 5\nxllcorner -0.2\nyllcorner -0.2\ncellsize 0.2\n{rows}"
    (Path(path).parent / "zones.asc").write_text(text)
    bed = read_problem(path).fields[1]
    shown = bed.weights(bed.posts(SCENE)).toarray().argmax(axis=1).reshape(7, 7)
    np.testing.assert_array_equal(shown[:, 3], [0, 1, 0, 1, 0, 1, 0])
    truth = bed.truth(SCENE)
    np.testing.assert_allclose(truth[:2], [np.mean(FRICTIONS[0::2]), np.mean(FRICTIONS[1::2])])
    assert np.isnan(truth[2])


def test_zones_lie_over_the_terrain_in_the_box(path: str) -> None:
    """To half a cell of it, as a raster whose cells have the posts at their middles; one cell may be enough."""
    file, single = Path(path).parent / "zones.asc", "ncols 1\nnrows 1\nxllcorner 0\nyllcorner 0\ncellsize 0.8\n7\n"
    for text in (ZONES.replace("corner 0", "corner 0.2"), single):
        file.write_text(text)
        assert read_problem(path).fields[1].inside.any()
    for x in (-0.21, 0.21, 1e5):
        file.write_text(ZONES.replace("xllcorner 0", f"xllcorner {x}"))
        said = f"x, z of 0, 0 to 0.8, 0.6 m, or to half a cell of it, got x, z of {x:.10g}, 0"
        refused(read_problem, path, said=f"zones.asc: expected zones over the terrain in the box, {said}")


def test_zones_are_whole_numbers(path: str) -> None:
    (Path(path).parent / "zones.asc").write_text(ZONES.replace("7 9", "7.5 9"))
    refused(read_problem, path, said="the whole number of a zone in every cell")


@pytest.mark.slow
def test_the_adjoint_of_both(path: str) -> None:
    """In double precision, of a smooth objective of positions, by central differences along random directions."""
    problem = read_problem(path)
    flow = WhiteFlow(problem, ThicknessSettings(cell=0.1).operator(problem.scene))
    rng = np.random.default_rng(0)
    white, weights = 0.2 * rng.normal(size=flow.size), rng.normal(size=(3,))

    def objective(positions: Any, velocities: Any) -> Any:
        ways = np.broadcast_to(weights, positions.shape)
        return float((positions * ways).sum()), ways.astype(np.float64), None

    scene = flow.scene_at(white, 0)
    _, slope = gradient(scene, objective, threads=1, exact=True)
    for unknown, part, values in zip(problem.fields, flow.parts, flow.fields(white), strict=True):
        ours = unknown.at_nodes(slope, values, np.zeros(len(slope.positions)), {})
        direction = rng.normal(size=len(values)) * values

        ends = [unknown.put(scene, values + step * direction) for step in (1e-5, -1e-5)]
        ahead, behind = (gradient(end, objective, threads=1, exact=True)[0] for end in ends)
        difference = (ahead - behind) / 2e-5
        assert ours @ direction == pytest.approx(difference, rel=1e-3), (unknown.settings.name, part)


class Dragged(torch.nn.Module):
    """In place of a surrogate: what lies on the bed moves on in proportion to its mean friction."""

    def __init__(self, settings: Any, share: float = 1.0) -> None:
        super().__init__()
        self.settings = settings
        self.share = torch.nn.Parameter(torch.tensor(share, dtype=torch.float64))

    def forward(self, state: Any, conditions: Any) -> Any:
        share = conditions.ground.friction.mean() * self.share
        step = torch.stack([share * 0.01, -0.001 * share, 0.0 * share])
        return dataclasses.replace(state, positions=state.positions + step, displacements=state.displacements + step)


def test_the_gradient_through_a_rollout(path: str) -> None:
    """Of thicknesses through positions and volumes, of zones through the raster of the ground; by differences."""
    problem = read_problem(path)
    settings = ModelSettings(dimension=3, cell=0.05, frame_dt=0.02, frames_per_step=1, history=1)
    flow = SurrogateFlow(problem, ThicknessSettings(cell=0.1).operator(problem.scene), Dragged(settings), Band())
    rng = np.random.default_rng(0)
    white, direction = 0.2 * rng.normal(size=flow.size), rng.normal(size=flow.size)
    (numbers,) = flow.observe([white], [0])
    rows = rng.normal(size=(2, len(numbers)))
    ours = flow.jacobian(white, rows, [0]) @ direction
    ahead, behind = (flow.mean(white + sign * 1e-4 * direction, [0]) for sign in (1.0, -1.0))
    np.testing.assert_allclose(ours, rows @ (ahead - behind) / 2e-4, rtol=1e-4, atol=1e-7)
    # The prior's medians are those of both models.
    (first,) = flow.observe([np.zeros(flow.size)], [0])
    scene = flow.scene_at(np.zeros(flow.size), 0)
    assert first.sum() * 0.01 == pytest.approx(released_volume(scene) * 0.95, rel=0.06)


@pytest.mark.parametrize(("wrong", "left"), [(0.0, 1e-9), (0.4, 0.03), (0.8, 0.4)])
def test_runs_with_the_derivatives_of_a_surrogate(wrong: float, left: float) -> None:
    """Of what J is above its least value at the surrogate's own answer; each run takes away a part of it."""
    shares = []
    for seed in range(30):
        rng = np.random.default_rng(seed)
        true = rng.normal(size=(M, W))
        lead, flow = LinearFlow(true + wrong * true @ rng.normal(size=(W, W)) / math.sqrt(W)), LinearFlow(true)
        target, covariance = 3.0 * rng.normal(size=M), 0.1 * np.eye(M)
        start = Objective(lead, target + 2.0, covariance, [0]).minimise(np.zeros(W), 3).mean
        objective = Objective(flow, target, covariance, [0], lead=(lead, [0]))
        found = objective.minimise(start, 5, 0.0, numbers=true @ start, runs=5)
        assert flow.runs <= 5
        exact = true.T @ np.linalg.solve(true @ true.T + covariance, target)
        best = 0.5 * (10.0 * float(np.sum((true @ exact - target) ** 2)) + float(exact @ exact))
        first, *_, last = (iterate["objective"] - best for iterate in objective.iterates)
        shares.append(last / first)
        if wrong == 0.0:
            np.testing.assert_allclose(found.mean, exact, atol=1e-9)
            np.testing.assert_allclose(found.jacobian, objective.whitened(true), atol=1e-9)
    assert np.quantile(shares, 0.8) < left


@pytest.mark.parametrize(("wrong", "least", "alone"), [(0.0, 0.88, 0.97), (0.4, 0.8, 0.75), (0.8, 0.8, 0.55)])
def test_widths_hold_the_truth_where_derivatives_are_wrong(wrong: float, least: float, alone: float) -> None:
    """Along what a survey tells more of than the prior does; alone: at most so many by the derivatives themselves."""
    held, by_derivatives = list[bool](), list[bool]()
    for seed in range(60):
        rng = np.random.default_rng(seed)
        left, right = (np.linalg.qr(rng.normal(size=(rows, 30)))[0] for rows in (40, 30))
        true = 10.0 * left * 0.6 ** np.arange(30) @ right.T
        leading = true + wrong * true @ rng.normal(size=(30, 30)) / math.sqrt(30.0)
        truth, flow = rng.normal(size=30), LinearFlow(true)
        target, errors, lead = true @ truth + rng.normal(size=40), np.eye(40), LinearFlow(leading)
        draws = np.stack([leading @ rng.normal(size=30) for _ in range(12)])
        found = Objective(lead, target, errors, [0], draws=draws).minimise(np.zeros(30), 3)
        objective = Objective(flow, target, errors, [0], lead=(lead, [0]), combinations=found.combinations)
        nearest = objective.minimise(found.mean, 4, numbers=true @ found.mean, runs=4)
        wider = doubted(nearest, objective.doubt(1e-9 * errors), np.eye(30))
        for posterior, kept in ((wider, held), (nearest, by_derivatives)):
            values, directions = posterior.decomposition
            near = np.abs(directions.T @ (truth - posterior.mean)) < 1.96 / np.sqrt(1.0 + values)
            kept.extend(near[values > 1.0])
    assert len(held) > 60
    assert np.mean(held) > least
    assert np.mean(by_derivatives) < alone


class Noisy(LinearFlow):
    """Whose runs scatter by 0.5."""

    def __init__(self, matrix: Any, rng: np.random.Generator) -> None:
        super().__init__(matrix)
        self.rng = rng

    def mean(self, white: Any, seeds: Any) -> Any:
        return super().mean(white, seeds) + 0.5 * self.rng.normal(size=len(self.matrix))


def test_what_the_scatter_explains_is_no_doubt() -> None:
    """Where derivatives are right, the scatter of runs widens nothing."""
    doubts = []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        true = rng.normal(size=(40, W))
        objective = Objective(Noisy(true, rng), np.zeros(40), np.eye(40), [0], lead=(LinearFlow(true), [0]))
        objective.minimise(5.0 * rng.normal(size=W), 3, runs=3)
        doubts.append((objective.doubt(0.25 * np.eye(40)), objective.doubt(np.zeros((40, 40)))))
    with_scatter, without = np.mean(doubts, axis=0)
    assert with_scatter < 0.1 * without


class Quadratic(WhiteFlow):
    """Numbers that are linear in the white ones but for a square, with a scatter that differs from run to run."""

    def __init__(self, problem: Any, slope: Any, square: float, scatter: float) -> None:
        super().__init__(problem, ThicknessSettings(cell=0.1).operator(problem.scene))
        self.slope, self.square, self.scatter = slope, square, scatter
        self.rng = np.random.default_rng(5)

    def observe(self, points: Any, seeds: Any) -> Any:
        self.runs += len(points)
        lines = np.stack(points) @ self.slope.T
        return lines + self.square * lines**2 + self.scatter * self.rng.normal(size=lines.shape)


def test_derivatives_by_differences(path: str) -> None:
    """Exact but for directions in which the prior hardly varies; squares cancel over two seeds."""
    problem = read_problem(path)
    flow = WhiteFlow(problem, ThicknessSettings(cell=0.1).operator(problem.scene))
    slope = np.random.default_rng(1).normal(size=(40, flow.size)) @ flow.directions.T @ flow.directions
    for square, seeds in ((0.0, [0]), (0.0, [0, 1, 2]), (0.5, [0, 1]), (0.5, [0, 1, 2, 3])):
        exact = Quadratic(problem, slope, square, 0.0)
        white = np.random.default_rng(2).normal(size=flow.size)
        expected = slope * (1.0 + 2.0 * square * (slope @ white))[:, None]
        np.testing.assert_allclose(exact.jacobian(white, np.eye(40), seeds), expected, atol=1e-9)
        assert exact.runs == len(seeds) * (len(flow.directions) + 1 + IDLE)


def test_the_scatter_of_flows_tells_nothing(path: str) -> None:
    """Of 400 numbers none, or all along one direction, depend on the unknowns; the scatter is 0.1 of a derivative."""
    problem = read_problem(path)
    directions = WhiteFlow(problem, ThicknessSettings(cell=0.1).operator(problem.scene)).directions
    for seed in range(20):
        for strength, most in ((0.0, 0.05), (1.0, 0.15)):
            rng = np.random.default_rng(seed)
            along = rng.normal(size=len(directions)) @ directions
            slope = strength * np.outer(rng.normal(size=400), along / np.linalg.norm(along))
            flow = Quadratic(problem, slope, 0.0, 0.05 * math.sqrt(2.0 * (len(directions) + 1 + IDLE)))
            flow.rng = rng
            found = flow.jacobian(np.zeros(flow.size), np.eye(400), [0, 1])
            # Each of the numbers, over all directions; without `denoised` 0.1 times the square root of their number.
            assert np.linalg.norm(found - slope) / math.sqrt(400.0) < most, (seed, strength)


def test_a_surrogate_that_lacks_an_unknown_is_refused_out_of_its_range_too(path: str) -> None:
    young = '{ name = "young", initial = 2.0e5, lower = 1.0e5, upper = 4.0e5 }'
    Path(path).write_text(PROBLEM.replace('"none"', '"gns"', 1).replace("0.6 },", f"0.6 }}, {young}"))
    problem = read_problem(path)
    operator = ThicknessSettings(cell=0.1).operator(problem.scene)
    target = target_of(np.zeros(operator.count), 1.0, operator)
    assert refused(leading, problem, target, said="young is no input of it").key == "surrogate"


@pytest.mark.slow
def test_the_command(path: str, tmp_path: Path) -> None:
    """The MPM on larger cells leads; and the adjoint alone."""
    Path(path).write_text(PROBLEM.replace('"none"', '"coarse"', 1))
    out = tmp_path / "out"
    assert run(main, "inverse", [path, "--out", str(out)]) == 0
    result = json.loads((out / "result.json").read_text())
    assert result["surrogate"]["asked"]
    assert len(result["mpm_runs"]) == 3
    assert result["run_count"] <= 9
    assert [entry["name"] for entry in result["fields"]] == ["thickness", "solids[0].friction"]
    report = (out / "report.md").read_text()
    assert "thickness.png" in report


def test_a_surrogate_leads_and_runs_correct_it(path: str) -> None:
    """In place of the MPM another stub, whose bed drags half as much again: few runs of it find a nearer answer."""
    problem = read_problem(path)
    operator = ThicknessSettings(cell=0.1).operator(problem.scene)
    settings = ModelSettings(dimension=3, cell=0.025, frame_dt=0.02, frames_per_step=1, history=1)
    truth, lead = (SurrogateFlow(problem, operator, Dragged(settings, share), Band()) for share in (1.5, 1.0))
    rng = np.random.default_rng(5)
    (values,) = truth.observe([rng.normal(size=truth.size)], [1000])
    result = led(truth, lead, target_of(values, 0.004, operator))
    objective = result.surrogate["objective"]
    assert truth.runs <= 1 + LED_RUNS - LED_CHECKS
    assert lead.reverses > 0
    assert min(objective) < 0.8 * objective[0]
    assert result.posterior.jacobian.shape == (len(result.posterior.combinations), truth.size)
    removed = (result.posterior.removed**2).sum(axis=1)
    assert 0.0 <= removed.min() <= removed.max() <= 1.0
