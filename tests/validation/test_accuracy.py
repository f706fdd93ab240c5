"""Errors against a reference, the Pareto front, and the study end to end on a scene of a second's work."""

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest

from datasets.command_line import run
from datasets.library import read_scene
from datasets.scene import Scene
from datasets.strict import from_mapping, read_toml
from datasets.trajectory import Trajectory
from mpm.resolution import Measurements, Resolution, at, particle_steps, resolved
from validation import accuracy, accuracy_report, bodies, deposits, pareto, studies
from validation.bodies import Trial
from validation.deposits import Run, Way
from validation.scores import equal_shares, score, truth
from validation.studies import Study

COLUMN = dataclasses.replace(read_scene("column-short-21"), duration=0.1)


def deposit(scene: Scene, length: float, *, shift: float = 0.0, seconds: float = 1.0) -> Trajectory:
    """A layer of even height from x = `shift` to `shift` + `length` [m]."""
    x = shift + length * (np.arange(1000) + 0.5) / 1000
    positions = np.stack([x, np.full(1000, 0.05)], axis=1)[None].astype(np.float32)
    return Trajectory(
        positions=positions,
        time=np.array([scene.duration]),
        velocity0=np.zeros((1000, 2), np.float32),
        friction=np.zeros(1000, np.float32),
        scene=scene,
        summary={"wall_s": seconds, "steps": 7, "particles": 1000},
    )


def test_the_front_is_what_nothing_cheaper_beats() -> None:
    choices = [(1.0, 9.0), (2.0, 9.0), (3.0, 4.0), (4.0, 5.0), (5.0, 4.0), (6.0, 1.0), (1.0, 10.0)]
    worth = pareto.front(choices, lambda each: each[0], lambda each: each[1])
    assert worth == [(1.0, 9.0), (3.0, 4.0), (6.0, 1.0)]


def test_equal_shares_of_an_even_layer_lie_evenly() -> None:
    shares = equal_shares(COLUMN, deposit(COLUMN, 0.8))
    assert shares == pytest.approx(0.8 * (np.arange(20) + 0.5) / 20, abs=1e-3)


def test_a_deposit_that_is_further_by_a_hundredth_is_off_by_it() -> None:
    reference = truth([deposit(COLUMN, 0.6)])
    assert reference.reach == pytest.approx(0.6 * 0.995, abs=1e-3)
    assert math.isnan(reference.scatter)
    found = score([deposit(COLUMN, 0.6, shift=0.01, seconds=3.0)], reference)
    assert found.bias == pytest.approx(0.01 / reference.reach, rel=1e-3)
    assert found.front_error == pytest.approx(found.bias)
    assert found.profile_error == pytest.approx(0.01 / reference.reach, rel=0.05)
    assert (found.seconds, found.particle_steps) == (3.0, 7000)


def test_scatter_counts_as_error_but_not_as_bias() -> None:
    reference = truth([deposit(COLUMN, 0.6)])
    found = score([deposit(COLUMN, 0.6, shift=shift) for shift in (-0.01, 0.01)], reference)
    assert found.bias == pytest.approx(0.0, abs=1e-5)
    assert found.front_error == pytest.approx(0.01 / reference.reach, rel=1e-3)
    assert found.scatter == pytest.approx(math.sqrt(2.0) * found.front_error, rel=1e-3)


def test_a_profile_can_be_off_where_the_front_is_not() -> None:
    reference = truth([deposit(COLUMN, 0.6)])
    bent = deposit(COLUMN, 0.6)
    bent.positions[0, :900, 0] *= 0.9
    found = score([bent], reference)
    assert found.front_error == pytest.approx(0.0, abs=1e-6)
    assert found.error == found.profile_error > 0.02


def test_the_reference_is_a_quarter_of_the_scenes_own_cell() -> None:
    for study in studies.STUDIES:
        for name in study.names:
            scene = read_scene(name)
            finest = studies.references(scene, study.reference, studies.OWN_STEP, 1)[0].scene
            assert finest.domain.cell == pytest.approx(scene.domain.cell / 4.0)
            assert finest.step_fraction == scene.step_fraction == studies.OWN_STEP
            assert finest.particles_per_axis == scene.particles_per_axis == studies.OWN_POINTS
            assert finest.duration == scene.duration


def test_nothing_that_is_tried_is_dearer_than_allowed() -> None:
    study = studies.STUDIES[1]
    scene = read_scene(study.names[0])
    tried = list(study.tried(scene))
    most = study.dearest * particle_steps(at(scene, studies.own(study.reference, "f64")))
    assert max(particle_steps(at(scene, each)) for each in tried) <= most
    assert len(tried) == len(set(tried)) > 30
    # Each fits the box without becoming another.
    assert len({at(scene, each).domain.cell for each in tried}) == len(study.cells)


def test_a_run_that_is_kept_is_not_run_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    small = dataclasses.replace(at(COLUMN, studies.own(5.0, "f32")), duration=0.01)
    runs = [Run(scene=dataclasses.replace(small, seed=seed), precision="f32", way=Way.TOGETHER) for seed in range(3)]
    deposits.compute(runs, tmp_path)
    first = deposits.read_all(runs, tmp_path)
    assert [flow.scene.seed for flow in first] == [0, 1, 2]
    assert all(flow.positions.shape[0] == 1 and flow.time[-1] == 0.01 for flow in first)
    monkeypatch.setattr(deposits, "simulate_many", lambda *_, **__: pytest.fail("ran again"))
    deposits.compute(runs, tmp_path)
    # A timed run is another one: what ran beside others has no time of its own.
    assert dataclasses.replace(runs[0], way=Way.ALONE).path(tmp_path) != runs[0].path(tmp_path)
    assert dataclasses.replace(runs[0], way=Way.WIDE).path(tmp_path) == runs[0].path(tmp_path)


def test_errors_that_follow_the_cells_across_a_length_do_not_scatter_about_it() -> None:
    trials = tuple(
        Trial(
            name="",
            scene=at(scene, studies.own(cells, "f32")),
            cells=cells,
            error=scene.masses[0].size[1] ** -2 / cells,
            bias=0.0,
            scatter=0.0,
        )
        for scene in bodies.bodies().values()
        for cells in (5.0, 10.0)
    )
    lengths = {name: bodies.spread(name, of, trials) for name, of in bodies.LENGTHS.items()}
    errors = np.array([trial.scene.domain.cell / (0.05 * trial.scene.masses[0].size[0]) for trial in trials])
    exact = bodies.spread(
        "length",
        bodies.LENGTHS["length"],
        tuple(dataclasses.replace(trial, error=float(error)) for trial, error in zip(trials, errors, strict=True)),
    )
    assert exact.exponent == pytest.approx(-1.0)
    assert exact.factor == pytest.approx(1.0)
    assert min(spread.factor for spread in lengths.values()) > 1.1


def test_the_command_end_to_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    tiny = Study(
        title="A tenth of a second",
        dimension=2,
        names=("column-short-21", "column-tall-42"),
        cells=(2.5, 5.0),
        reference=10.0,
        seeds=2,
        steps=True,
        dearest=0.5,
        remark="A remark.",
    )
    monkeypatch.setattr(studies, "STUDIES", (tiny,))
    monkeypatch.setattr(studies, "read_scene", lambda name: dataclasses.replace(read_scene(name), duration=0.1))
    monkeypatch.setattr(bodies, "compare", lambda folder: [])
    arguments = ["mpm", "--out", str(tmp_path), "--keep", str(tmp_path / "keep"), "--seeds", "2"]
    assert run(accuracy.command, "test", arguments) == 0
    text = (tmp_path / "accuracy.md").read_text()
    assert "column-tall-42" in text
    assert "A tenth of a second" in text
    assert (tmp_path / "accuracy.png").stat().st_size > 10_000
    assert (tmp_path / "accuracy-scenes.png").exists()
    found = from_mapping(Measurements, read_toml(tmp_path / "resolution.toml")).measured
    assert Resolution(cells=5.0, particles_per_axis=2, step_fraction=0.9, precision="f64") in [
        each.resolution for each in found
    ]
    assert min(each.resolution.particles_per_axis for each in found) == studies.FEWEST_POINTS
    # Coarser is worse, and the file is what a tolerance reads.
    errors = {
        each.resolution.cells: each.error
        for each in found
        if each.resolution == studies.own(each.resolution.cells, "f32")
    }
    assert errors[2.5] > errors[5.0] > 0.0
    picked = resolved(read_scene("column-short-21"), 1.05 * min(errors.values()), found)
    assert picked.error <= 1.05 * min(errors.values())


def test_signs_and_per_cents() -> None:
    assert accuracy_report.signed(-0.0213) == "-2.1 %"
    assert accuracy_report.percent(0.0213) == "2.1 %"
