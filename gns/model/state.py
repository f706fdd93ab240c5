"""What a simulation step takes and gives."""

import dataclasses
from dataclasses import dataclass
from typing import Any, Self

import torch
from torch import Tensor


@dataclass(frozen=True, kw_only=True)
class Tensors:
    """A record of tensors; all of them move together, here and nowhere else."""

    def to(self, device: torch.device | str | None = None, dtype: torch.dtype | None = None) -> Self:
        """The same record on another device, its real numbers in another precision; None leaves either as it is."""
        moved: dict[str, Any] = {}
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if isinstance(value, Tensor):
                moved[field.name] = value.to(device=device, dtype=dtype if value.is_floating_point() else None)
            elif isinstance(value, Tensors):
                moved[field.name] = value.to(device, dtype)
        return dataclasses.replace(self, **moved)


@dataclass(frozen=True, kw_only=True)
class State(Tensors):
    """Positions of the particles, and their last displacements."""

    positions: Tensor
    """Positions [m], shape [N, D]."""
    displacements: Tensor
    """The last H displacements [m per step], newest last, shape [H, N, D]."""

    @staticmethod
    def moving(positions: Tensor, velocities: Tensor, *, step: float, history: int) -> "State":
        """From positions [m] and velocities [m/s], both [N, D], as if the velocities had always been these."""
        return State(positions=positions, displacements=(velocities * step).expand(history, *positions.shape))

    @staticmethod
    def observed(frames: Tensor, velocities0: Tensor, *, step: float, history: int) -> "State":
        """From frames one step apart [F, N, D]; where they are too few, what came before had the initial velocities.

        frames: [m], the last is now; velocities0: those at the first frame [m/s], shape [N, D].
        """
        before = State.moving(frames[0], velocities0, step=step, history=history)
        displacements = torch.cat((before.displacements, frames[1:] - frames[:-1]))[-history:]
        return State(positions=frames[-1], displacements=displacements)


@dataclass(frozen=True, kw_only=True)
class Conditions(Tensors):
    """What is constant during a rollout: material, volumes, box, gravity, baffles."""

    friction: Tensor
    """tan(phi) of each particle [-], shape [N]; may require a gradient."""
    cohesion: Tensor
    """Cohesion of each particle [Pa], shape [N]; may require a gradient."""
    volume: Tensor
    """Initial volume of each particle [m^D], shape [N]."""
    size: tuple[float, ...]
    """Extent of the box [0, size] that holds all samples [m], length D."""
    gravity: float = 9.81
    """Gravitational acceleration along -y [m/s^2]."""
    batch: Tensor | None = None
    """Sample that each particle belongs to, shape [N]; absent where there is one."""
    samples: int = 1
    """Number of samples, B."""
    baffles: Tensor | None = None
    """Lower and upper corner of the K baffles of each sample [m], shape [B, K, 2, D]; may require a gradient.

    A sample with fewer has boxes of no size far outside the domain.
    """
