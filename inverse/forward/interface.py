"""Forward models, the MPM and the GNS: from a vector of parameters to the observation that it predicts."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from datasets.scene import Scene
from datasets.trajectory import Trajectory
from inverse.observations import Values
from inverse.parameters import Vector
from mpm.output.request import ALL, Recording


class Forward(Protocol):
    """Predicts the observation at given parameters."""

    def observe(self, parameters: Sequence[Vector], /) -> list[Values]:
        """The observation [M] at each vector of parameters [U]; runs may be side by side."""


@runtime_checkable
class Differentiable(Forward, Protocol):
    """A forward model through which torch differentiates."""

    def predict(self, parameters: Tensor, /) -> Tensor:
        """The observation, float64 of shape [m], of parameters, float64 of shape [U]."""


class Simulate(Protocol):
    """The MPM, or what stands for it."""

    def __call__(self, scenes: Sequence[Scene], /, *, record: Recording = ALL) -> list[Trajectory]:
        """The trajectories of scenes that run side by side, with what `record` asks for."""


@dataclass(frozen=True, kw_only=True)
class Evaluation:
    """The misfit and its gradient at one vector of parameters."""

    parameters: Vector
    """Shape [U]."""
    observation: Values
    """What the forward model predicts there, shape [M]."""
    residual: Values
    """Observation less target, shape [M]."""
    components: int = 1
    """See `inverse.observations.observation.Observation`."""
    gradient: Vector | None = None
    """d(loss)/d(parameters), shape [U]; None for a search without gradients."""
    jacobian: NDArray[np.float64] | None = None
    """d(observation)/d(parameters), shape [M, U], where it was asked for."""
    forward_s: float = 0.0
    """Seconds of prediction."""
    backward_s: float = 0.0
    """Seconds for the gradient on top of it."""

    @property
    def loss(self) -> float:
        """Misfit from the target (`Observation.misfit`)."""
        return self.components * float(np.mean(self.residual**2))

    @property
    def slope(self) -> Vector:
        """The gradient of an evaluation that has one."""
        assert self.gradient is not None
        return self.gradient
