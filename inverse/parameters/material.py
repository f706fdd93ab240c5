"""Constants of a material: strength, stiffness, what is left of the strength after a long slip."""

import dataclasses
from abc import abstractmethod
from dataclasses import dataclass

import torch
from torch import Tensor

from datasets.errors import InputError
from datasets.material import Material
from datasets.scene import Scene
from gns.initial import InitialState
from inverse.parameters.kind import Kind, Parts, require_index


@dataclass(frozen=True)
class MaterialKind(Kind):
    """A constant of the material of a mass, or for None of the shared one."""

    mass: int | None

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

    def put(self, parts: Parts, value: float) -> None:
        if self.mass is None:
            parts.material = self.changed(parts.material, value)
            return
        mass = parts.masses[self.mass]
        material = self.changed(mass.material or parts.material, value)
        parts.masses[self.mass] = dataclasses.replace(mass, material=material)

    @abstractmethod
    def changed(self, material: Material, value: float) -> Material:
        """`material` with this value."""


@dataclass(frozen=True)
class Friction(MaterialKind):
    """Angle of internal friction [deg]; an input of the surrogate as its tangent."""

    unit = "deg"
    digits = 2
    step = 0.05  # the paper's
    differentiable = True

    def read(self, scene: Scene) -> float:
        return self.material(scene).friction_deg

    def changed(self, material: Material, value: float) -> Material:
        return dataclasses.replace(material, friction_deg=value)

    def enter(self, initial: InitialState, value: Tensor) -> InitialState:
        known = initial.conditions.friction
        friction = torch.tan(torch.deg2rad(value)).to(known.dtype)
        return initial.with_conditions(friction=torch.where(initial.of_mass(self.mass), friction, known))


@dataclass(frozen=True)
class Cohesion(MaterialKind):
    """Cohesion [Pa]. The tension cutoff and residual values change with it in proportion."""

    unit = "Pa"
    digits = 1
    step = 1.0
    differentiable = True

    def read(self, scene: Scene) -> float:
        return self.material(scene).cohesion

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


@dataclass(frozen=True)
class Young(MaterialKind):
    """Young's modulus [Pa]."""

    unit = "Pa"
    digits = 0
    step = 1.0e5

    def read(self, scene: Scene) -> float:
        return self.material(scene).young

    def changed(self, material: Material, value: float) -> Material:
        return dataclasses.replace(material, young=value)


@dataclass(frozen=True)
class Residual(MaterialKind):
    """A residual strength: `friction_deg` [deg] or `cohesion` [Pa] after a long slip."""

    peak: str
    """Name of the constant at the peak."""

    @property
    def unit(self) -> str:  # type: ignore[override]
        """As it is printed."""
        return "deg" if self.peak == "friction_deg" else "Pa"

    @property
    def digits(self) -> int:  # type: ignore[override]
        """Decimals with which it is printed."""
        return 2 if self.peak == "friction_deg" else 1

    @property
    def step(self) -> float:  # type: ignore[override]
        """Step of a finite difference."""
        return 0.5 if self.peak == "friction_deg" else 10.0

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
        known = getattr(material, f"residual_{self.peak}")
        return float(getattr(material, self.peak) if known is None else known)

    def changed(self, material: Material, value: float) -> Material:
        return dataclasses.replace(material, **{f"residual_{self.peak}": value})
