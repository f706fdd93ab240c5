"""A kind of parameter: something of a scene that can be unknown, and how its value enters the MPM and the surrogate."""

import dataclasses
from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from datasets.errors import InputError
from datasets.material import Material
from datasets.scene import Baffle, Mass, Scene, Solid
from gns.initial import InitialState

Vector = NDArray[np.float64]
"""One value per parameter, in the order of the problem and the units of the names; shape [U]."""

Lengths = tuple[float, ...]
T = TypeVar("T", float, Tensor)

AXES = "xyz"
UP = 1


@dataclass
class Parts:
    """The parts of a scene that parameters change: a scene is checked when it is put together again."""

    material: Material
    masses: list[Mass]
    baffles: list[Baffle]
    solids: list[Solid]
    constants: dict[str, float] = field(default_factory=dict)
    """Of the scene as a whole, by their names."""

    @classmethod
    def split(cls, scene: Scene) -> "Parts":
        """The parts of `scene`."""
        return cls(scene.material, list(scene.masses), list(scene.baffles), list(scene.solids))

    def joined(self, scene: Scene) -> Scene:
        """`scene` with these parts. Raises InputError for one that cannot be simulated."""
        return dataclasses.replace(
            scene,
            material=self.material,
            masses=tuple(self.masses),
            baffles=tuple(self.baffles),
            solids=tuple(self.solids),
            **self.constants,  # type: ignore[arg-type]
        )


class Kind(ABC):
    """What a parameter is: one object for its unit, its value in a scene and how it enters both forward models."""

    unit: str
    """As it is printed."""
    digits: int
    """Decimals with which it is printed."""
    step: float
    """Step of a finite difference, unless the problem has its own."""
    positive: bool = False
    """Whether it is a quantity with a zero of its own and no sign, so that an error can be compared with the value."""
    changes_volume: bool = False
    """Whether more or less material is released with it."""
    differentiable: bool = False
    """Whether it is an input of the surrogate, which is differentiable in it; else the MPM's alone."""
    independent: bool = False
    """Whether a scene that can be simulated with all such parameters at a bound can be with each there alone."""
    order: int = 2
    """Parameters are set in ascending order: shared material (0), its residual strength (1), others (2, 3)."""

    def text(self, value: float) -> str:
        """A value with its unit."""
        return f"{value:z.{self.digits}f} {self.unit}".removesuffix(" -")

    @abstractmethod
    def check(self, scene: Scene) -> None:
        """Raise InputError where `scene` has no such thing."""

    @abstractmethod
    def read(self, scene: Scene) -> float:
        """Its value in `scene`."""

    @abstractmethod
    def put(self, parts: Parts, value: float) -> None:
        """Set this value: how it enters the MPM. Use `with_parameters`."""

    def enter(self, initial: InitialState, value: Tensor) -> InitialState:
        """`initial` with this value, differentiable in it: how it enters the surrogate."""
        raise NotImplementedError("no surrogate has it as an input; `differentiable` says so")


def require_index(group: str, index: int, count: int) -> None:
    """Raise InputError unless the scene has a member `index` of `group`."""
    if index >= count:
        raise InputError(f"expected an index below {count}, the number of {group} in the scene, got {index}")


def require_axis(axis: int, scene: Scene) -> None:
    """Raise InputError unless `scene` has this axis."""
    if axis >= scene.dimension:
        raise InputError(f"expected a parameter along x or y, the scene is {scene.dimension}D and has no {AXES[axis]}")


def replaced(lengths: Lengths, axis: int, value: float) -> Lengths:
    """`lengths` with another one along `axis`."""
    return (*lengths[:axis], value, *lengths[axis + 1 :])
