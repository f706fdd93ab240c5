"""Kind: something of a scene that can be unknown, and how its value enters the MPM and the surrogate."""

import dataclasses
from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import ClassVar, TypeVar

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from datasets.errors import InputError
from datasets.geometry.solid import Solid
from datasets.material import Material
from datasets.scene import Baffle, Mass, Scene
from gns.initial import InitialState

Vector = NDArray[np.float64]
"""One value per unknown, in the order of the problem and the units of the names; shape [U]."""

T = TypeVar("T", float, Tensor)

AXES = "xyz"
UP = 1


@dataclass
class Parts:
    """What of a scene can be unknown, taken apart: a scene is checked when it is put together again."""

    material: Material
    masses: list[Mass]
    baffles: list[Baffle]
    solids: list[Solid] = field(default_factory=list)
    constants: dict[str, float] = field(default_factory=dict)
    """Of the scene as a whole, by their names."""


class Kind(ABC):
    """A kind of unknown."""

    unit: ClassVar[str]
    """As it is printed."""
    digits: ClassVar[int]
    """Decimals with which it is printed."""
    step: ClassVar[float]
    """Step of a finite difference, unless the problem has its own."""
    positive: ClassVar[bool] = False
    """Whether it is a quantity with a zero of its own and no sign, so that an error can be compared with the value."""
    changes_volume: ClassVar[bool] = False
    """Whether more or less material is released with it."""
    by_surrogate: ClassVar[bool] = True
    """Whether the learned surrogate is told of it, and is differentiable in it."""
    moves_the_start: ClassVar[bool] = False
    """Whether the MPM's first frames depend on it so much that a rollout has to begin before them."""

    @abstractmethod
    def check(self, scene: Scene) -> None:
        """Raise InputError where `scene` has no such thing."""

    @abstractmethod
    def read(self, scene: Scene) -> float:
        """Its value in `scene`."""

    @abstractmethod
    def put(self, parts: Parts, value: float) -> None:
        """Give it this value: how it enters the MPM. Use `with_unknowns`."""

    @abstractmethod
    def enter(self, initial: InitialState, value: Tensor) -> InitialState:
        """`initial` with this value, differentiable in it: how it enters the surrogate. Use `launched`."""


@dataclass(frozen=True)
class Strength(Kind):
    """A constant of the material of a mass, or for None of the shared one."""

    mass: int | None

    def check(self, scene: Scene) -> None:
        if self.mass is not None:
            there("masses", self.mass, len(scene.masses))
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
        parts.masses[self.mass] = dataclasses.replace(
            mass, material=self.changed(mass.material or parts.material, value)
        )

    @abstractmethod
    def changed(self, material: Material, value: float) -> Material:
        """`material` with this value."""


def there(group: str, index: int, count: int) -> None:
    """Raise InputError unless the scene has a member `index` of `group`."""
    if index >= count:
        raise InputError(f"expected an index below {count}, the number of {group} in the scene, got {index}")
