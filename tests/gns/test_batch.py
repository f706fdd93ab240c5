"""Samples side by side are samples alone."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import torch

from datasets.training.samples import Sample, cut, load_flows
from gns.conditions import ABSENT
from gns.model.settings import ModelSettings
from gns.model.simulator import Simulator
from gns.training.batch import Particles, batched, perturbed


def samples(dataset: Path, settings: ModelSettings, starts: tuple[int, int] = (0, 5)) -> list[Sample]:
    """Two samples, one of them from the very start."""
    flows = load_flows(dataset, "valid", step=settings.step, dimension=2, spacing=settings.cell)
    rng = np.random.default_rng(0)
    return [
        cut(flow, now=now, steps=2, history=settings.history, cell=settings.cell, kept=1, rng=rng)
        for flow, now in zip(flows, starts, strict=True)
    ]


def joined(some: list[Sample], settings: ModelSettings) -> Particles:
    """The samples as a batch."""
    return batched(some, step=settings.step, history=settings.history)


def after(simulator: Simulator, some: list[Sample]) -> torch.Tensor:
    """Where a step takes the particles of samples side by side [m]."""
    batch = joined(some, simulator.settings)
    with torch.no_grad():
        return simulator(batch.state, batch.conditions(simulator.settings.cell)).positions


def test_samples_of_a_batch_are_independent(lively: Simulator, dataset: Path) -> None:
    given = samples(dataset, lively.settings, starts=(5, 5))
    # The same grid for both: the second one is the first, but for its material and its surroundings.
    around = dataclasses.replace(given[0].surroundings, wall_friction=0.7, damping=0.2)
    given[1] = dataclasses.replace(given[0], friction=given[1].friction, surroundings=around)
    alone = [after(lively, [sample]) for sample in given]
    assert (alone[0] - alone[1]).abs().max() > 1e-5
    torch.testing.assert_close(after(lively, given), torch.cat(alone), atol=1e-6, rtol=0.0)


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


def test_noise_ends_where_the_true_path_goes_on(settings: ModelSettings, dataset: Path) -> None:
    batch = joined(samples(dataset, settings), settings)
    noisy = perturbed(batch, 1e-3, torch.Generator().manual_seed(0))
    torch.testing.assert_close(noisy.targets - noisy.pos, batch.targets - batch.pos)
    walk = noisy.displacements - batch.displacements
    assert 0.8e-3 < walk[-1].std() < 1.2e-3
    torch.testing.assert_close(walk.sum(0), noisy.pos - batch.pos, atol=1e-6, rtol=0.0)


def test_baffles_are_padded_outside_the_domain(settings: ModelSettings, dataset: Path) -> None:
    def baffles(*each: list[list[list[float]]]) -> torch.Tensor | None:
        some = []
        for sample, boxes in zip(samples(dataset, settings), each, strict=True):
            around = dataclasses.replace(
                sample.surroundings,
                baffles=np.array(boxes, np.float32).reshape(-1, 2, 2),
                baffle_friction=np.full(len(boxes), 0.5, np.float32),
                baffle_turn=np.zeros(len(boxes), np.float32),
            )
            some.append(dataclasses.replace(sample, surroundings=around))
        conditions = joined(some, settings).conditions(settings.cell)
        if conditions.baffle_friction is not None:
            assert conditions.baffle_friction.tolist() == [[0.5, 0.0], [0.5, 0.5]]
        return conditions.baffles

    one, two = [[0.1, 0.0], [0.2, 0.3]], [[0.4, 0.0], [0.5, 0.3]]
    assert baffles([], []) is None
    absent = [[ABSENT, ABSENT], [ABSENT, ABSENT]]
    found = baffles([one], [two, one])
    assert found is not None
    torch.testing.assert_close(found, torch.tensor([[one, absent], [two, one]]))


def test_ground_is_padded_with_its_end_and_lies_far_below_where_there_is_none(
    settings: ModelSettings, dataset: Path
) -> None:
    some = samples(dataset, settings)
    assert joined(some, settings).conditions(settings.cell).ground is None
    for index, heights in enumerate(([0.3, 0.2], [0.3, 0.2, 0.1])):
        ground = np.array(heights, np.float32), np.array(heights, np.float32) + 0.1
        around = dataclasses.replace(some[index].surroundings, ground=ground)
        some[index] = dataclasses.replace(some[index], surroundings=around)
    ground = joined(some, settings).conditions(0.25).ground
    assert ground is not None
    assert ground.spacing == 0.25
    torch.testing.assert_close(ground.elevation, torch.tensor([[0.3, 0.2, 0.2], [0.3, 0.2, 0.1]]))
    torch.testing.assert_close(ground.friction, ground.elevation + 0.1)
    bare = dataclasses.replace(some[0], surroundings=dataclasses.replace(some[0].surroundings, ground=None))
    found = joined([bare, some[1]], settings).conditions(0.25).ground
    assert found is not None
    assert found.elevation[0].tolist() == [ABSENT] * 3


def test_a_batch_moves_to_a_device_as_a_whole(settings: ModelSettings, dataset: Path) -> None:
    batch = joined(samples(dataset, settings), settings)
    there = batch.to("meta")
    assert {value.device.type for value in there.to_dict().values() if isinstance(value, torch.Tensor)} == {"meta"}


def test_conditions_are_those_of_each_sample(settings: ModelSettings, dataset: Path) -> None:
    some = samples(dataset, settings)
    around = dataclasses.replace(
        some[1].surroundings,
        size=np.array([1.2, 0.5], np.float32),
        gravity=np.array([3.0, -9.0], np.float32),
        floor_friction=0.1,
        wall_friction=0.2,
        damping=0.3,
    )
    cohesion = np.full_like(some[1].cohesion, 100.0)
    some[1] = dataclasses.replace(some[1], cohesion=cohesion, surroundings=around)
    found = joined(some, settings).conditions(settings.cell)
    assert found.samples == 2
    assert found.batch is not None
    assert found.cohesion.tolist() == (found.batch * 100.0).tolist()
    torch.testing.assert_close(found.size, torch.tensor([[0.6, 0.4], [1.2, 0.5]]))
    torch.testing.assert_close(found.gravity, torch.tensor([[0.0, -9.81], [3.0, -9.0]]))
    for name, value in (("floor_friction", 0.1), ("wall_friction", 0.2), ("damping", 0.3)):
        assert getattr(found, name).tolist() == pytest.approx([0.0, value])
