"""Samples side by side are samples alone."""

from pathlib import Path

import numpy as np
import torch

from datasets.samples import Sample, cut, load_flows
from gns.batch import batched, perturbed
from gns.settings import ModelSettings
from gns.simulator import Simulator


def samples(dataset: Path, settings: ModelSettings) -> list[Sample]:
    """Two samples, one of them from the very start."""
    flows = load_flows(dataset, "valid", step=settings.step, dimension=2)
    rng = np.random.default_rng(0)
    return [
        cut(flow, now=now, steps=2, history=settings.history, cell=settings.cell, kept=1, rng=rng)
        for flow, now in zip(flows, (0, 5), strict=True)
    ]


def test_samples_do_not_see_each_other(lively: Simulator, dataset: Path) -> None:
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
    torch.testing.assert_close(noisy.targets - noisy.state.positions, batch.targets - batch.state.positions)
    walk = noisy.state.displacements - batch.state.displacements
    assert 0.8e-3 < walk[-1].std() < 1.2e-3
    torch.testing.assert_close(walk.sum(0), noisy.state.positions - batch.state.positions, atol=1e-6, rtol=0.0)
