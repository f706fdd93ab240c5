"""What one mass has of its own: initial velocity and stress, how much of it is released."""

import dataclasses
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from datasets.errors import InputError
from datasets.scene import Scene
from gns.initial import InitialState
from inverse.parameters.kind import UP, Kind, Parts, replaced, require_axis, require_index


@dataclass(frozen=True)
class MassNumber(Kind):
    """A number of one mass: `k0`, the ratio of its initial stresses [-], or the `thickness` of a layer [m]."""

    mass: int
    name: str
    unit: str
    digits: int
    step: float
    changes_volume: bool = False

    positive = True

    def check(self, scene: Scene) -> None:
        require_index("masses", self.mass, len(scene.masses))
        if not isinstance(getattr(scene.masses[self.mass], self.name), float | int):
            kind = "a mass of kind layer" if self.name == "thickness" else "a mass"
            raise InputError(f"expected {kind} whose {self.name} is a number in the scene, its own is none")

    def read(self, scene: Scene) -> float:
        return float(getattr(scene.masses[self.mass], self.name))

    def put(self, parts: Parts, value: float) -> None:
        changed: dict[str, Any] = {self.name: value}
        parts.masses[self.mass] = dataclasses.replace(parts.masses[self.mass], **changed)


@dataclass(frozen=True)
class Height(MassNumber):
    """Extent of a box along y, from its foot [m]: how much is released.

    Its particles fit their lattice to it, and have its volume exactly; their number changes by whole rows.
    """

    def check(self, scene: Scene) -> None:
        require_index("masses", self.mass, len(scene.masses))
        if (kind := scene.masses[self.mass].kind) != "box":
            raise InputError(f"expected a mass of kind box, got a {kind}")

    def read(self, scene: Scene) -> float:
        return scene.masses[self.mass].size[UP]

    def put(self, parts: Parts, value: float) -> None:
        mass = parts.masses[self.mass]
        parts.masses[self.mass] = dataclasses.replace(mass, size=replaced(mass.size, UP, value))


@dataclass(frozen=True)
class Velocity(Kind):
    """Initial velocity of a mass along an axis [m/s]."""

    mass: int
    axis: int

    unit = "m/s"
    digits = 3
    step = 0.01
    differentiable = True
    independent = True

    def check(self, scene: Scene) -> None:
        require_index("masses", self.mass, len(scene.masses))
        require_axis(self.axis, scene)

    def read(self, scene: Scene) -> float:
        return (scene.masses[self.mass].velocity or (0.0,) * scene.dimension)[self.axis]

    def put(self, parts: Parts, value: float) -> None:
        mass = parts.masses[self.mass]
        velocity = replaced(mass.velocity or (0.0,) * len(mass.size), self.axis, value)
        parts.masses[self.mass] = dataclasses.replace(mass, velocity=velocity)

    def enter(self, initial: InitialState, value: Tensor) -> InitialState:
        # The particles' history: as if they had always moved with this velocity.
        state = initial.state
        along = torch.arange(state.positions.shape[1]) == self.axis
        own = initial.of_mass(self.mass).unsqueeze(1) & along
        displacement = (value * initial.step).to(state.displacements.dtype)
        return initial.with_displacements(torch.where(own, displacement, state.displacements))
