"""Samples of the dataset side by side, as tensors."""

import dataclasses
from dataclasses import dataclass
from typing import Any, TypeVar

import torch
from torch import Tensor

from datasets.training.samples import Sample
from gns.model.state import Conditions, State

NOWHERE = -10.0
"""Coordinates [m] of a box of zero size that stands for a baffle which a sample does not have."""

Part = TypeVar("Part", State, Conditions)


@dataclass(frozen=True, kw_only=True)
class Batch:
    """Several samples as one cloud whose parts never meet."""

    state: State
    """Where they start."""
    conditions: Conditions
    """What stays as it is."""
    targets: Tensor
    """Positions in the coming steps [m], shape [K, N, D]."""

    def to(self, device: torch.device | str) -> "Batch":
        """The same batch on another device."""

        def there(part: Part) -> Part:
            values = {field.name: getattr(part, field.name) for field in dataclasses.fields(part)}
            tensors: dict[str, Any] = {
                name: value.to(device) for name, value in values.items() if isinstance(value, Tensor)
            }
            return dataclasses.replace(part, **tensors)

        return Batch(state=there(self.state), conditions=there(self.conditions), targets=self.targets.to(device))


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
            cohesion=torch.cat([torch.from_numpy(sample.cohesion) for sample in samples]),
            volume=torch.cat([torch.from_numpy(sample.volume) for sample in samples]),
            size=size,
            gravity=gravity,
            batch=torch.repeat_interleave(torch.arange(len(samples)), lengths),
            samples=len(samples),
            baffles=_padded([torch.from_numpy(sample.baffles) for sample in samples]),
        ),
        targets=torch.cat([torch.from_numpy(sample.targets) for sample in samples], dim=1),
    )


def _padded(baffles: list[Tensor]) -> Tensor | None:
    """Boxes [K_b, 2, D] of each sample as [B, K, 2, D]; None where no sample has any."""
    most = max(len(boxes) for boxes in baffles)
    if most == 0:
        return None
    padded = baffles[0].new_full((len(baffles), most, *baffles[0].shape[1:]), NOWHERE)
    for row, boxes in zip(padded, baffles, strict=True):
        row[: len(boxes)] = boxes
    return padded


def perturbed(batch: Batch, noise: float, generator: torch.Generator) -> Batch:
    """The batch with a random walk in the past displacements, `noise` [m] at its end (Sanchez-Gonzalez et al. 2020).

    The targets move with the points, so that the model is asked for the true displacement from a wrong past. The walk
    is drawn on the CPU: it is the same on every device.
    """
    past = batch.state.displacements
    walk = torch.randn(past.shape, generator=generator).cumsum(0) * (noise / len(past) ** 0.5)
    walk = walk.to(past.device)
    shift = walk.sum(0)
    return Batch(
        state=State(positions=batch.state.positions + shift, displacements=past + walk),
        conditions=batch.conditions,
        targets=batch.targets + shift,
    )
