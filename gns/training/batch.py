"""Samples of the datasets as PyTorch Geometric `Data`, and side by side as its `Batch`."""

from typing import Any

import torch
from torch import Tensor
from torch_geometric.data import Batch, Data

from datasets.training.samples import Sample
from gns.model.state import Conditions, State

ABSENT = -10.0
"""Coordinates [m] of a box of zero size that stands for a baffle which a sample does not have."""
TIME_FIRST = ("displacements", "targets")
"""Whose first axis is time, so that samples are joined along the second."""


class Particles(Data):  # type: ignore[misc]
    """The particles of a sample, or of multiple samples joined by `Batch`, which then has these properties too.

    | attribute                      | unit       | shape                         |
    | pos                            | m          | [N, D]                        |
    | displacements                  | m per step | [H, N, D], newest last        |
    | targets                        | m          | [K, N, D], the coming steps   |
    | friction, cohesion, volume     | -, Pa, m^D | [N]                           |
    | baffles                        | m          | [B, K, 2, D], padded; K may be 0 |
    | domain, gravity                | m, m/s^2   | [B, D], [B]; extent of the box |
    """

    def __cat_dim__(self, key: str, value: Any, *args: Any, **kwargs: Any) -> int:
        return 1 if key in TIME_FIRST else 0

    @property
    def state(self) -> State:
        """Where the samples start."""
        return State(positions=self.pos, displacements=self.displacements)

    @property
    def conditions(self) -> Conditions:
        """What is constant during their rollout."""
        return Conditions(
            friction=self.friction,
            cohesion=self.cohesion,
            volume=self.volume,
            size=tuple(self.domain[0].tolist()),
            gravity=self.gravity[0].item(),
            batch=self.batch,
            samples=self.num_graphs,
            baffles=self.baffles if self.baffles.shape[1] else None,
        )


def batched(samples: list[Sample], *, size: tuple[float, ...], gravity: float, step: float, history: int) -> Particles:
    """Join samples of one domain of `size` [m]; they have equally many targets. `.to(device)` moves all of it."""
    boxes = max(len(sample.baffles) for sample in samples)
    batch: Particles = Batch.from_data_list(
        [_particles(sample, boxes, size=size, gravity=gravity, step=step, history=history) for sample in samples]
    )
    return batch


def _particles(
    sample: Sample, boxes: int, *, size: tuple[float, ...], gravity: float, step: float, history: int
) -> Particles:
    """A sample with its baffles padded to so many boxes."""
    frames, velocity0 = torch.from_numpy(sample.frames), torch.from_numpy(sample.velocity0)
    state = State.observed(frames, velocity0, step=step, history=history)
    baffles = state.positions.new_full((1, boxes, 2, len(size)), ABSENT)
    baffles[0, : len(sample.baffles)] = torch.from_numpy(sample.baffles)
    return Particles(
        pos=state.positions,
        displacements=state.displacements,
        targets=torch.from_numpy(sample.targets),
        friction=torch.from_numpy(sample.friction),
        cohesion=torch.from_numpy(sample.cohesion),
        volume=torch.from_numpy(sample.volume),
        baffles=baffles,
        domain=torch.tensor([size], dtype=torch.float64),
        gravity=torch.tensor([gravity], dtype=torch.float64),
    )


def perturbed(batch: Particles, noise: float, generator: torch.Generator) -> Particles:
    """The batch with a random walk in the past displacements, `noise` [m] at its end (Sanchez-Gonzalez et al. 2020).

    The targets move with the particles, so that the true displacement is asked for from a wrong past. The walk is
    drawn on the CPU: it is the same on every device.
    """
    past: Tensor = batch.displacements
    walk = torch.randn(past.shape, generator=generator).cumsum(0) * (noise / len(past) ** 0.5)
    walk = walk.to(past.device)
    shift = walk.sum(0)
    noisy: Particles = batch.clone()
    noisy.pos, noisy.displacements, noisy.targets = batch.pos + shift, past + walk, batch.targets + shift
    return noisy
