"""What one mass has of its own: initial velocity and stress, how much of it is released."""

import dataclasses
from abc import abstractmethod
from dataclasses import dataclass

import torch
from torch import Tensor

from datasets.errors import InputError
from datasets.scene import Mass, Scene
from gns.initial import InitialState
from inverse.parameters.kind import UP, Kind, Parts, replaced, require_axis, require_index


@dataclass(frozen=True)
class MassKind(Kind):
    """A property of one mass."""

    mass: int

    def check(self, scene: Scene) -> None:
        require_index("masses", self.mass, len(scene.masses))

    def put(self, parts: Parts, value: float) -> None:
        parts.masses[self.mass] = self.changed(parts.masses[self.mass], value)

    @abstractmethod
    def changed(self, mass: Mass, value: float) -> Mass:
        """The mass with this value."""


@dataclass(frozen=True)
class Velocity(MassKind):
    """Initial velocity of a mass along an axis [m/s]."""

    axis: int

    unit = "m/s"
    digits = 3
    step = 0.01
    differentiable = True
    independent = True

    def check(self, scene: Scene) -> None:
        super().check(scene)
        require_axis(self.axis, scene)

    def read(self, scene: Scene) -> float:
        return (scene.masses[self.mass].velocity or (0.0,) * scene.dimension)[self.axis]

    def changed(self, mass: Mass, value: float) -> Mass:
        velocity = mass.velocity or (0.0,) * len(mass.size)
        return dataclasses.replace(mass, velocity=replaced(velocity, self.axis, value))

    def enter(self, initial: InitialState, value: Tensor) -> InitialState:
        # The particles' history: as if they had always moved with this velocity.
        state = initial.state
        along = torch.arange(state.positions.shape[1]) == self.axis
        own = initial.of_mass(self.mass).unsqueeze(1) & along
        displacement = (value * initial.step).to(state.displacements.dtype)
        return initial.with_displacements(torch.where(own, displacement, state.displacements))


@dataclass(frozen=True)
class InitialStress(MassKind):
    """K0 of a mass, its horizontal over its vertical initial stress [-]."""

    unit = "-"
    digits = 3
    step = 0.05
    positive = True

    def check(self, scene: Scene) -> None:
        super().check(scene)
        if not isinstance(scene.masses[self.mass].k0, float | int):
            raise InputError("expected a mass whose k0 is a number in the scene, its own is none")

    def read(self, scene: Scene) -> float:
        return float(scene.masses[self.mass].k0 or 0.0)

    def changed(self, mass: Mass, value: float) -> Mass:
        return dataclasses.replace(mass, k0=value)


@dataclass(frozen=True)
class Height(MassKind):
    """Extent of a box along y, from its foot [m]: how much is released.

    Its particles fit their lattice to it, and have its volume exactly; their number changes by whole rows.
    """

    unit = "m"
    digits = 4
    step = 0.01
    positive = True
    changes_volume = True

    def check(self, scene: Scene) -> None:
        super().check(scene)
        if (kind := scene.masses[self.mass].kind) != "box":
            raise InputError(f"expected a mass of kind box, got a {kind}")

    def read(self, scene: Scene) -> float:
        return scene.masses[self.mass].size[UP]

    def changed(self, mass: Mass, value: float) -> Mass:
        return dataclasses.replace(mass, size=replaced(mass.size, UP, value))


@dataclass(frozen=True)
class Thickness(MassKind):
    """Thickness of a layer, the same all over it [m]: the release depth."""

    unit = "m"
    digits = 4
    step = 0.01
    positive = True
    changes_volume = True

    def check(self, scene: Scene) -> None:
        super().check(scene)
        mass = scene.masses[self.mass]
        if mass.kind != "layer" or not isinstance(mass.thickness, float | int):
            raise InputError("expected a mass of kind layer whose thickness is a number")

    def read(self, scene: Scene) -> float:
        thickness = scene.masses[self.mass].thickness
        assert isinstance(thickness, float | int), "`check` has been called"
        return float(thickness)

    def changed(self, mass: Mass, value: float) -> Mass:
        return dataclasses.replace(mass, thickness=value)
