"""Kinds of unknowns that the MPM alone knows: no surrogate has them among its inputs."""

import dataclasses
from abc import abstractmethod
from dataclasses import dataclass

from torch import Tensor

from datasets.errors import InputError
from datasets.material import Material
from datasets.scene import Mass, Scene
from gns.initial import InitialState
from inverse.parameters.kind import UP, Kind, Parts, Strength, there


class MpmKind(Kind):
    """A kind of unknown that is no input of a surrogate."""

    by_surrogate = False

    def enter(self, initial: InitialState, value: Tensor) -> InitialState:
        raise NotImplementedError("no surrogate has it as an input; `by_surrogate` says so")


@dataclass(frozen=True)
class SceneConstant(MpmKind):
    """A coefficient of the scene as a whole [-]: friction of floor, walls or baffles, damping."""

    name: str

    unit = "-"
    digits = 3
    step = 0.02
    positive = True

    def check(self, scene: Scene) -> None:
        if self.name == "baffle_friction" and not scene.baffles:
            raise InputError("expected a scene with baffles, there are none")

    def read(self, scene: Scene) -> float:
        return float(getattr(scene, self.name))

    def put(self, parts: Parts, value: float) -> None:
        parts.constants[self.name] = value


RESIDUAL = ("residual_friction_deg", "residual_cohesion")


@dataclass(frozen=True)
class MaterialConstant(MpmKind, Strength):
    """Young's modulus [Pa], or what is left of the strength after a long slip [deg, Pa]."""

    name: str

    positive = True

    @property
    def unit(self) -> str:  # type: ignore[override]
        """As it is printed."""
        return "deg" if self.name.endswith("_deg") else "Pa"

    @property
    def digits(self) -> int:  # type: ignore[override]
        """Decimals with which it is printed."""
        return {"young": 0, "residual_friction_deg": 2}.get(self.name, 1)

    @property
    def step(self) -> float:  # type: ignore[override]
        """Step of a finite difference."""
        return {"young": 1.0e5, "residual_friction_deg": 0.5}.get(self.name, 10.0)

    def check(self, scene: Scene) -> None:
        Strength.check(self, scene)
        if self.name in RESIDUAL and self.material(scene).softening_length is None:
            raise InputError("expected a material with a softening_length, it never falls to a residual strength")

    def read(self, scene: Scene) -> float:
        material = self.material(scene)
        known = getattr(material, self.name)
        # Unless they are named, residual values are those of the peak.
        return float(getattr(material, self.name.removeprefix("residual_")) if known is None else known)

    def changed(self, material: Material, value: float) -> Material:
        return dataclasses.replace(material, **{self.name: value})


@dataclass(frozen=True)
class SolidFriction(MpmKind):
    """Coulomb coefficient of a solid, the same all over it [-]."""

    solid: int

    unit = "-"
    digits = 3
    step = 0.02
    positive = True

    def check(self, scene: Scene) -> None:
        there("solids", self.solid, len(scene.solids))
        if not isinstance(scene.solids[self.solid].friction, float | int):
            raise InputError("expected a solid whose friction is a number in the scene, its own is a map")

    def read(self, scene: Scene) -> float:
        friction = scene.solids[self.solid].friction
        assert isinstance(friction, float | int), "`check` has been called"
        return float(friction)

    def put(self, parts: Parts, value: float) -> None:
        parts.solids[self.solid] = dataclasses.replace(parts.solids[self.solid], friction=value)


@dataclass(frozen=True)
class OfMass(MpmKind):
    """What one mass has of its own."""

    mass: int

    positive = True

    def check(self, scene: Scene) -> None:
        there("masses", self.mass, len(scene.masses))

    def put(self, parts: Parts, value: float) -> None:
        parts.masses[self.mass] = self.changed(parts.masses[self.mass], value)

    @abstractmethod
    def changed(self, mass: Mass, value: float) -> Mass:
        """The mass with this value."""


@dataclass(frozen=True)
class InitialStress(OfMass):
    """K0 of a mass, its horizontal over its vertical initial stress [-]."""

    unit = "-"
    digits = 3
    step = 0.05

    def check(self, scene: Scene) -> None:
        super().check(scene)
        if not isinstance(scene.masses[self.mass].k0, float | int):
            raise InputError("expected a mass whose k0 is a number in the scene, its own is none")

    def read(self, scene: Scene) -> float:
        return float(scene.masses[self.mass].k0 or 0.0)

    def changed(self, mass: Mass, value: float) -> Mass:
        return dataclasses.replace(mass, k0=value)


@dataclass(frozen=True)
class Height(OfMass):
    """Extent of a box along y, from its foot [m]: how much is released.

    Its particles fit their lattice to it, and have its volume exactly; their number changes by whole rows.
    """

    unit = "m"
    digits = 4
    step = 0.01
    changes_volume = True

    def check(self, scene: Scene) -> None:
        super().check(scene)
        if (kind := scene.masses[self.mass].kind) != "box":
            raise InputError(f"expected a mass of kind box, got a {kind}")

    def read(self, scene: Scene) -> float:
        return scene.masses[self.mass].size[UP]

    def changed(self, mass: Mass, value: float) -> Mass:
        return dataclasses.replace(mass, size=(*mass.size[:UP], value, *mass.size[UP + 1 :]))


@dataclass(frozen=True)
class Thickness(OfMass):
    """Thickness of a layer, the same all over it [m]: the release depth."""

    unit = "m"
    digits = 4
    step = 0.01
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
