"""Constants of a material: strength, stiffness, what is left of the strength after a long slip."""

import dataclasses
from dataclasses import dataclass

import torch
from torch import Tensor

from datasets.errors import InputError
from datasets.material import Material
from datasets.scene import Scene
from gns.initial import InitialState
from inverse.parameters.kind import Kind, Parts, require_index


@dataclass(frozen=True)
class Constant(Kind):
    """A constant of the material of a mass, or for None of the shared one."""

    mass: int | None
    name: str
    unit: str
    digits: int
    step: float

    positive = True

    @property
    def order(self) -> int:  # type: ignore[override]
        """Shared constants first: those of a single mass take precedence."""
        return 0 if self.mass is None else 2

    def check(self, scene: Scene) -> None:
        if self.mass is not None:
            require_index("masses", self.mass, len(scene.masses))
        elif all(mass.material is not None for mass in scene.masses):
            raise InputError("expected a mass of the scene's shared material, every mass has its own")

    def material(self, scene: Scene) -> Material:
        """The material in question."""
        return scene.material if self.mass is None else scene.material_of(scene.masses[self.mass])

    def read(self, scene: Scene) -> float:
        return float(getattr(self.material(scene), self.name))

    def put(self, parts: Parts, value: float) -> None:
        if self.mass is None:
            parts.material = self.changed(parts.material, value)
            return
        mass = parts.masses[self.mass]
        material = self.changed(mass.material or parts.material, value)
        parts.masses[self.mass] = dataclasses.replace(mass, material=material)

    def changed(self, material: Material, value: float) -> Material:
        """`material` with this value."""
        return dataclasses.replace(material, **{self.name: value})


class Friction(Constant):
    """Angle of internal friction [deg]; an input of the surrogate as its tangent."""

    differentiable = True

    def enter(self, initial: InitialState, value: Tensor) -> InitialState:
        known = initial.conditions.friction
        friction = torch.tan(torch.deg2rad(value)).to(known.dtype)
        return initial.with_conditions(friction=torch.where(initial.of_mass(self.mass), friction, known))


class Cohesion(Constant):
    """Cohesion [Pa]. The tension cutoff and residual values change with it in proportion."""

    differentiable = True

    def changed(self, material: Material, value: float) -> Material:
        # Where there is no cohesion there is no ratio: cutoff and residual values stay as well.
        ratio = value / material.cohesion if material.cohesion > 0.0 else 1.0
        keys = ("tension_cutoff", "residual_cohesion", "residual_tension_cutoff")
        known = {key: getattr(material, key) for key in keys}
        scaled = {key: ratio * each for key, each in known.items() if each is not None}
        return dataclasses.replace(material, cohesion=value, **scaled)

    def enter(self, initial: InitialState, value: Tensor) -> InitialState:
        known = initial.conditions.cohesion
        return initial.with_conditions(cohesion=torch.where(initial.of_mass(self.mass), value.to(known.dtype), known))


class Residual(Constant):
    """A residual strength: friction angle [deg] or cohesion [Pa] after a long slip."""

    @property
    def order(self) -> int:  # type: ignore[override]
        """After the cohesion of the same material, which scales residual values."""
        return 1 if self.mass is None else 3

    def check(self, scene: Scene) -> None:
        super().check(scene)
        if self.material(scene).softening_length is None:
            raise InputError("expected a material with a softening_length, it never falls to a residual strength")

    def read(self, scene: Scene) -> float:
        material = self.material(scene)
        # Unless they are named, residual values are those of the peak.
        known = getattr(material, self.name)
        return float(getattr(material, self.name.removeprefix("residual_")) if known is None else known)
