"""Unknown fields: the prior, the exact posterior of a linear problem, and a block of 48 particles from end to end."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.special import gamma, kv

from datasets import read_scene
from datasets.command_line import run
from datasets.scene.grid_field import Grid
from inverse import invert, read_problem
from inverse.__main__ import main
from inverse.answer import Verdict
from inverse.fields.flow import WhiteFlow
from inverse.fields.search import Objective, linear_mean
from inverse.parameters.field import BAND, FieldPrior
from inverse.target import read_target
from mpm import simulate
from tests.inverse.flows import LinearFlow, M, W
from tests.refusals import refused

SCENE = """
duration = 0.1
frame_dt = 0.005
floor_friction = 0.3
step_fraction = 0.9
domain = { size = [0.6, 0.2], cell = 0.02 }
material = { friction_deg = 30.0, young = 1.0e5, cohesion = 200.0, tension_cutoff = 100.0 }
masses = [{ lower = [0.1, 0.0], size = [0.12, 0.04], velocity = [0.5, 0.0] }]
fields = [
  { quantity = "velocity_x", origin = [0.1, 0.0], spacing = [0.12, 0.04], nodes = [2, 1], values = [0.4, 0.9] },
]
"""
PROBLEM = """
scene = "scene.toml"
observations = [
  { kind = "profile", spacing = 0.01, times = [0.0525], noise = 0.0005 },
  { kind = "height", x = [0.2, 0.24], times = [0.05, 0.1], noise = 0.0005 },
]
target = { twin = true, seed = 1000 }
optimiser = { seeds = 2, ensemble = 6, max_iterations = 2 }
unknowns = [
  { name = "velocity_x", spacing = [0.02, 1.0], mean = 0.6, deviation = 0.3, length = 0.06 },
  { name = "floor_friction", initial = 0.4, lower = 0.1, upper = 0.7 },
]
"""
BOUNDS = "lower = 10.0, upper = 45.0"
FRICTION = f'name = "friction_deg", spacing = [0.02, 0.02], mean = 28.0, deviation = 5.0, length = 0.06, {BOUNDS}'
GRIDS = {
    "2D, longer along x": (Grid((0.0, 0.0), (0.02, 0.01), (21, 15)), (0.16, 0.06)),
    "along x alone": (Grid((0.0, 0.0), (0.02, 1.0), (31, 1)), (0.12, 1.0)),
}


def files(folder: Path, problem: str = PROBLEM, scene: str = SCENE) -> str:
    """Write both, and return the path of the problem."""
    (folder / "scene.toml").write_text(scene)
    (folder / "problem.toml").write_text(problem)
    return str(folder / "problem.toml")


def matern(offsets: Any, lengths: Any) -> Any:
    """Correlation of two places that differ by `offsets` [m], shape [K, D]."""
    nu = 2.0 - 0.5 * offsets.shape[-1]
    scaled = np.linalg.norm(offsets * np.sqrt(8.0 * nu) / np.array(lengths), axis=-1)
    apart = np.where(scaled > 0.0, scaled, 1.0)
    return np.where(scaled > 0.0, 2.0 ** (1.0 - nu) / gamma(nu) * apart**nu * kv(nu, apart), 1.0)


@pytest.mark.parametrize("name", GRIDS)
def test_the_prior_has_the_stated_deviation_and_materns_correlation(name: str) -> None:
    grid, lengths = GRIDS[name]
    prior, rng = FieldPrior(grid, 2.5, lengths), np.random.default_rng(0)
    root = prior.field(np.eye(prior.size))
    np.testing.assert_allclose((root**2).sum(axis=1), 2.5**2, rtol=1e-9)
    middle = int(np.argmin(np.linalg.norm(grid.positions - grid.positions.mean(axis=0), axis=1)))
    varying = [axis for axis, count in enumerate(grid.nodes) if count > 1]
    exact = matern((grid.positions - grid.positions[middle])[:, varying], [lengths[axis] for axis in varying])
    np.testing.assert_allclose(root @ root[middle] / 2.5**2, exact, atol=0.07)
    white, adjoint = rng.normal(size=prior.size), rng.normal(size=grid.count)
    assert adjoint @ prior.field(white) == pytest.approx(white @ prior.white(adjoint), rel=1e-10)


MATRIX = np.random.default_rng(0).normal(size=(M, W))


def objective(flow: LinearFlow, target: Any) -> Objective:
    """With dependent errors, of draws that move every combination."""
    root = np.random.default_rng(1).normal(size=(M, M))
    covariance, draws = root @ root.T + 0.6 * np.eye(M), 100.0 * np.random.default_rng(6).normal(size=(60, M))
    return Objective(flow, target, covariance, range(2), draws=draws)


def test_a_linear_problem_has_the_exact_gaussian_posterior() -> None:
    flow, target = LinearFlow(MATRIX), 3.0 * np.random.default_rng(2).normal(size=M)
    search = objective(flow, target)
    posterior = search.minimise(np.zeros(W), 5)
    inverse = np.linalg.inv(search.root @ search.root.T)
    exact = np.linalg.inv(np.eye(W) + flow.matrix.T @ inverse @ flow.matrix)
    assert posterior.promised < 1e-9
    assert [iterate["step"] for iterate in search.iterates] == [0.0, 1.0]
    np.testing.assert_allclose(posterior.mean, exact @ flow.matrix.T @ inverse @ target, atol=1e-10)
    np.testing.assert_allclose(np.eye(W) - posterior.removed @ posterior.removed.T, exact, atol=1e-10)
    eigenvalues = np.linalg.eigvalsh(flow.matrix.T @ inverse @ flow.matrix)[::-1]
    assert posterior.informative == int((eigenvalues > 1.0).sum())
    np.testing.assert_allclose(np.cov(posterior.draws(20_000).T), exact, atol=0.06)
    jacobian, white, residual = posterior.jacobian, np.ones(W), np.arange(float(M))
    step = np.linalg.solve(np.eye(W) + jacobian.T @ jacobian, jacobian.T @ (jacobian @ white - residual))
    np.testing.assert_allclose(linear_mean(jacobian, white, residual), step, atol=1e-9)


def test_a_step_is_halved_until_the_objective_falls() -> None:
    search = objective(LinearFlow(MATRIX, bend=0.05), np.full(M, 20.0))
    posterior = search.minimise(np.zeros(W), 30)
    assert posterior.promised < 0.5
    assert not posterior.cut
    ended = objective(LinearFlow(MATRIX, bend=0.05), np.full(M, 20.0)).minimise(np.zeros(W), 1)
    assert ended.promised > 0.5
    assert ended.cut
    objectives = [iterate["objective"] for iterate in search.iterates]
    assert sorted(objectives, reverse=True) == objectives
    assert min(iterate["step"] for iterate in search.iterates[1:]) < 1.0


def test_nodes_cover_the_body_between_the_stated_band(tmp_path: Path) -> None:
    text = PROBLEM.replace('name = "floor_friction", initial = 0.4, lower = 0.1, upper = 0.7', FRICTION)
    problem = read_problem(files(tmp_path, text.replace("twin = true, seed = 1000", 'trajectory = "seen.npz"')))
    velocity, friction = problem.fields
    assert (velocity.grid.nodes, friction.grid.nodes) == ((7, 1), (7, 3))
    np.testing.assert_allclose(friction.grid.positions[[0, -1]], [[0.1, 0.0], [0.22, 0.04]])
    zero = np.zeros(friction.grid.count)
    ends = [friction.values(zero + sign * BAND * friction.prior.deviation)[0] for sign in (1.0, -1.0)]
    assert friction.values(zero) == pytest.approx(28.0)
    assert ends[0] - ends[1] == pytest.approx(2.0 * BAND * 5.0)
    slope = (friction.values(zero + 0.5 + 1e-6) - friction.values(zero + 0.5 - 1e-6)) / 2e-6
    np.testing.assert_allclose(friction.slope(zero + 0.5), slope, rtol=1e-7)
    assert len({*problem.seeds, *problem.scatter_seeds}) == 2 + 6


@pytest.mark.parametrize(
    ("before", "after", "key"),
    [
        ('name = "velocity_x"', 'name = "porosity"', "unknowns[0].name"),
        ("spacing = [0.02, 1.0]", "spacing = [0.04, 1.0]", "unknowns[0].length"),
        ("spacing = [0.02, 1.0]", "spacing = [1e-300, 1.0]", "unknowns[0].spacing"),
        ("spacing = [0.02, 1.0]", "spacing = [1e-8, 1e-8]", "unknowns[0].spacing"),
        ("spacing = [0.02, 1.0]", "spacing = [0.02, nan]", "unknowns[0].spacing"),
        ("length = 0.06", "length = 1e300", "unknowns[0].length"),
        ("length = 0.06", "length = 1e8", "unknowns[0].length"),
        ("deviation = 0.3", "deviation = 1e-300", "unknowns[0].deviation"),
        ("deviation = 0.3", "deviation = 1e-12, lower = 0.0, upper = 2.0", "unknowns[0].deviation"),
        ("mean = 0.6", "mean = nan", "unknowns[0].mean"),
        ("mean = 0.6", "mean = 0.6, initial = 0.6", "unknowns[0].initial"),
        ("length = 0.06", "length = 0.06, lower = 0.0", "unknowns[0].upper"),
        ('kind = "height"', 'kind = "deposit"', "observations[1]"),
        ("seed = 1000", "seed = 1", "target.seed"),
        ("ensemble = 6", "ensemble = 2", "optimiser.ensemble"),
    ],
)
def test_mistakes_are_named(tmp_path: Path, before: str, after: str, key: str) -> None:
    assert refused(read_problem, files(tmp_path, PROBLEM.replace(before, after, 1))).key.startswith(key)
    refused(read_problem, files(tmp_path, scene=SCENE.split("fields")[0]), said="as the truth")


@pytest.mark.slow
def test_the_derivative_of_the_numbers(tmp_path: Path) -> None:
    """Of two combinations of all numbers along a random direction of the field and of the number, for two seeds."""
    problem, rng = read_problem(files(tmp_path)), np.random.default_rng(0)
    flow = WhiteFlow(problem, read_target(problem, simulate).observation)
    # Both sides of the time between two frames, the times of the gauges, the end and the frame before.
    assert flow.frames == [10, 11, 19, 20]
    white, direction = 0.2 * rng.normal(size=flow.size), rng.normal(size=flow.size)
    rows = rng.normal(size=(2, len(flow.mean(white, problem.seeds))))
    ours = flow.jacobian(white, rows, problem.seeds) @ direction
    ahead, behind = (flow.mean(white + sign * 0.05 * direction, problem.seeds) for sign in (1.0, -1.0))
    differences = rows @ (ahead - behind) / 0.1
    np.testing.assert_allclose(ours, differences, atol=0.15 * np.abs(differences).max())


def test_the_command(tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert run(main, "inverse", [files(tmp_path), "--out", str(out)]) == 0
    result = json.loads((out / "result.json").read_text())
    (velocity,) = result["fields"]
    assert result["unknowns"].keys() == result["certainty"].keys() == {"velocity_x", "floor_friction"}
    assert 0.1 < result["unknowns"]["floor_friction"] < 0.7
    assert velocity["variance_removed"] > 0.05
    assert velocity["deviation"]["posterior"] < velocity["deviation"]["prior"]
    assert result["iterations"][-1]["objective"] < result["iterations"][0]["objective"]
    with np.load(out / "field.npz", allow_pickle=False) as arrays:
        assert arrays["0_draws"].shape == (100, 7)
        np.testing.assert_allclose(arrays["0_truth"], np.linspace(0.4, 0.9, 7), rtol=1e-6)
        np.testing.assert_allclose(arrays["0_draws"].std(axis=0), arrays["0_deviation"], rtol=0.4)
        mean = arrays["0_mean"]
    np.testing.assert_allclose(read_scene(out / "scene.toml").fields[0].values, mean, rtol=1e-12)
    report = (out / "report.md").read_text()
    assert "velocity_x.png" in report
    assert (out / "velocity_x.png").stat().st_size > 1000


@pytest.mark.slow
def test_the_slope_that_ships() -> None:
    """The weak band is found where the deposit identifies it, and a run with another jitter confirms."""
    result = invert(read_problem("slope-friction"))
    (friction,) = result.fields
    assert result.verdict is Verdict.CONFIRMED
    before, after = (friction.error(friction.identified, values) for values in (friction.unknown.settings.mean, None))
    assert (after or 1.0) < 0.6 * (before or 0.0)
    assert (friction.covered(friction.unknown.inside) or 0.0) > 0.9
