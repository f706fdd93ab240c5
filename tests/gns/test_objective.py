"""The loss, the schedule and the samples that are drawn."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import torch

from datasets.samples import Flow, load_flows
from gns.objective import Curriculum, rollout_loss, statistics, unrolled_steps
from gns.settings import ModelSettings


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


@pytest.fixture
def flows(dataset: Path, settings: ModelSettings) -> list[Flow]:
    """The training flows."""
    return load_flows(dataset, "train", step=settings.step, dimension=2)


def test_samples_are_stretches_of_the_flows(flows: list[Flow], settings: ModelSettings) -> None:
    curriculum = Curriculum([flows], settings)
    rng = np.random.default_rng(0)
    drawn = [curriculum.draw(4, rng) for _ in range(60)]
    assert {len(sample.frames) for sample in drawn} == {1, 2, 3, 4}
    assert all(len(sample.targets) == 4 for sample in drawn)
    # The columns lean on the left wall; mirrored ones on the right.
    sides = {bool(sample.frames[-1, :, 0].mean() > 0.3) for sample in drawn}
    assert sides == {False, True}
    for sample in drawn:
        assert sample.volume.sum() == pytest.approx(0.12 * 0.16, rel=1e-5)


def test_statistics_leave_gravity_out(flows: list[Flow]) -> None:
    time = np.arange(8) * 0.01
    falling = np.zeros((8, 5, 2), np.float32)
    falling[..., 0] = 0.1 * np.arange(5)
    falling[..., 1] = 0.9 - 0.5 * 9.81 * time[:, None] ** 2
    flow = dataclasses.replace(
        flows[0], positions=falling, friction=np.ones(5, np.float32), velocity0=np.zeros((5, 2), np.float32)
    )
    found = statistics([flow])
    assert found.acceleration < 1e-6
    assert found.friction_mean == pytest.approx(1.0)
    assert found.friction_std == 1.0
