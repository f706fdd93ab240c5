"""Problem files: what is shipped reads, what is wrong is said in one line, and targets come from where they say."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from datasets import Scene, Trajectory
from datasets.scene.library import SCENES
from inverse import Problem, TargetSettings, read_problem
from inverse.__main__ import main
from inverse.observations import KINDS
from inverse.parameters import kind
from inverse.problem import PROBLEMS
from inverse.target import read_target
from tests.inverse.parameters.test_prior import GOOD as STATED
from tests.refusals import refused, refused_by
from tests.scenes import flow_of

GOOD = """
scene = "column-tall-42"
[[unknowns]]
name = "friction_deg"
initial = 30.0
lower = 12.0
upper = 52.0
[[observations]]
kind = "front"
value = 0.55
[target]
"""
PAIR = '{ between = ["cohesion", "friction_deg"], coefficient = 0.1 }'


def written(folder: Path, text: str) -> Path:
    path = folder / "problem.toml"
    path.write_text(text)
    return path


@pytest.mark.parametrize("path", sorted(PROBLEMS.glob("*.toml")), ids=lambda path: path.stem)
def test_a_shipped_problem_reads(path: Path) -> None:
    problem = read_problem(path.stem)
    assert problem.name == path.stem
    assert not problem.target.twin or problem.twin_scene.seed != problem.scene.seed
    if path.stem.startswith("friction-"):
        kind = "profile" if path.stem.endswith("profile") else "front"
        assert problem.observations[0].kind == kind


def test_the_papers_problems_of_many_unknowns_are_the_papers() -> None:
    velocities, baffles = read_problem("velocity-layers-10"), read_problem("baffles-2")
    np.testing.assert_array_equal(velocities.initial, np.zeros(10))
    layers = [kind(name).read(velocities.twin_scene) for name in velocities.names]
    np.testing.assert_allclose(layers, [1.50, 1.35, 1.20, 1.05, 0.90, 0.75, 0.60, 0.45, 0.30, 0.15])
    # Ours are the paper's coordinates less 0.1 m.
    np.testing.assert_allclose(baffles.initial, np.array([0.225, 0.925]) - 0.1)
    np.testing.assert_allclose([kind(name).read(baffles.scene) for name in baffles.names], baffles.initial)
    true = [kind(name).read(baffles.twin_scene) for name in baffles.names]
    np.testing.assert_allclose(true, np.array([0.341, 0.812]) - 0.1)


def test_bounds_in_radians_are_warned_of(tmp_path: Path) -> None:
    text = GOOD.replace("30.0", "0.5").replace("12.0", "0.2").replace("52.0", "0.9")
    with pytest.warns(UserWarning, match="in radians it would be 51"):
        read_problem(written(tmp_path, text))


def test_an_unknown_name_gets_suggestions_that_the_scene_has(tmp_path: Path) -> None:
    text = GOOD.replace('"friction_deg"', '"phi"')
    message = refused(read_problem, written(tmp_path, text), said="friction_deg").message
    assert "masses[0].height" in message
    assert "baffles" not in message
    assert "solids" not in message


@pytest.mark.parametrize(
    ("old", "new", "key"),
    [
        ('kind = "front"', 'knid = "front"', "knid"),
        ('kind = "front"', 'kind = "fornt"', "observations[0].kind: expected one of front, runout, "),
        ("value", "valeu", "observations[0].valeu: expected a known key, did you mean 'value'?"),
        ("value = 0.55", "", "observations[0]"),
        ("value = 0.55", "value = 0.55\ntwin = true", "observations[0].twin"),
        ("value = 0.55", "value = 1.55", "observations[0].value"),
        ("value = 0.55", 'csv = "profile.csv"', "profile.csv"),
        ("value = 0.55\n[target]", "[target]\ntwin = true\nseed = 0", "target.seed"),
        ("value = 0.55\n[target]", "[target]\ntwin = true\ntruth = {cohesion = 3.0}", "target.truth.cohesion"),
        ("value = 0.55\n[target]", "[target]\ntwin = true\ncell = 0.03", "target.cell"),
        ("[target]", "[target]\ncell = 0.005", "target.cell"),
        ('"friction_deg"', '"frictoin_deg"', "unknowns[0].name"),
        ("upper = 52.0", "upper = 90.0", "unknowns[0].upper"),
        ('"column-tall-42"', '"column-tall-43"', "column-tall-43"),
        ("[target]", "[loop]\nmpm_runs = 1000001\n[target]", "loop.mpm_runs: expected an integer from 1 to 1000000"),
        ("[target]", "[optimiser]\nensemble = 9999999\n[target]", "optimiser.ensemble: expected an integer from 4"),
        ("[target]", "[[target", "problem.toml"),
        ('"friction_deg"', '"baffles[0].x"', "unknowns[0].name"),
        ("value = 0.55", "values = [0.5, 0.1]", "observations[0].values"),
        ('kind = "front"', 'kind = "front"\nline = 0.5', "line: expected it with kind passed alone, not with front"),
        ('kind = "front"', 'kind = "toe"', "observations[0].value"),
        ("[target]", '[optimiser]\nmethod = "newton"\n[target]', "optimiser.method"),
        ('"normal"', '"gaussian"', "unknowns[0].prior.kind"),
        ("deviation = 2.0", "deviation = -2.0", "unknowns[0].prior.deviation"),
        ("deviation = 2.0", "mode = 2.0", "unknowns[0].prior.deviation"),
        ("deviation = 2.0", "deviation = 2.0, mode = 20.0", "unknowns[0].prior.mode"),
        ("deviation = 2.0", "width = 2.0", "unknowns[0].prior.width"),
        ("mean = 30.0", "mean = 90.0", "unknowns[0].prior.mean"),
        ('"normal", mean = 30.0, deviation = 2.0', '"triangular", mode = 50.0', "unknowns[0].prior.mode"),
        ("mean = 600.0", "mean = -600.0", "unknowns[1].prior.mean"),
        ("upper = 45.0, prior", "upper = 45.0, initial = 60.0, prior", "unknowns[0].initial"),
        (', prior = { kind = "normal", mean = 30.0, deviation = 2.0 }', "", "unknowns[0].initial"),
        ("coefficient = -0.5", "coefficient = -1.0", "correlations[0].coefficient"),
        ('["friction_deg", "cohesion"]', '["friction_deg", "young"]', "correlations[0].between"),
        ('["friction_deg", "cohesion"]', '["cohesion", "cohesion"]', "correlations[0].between"),
        ("coefficient = -0.5 }", f"coefficient = -0.5 }}, {PAIR}", "correlations[1].between"),
    ],
)
def test_a_wrong_problem_is_one_line_and_status_2(
    old: str, new: str, key: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    text = next(template for template in (GOOD, STATED) if old in template)
    path = written(tmp_path, text.replace(old, new))
    assert key in refused_by(capfd, main, path, "--out", tmp_path / "out")
    assert not (tmp_path / "out").exists()


def small(kind: str, folder: Path, target: TargetSettings | None = None, **measured: str) -> Problem:
    problem, settings = read_problem("friction-tall-42"), KINDS[kind](**measured)
    return dataclasses.replace(problem, observations=(settings,), folder=folder, target=target or TargetSettings())


def fall(scene: Scene) -> Trajectory:
    """A deposit that depends on the angle and on the seed."""
    x = np.linspace(0.0, 1.0 - scene.material.friction_deg / 100.0 - 0.001 * scene.seed, 500)
    positions = np.stack([x, np.zeros(500)], axis=1)[None]
    return flow_of(scene, positions, time=np.array([1.0]))


def test_a_twin_has_its_own_angle_and_jitter(tmp_path: Path) -> None:
    settings = TargetSettings(twin=True, seed=3, truth={"friction_deg": 37.0})
    problem = small("front", tmp_path, settings)
    target = read_target(problem, fall)
    assert target.truth == {"friction_deg": 37.0}
    assert target.front == pytest.approx(0.995 * (1.0 - 0.37 - 0.003), rel=2e-3)
    assert target.values == pytest.approx([target.front])
    unstated = small("front", tmp_path, TargetSettings(twin=True, seed=3))
    assert read_target(unstated, fall).truth == {"friction_deg": 42.0}
    # On other cells it is the flow of these.
    finer = dataclasses.replace(problem, target=dataclasses.replace(settings, cell=0.005))
    assert finer.twin_scene == problem.twin_scene.with_cell(0.005)
    assert finer.scene.domain.cell == 0.01


def test_a_trajectory_is_a_target_without_a_truth(tmp_path: Path) -> None:
    problem = small("profile", tmp_path, TargetSettings(trajectory="seen.npz"))
    seen = fall(problem.scene)
    seen.save(tmp_path / "seen.npz")
    whole = small("deposit", tmp_path, TargetSettings(trajectory="seen.npz"))
    refused(read_target, whole, fall, said="seen.npz: expected the 3200 particles")
    elsewhere = dataclasses.replace(problem.scene, domain=dataclasses.replace(problem.scene.domain, origin=(9.0, 0.0)))
    said = "seen.npz: expected a flow in a box at [9.0, 0.0], as the scene's"
    refused(read_target, dataclasses.replace(problem, scene=elsewhere), fall, said=said)
    observation = problem.operators[0]
    target = read_target(problem, fall)
    assert target.truth is None
    np.testing.assert_allclose(target.values, observation.exact(seen.positions[-1]))
    further = dataclasses.replace(seen, positions=1.01 * seen.positions)
    assert target.front_error(further) == pytest.approx(0.01, rel=1e-4)


def test_a_scene_is_no_problem() -> None:
    path = SCENES / "column-tall-42.toml"
    refused(read_problem, str(path), said="domain: expected a problem, got a scene: python -m mpm.run takes it")
