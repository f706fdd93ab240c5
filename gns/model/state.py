"""What a simulation step takes and gives."""

from dataclasses import dataclass

import torch
from torch import Tensor


@dataclass(frozen=True, kw_only=True)
class State:
    """Where the points are and how they moved."""

    positions: Tensor
    """Positions [m], shape [N, D]."""
    displacements: Tensor
    """The last H displacements [m per step], newest last, shape [H, N, D]."""

    @staticmethod
    def launched(positions: Tensor, velocities: Tensor, *, step: float, history: int) -> "State":
        """From positions [m] and velocities [m/s], both [N, D], as if they had always moved with these velocities."""
        return State(positions=positions, displacements=(velocities * step).expand(history, *positions.shape))

    @staticmethod
    def observed(frames: Tensor, velocities0: Tensor, *, step: float, history: int) -> "State":
        """From frames one step apart [F, N, D]; where they are too few, what came before had the initial velocities.

        frames: [m], the last is now; velocities0: those at the first frame [m/s], shape [N, D].
        """
        launched = State.launched(frames[0], velocities0, step=step, history=history)
        displacements = torch.cat((launched.displacements, frames[1:] - frames[:-1]))[-history:]
        return State(positions=frames[-1], displacements=displacements)


@dataclass(frozen=True, kw_only=True)
class Conditions:
    """What stays as it is while the points move."""

    friction: Tensor
    """tan(phi) of each point [-], shape [N]; may require a gradient."""
    cohesion: Tensor
    """Cohesion of each point [Pa], shape [N]; may require a gradient."""
    volume: Tensor
    """Initial volume of each point [m^D], shape [N]."""
    size: tuple[float, ...]
    """Extent of the box [0, size] that holds all samples [m], length D."""
    gravity: float = 9.81
    """Gravitational acceleration along -y [m/s^2]."""
    batch: Tensor | None = None
    """Sample that each point belongs to, shape [N]; absent where there is one."""
    samples: int = 1
    """Number of samples, B."""
    baffles: Tensor | None = None
    """Lower and upper corner of the K baffles of each sample [m], shape [B, K, 2, D]; may require a gradient.

    A sample with fewer has boxes of no size far outside the domain.
    """
