"""Forward: from a vector of unknowns to the observation it predicts. The MPM and the GNS are two of them."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from datasets.scene import Scene
from datasets.trajectory import Trajectory
from inverse.observations.deposit import Values
from inverse.parameters.parameters import Vector
from mpm.output.request import ALL, Recording


class Forward(Protocol):
    """Predicts the observation of given unknowns."""

    def observe(self, unknowns: Sequence[Vector]) -> list[Values]:
        """The observation [M] for each vector of unknowns [U]; several may run side by side."""


class Differentiable(Forward, Protocol):
    """A forward that autograd can look through."""

    def predict(self, unknowns: Tensor) -> Tensor:
        """The observation, float64 of shape [M], of unknowns, float64 of shape [U]."""


class Surrogate(Differentiable, Protocol):
    """A learned simulator of one flow, started from the scene itself or from the MPM's first frames."""

    def wanted(self, target: Values) -> Values:
        """What of an exact observation [M] its own [m] are held against: it may follow some of the points alone."""

    def deposit(self, unknowns: Vector) -> NDArray[np.floating]:
        """Where its points come to rest [m], shape [N, D]: for pictures."""


class SurrogateSource(Protocol):
    """Makes surrogates of a flow."""

    def first_frames(self, scene: Scene) -> Scene | None:
        """`scene`, cut to the first frames that a surrogate is started from; None where it needs none."""

    def start(self, beginning: Trajectory | None) -> Surrogate:
        """The surrogate that goes on from the first frames of `beginning`, as long as the problem's scene lasts.

        One that needs no frames takes the jitter of the points from `beginning`, or from the problem's scene.
        """


class Simulate(Protocol):
    """The MPM, or what stands for it."""

    def __call__(self, scenes: Sequence[Scene], /, *, record: Recording = ALL) -> list[Trajectory]:
        """The trajectories of scenes that run side by side, with what `record` asks for."""


@dataclass(frozen=True, kw_only=True)
class Evaluation:
    """The loss and its gradient at one vector of unknowns."""

    unknowns: Vector
    """Where, shape [U]."""
    observation: Values
    """What the forward predicts there, shape [M]."""
    loss: float
    """Mean squared difference from the target (`inverse.observations.deposit.loss`)."""
    gradient: Vector | None
    """d(loss)/d(unknowns), shape [U]; None for a search without gradients."""
    forward_s: float
    """Seconds of prediction."""
    backward_s: float
    """Seconds for the gradient on top of it."""
    residual: Values | None = None
    """Observation less target, shape [M], where the Jacobian was asked for."""
    jacobian: NDArray[np.float64] | None = None
    """d(observation)/d(unknowns), shape [M, U], where it was asked for."""

    @property
    def slope(self) -> Vector:
        """The gradient of an evaluation that has one."""
        assert self.gradient is not None
        return self.gradient
