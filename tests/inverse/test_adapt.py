"""`inverse.adapt`: flows over a problem's box, a model trained on them, and what is refused in a line."""

import dataclasses
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import qmc

from datasets import Trajectory
from datasets.definitions.definition import Split
from gns import card, checkpoint
from gns.checkpoint import Model
from gns.library import model_path
from gns.surroundings.units import Units
from gns.training.samples import flows_of
from inverse import Parameter
from inverse.adapt import main
from inverse.adaptation import DATA, adapt, definition, deposits, scatter
from tests.inverse.flows import problem_of, simulator_of
from tests.pool import pool
from tests.refusals import refused, refused_by
from tests.scenes import flow_of

NAMES = ("friction_deg", "masses[0].velocity_x")


@pytest.fixture(scope="module")
def weights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The file of a tiny model in 2D."""
    path = tmp_path_factory.mktemp("model") / "tiny.safetensors"
    checkpoint.save(path, simulator_of(2).float(), {})
    return path


@pytest.fixture(scope="module")
def tiny(weights: Path) -> Model:
    return checkpoint.load(weights)


@pytest.fixture(scope="module")
def adapted(weights: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a model that was trained for a second on seven flows."""
    out = tmp_path_factory.mktemp("run")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("mpm.generate.pool", pool)
        adapt(problem_of(2, *NAMES), out, runs=7, minutes=0.01, model=weights, jobs=1)
    return out


def test_the_call_holds_beside_the_command_and_refuses_what_no_surrogate_knows(tmp_path: Path, weights: Path) -> None:
    """`import inverse.adapt`, as for the command, binds the module over the function of the package."""
    import inverse
    import inverse.adapt

    refused(inverse.adapt, "friction-tall-42", "out", runs=1, said="at least 7 runs")
    young = Parameter(name="young", initial=2e6, lower=1e6, upper=3e6)
    problem = dataclasses.replace(problem_of(2, "friction_deg"), parameters=(young,))
    said = "unknowns[0]: expected an input of the surrogate, young is none"
    refused(adapt, problem, tmp_path, model=weights, said=said)


def test_flows_fill_the_box_and_more_begin_with_the_fewer(tiny: Model) -> None:
    problem, settings = problem_of(2, *NAMES), tiny.simulator.settings
    entries = definition(problem, 32, settings, seed=3).entries(seed=3)
    assert entries[:8] == definition(problem, 8, settings, seed=3).entries(seed=3)
    values = np.array([[kind.read(entry.scene) for kind in problem.kinds] for entry in entries])
    shares = (values - problem.box.lower) / problem.box.range
    # Every eighth of every range has four of 32 points.
    assert all((np.bincount((8 * column).astype(int), minlength=8) == 4).all() for column in shares.T)
    assert len({entry.scene.seed for entry in entries} | {problem.target.seed, problem.scene.seed}) == 34
    held_out = np.array([entry.split is Split.VALID for entry in entries])
    assert held_out.sum() == 7
    assert ((shares[held_out].min(axis=0) < 0.3) & (shares[held_out].max(axis=0) > 0.7)).all()


def test_flows_are_stored_as_a_rollout_runs_them(adapted: Path, tiny: Model) -> None:
    problem, settings = problem_of(2, *NAMES), tiny.simulator.settings
    units = Units.of_model(problem.scene, settings)
    assert units.length != 1.0
    flow = flows_of(adapted / DATA, "train", settings)[0]
    stored = Trajectory.load(flow.name)
    assert flow.step == pytest.approx(flow.units.time * settings.step)
    np.testing.assert_array_equal(flow.positions, stored.positions)
    assert flow.units.length == pytest.approx(units.length, rel=0.1)


def test_an_adapted_model_has_its_card_and_its_deposits(adapted: Path, weights: Path) -> None:
    problem = problem_of(2, *NAMES)
    model_card = card.read(model_path(adapted))
    low, high = model_card.ranges["friction_deg"]
    assert problem.box.lower[0] <= low < high <= problem.box.upper[0]
    assert sum(data.scenes for data in model_card.datasets.values()) == 5
    assert "moving" in model_card.scores
    band = model_card.calibration(problem.scene)
    assert band.flows == 2
    runs = deposits(adapted, problem)
    assert len(runs) == len(deposits(model_path(adapted), problem)) == 7
    for values, flow in runs:
        assert len(flow.time) == 1
        assert flow.time[0] == pytest.approx(problem.scene.duration)
        np.testing.assert_allclose(values, [kind.read(flow.scene) for kind in problem.kinds])
    first = dataclasses.replace(problem.parameters[0], initial=31.0)
    assert deposits(adapted, dataclasses.replace(problem, parameters=(first, *problem.parameters[1:])))
    other = problem_of(2, "cohesion")
    first = dataclasses.replace(problem.parameters[0], upper=problem.parameters[0].upper + 1.0)
    wider = dataclasses.replace(problem, parameters=(first, *problem.parameters[1:]))
    longer = dataclasses.replace(problem, scene=dataclasses.replace(problem.scene, duration=0.16))
    for asked, said in (
        (other, "another problem (friction_deg, masses[0].velocity_x)"),
        (wider, "this problem with other bounds"),
        (longer, "another scene with the same unknowns"),
    ):
        with pytest.warns(UserWarning, match=re.escape(f"its runs of the MPM are of {said}, and are not used")):
            assert deposits(adapted, asked) == []
        message = f"expected a new folder, or one of small, it is of {said}"
        refused(adapt, asked, adapted, runs=7, model=weights, said=message)


def test_more_runs_begin_the_training_anew(
    adapted: Path, weights: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A model of seven runs is not kept for its scores on other held-out flows."""
    out = shutil.copytree(adapted, tmp_path / "run")
    monkeypatch.setattr("mpm.generate.pool", pool)
    adapt(problem_of(2, *NAMES), out, runs=9, minutes=0.01, model=weights, jobs=1)
    assert [data.scenes for data in card.read(model_path(out)).datasets.values()] == [7]


@pytest.mark.parametrize("true", [0.003, 0.02])
def test_the_scatter_of_fronts_is_stated_if_the_runs_show_it(true: float) -> None:
    """Fronts that bend by a tenth of the extent over two unknowns; with eight runs, the bend would count as scatter."""
    problem, rng = problem_of(2, *NAMES), np.random.default_rng(0)
    points = qmc.Sobol(2, rng=rng).random(64)
    fronts = 1.0 + points @ [0.3, -0.2] + 0.4 * (points[:, 0] - 0.5) ** 2 + true * rng.normal(size=64)
    flows = [flow_of(problem.scene, np.linspace([[0.0, 0.0]], [[x, 0.0]], 999, axis=1)) for x in fronts]
    runs = list(zip(problem.box.at(points), flows, strict=True))
    assert scatter(runs[:8], problem) == ""
    stated = re.fullmatch(r", whose fronts scatter by ([\d.]+) %", scatter(runs, problem))
    assert stated is not None
    assert float(stated[1]) == pytest.approx(100.0 * true, rel=0.3)


@pytest.mark.slow
def test_the_same_call_again_makes_what_is_missing(adapted: Path, weights: Path) -> None:
    before = model_path(adapted).read_bytes()
    lost = next((adapted / DATA / "train").glob("*.npz"))
    there = lost.read_bytes()
    lost.unlink()
    adapt(problem_of(2, *NAMES), adapted, runs=7, minutes=0.01, model=weights, jobs=2)
    assert lost.read_bytes() == there
    assert model_path(adapted).read_bytes() == before


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["slope-friction", "--runs", "5"], "unknowns: expected numbers, a surrogate knows no fields"),
        (["friction-tall-42", "--runs", "5"], "--runs: expected at least 7 runs"),
        (["friction-tall-42", "--seed", "-1"], "--seed: expected an integer from 0 to 2^62, got -1"),
        (["friction-tall-42", "--jobs", "0"], "--jobs: expected at least 1 job"),
        (["friction-tall-42", "--minutes", "0"], "minutes: expected a positive number"),
    ],
)
def test_wrong_input_ends_in_a_line(
    arguments: list[str], expected: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert expected in refused_by(capsys, main, *arguments, "--out", tmp_path / "run")
    assert not (tmp_path / "run").exists()
