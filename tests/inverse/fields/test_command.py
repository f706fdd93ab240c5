"""`python -m inverse.fields` from end to end on a tiny twin; the gradient of its objective against differences."""

import json
from pathlib import Path

import numpy as np
import pytest

from datasets.command_line import run
from datasets.library import read_scene
from inverse.fields.__main__ import main
from inverse.fields.flow import Flow
from inverse.fields.inversion import invert, observed
from inverse.fields.problem import read_problem
from inverse.result import Verdict
from tests.inverse.fields.tiny import PROBLEM, SCENE, files, tiny


@pytest.fixture(scope="module")
def flow(tmp_path_factory: pytest.TempPathFactory) -> Flow:
    """Of the tiny problem."""
    problem = tiny(tmp_path_factory.mktemp("tiny"))
    target, _ = observed(problem)
    return Flow(problem, target.observation)


def test_what_the_adjoint_does_not_know_is_refused_at_once(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    softens = "softening_length = 0.004\nresidual_cohesion = 0.0\n"
    scene = "volume_correction = true\n" + SCENE.replace("[material]\n", "[material]\n" + softens)
    path = files(tmp_path, scene=scene)
    assert run(main, "inverse.fields", [path, "--out", str(tmp_path)]) == 2
    assert "volume_correction" in capfd.readouterr().err


def test_frames_that_are_observed(flow: Flow) -> None:
    """Both sides of the time between two frames, the times of the gauges, the end and the frame before."""
    assert flow.frames == [10, 11, 19, 20]


def test_the_derivative_of_the_numbers(flow: Flow) -> None:
    """Of two combinations of all numbers along a random direction of both fields, for two seeds."""
    rng = np.random.default_rng(0)
    white, direction = 0.2 * rng.normal(size=flow.size), rng.normal(size=flow.size)
    seeds = flow.problem.seeds
    rows = rng.normal(size=(2, len(flow.mean(white, seeds))))
    ours = flow.jacobian(white, rows, seeds) @ direction
    step = 0.05
    ahead, behind = (flow.mean(white + sign * step * direction, seeds) for sign in (1.0, -1.0))
    np.testing.assert_allclose(ours, rows @ (ahead - behind) / (2.0 * step), rtol=0.1)


def test_the_command(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    assert run(main, "inverse.fields", [files(tmp_path), "--out", str(out)]) == 0
    said = capfd.readouterr().out
    assert "velocity_x: The observation removes" in said
    result = json.loads((out / "result.json").read_text())
    friction, velocity = result["fields"]
    assert result["verdict"] == Verdict.CONFIRMED
    assert velocity["error"]["posterior"] < velocity["error"]["prior"]
    assert velocity["variance_removed"] > friction["variance_removed"]
    assert result["informative_directions"] == sum(value > 1.0 for value in result["eigenvalues"])
    objectives = [each["objective"] for each in result["iterations"]]
    assert objectives[-1] < objectives[0]
    with np.load(out / "field.npz", allow_pickle=False) as arrays:
        assert arrays["0_mean"].shape == (21,)
        assert arrays["1_draws"].shape == (100, 7)
        lower, upper, truth = (arrays[f"1_{name}"] for name in ("lower", "upper", "truth"))
        np.testing.assert_allclose(truth, np.linspace(0.4, 0.9, 7), rtol=1e-6)
        share = np.mean((lower <= truth) & (truth <= upper))
        assert velocity["truth_in_band"]["all"] == pytest.approx(share)
        spread = arrays["1_draws"].std(axis=0)
        np.testing.assert_allclose(spread, arrays["1_deviation"], rtol=0.4)
        mean = arrays["1_mean"]
    scene = read_scene(out / "scene.toml")
    assert [each.quantity for each in scene.fields] == ["friction_deg", "velocity_x"]
    np.testing.assert_allclose(scene.fields[1].values, mean, rtol=1e-12)
    report = (out / "report.md").read_text()
    for name in ("friction_deg.png", "velocity_x.png", "observation.png"):
        assert name in report
        assert (out / name).stat().st_size > 1000
    assert (out / "friction_deg.vti").exists()


def test_measured_profiles(tmp_path: Path) -> None:
    """Rows of a file at a time: no twin, no truth, the same answer shape."""
    (tmp_path / "early.csv").write_text("x,height\n0.11,0.0\n0.12,0.04\n0.18,0.04\n0.23,0.04\n0.25,0.0\n")
    profile = 'kind = "profile"\ncsv = "early.csv"\nspacing = 0.01\ntimes = [0.05]\nnoise = 0.002\n'
    text = PROBLEM.split("[[observations]]")[0] + "[[observations]]\n" + profile
    result = invert(read_problem(files(tmp_path, text + "[search]\nseeds = 1\nensemble = 4\niterations = 1\n")))
    assert result.fields[0].truth is None
    assert result.as_json()["fields"][0]["error"]["posterior"] is None
    assert np.isfinite(result.fields[1].mean).all()


def test_a_mistake_is_one_line(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    path = files(tmp_path, PROBLEM.replace("mean = 28.0", "mean = 60.0"))
    assert run(main, "inverse.fields", [path, "--out", str(tmp_path)]) == 2
    said = capfd.readouterr().err
    assert said.count("\n") == 1
    assert "fields[0].mean" in said


@pytest.mark.slow
def test_the_slope_that_ships() -> None:
    """The weak band is found where the deposit identifies it, and a run with another jitter confirms."""
    result = invert(read_problem("slope-friction"))
    (found,) = result.fields
    assert result.verdict is Verdict.CONFIRMED
    assert result.posterior.informative >= 4
    inside = found.unknown.inside
    before, after = (found.error(found.identified, values) for values in (found.unknown.settings.mean, None))
    assert after is not None
    assert before is not None
    assert after < 0.6 * before
    assert (found.covered(inside) or 0.0) > 0.9
