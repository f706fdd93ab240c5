"""What can be unknown, and how each enters a scene and the surrogate's conditions. A new one is added here alone."""

from collections.abc import Sequence
from typing import Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from datasets.scene import Scene

Vector = NDArray[np.float64]
"""One value per unknown, in the order of the problem and the units of the names; shape [U]."""


class Kind(Protocol):
    """A kind of unknown."""

    unit: str
    """As it is printed."""
    limits: tuple[float, float]
    """The open interval outside of which no bound may lie."""

    def read(self, scene: Scene) -> float:
        """Its value in `scene`."""

    def write(self, scene: Scene, value: float) -> Scene:
        """`scene` with this value: how it enters the MPM."""

    def condition(self, friction: Tensor, scene: Scene, value: Tensor) -> Tensor:
        """tan(phi) per point [N] with this value, differentiable in it: how it enters the surrogate."""


class FrictionAngle:
    """`friction_deg`, the angle of internal friction of the scene's shared material [deg]."""

    unit = "deg"
    limits = (0.0, 90.0)

    def read(self, scene: Scene) -> float:
        return scene.material.friction_deg

    def write(self, scene: Scene, value: float) -> Scene:
        return scene.with_friction_deg(float(value))

    def condition(self, friction: Tensor, scene: Scene, value: Tensor) -> Tensor:
        # Points of a mass with its own material keep their friction.
        shared = torch.isclose(friction, torch.tensor(scene.material.friction, dtype=friction.dtype))
        return torch.where(shared, torch.tan(torch.deg2rad(value)).to(friction.dtype), friction)


KINDS: dict[str, Kind] = {"friction_deg": FrictionAngle()}


def with_unknowns(scene: Scene, names: Sequence[str], values: Sequence[float] | Vector) -> Scene:
    """`scene` with the unknowns `names` set to `values`."""
    for name, value in zip(names, values, strict=True):
        scene = KINDS[name].write(scene, float(value))
    return scene
