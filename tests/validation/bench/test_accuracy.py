"""Errors against a reference, bounds on further scenes, and the pages on a study of a second's work."""

import dataclasses
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from datasets.library import read_scene
from datasets.records import from_mapping, read_toml
from datasets.scene import Scene
from datasets.trajectory import Trajectory
from mpm.resolution import COVERAGE, Measurements, characteristic_length, resolved, with_resolution
from validation.bench.accuracy import bench as accuracy
from validation.bench.accuracy import flows, studies
from validation.bench.accuracy.flows import Flow
from validation.bench.accuracy.scores import Outcome, Score, equal_shares, reference, score
from validation.bench.accuracy.studies import Findings, Study, prediction_limit

COLUMN = dataclasses.replace(read_scene("column-short-21"), duration=0.1)


def deposit(scene: Scene, length: float, *, shift: float = 0.0) -> Trajectory:
    """A layer of even height from x = `shift` to `shift` + `length` [m]."""
    x = shift + length * (np.arange(1000) + 0.5) / 1000
    positions = np.stack([x, np.full(1000, 0.05)], axis=1)[None].astype(np.float32)
    return Trajectory(
        positions=positions,
        time=np.array([scene.duration]),
        velocity0=np.zeros((1000, 2), np.float32),
        friction=np.zeros(1000, np.float32),
        scene=scene,
        summary={"steps": 7, "particles": 1000},
    )


def test_equal_shares_of_an_even_layer_lie_evenly() -> None:
    shares = equal_shares(deposit(COLUMN, 0.8))
    assert shares == pytest.approx(0.8 * (np.arange(20) + 0.5) / 20, abs=1e-3)


def test_errors_are_of_fronts_and_profiles_over_the_extent() -> None:
    exact = reference(deposit(COLUMN, 0.6))
    assert exact.extent == pytest.approx(0.6 * 0.995, abs=1e-3)
    further = score([deposit(COLUMN, 0.6, shift=0.01)], exact)
    assert further.bias == pytest.approx(0.01 / exact.extent, rel=1e-3)
    assert further.errors == pytest.approx((further.bias,), rel=0.05)
    assert further.particle_steps == 7000
    # Scatter is an error, but no bias.
    both = score([deposit(COLUMN, 0.6, shift=shift) for shift in (-0.01, 0.01)], exact)
    assert both.bias == pytest.approx(0.0, abs=1e-5)
    assert both.error == pytest.approx(0.01 / exact.extent, rel=1e-2)
    assert both.largest == pytest.approx(both.error, rel=2e-2)
    assert both.scatter == pytest.approx(math.sqrt(2.0) * 0.01 / exact.extent, rel=1e-3)
    # A profile can be off where the front is not.
    bent = deposit(COLUMN, 0.6)
    bent.positions[0, :900, 0] *= 0.9
    assert score([bent], exact).bias == pytest.approx(0.0, abs=1e-6)
    assert score([bent], exact).error > 0.02


SCENES = [flow.scene() for group in (flows.MEASURED, flows.UNSEEN) for kind in group.values() for flow in kind.values()]


@pytest.mark.parametrize("cells", [4.0, 7.0, 14.0, 80.0])
def test_every_whole_number_of_cells_fits_the_box_of_a_flow(cells: float) -> None:
    for scene in SCENES:
        finer = with_resolution(scene, studies.own(cells))
        assert characteristic_length(scene) / finer.domain.cell == pytest.approx(cells)


@pytest.mark.parametrize("dimension", [2, 3])
def test_a_tolerance_is_tried_on_other_scenes_than_the_measured(dimension: int) -> None:
    measured, unseen = flows.MEASURED[dimension], flows.UNSEEN[dimension]
    assert not set(measured) & set(unseen)
    assert not set(measured.values()) & set(unseen.values())
    assert len(unseen) == {2: 14, 3: 6}[dimension]


def test_a_flow_of_another_size_is_the_same_in_numbers_without_units() -> None:
    flow = Flow(aspect=2.0, friction_deg=30.0, cohesion=0.02, velocity=0.5)
    small, large = flow.scene(), dataclasses.replace(flow, smallest=1.0).scene()
    assert large.masses[0].size == pytest.approx([10.0 * side for side in small.masses[0].size])
    assert large.duration == pytest.approx(math.sqrt(10.0) * small.duration)
    assert large.material.young == pytest.approx(10.0 * small.material.young)
    assert large.material.cohesion == pytest.approx(10.0 * small.material.cohesion)
    assert small.masses[0].velocity is not None
    assert large.masses[0].velocity is not None
    assert large.masses[0].velocity[0] == pytest.approx(math.sqrt(10.0) * small.masses[0].velocity[0])


def test_one_more_scene_is_within_the_bound_as_often_as_stated() -> None:
    chance = np.random.default_rng(5)
    drawn = np.abs(0.05 + 0.02 * chance.normal(size=(2000, 10)))
    within = [float(errors[-1]) <= prediction_limit(errors[:-1].tolist()) for errors in drawn]
    assert COVERAGE - 0.01 < np.mean(within) < COVERAGE + 0.05
    assert prediction_limit([0.01] * 9 + [0.5]) >= 0.5
    assert prediction_limit([0.03]) == 0.03


def findings(errors: dict[float, Sequence[float]]) -> Findings:
    """Made-up errors by cells, one per scene."""
    names = ("a", "b")
    study = Study(
        dimension=2, scenes=dict.fromkeys(names, COLUMN), cells=tuple(errors), checked=(), reference=80.0, seeds=1
    )
    return Findings(
        study=study,
        references={},
        outcomes=[
            Outcome(
                resolution=studies.own(cells),
                scores={
                    name: Score(bias=0.0, scatter=0.0, errors=(value,), particle_steps=cells**3)
                    for name, value in zip(names, values, strict=True)
                },
            )
            for cells, values in errors.items()
        ],
    )


def test_an_error_that_grows_again_on_finer_grids_counts_on_the_coarse_one() -> None:
    found = findings({5.0: (0.01, 0.1), 10.0: (0.06, 0.03), 20.0: (0.02, 0.01)})
    assert found.lasting(studies.own(5.0)) == {"a": 0.06, "b": 0.1}
    assert found.lasting(studies.own(20.0)) == {"a": 0.02, "b": 0.01}
    promised = [each.promised for each in studies.measured([found])]
    assert promised[0] > promised[2] >= 0.02


def test_the_error_of_the_reference_if_errors_are_in_proportion_to_the_cell() -> None:
    found = findings({20.0: (0.1, 0.1), 40.0: (0.1, 0.1)})
    for outcome in found.outcomes:
        bias = 0.8 * (1.0 / 80.0 - 1.0 / outcome.resolution.cells)
        for name, each in outcome.scores.items():
            outcome.scores[name] = dataclasses.replace(each, bias=bias)  # type: ignore[index]
    assert found.reference_error() == pytest.approx(0.8 / 80.0)


def test_only_resolutions_that_differ_in_nothing_but_the_cells_are_compared() -> None:
    for study in (*studies.full(), *studies.quick()):
        tried = list(study.tried())
        assert len(tried) == len(set(tried)) == len(study.cells) + 2 * len(study.checked)
        assert max(study.cells) < study.reference
        assert set(study.checked) <= set(study.cells)


def test_the_page_of_a_tiny_study(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    names = ("square, 20°", "high, 30°")
    tiny = Study(
        dimension=2,
        scenes={name: flows.shortened(flows.MEASURED[2][name], 0.2).scene() for name in names},
        cells=(2.0, 5.0),
        checked=(2.0,),
        reference=10.0,
        seeds=2,
    )
    monkeypatch.setattr(studies, "full", lambda: (tiny,))
    keep = tmp_path / "keep"
    assert accuracy.bench(tmp_path, quick=False, keep=keep).startswith("- **2D**")
    assert "high, 30°" in (tmp_path / "accuracy.md").read_text()
    assert (tmp_path / "accuracy.png").stat().st_size > 10_000
    assert (tmp_path / "accuracy-scenes.png").exists()
    found = from_mapping(Measurements, read_toml(tmp_path / "resolution.toml")).measured
    assert [each.resolution for each in found] == list(tiny.tried())
    # The bound of a coarser grid is larger, and the file is what a tolerance reads.
    bounds = {each.resolution: each.promised for each in found}
    assert bounds[studies.own(2.0)] > bounds[studies.own(5.0)] > 0.0
    selected = resolved(read_scene("column-short-21"), 1.05 * bounds[studies.own(5.0)], found)
    assert selected.cells == pytest.approx(5.0)
