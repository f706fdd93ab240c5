"""Samples of the dataset side by side, as tensors."""

from dataclasses import dataclass

import torch
from torch import Tensor

from datasets.samples import Sample
from gns.state import Conditions, State


@dataclass(frozen=True, kw_only=True)
class Batch:
    """Several samples as one cloud whose parts never meet."""

    state: State
    """Where they start."""
    conditions: Conditions
    """What stays as it is."""
    targets: Tensor
    """Positions in the coming steps [m], shape [K, N, D]."""


def batched(samples: list[Sample], *, size: tuple[float, ...], gravity: float, step: float, history: int) -> Batch:
    """Join samples of one domain of `size` [m]; they have equally many targets."""
    states = [
        State.observed(torch.from_numpy(sample.frames), torch.from_numpy(sample.velocity0), step=step, history=history)
        for sample in samples
    ]
    lengths = torch.tensor([len(sample.friction) for sample in samples])
    return Batch(
        state=State(
            positions=torch.cat([state.positions for state in states]),
            displacements=torch.cat([state.displacements for state in states], dim=1),
        ),
        conditions=Conditions(
            friction=torch.cat([torch.from_numpy(sample.friction) for sample in samples]),
            volume=torch.cat([torch.from_numpy(sample.volume) for sample in samples]),
            size=size,
            gravity=gravity,
            batch=torch.repeat_interleave(torch.arange(len(samples)), lengths),
            samples=len(samples),
        ),
        targets=torch.cat([torch.from_numpy(sample.targets) for sample in samples], dim=1),
    )


def perturbed(batch: Batch, noise: float, generator: torch.Generator) -> Batch:
    """The batch with a random walk in the past displacements, `noise` [m] at its end (Sanchez-Gonzalez et al. 2020).

    The targets move with the points, so that the model is asked for the true displacement from a wrong past.
    """
    past = batch.state.displacements
    walk = torch.randn(past.shape, generator=generator).cumsum(0) * (noise / len(past) ** 0.5)
    shift = walk.sum(0)
    return Batch(
        state=State(positions=batch.state.positions + shift, displacements=past + walk),
        conditions=batch.conditions,
        targets=batch.targets + shift,
    )
