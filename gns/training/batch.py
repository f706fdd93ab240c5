"""Samples of the datasets as PyTorch Geometric `Data`, and side by side as its `Batch`."""

from typing import Any

import torch
from torch import Tensor
from torch_geometric.data import Batch, Data

from datasets.training.samples import Sample
from gns.conditions import NO_GROUND, conditions_of, tensors_of
from gns.model.state import Conditions, State

TIME_FIRST = ("displacements", "targets", "shares")
"""Whose first axis is time, so that samples are joined along the second."""


class Particles(Data):  # type: ignore[misc]
    """The particles of a sample, or of multiple samples joined by `Batch`, which then has these properties too.

    | attribute                      | unit       | shape                                           |
    | pos                            | m          | [N, D]                                          |
    | displacements                  | m per step | [H, N, D], newest last                          |
    | targets                        | m          | [K, N, D], the coming steps                     |
    | shares                         | m          | [K, N, D], of each sample; see `Sample.shares`  |
    | friction, cohesion, volume     | -, Pa, m^D | [N]                                             |
    | box, gravity                   | m, m/s^2   | [B, D]; extent of the boxes                     |
    | floor_friction, wall_friction, damping | -  | [B]                                             |
    | baffles, baffle_friction       | m, -       | [B, K, 2, D], [B, K], padded; K may be 0        |
    | baffle_turn                    | rad        | [B, K]; [B, 0] where none is turned             |
    | elevation, ground_friction     | m, -       | [B, X(, Z)], padded; X is 0 without any terrain |
    """

    def __cat_dim__(self, key: str, value: Any, *args: Any, **kwargs: Any) -> int:
        return 1 if key in TIME_FIRST else 0

    @property
    def state(self) -> State:
        """Where the samples start."""
        return State(positions=self.pos, displacements=self.displacements)

    def conditions(self, spacing: float) -> Conditions:
        """What is constant during their rollout; spacing: between two elevations of the ground [m]."""
        return conditions_of(
            self,
            friction=self.friction,
            cohesion=self.cohesion,
            volume=self.volume,
            spacing=spacing,
            batch=self.batch,
        )


def batched(samples: list[Sample], *, step: float, history: int) -> Particles:
    """Join samples; they have equally many targets. `.to(device)` moves all of it."""
    boxes = max(len(sample.surroundings.baffles) for sample in samples)
    turned = any(bool(sample.surroundings.baffle_turn.any()) for sample in samples)
    rasters = [sample.surroundings.ground[0].shape for sample in samples if sample.surroundings.ground is not None]
    raster = tuple(max(counts) for counts in zip(*rasters, strict=True)) or NO_GROUND
    parts = []
    for sample in samples:
        frames, velocity0 = torch.from_numpy(sample.frames), torch.from_numpy(sample.velocity0)
        state = State.observed(frames, velocity0, step=step, history=history)
        parts.append(
            Particles(
                pos=state.positions,
                displacements=state.displacements,
                targets=torch.from_numpy(sample.targets),
                shares=torch.from_numpy(sample.shares),
                friction=torch.from_numpy(sample.friction),
                cohesion=torch.from_numpy(sample.cohesion),
                volume=torch.from_numpy(sample.volume),
                **tensors_of(sample.surroundings, boxes=boxes, turned=turned, raster=raster),
            )
        )
    batch: Particles = Batch.from_data_list(parts)
    return batch


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
