"""Held-out scenes, their references, and the errors of a surrogate beside them, on flows with a formula."""

import dataclasses
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from datasets.definitions.definition import Definition, Split, Storage
from datasets.errors import InputError
from datasets.scene import Baffle, Mass, Scene
from datasets.trajectory import Trajectory
from mpm.output.request import Recording
from tests.validation.bench.surrogate.flows import BLOCK, sliding
from validation.bench.surrogate import accuracy, bench, held_out
from validation.bench.surrogate.held_out import Family, HeldOut, References
from validation.bench.surrogate.records import Records
from validation.bench.surrogate.scores import Deposit, compare
from validation.bench.surrogate.velocities import Slope


def test_held_out_scenes_are_of_every_kind_and_no_variants(tmp_path: Path) -> None:
    def draw(stream: np.random.Generator, index: int) -> Scene:
        return BLOCK.with_friction_deg(float(stream.uniform(20.0, 40.0)))

    # Of six scenes the last three are variants of the first three.
    definition = Definition(
        name="toys",
        size=10,
        connectivity_radius=0.02,
        split=lambda _: Split.TRAIN,
        draw=draw,
        stream=lambda index: index // 6 * 3 + index % 3,
    )
    family = Family(definition=definition, kinds=("a", "b", "a"), storage=Storage(cell=0.01, kept=1), cell=0.01)
    found = held_out.draw(family, 3, tmp_path)
    assert sorted(each.name for each in found) == ["a 1", "a 2", "a 3", "b 1", "b 2", "b 3"]
    angles = [each.scene.material.friction_deg for each in found]
    assert len(set(angles)) == 6
    assert held_out.draw(family, 3, tmp_path) == found
    training = [entry.scene.material.friction_deg for entry in definition.entries(seed=0)]
    assert not set(training) & set(angles)
    with pytest.raises(InputError, match="--scenes"):
        held_out.draw(family, 0, tmp_path)


def test_shipped_scenes_on_the_cells_of_the_references() -> None:
    for dimension, count in ((2, 4), (3, 2)):
        source = held_out.family(dimension)
        assert source is not None
        found = bench.shipped_scenes(source, dimension)
        assert len(found) == count
        assert all(0.8 < each.scene.domain.cell / source.cell <= 1.0 + 1e-9 for each in found)
        assert {each.scene.frame_dt for each in found} == {0.02}
        assert not {each.kind for each in found} & set(source.kinds)


def test_references_are_thinned_and_found_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[Scene] = []

    def simulate(scenes: Sequence[Scene], *, record: Recording, precision: str) -> list[Trajectory]:
        assert record.until_rest
        made.extend(scenes)
        return [dataclasses.replace(sliding(each, 1.0), volume=None, mass=None) for each in scenes]

    monkeypatch.setattr(held_out, "simulate_many", simulate)
    references = References(tmp_path, Storage(cell=0.02, kept=1))
    (flow,) = references([BLOCK])
    (again,) = references([BLOCK])
    # 10 x 10 cells of 4 particles each; one of 16 stays.
    assert made == [BLOCK]
    assert again.positions.shape == flow.positions.shape == (21, 25, 2)
    assert flow.volumes.sum() == pytest.approx(0.01)
    finer, others = accuracy.reference_errors([HeldOut(kind="block", number=1, scene=BLOCK)], references)
    assert made[1].domain.cell == 0.005
    assert made[2].seed != BLOCK.seed
    assert 0.0 <= finer[0].error < 0.1
    assert 0.0 < others[0].error < 0.1


def test_errors_are_zero_for_a_perfect_surrogate_and_exact_for_a_slow_one() -> None:
    truth = sliding(BLOCK, 2.0)
    score = compare(truth, truth, 0.005)
    assert score.deposit == Deposit(front=0.0, transport=0.0)
    assert (score.kinetic, score.potential, score.runout, score.depth) == (0.0, 0.0, 0.0, None)
    assert (score.rightwards, score.at_wall, score.seconds) == (True, False, 0.5)
    # 0.2 s at 0.5 m/s less; kinetic energies v^2 / 2 beside g h / 2 of a block 0.1 m high.
    slow = compare(sliding(BLOCK, 0.5), sliding(BLOCK, 1.0), 0.005)
    assert slow.extent == pytest.approx(0.1, abs=0.004)
    assert slow.deposit.front * slow.extent == pytest.approx(-0.1, rel=1e-4)
    assert slow.deposit.transport * slow.extent == pytest.approx(0.1, rel=1e-4)
    assert slow.runout * slow.extent == pytest.approx(-0.1, abs=0.01)
    assert slow.kinetic == pytest.approx(0.375 / (0.5 + 9.81 * 0.05), rel=0.02)
    assert slow.potential == pytest.approx(0.0, abs=1e-6)
    assert compare(sliding(BLOCK, 1.0, every=3), sliding(BLOCK, 1.0), 0.02).deposit.error < 0.1


def test_the_front_is_the_end_that_moved_and_says_nothing_at_a_wall() -> None:
    left = dataclasses.replace(BLOCK, masses=(Mass(lower=(0.8, 0.0), size=(0.1, 0.1)),))
    score = compare(sliding(left, -1.0), sliding(left, -2.0), 0.005)
    assert not score.rightwards
    assert not score.at_wall
    assert score.deposit.front * score.extent == pytest.approx(-0.2, rel=1e-4)
    stopped = sliding(left, 0.0)
    there = np.minimum(stopped.positions + np.float32([0.1, 0.0]) * stopped.time[:, None, None] / 0.2, 1.0)
    assert compare(stopped, dataclasses.replace(stopped, positions=there.astype(np.float32)), 0.005).at_wall


def test_on_a_slope_the_potential_energy_falls_along_x() -> None:
    slope = dataclasses.replace(BLOCK, slope_deg=30.0)
    score = compare(sliding(slope, 0.0), sliding(slope, 1.0), 0.005)
    # g sin 30 over 0.2 m, beside the energies above the lowest corner: 0.25 m down the slope and 0.05 m above it.
    low = 9.81 * (0.5 * 0.25 + math.cos(math.radians(30.0)) * 0.05)
    assert score.potential == pytest.approx(9.81 * 0.5 * 0.2 / (0.5 + low), rel=0.03)


def test_depths_before_baffles() -> None:
    scene = dataclasses.replace(BLOCK, baffles=(Baffle(lower=(0.4, 0.0), size=(0.1, 0.1)),))
    assert compare(sliding(scene, 1.0), sliding(scene, 1.0), 0.005).depth == 0.0
    never = compare(sliding(scene, 0.0), sliding(scene, 1.0), 0.005).depth
    assert never is not None
    assert 0.1 < never < 1.0
    assert compare(sliding(scene, 0.0), sliding(scene, 0.0), 0.005).depth is None


def test_records_are_found_again_and_broken_ones_named(tmp_path: Path) -> None:
    path = tmp_path / "slopes.json"
    slope = Slope(seconds=1.0, values=(1.0, 2.0))
    assert Records(path, Slope).made("key", lambda: slope) == slope
    assert Records(path, Slope).made("key", lambda: pytest.fail("it is there")) == slope
    path.write_text("{")
    with pytest.raises(InputError, match=r"slopes\.json"):
        Records(path, Slope)
