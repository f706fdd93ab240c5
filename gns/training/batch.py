"""Samples of the datasets as PyTorch Geometric `Data`, and side by side as its `Batch`."""

from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch_geometric.data import Batch, Data

from datasets.training.samples import Sample, Surroundings
from gns.model.state import Conditions, Ground, State

ABSENT = -10.0
"""Coordinates [m] of a box of zero size that stands for a baffle which a sample does not have, and of ground."""
TIME_FIRST = ("displacements", "targets", "shares")
"""Whose first axis is time, so that samples are joined along the second."""
Floats = np.typing.NDArray[np.float32]


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
        some_baffles, some_ground = self.baffles.shape[1] > 0, self.elevation.shape[1] > 0
        return Conditions(
            friction=self.friction,
            cohesion=self.cohesion,
            volume=self.volume,
            size=self.box,
            gravity=self.gravity,
            floor_friction=self.floor_friction,
            wall_friction=self.wall_friction,
            damping=self.damping,
            batch=self.batch,
            baffles=self.baffles if some_baffles else None,
            baffle_friction=self.baffle_friction if some_baffles else None,
            ground=Ground(elevation=self.elevation, friction=self.ground_friction, spacing=spacing)
            if some_ground
            else None,
        )


def batched(samples: list[Sample], *, step: float, history: int) -> Particles:
    """Join samples; they have equally many targets. `.to(device)` moves all of it."""
    boxes = max(len(sample.surroundings.baffles) for sample in samples)
    rasters = [sample.surroundings.ground[0].shape for sample in samples if sample.surroundings.ground is not None]
    raster = tuple(max(counts) for counts in zip(*rasters, strict=True)) or (0,)
    batch: Particles = Batch.from_data_list(
        [_particles(sample, boxes, raster, step=step, history=history) for sample in samples]
    )
    return batch


def _particles(sample: Sample, boxes: int, raster: tuple[int, ...], *, step: float, history: int) -> Particles:
    """A sample with its baffles padded to so many boxes, and its ground to that raster."""
    frames, velocity0 = torch.from_numpy(sample.frames), torch.from_numpy(sample.velocity0)
    state = State.observed(frames, velocity0, step=step, history=history)
    around = sample.surroundings
    baffles, friction = padded_baffles(around, boxes)
    elevation, roughness = padded_ground(around, raster)

    def number(value: float) -> Tensor:
        return torch.tensor([value], dtype=torch.float32)

    return Particles(
        pos=state.positions,
        displacements=state.displacements,
        targets=torch.from_numpy(sample.targets),
        shares=torch.from_numpy(sample.shares),
        friction=torch.from_numpy(sample.friction),
        cohesion=torch.from_numpy(sample.cohesion),
        volume=torch.from_numpy(sample.volume),
        box=torch.from_numpy(around.size).unsqueeze(0),
        gravity=torch.from_numpy(around.gravity).unsqueeze(0),
        floor_friction=number(around.floor_friction),
        wall_friction=number(around.wall_friction),
        damping=number(around.damping),
        baffles=torch.from_numpy(baffles).unsqueeze(0),
        baffle_friction=torch.from_numpy(friction).unsqueeze(0),
        elevation=torch.from_numpy(elevation).unsqueeze(0),
        ground_friction=torch.from_numpy(roughness).unsqueeze(0),
    )


def padded_baffles(around: Surroundings, boxes: int) -> tuple[Floats, Floats]:
    """Corners [boxes, 2, D] and friction [boxes] of baffles, and of absent ones."""
    baffles = np.full((boxes, 2, len(around.size)), ABSENT, np.float32)
    friction = np.zeros(boxes, np.float32)
    baffles[: len(around.baffles)] = around.baffles
    friction[: len(around.baffles)] = around.baffle_friction
    return baffles, friction


def padded_ground(around: Surroundings, raster: tuple[int, ...]) -> tuple[Floats, Floats]:
    """Elevation and friction of the ground over a raster; where a sample has none it lies far below."""
    if around.ground is None:
        return np.full(raster, ABSENT, np.float32), np.zeros(raster, np.float32)
    ends = [(0, count - own) for count, own in zip(raster, around.ground[0].shape, strict=True)]
    elevation, friction = (np.pad(field, ends, mode="edge") for field in around.ground)
    return elevation, friction


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
