"""Samples: drawn of the flows in all their symmetries, and side by side what they are alone."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import torch

from datasets.training.samples import Flows, Sample, Surroundings, cut
from gns.samples import Sampler, batched, flows_of, statistics, turned
from gns.settings import ModelSettings, TrainingSettings
from gns.simulator import Simulator


def samples(dataset: Path, settings: ModelSettings, starts: tuple[int, int] = (0, 5)) -> list[Sample]:
    """Two samples, one of them from the very start."""
    flows = flows_of(dataset, "valid", settings)
    rng = np.random.default_rng(0)
    return [
        cut(flow, now=now, steps=2, history=settings.history, cell=settings.cell, kept=1, rng=rng)
        for flow, now in zip(flows, starts, strict=True)
    ]


def after(simulator: Simulator, some: list[Sample]) -> torch.Tensor:
    """Where a step takes the particles of samples side by side [m]."""
    batch = batched(some, simulator.settings)
    with torch.no_grad():
        return simulator(batch.state, batch.conditions).positions


def test_baffles_and_ground_of_one_sample_have_no_effect_on_another(lively: Simulator, dataset: Path) -> None:
    first, second = samples(dataset, lively.settings, starts=(5, 5))
    second = dataclasses.replace(first, friction=second.friction)
    ground = np.linspace(0.05, 0.0, 61, dtype=np.float32), np.full(61, 0.3, np.float32)
    around = dataclasses.replace(
        first.surroundings,
        baffles=np.array([[[0.15, 0.0], [0.2, 0.1]]], np.float32),
        baffle_friction=np.array([0.5], np.float32),
        baffle_turn=np.array([0.4], np.float32),
        ground=ground,
    )
    rough = dataclasses.replace(second, surroundings=around)
    alone = [after(lively, [sample]) for sample in (first, rough)]
    assert (alone[1] - after(lively, [second])).abs().max() > 1e-3
    torch.testing.assert_close(after(lively, [first, rough]), torch.cat(alone), atol=1e-6, rtol=0.0)


@pytest.fixture
def flows(dataset: Path, settings: ModelSettings) -> Flows:
    """The training flows."""
    return flows_of(dataset, "train", settings)


def test_samples_are_stretches_of_the_flows(flows: Flows, settings: ModelSettings) -> None:
    sampler, rng = Sampler([flows], settings, TrainingSettings()), np.random.default_rng(0)
    drawn = [sampler.sample(4, rng) for _ in range(60)]
    assert {len(sample.frames) for sample in drawn} == {1, 2, 3, 4}
    assert all(len(sample.targets) == 4 for sample in drawn)
    # The columns lean on the left wall; mirrored ones on the right.
    mirrored = {bool(sample.frames[-1, :, 0].mean() > 0.3) for sample in drawn}
    assert mirrored == {False, True}
    for sample in drawn:
        assert sample.volume.sum() == pytest.approx(0.12 * 0.16, rel=1e-5)


def test_a_batch_joins_domains_and_datasets_have_their_shares(flows: Flows, settings: ModelSettings) -> None:
    around = dataclasses.replace(flows[0].surroundings, size=np.array([1.2, 0.4], np.float32))
    wide = [dataclasses.replace(flow, surroundings=around) for flow in flows]
    training = TrainingSettings(batch=2, shares=(1.0, 3.0))
    sampler, rng = Sampler([flows, wide], settings, training), np.random.default_rng(0)
    sizes = torch.cat([sampler.batch(1, rng).conditions.size for _ in range(100)])
    assert {tuple(size) for size in sizes.tolist()} == {
        tuple(size) for size in torch.tensor([[0.6, 0.4], [1.2, 0.4]]).tolist()
    }
    # 200 samples: three standard deviations.
    assert (sizes[:, 0] > 1.0).float().mean().item() == pytest.approx(0.75, abs=0.1)


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
    assert found.acceleration_scale < 1e-6
    assert found.friction_mean == pytest.approx(1.0)
    assert found.friction_std == 1.0


def test_samples_in_3d_come_in_all_eight_symmetries() -> None:
    rng, one = np.random.default_rng(0), np.ones(1, np.float32)
    corner = np.array([0.1, 0.2, 0.15], np.float32)
    around = Surroundings(
        size=np.array((0.6, 0.4, 0.5), np.float32),
        gravity=np.array([3.0, -9.0, 0.0], np.float32),
        floor_friction=0.4,
        wall_friction=0.2,
        damping=0.0,
        baffles=np.stack((corner, corner + 0.1))[None],
        baffle_friction=one,
        baffle_turn=np.zeros(1, np.float32),
        ground=None,
    )
    points = {name: corner.reshape(1, 1, -1) for name in ("frames", "targets")}
    numbers = dict.fromkeys(("friction", "cohesion", "volume"), one)
    sample = Sample(velocity0=corner[None], surroundings=around, **points, **numbers)
    found = {tuple(np.round(turned(sample, 0.01, rng).targets[0, 0].astype(float), 5)) for _ in range(100)}
    assert len(found) == 8
