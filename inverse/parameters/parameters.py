"""What can be unknown, and how each enters a scene and the surrogate's initial state. A new kind is added here alone.

| name | unit | what it is |
|---|---|---|
| `friction_deg`, `cohesion` | deg, Pa | of the scene's shared material |
| `masses[I].friction_deg`, `masses[I].cohesion` | deg, Pa | of mass I, counted from 0, whose material is its own then |
| `masses[I].velocity_x`, `_y`, `_z` | m/s | initial velocity of mass I |
| `baffles[I].x`, `.z` | m | centre of baffle I |
| `baffles[I].length`, `.width` | m | its extent along x and z, about the centre |
| `baffles[I].height` | m | its extent along y, from its foot |
| `floor_friction`, `wall_friction`, `baffle_friction`, `damping` | - | of the scene |
| `young`, `residual_friction_deg`, `residual_cohesion` | Pa, deg, Pa | of the material, shared or of `masses[I]` |
| `masses[I].k0` | - | ratio of the initial stresses of mass I |
| `masses[I].height`, `.thickness` | m | extent of a box along y from its foot; thickness of a layer |
| `solids[I].friction` | - | Coulomb coefficient of solid I |

The last five rows are the MPM's alone: no surrogate is told of them, the loop then runs without one.
A cohesion takes the tension cutoff along: their ratio stays what it is in the scene, the default where it names none.
"""

import dataclasses
import itertools
import re
from abc import abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from datasets.errors import InputError
from datasets.material import Material
from datasets.scene import Baffle, Scene
from datasets.scene import Vector as Lengths
from gns.initial import InitialState
from inverse.parameters.kind import AXES, UP, Kind, Parts, Strength, T, Vector, there
from inverse.parameters.mpm_kinds import (
    Height,
    InitialStress,
    MaterialConstant,
    SceneConstant,
    SolidFriction,
    Thickness,
)

__all__ = ["Vector", "kind", "launched", "swept", "with_unknowns"]


@dataclass(frozen=True)
class Friction(Strength):
    """Angle of internal friction [deg]; the surrogate is told its tangent."""

    unit = "deg"
    positive = True
    digits = 2
    step = 0.05  # the paper's

    def read(self, scene: Scene) -> float:
        return self.material(scene).friction_deg

    def changed(self, material: Material, value: float) -> Material:
        return dataclasses.replace(material, friction_deg=value)

    def enter(self, initial: InitialState, value: Tensor) -> InitialState:
        known = initial.conditions.friction
        friction = torch.tan(torch.deg2rad(value)).to(known.dtype)
        friction = torch.where(initial.of_mass(self.mass), friction, known)
        return initial.with_conditions(friction=friction)


@dataclass(frozen=True)
class Cohesion(Strength):
    """Cohesion [Pa]."""

    unit = "Pa"
    positive = True
    digits = 1
    step = 1.0

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
        cohesion = torch.where(initial.of_mass(self.mass), value.to(known.dtype), known)
        return initial.with_conditions(cohesion=cohesion)


@dataclass(frozen=True)
class Velocity(Kind):
    """Initial velocity of a mass along an axis [m/s]."""

    mass: int
    axis: int

    unit = "m/s"
    digits = 3
    step = 0.01
    moves_the_start = True

    def check(self, scene: Scene) -> None:
        there("masses", self.mass, len(scene.masses))
        _along(self.axis, scene)

    def read(self, scene: Scene) -> float:
        return (scene.masses[self.mass].velocity or (0.0,) * scene.dimension)[self.axis]

    def put(self, parts: Parts, value: float) -> None:
        mass = parts.masses[self.mass]
        velocity = _with(mass.velocity or (0.0,) * len(mass.size), self.axis, value)
        parts.masses[self.mass] = dataclasses.replace(mass, velocity=velocity)

    def enter(self, initial: InitialState, value: Tensor) -> InitialState:
        # As `gns.model.state.State.moving`: it has always moved like this.
        state = initial.state
        along = torch.arange(state.positions.shape[1]) == self.axis
        mine = initial.of_mass(self.mass).unsqueeze(1) & along
        moved = (value * initial.step).to(state.displacements.dtype)
        displacements = torch.where(mine, moved, state.displacements)
        return initial.with_displacements(displacements)


@dataclass(frozen=True)
class BaffleKind(Kind):
    """A length of a baffle along an axis [m]."""

    baffle: int
    axis: int

    unit = "m"
    digits = 4
    step = 0.002

    def check(self, scene: Scene) -> None:
        there("baffles", self.baffle, len(scene.baffles))
        _along(self.axis, scene)

    def put(self, parts: Parts, value: float) -> None:
        baffle = parts.baffles[self.baffle]
        low, size = self.changed(baffle.lower[self.axis], baffle.size[self.axis], value)
        lower = _with(baffle.lower, self.axis, low)
        parts.baffles[self.baffle] = dataclasses.replace(baffle, lower=lower, size=_with(baffle.size, self.axis, size))

    def enter(self, initial: InitialState, value: Tensor) -> InitialState:
        boxes = initial.conditions.baffles
        assert boxes is not None, "the scene was checked, and a model that knows no baffles refuses it"
        number, corner, axis = torch.meshgrid(*map(torch.arange, boxes.shape[1:]), indexing="ij")
        mine = (number == self.baffle) & (axis == self.axis)
        lower, upper = boxes[0, self.baffle, :, self.axis]
        low, size = self.changed(lower, upper - lower, value.to(boxes.dtype))
        boxes = torch.where(mine, low + corner * size, boxes)
        return initial.with_conditions(baffles=boxes)

    @abstractmethod
    def changed(self, low: T, size: T, value: T) -> tuple[T, T]:
        """Lower end and extent along the axis [m] with this value."""


@dataclass(frozen=True)
class Centre(BaffleKind):
    """Where the middle of a baffle stands [m]."""

    def read(self, scene: Scene) -> float:
        baffle = scene.baffles[self.baffle]
        return baffle.lower[self.axis] + 0.5 * baffle.size[self.axis]

    def changed(self, low: T, size: T, value: T) -> tuple[T, T]:
        return value - 0.5 * size, size


@dataclass(frozen=True)
class Extent(BaffleKind):
    """Extent of a baffle [m]: upwards from its foot, else about its centre."""

    def read(self, scene: Scene) -> float:
        return scene.baffles[self.baffle].size[self.axis]

    def changed(self, low: T, size: T, value: T) -> tuple[T, T]:
        return (low if self.axis == UP else low + 0.5 * size - 0.5 * value), value


_FORMS: dict[str, Callable[[int], Kind]] = {
    "friction_deg": lambda _: Friction(None),
    "cohesion": lambda _: Cohesion(None),
    "masses[].friction_deg": Friction,
    "masses[].cohesion": Cohesion,
    "masses[].velocity_x": lambda mass: Velocity(mass, 0),
    "masses[].velocity_y": lambda mass: Velocity(mass, 1),
    "masses[].velocity_z": lambda mass: Velocity(mass, 2),
    "baffles[].x": lambda baffle: Centre(baffle, 0),
    "baffles[].z": lambda baffle: Centre(baffle, 2),
    "baffles[].length": lambda baffle: Extent(baffle, 0),
    "baffles[].height": lambda baffle: Extent(baffle, UP),
    "baffles[].width": lambda baffle: Extent(baffle, 2),
    "floor_friction": lambda _: SceneConstant("floor_friction"),
    "wall_friction": lambda _: SceneConstant("wall_friction"),
    "baffle_friction": lambda _: SceneConstant("baffle_friction"),
    "damping": lambda _: SceneConstant("damping"),
    "young": lambda _: MaterialConstant(None, "young"),
    "residual_friction_deg": lambda _: MaterialConstant(None, "residual_friction_deg"),
    "residual_cohesion": lambda _: MaterialConstant(None, "residual_cohesion"),
    "masses[].young": lambda mass: MaterialConstant(mass, "young"),
    "masses[].residual_friction_deg": lambda mass: MaterialConstant(mass, "residual_friction_deg"),
    "masses[].residual_cohesion": lambda mass: MaterialConstant(mass, "residual_cohesion"),
    "masses[].k0": InitialStress,
    "masses[].height": Height,
    "masses[].thickness": Thickness,
    "solids[].friction": SolidFriction,
}


def kind(name: str) -> Kind:
    """What `name` stands for. Raises InputError."""
    index = re.search(r"\[(\d{1,6})\]", name)
    form = name if index is None else name[: index.start() + 1] + name[index.end() - 1 :]
    # An index is part of a name exactly where its form has brackets.
    if form not in _FORMS or ("[]" in form) != (index is not None):
        known = ", ".join(each.replace("[]", "[0]") for each in _FORMS)
        raise InputError(f"expected one of {known}, got {name!r}")
    return _FORMS[form](int(index[1]) if index else 0)


def with_unknowns(scene: Scene, names: Sequence[str], values: Sequence[float] | Vector) -> Scene:
    """`scene` with the unknowns `names` set to `values`. Raises InputError for a scene that cannot be."""
    parts = Parts(
        material=scene.material, masses=list(scene.masses), baffles=list(scene.baffles), solids=list(scene.solids)
    )
    for place in _shared_first(names):
        kind(names[place]).put(parts, float(values[place]))
    return dataclasses.replace(
        scene,
        material=parts.material,
        masses=tuple(parts.masses),
        baffles=tuple(parts.baffles),
        solids=tuple(parts.solids),
        **parts.constants,  # type: ignore[arg-type]
    )


def launched(initial: InitialState, names: Sequence[str], values: Tensor) -> InitialState:
    """`initial` with the unknowns `names` set to `values` [U], differentiable in them."""
    for place in _shared_first(names):
        initial = kind(names[place]).enter(initial, values[place])
    return initial


def swept(scene: Scene, names: Sequence[str], bounds: Sequence[tuple[float, float]]) -> dict[int, Baffle]:
    """The box that each baffle with an unknown may stand in, while each unknown stays in its (lower, upper)."""
    boxes = {}
    for index in sorted({each.baffle for each in map(kind, names) if isinstance(each, BaffleKind)}):
        own = [place for place, name in enumerate(names) if getattr(kind(name), "baffle", None) == index]
        ends = []
        for values in itertools.product(*(bounds[place] for place in own)):
            parts = Parts(material=scene.material, masses=[], baffles=list(scene.baffles))
            for place, value in zip(own, values, strict=True):
                kind(names[place]).put(parts, value)
            baffle = parts.baffles[index]
            ends.append((np.array(baffle.lower), np.array(baffle.lower) + baffle.size))
        lower = np.min([low for low, _ in ends], axis=0).round(9)
        upper = np.max([high for _, high in ends], axis=0).round(9)
        boxes[index] = Baffle(lower=tuple(lower.tolist()), size=tuple((upper - lower).round(9).tolist()))
    return boxes


def _shared_first(names: Sequence[str]) -> list[int]:
    """Places of `names`, shared constants first: those of a single mass count more, in whatever order they stand.

    Residual values last: a cohesion takes them along.
    """
    return sorted(range(len(names)), key=lambda place: ("[" in names[place], "residual" in names[place]))


def _with(lengths: Lengths, axis: int, value: float) -> Lengths:
    return (*lengths[:axis], value, *lengths[axis + 1 :])


def _along(axis: int, scene: Scene) -> None:
    if axis >= scene.dimension:
        raise InputError(f"expected an unknown along x or y, the scene is {scene.dimension}D and has no {AXES[axis]}")
