"""Errors against a reference, bounds on further scenes, and the page on made-up figures."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from datasets import Scene, Trajectory, read_scene
from mpm.resolution import COVERAGE, characteristic_length, read_measured, resolved, with_resolution
from tests.scenes import flow_of
from validation.bench.accuracy import bench
from validation.bench.accuracy.bench import Error, Errors, own, prediction_limit
from validation.bench.accuracy.flows import read_flows
from validation.run_store import RunStore

COLUMN = replace(read_scene("column-short-21"), duration=0.1)


def deposit(scene: Scene, length: float, *, shift: float = 0.0) -> Trajectory:
    """A layer of even height from x = `shift` to `shift` + `length` [m]."""
    x = shift + length * (np.arange(1000) + 0.5) / 1000
    return flow_of(scene, np.stack([x, np.full(1000, 0.05)], axis=1)[None])


def test_errors_are_of_fronts_and_profiles_over_the_extent() -> None:
    exact = deposit(COLUMN, 0.6)
    assert bench.error(deposit(COLUMN, 0.6, shift=0.01), exact) == pytest.approx(0.01 / (0.6 * 0.995), rel=0.01)
    # A profile can be off where the front is not.
    bent = deposit(COLUMN, 0.6)
    bent.positions[0, :900, 0] *= 0.9
    assert bench.error(bent, exact) > 0.02


@pytest.mark.parametrize("dimension", [2, 3])
def test_a_tolerance_is_tried_on_other_scenes_than_the_measured(dimension: int) -> None:
    seen, unseen = (read_flows(dimension, unseen=is_unseen) for is_unseen in (False, True))
    assert not set(seen) & set(unseen)
    assert not set(seen.values()) & set(unseen.values())
    for scene in (*seen.values(), *unseen.values()):
        assert scene.dimension == dimension
        # Every whole number of cells fits the box.
        for cells in (4.0, 7.0, 80.0):
            finer = with_resolution(scene, own(cells))
            assert characteristic_length(scene) / finer.domain.cell == pytest.approx(cells)


def test_one_more_scene_is_within_the_bound_as_often_as_stated() -> None:
    chance = np.random.default_rng(5)
    drawn = np.abs(0.05 + 0.02 * chance.normal(size=(2000, 10)))
    within = [float(errors[-1]) <= prediction_limit(errors[:-1].tolist()) for errors in drawn]
    assert COVERAGE - 0.02 < np.mean(within) < COVERAGE + 0.06
    assert prediction_limit([0.01] * 9 + [0.5]) >= 0.5
    assert prediction_limit([0.03]) == 0.03


def found(errors: dict[float, Sequence[float]]) -> Errors:
    """Made-up errors by cells, one per scene."""

    def of_scene(cells: float, value: float) -> Error:
        return Error(errors=(value,), thickness=(2.0 * value,), seconds=cells / 10.0, particle_steps=cells**3)

    return {
        own(cells): {f"scene {number}": of_scene(cells, value) for number, value in enumerate(values)}
        for cells, values in errors.items()
    }


def test_an_error_that_grows_again_on_finer_grids_counts_on_the_coarse_one() -> None:
    errors = found({5.0: (0.01, 0.1), 10.0: (0.06, 0.03), 20.0: (0.02, 0.01)})
    assert bench.bound(errors, own(5.0)) == prediction_limit([0.06, 0.1])
    assert bench.bound(errors, own(20.0)) == prediction_limit([0.02, 0.01])
    measurements = bench.measured(2, errors)
    assert measurements[0].promised > measurements[2].promised >= 0.02
    # Another step is compared with itself alone.
    other = {**errors, own(20.0, step_fraction=0.4): errors[own(5.0)]}
    assert bench.bound(other, own(20.0)) == bench.bound(errors, own(20.0))


def test_what_is_measured_is_what_a_tolerance_reads(tmp_path: Path) -> None:
    square = read_flows(2, unseen=False)["square, 20°"]
    scenes = {"square": replace(square, duration=4 * square.frame_dt)}
    tried = [own(2.0), own(5.0)]
    measurements = bench.measured(2, bench.errors_of(scenes, tried, 10.0, (0, 1), RunStore(tmp_path / "keep")))
    path = tmp_path / "resolution.toml"
    path.write_text(bench.toml(measurements))
    assert read_measured(path) == tuple(measurements)
    assert [measurement.resolution for measurement in measurements] == tried
    assert measurements[0].promised >= measurements[1].promised > 0.0
    assert 0.0 < measurements[1].thickness < 0.5
    assert "of its largest" in str(resolved(COLUMN, 1.05 * measurements[1].promised, measurements))
    assert resolved(COLUMN, 1.05 * measurements[1].promised, measurements).cells == pytest.approx(5.0)
