"""Samples side by side are samples alone."""

import dataclasses
from pathlib import Path

import numpy as np
import torch

from datasets.training.samples import Sample, cut, load_flows
from gns.model.settings import ModelSettings
from gns.model.simulator import Simulator
from gns.training.batch import batched, perturbed


def samples(dataset: Path, settings: ModelSettings) -> list[Sample]:
    """Two samples, one of them from the very start."""
    flows = load_flows(dataset, "valid", step=settings.step, dimension=2)
    rng = np.random.default_rng(0)
    return [
        cut(flow, now=now, steps=2, history=settings.history, cell=settings.cell, kept=1, rng=rng)
        for flow, now in zip(flows, (0, 5), strict=True)
    ]


def test_samples_of_a_batch_are_independent(lively: Simulator, dataset: Path) -> None:
    settings = lively.settings
    given = samples(dataset, settings)

    def after(some: list[Sample]) -> torch.Tensor:
        batch = batched(some, size=(0.6, 0.4), gravity=9.81, step=settings.step, history=settings.history)
        with torch.no_grad():
            return lively(batch.state, batch.conditions).positions

    torch.testing.assert_close(after(given), torch.cat([after([sample]) for sample in given]), atol=1e-6, rtol=0.0)


def test_noise_ends_where_the_true_path_goes_on(settings: ModelSettings, dataset: Path) -> None:
    batch = batched(samples(dataset, settings), size=(0.6, 0.4), gravity=9.81, step=settings.step, history=3)
    noisy = perturbed(batch, 1e-3, torch.Generator().manual_seed(0))
    torch.testing.assert_close(noisy.targets - noisy.pos, batch.targets - batch.pos)
    walk = noisy.displacements - batch.displacements
    assert 0.8e-3 < walk[-1].std() < 1.2e-3
    torch.testing.assert_close(walk.sum(0), noisy.pos - batch.pos, atol=1e-6, rtol=0.0)


def test_baffles_are_padded_outside_the_domain(settings: ModelSettings, dataset: Path) -> None:
    def joined(*baffles: list[list[list[float]]]) -> torch.Tensor | None:
        some = [
            dataclasses.replace(sample, baffles=np.array(boxes, np.float32).reshape(-1, 2, 2))
            for sample, boxes in zip(samples(dataset, settings), baffles, strict=True)
        ]
        return batched(some, size=(0.6, 0.4), gravity=9.81, step=settings.step, history=3).conditions.baffles

    one, two = [[0.1, 0.0], [0.2, 0.3]], [[0.4, 0.0], [0.5, 0.3]]
    assert joined([], []) is None
    absent = [[-10.0, -10.0], [-10.0, -10.0]]
    found = joined([one], [two, one])
    assert found is not None
    torch.testing.assert_close(found, torch.tensor([[one, absent], [two, one]]))


def test_a_batch_moves_to_a_device_as_a_whole(settings: ModelSettings, dataset: Path) -> None:
    batch = batched(samples(dataset, settings), size=(0.6, 0.4), gravity=9.81, step=settings.step, history=3)
    assert (batch.conditions.size, batch.conditions.gravity) == ((0.6, 0.4), 9.81)
    there = batch.to("meta")
    assert {value.device.type for value in there.to_dict().values() if isinstance(value, torch.Tensor)} == {"meta"}


def test_cohesion_is_that_of_each_sample(settings: ModelSettings, dataset: Path) -> None:
    some = samples(dataset, settings)
    some[1] = dataclasses.replace(some[1], cohesion=np.full_like(some[1].cohesion, 100.0))
    found = batched(some, size=(0.6, 0.4), gravity=9.81, step=settings.step, history=3).conditions
    assert found.cohesion.tolist() == (found.batch * 100.0).tolist()
