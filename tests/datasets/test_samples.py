"""Trajectories at a model's step, and stretches cut from them."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from datasets.errors import InputError
from datasets.samples import Flow, cut, load_flows, mirrored
from datasets.trajectory import Trajectory


@pytest.fixture
def flow(trajectory: Trajectory) -> Flow:
    """Five points that move by 1 mm a step in x, then rest."""
    steps = np.minimum(np.arange(10), 6)[:, None, None] * np.array([1e-3, 0.0])
    positions = (np.linspace(0.0, 0.04, 5)[:, None] * np.array([1.0, 0.0]) + steps).astype(np.float32)
    time = np.arange(10) * 0.0025
    return Flow.of(dataclasses.replace(trajectory, positions=positions, time=time), 0.0025, "a")


def test_a_flow_takes_every_so_many_frames(trajectory: Trajectory) -> None:
    flow = Flow.of(trajectory, 0.005, "a")
    assert np.array_equal(flow.positions, trajectory.positions[[0, 2]])
    for step in (0.004, 0.001):
        with pytest.raises(InputError, match=r"a: expected frames 0\.00"):
            Flow.of(trajectory, step, "a")


def test_moving_times_are_those_before_it_rests(flow: Flow) -> None:
    assert flow.moving().tolist() == [0, 1, 2, 3, 4, 5]


@pytest.mark.parametrize(("now", "given"), [(0, [0]), (2, [0, 1, 2]), (6, [3, 4, 5, 6])])
def test_a_cut_gives_the_past_that_there_is(flow: Flow, now: int, given: list[int]) -> None:
    sample = cut(flow, now=now, steps=3, history=3, cell=0.01, kept=4, rng=np.random.default_rng(0))
    assert np.array_equal(sample.frames, flow.positions[given])
    assert np.array_equal(sample.targets, flow.positions[now + 1 : now + 4])
    assert sample.volume.sum() == pytest.approx(5 * flow.volume)


def test_mirroring_twice_changes_nothing_and_once_turns_x_around(flow: Flow) -> None:
    sample = cut(flow, now=4, steps=3, history=3, cell=0.01, kept=4, rng=np.random.default_rng(0))
    once = mirrored(sample, 0.2)
    np.testing.assert_allclose(once.frames[..., 0], 0.2 - sample.frames[..., 0], atol=1e-7)
    np.testing.assert_allclose(once.velocity0, sample.velocity0 * [-1.0, 1.0])
    np.testing.assert_allclose(mirrored(once, 0.2).targets, sample.targets, atol=1e-7)


def test_a_split_is_loaded_in_order(trajectory: Trajectory, tmp_path: Path) -> None:
    for name in ("b", "a"):
        trajectory.save(tmp_path / "valid" / f"{name}.npz")
    flows = load_flows(tmp_path, "valid", step=0.0025, dimension=2)
    assert [Path(flow.name).stem for flow in flows] == ["a", "b"]
    with pytest.raises(InputError, match="expected trajectories in train"):
        load_flows(tmp_path, "train", step=0.0025, dimension=2)
    with pytest.raises(InputError, match="expected a 3D trajectory"):
        load_flows(tmp_path, "valid", step=0.0025, dimension=3)
