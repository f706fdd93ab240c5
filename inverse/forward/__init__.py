"""Forward models, the MPM and the GNS: from a vector of parameters to the observation that it predicts."""

from collections.abc import Sequence
from typing import Protocol, runtime_checkable

from torch import Tensor

from datasets.flow.trajectory import Trajectory
from datasets.scene import Scene
from inverse.observations import Values
from inverse.parameters import Vector
from inverse.posterior import Matrix
from mpm.output.recording import ALL, Recording


class Forward(Protocol):
    """Predicts the observation at given parameters."""

    def observe(self, parameters: Sequence[Vector], /) -> list[Values]:
        """The observation [m] at each vector of parameters [U]; runs may be parallel."""

    def select(self, target: Values, /) -> Values:
        """The part of exact numbers [M] that this model predicts, shape [m]."""

    def errors(self, parameters: Vector, /) -> Matrix:
        """Errors at parameters [U] from its band: columns e_k of their covariance, shape [K, m]."""


@runtime_checkable
class Differentiable(Forward, Protocol):
    """A forward model through which torch differentiates."""

    def predict(self, parameters: Tensor, /) -> Tensor:
        """The observation, float64 of shape [m] or [S, m], of parameters, float64 of shape [U] or [S, U]."""


class Simulate(Protocol):
    """The MPM, or a replacement."""

    def __call__(self, scenes: Sequence[Scene], /, *, record: Recording = ALL) -> list[Trajectory]:
        """The trajectories of scenes, which run in parallel, with the quantities that `record` requests."""
