"""The loss, the schedule and the samples that are drawn."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import torch

from datasets.training.samples import Flows, Sample, Surroundings, load_flows, shares_of
from gns.model.settings import ModelSettings
from gns.training.objective import (
    Curriculum,
    partners,
    remaining_steps,
    rollout_loss,
    share_loss,
    statistics,
    turned,
    unrolled_steps,
)


def test_the_loss_measures_positions_and_displacements() -> None:
    targets = torch.zeros(2, 1, 1)
    positions = torch.tensor([0.0, 1.0, 3.0]).view(3, 1, 1)
    # Errors over s = 2: positions 0.5 and 1.5 / 2 = 0.75, displacements 0.5 and 1.
    expected = (0.125 + 0.28125) / 2 + (0.125 + 0.5) / 2
    assert rollout_loss(positions, targets, 2.0).item() == pytest.approx(expected)


def test_the_entries_of_the_schedule_share_the_time() -> None:
    assert [unrolled_steps((1, 2, 2, 8), progress) for progress in (0.0, 0.24, 0.26, 0.7, 0.8, 1.0)] == [
        1, 1, 2, 2, 8, 8,
    ]  # fmt: skip


def test_the_steps_left_are_the_area_under_the_schedule() -> None:
    schedule = (1, 2, 2, 8)
    assert remaining_steps(schedule, 0.0) == pytest.approx(13 / 4)
    assert remaining_steps(schedule, 0.625) == pytest.approx(0.125 * 2 + 0.25 * 8)
    assert remaining_steps(schedule, 1.0) == 0.0


@pytest.fixture
def flows(dataset: Path, settings: ModelSettings) -> Flows:
    """The training flows."""
    return load_flows(dataset, "train", step=settings.step, dimension=2, spacing=settings.cell)


def test_samples_are_stretches_of_the_flows(flows: Flows, settings: ModelSettings) -> None:
    curriculum = Curriculum([flows], settings)
    rng = np.random.default_rng(0)
    drawn = curriculum.samples(60, 4, rng)
    assert {len(sample.frames) for sample in drawn} == {1, 2, 3, 4}
    assert all(len(sample.targets) == 4 for sample in drawn)
    # The columns lean on the left wall; mirrored ones on the right.
    mirrored = {bool(sample.frames[-1, :, 0].mean() > 0.3) for sample in drawn}
    assert mirrored == {False, True}
    for sample in drawn:
        assert sample.volume.sum() == pytest.approx(0.12 * 0.16, rel=1e-5)


def test_a_batch_joins_domains_and_datasets_have_equal_shares(flows: Flows, settings: ModelSettings) -> None:
    around = dataclasses.replace(flows[0].surroundings, size=np.array([1.2, 0.4], np.float32))
    wide = [dataclasses.replace(flow, surroundings=around) for flow in flows]
    curriculum, rng = Curriculum([flows, wide, wide], settings), np.random.default_rng(0)
    sizes = torch.cat([curriculum.batch(2, 1, rng).box for _ in range(60)])
    assert {tuple(size) for size in sizes.tolist()} == {
        tuple(size) for size in torch.tensor([[0.6, 0.4], [1.2, 0.4]]).tolist()
    }
    assert 0.5 < (sizes[:, 0] > 1.0).float().mean() < 0.8


@pytest.mark.parametrize("along", [0.0, 3.0])
def test_statistics_leave_gravity_out(flows: Flows, along: float) -> None:
    gravity = np.array([along, -9.81], np.float32)
    time = np.arange(8) * 0.01
    corner = np.stack((0.1 * np.arange(5), np.full(5, 0.9)), axis=1)
    falling = (corner + 0.5 * time[:, None, None] ** 2 * gravity).astype(np.float32)
    flow = dataclasses.replace(
        flows[0],
        positions=falling,
        friction=np.ones(5, np.float32),
        velocity0=np.zeros((5, 2), np.float32),
        surroundings=dataclasses.replace(flows[0].surroundings, gravity=gravity),
    )
    found = statistics([[flow]])
    assert found.acceleration < 1e-6
    assert found.friction_mean == pytest.approx(1.0)
    assert found.friction_std == 1.0


def test_statistics_of_many_times_are_sampled_and_always_the_same(
    flows: Flows, monkeypatch: pytest.MonkeyPatch
) -> None:
    exact = statistics([flows])
    monkeypatch.setattr("gns.training.objective.SAMPLED_TIMES", 32)
    sampled = statistics([flows])
    assert sampled == statistics([flows])
    assert sampled != exact
    assert sampled.displacement == pytest.approx(exact.displacement, rel=0.3)
    assert sampled.friction_std == exact.friction_std


def test_samples_that_should_move_do(flows: Flows, settings: ModelSettings, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("gns.training.objective.SHARE_EARLY", 0.0)
    monkeypatch.setattr("gns.training.objective.SHARE_MOVING", 1.0)
    flow = flows[0]
    resting = np.concatenate((flow.positions, np.repeat(flow.positions[-1:], 20, axis=0)))
    longer = dataclasses.replace(flow, positions=resting)
    curriculum, rng = Curriculum([[longer]], settings, first=0.0), np.random.default_rng(0)
    drawn = curriculum.samples(30, 1, rng)
    assert all(np.abs(sample.targets[0] - sample.frames[-1]).max() > 1e-4 for sample in drawn)


@pytest.mark.parametrize(("size", "ways"), [((0.6, 0.4), 2), ((0.6, 0.4, 0.6), 8), ((0.6, 0.4, 0.5), 8)])
def test_samples_come_in_every_symmetry_of_their_box(size: tuple[float, ...], ways: int) -> None:
    rng = np.random.default_rng(0)
    corner = np.array([0.1, 0.2, 0.15], np.float32)[: len(size)]
    one = np.ones(1, np.float32)
    around = Surroundings(
        size=np.array(size, np.float32),
        gravity=np.array([3.0, -9.0, 0.0], np.float32)[: len(size)],
        floor_friction=0.4,
        wall_friction=0.2,
        damping=0.0,
        baffles=np.stack((corner, corner + 0.1))[None],
        baffle_friction=one,
        baffle_turn=np.zeros(1, np.float32),
        ground=None,
    )
    sample = Sample(
        frames=corner.reshape(1, 1, -1),
        velocity0=corner.reshape(1, -1),
        targets=corner.reshape(1, 1, -1),
        shares=corner.reshape(1, 1, -1),
        friction=one,
        cohesion=one,
        volume=one,
        surroundings=around,
    )
    found = set()
    for _ in range(100):
        other = turned(sample, 0.01, rng)
        found.add(tuple(np.round(other.targets[0, 0].astype(float), 5)))
        baffles = other.surroundings.baffles
        assert (baffles[:, 0] < baffles[:, 1]).all()
        # The point is a corner of the baffle, and stays one.
        assert np.isclose(baffles[0], other.targets[0, 0], atol=1e-6).any(axis=0).all()
        # Gravity turns with the velocities.
        assert float(other.velocity0[0] @ other.surroundings.gravity) == pytest.approx(0.1 * 3.0 - 0.2 * 9.0)
    assert len(found) == ways


def test_share_loss_is_zero_where_the_distributions_agree_and_separates_common_errors_from_wrong_answers() -> None:
    generator = torch.Generator().manual_seed(0)
    positions = torch.rand((3, 20, 2), generator=generator)
    batch = torch.arange(2).repeat_interleave(10)
    shares = torch.cat([positions[:, batch == each].sort(dim=1).values for each in (0, 1)], dim=1)
    apart, changed = share_loss(positions, shares, batch, 2, 0.01)
    assert apart == changed == 0.0
    # Another particle in each place is the same deposit.
    apart, _ = share_loss(positions[:, torch.arange(10).flip(0).repeat(2) + 10 * batch], shares, batch, 2, 0.01)
    assert apart == 0.0
    # An error that both have is no wrong answer to what differs between them.
    apart, changed = share_loss(positions + 0.005, shares, batch, 2, 0.01)
    assert apart == pytest.approx(0.125, rel=1e-4)
    assert changed == pytest.approx(0.0, abs=1e-6)


def test_pairs_are_of_variants_and_start_from_the_same_particles(flows: Flows, settings: ModelSettings) -> None:
    varied = [
        dataclasses.replace(flow, seed=number // 2, positions=flows[number // 2 * 2].positions)
        for number, flow in enumerate(flows)
    ]
    assert partners(varied) == {0: 1, 1: 0, 2: 3, 3: 2}
    curriculum = Curriculum([varied], settings, pairs=1.0)
    samples = curriculum.samples(8, 3, np.random.default_rng(0))
    for first, second in zip(samples[::2], samples[1::2], strict=True):
        assert np.array_equal(first.frames, second.frames)
        assert first.friction[0] != second.friction[0]


def test_shares_are_the_middles_of_equal_parts_of_all_particles() -> None:
    positions = np.random.default_rng(0).permutation(40).reshape(1, 40, 1).astype(np.float32)
    assert shares_of(positions, 40)[0, :, 0] == pytest.approx(np.arange(40))
    assert shares_of(positions, 4)[0, :, 0] == pytest.approx([4.5, 14.5, 24.5, 34.5])
