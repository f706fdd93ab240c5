"""Kinds of numbers that can be unknown: their place in a scene, how they are read and set, and their units.

The functions `with_...` put a number into the surrogate's initial state, differentiably.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any, TypeVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from datasets.errors import InputError
from datasets.geometry.ground import ground_raster
from datasets.scene import DOMAIN_SIDES, Scene
from datasets.scene.material import Material, sine_of_slope
from gns.surroundings.initial import InitialState

Vector = NDArray[np.float64]  # a value per parameter, in the order of the problem and the units of the names, [U]

Draft = SimpleNamespace  # the fields of a scene while parameters change one by one, so that it is checked only once
Input = Callable[[Any, InitialState, Tensor], InitialState]
"""A kind, an initial state and a value -> the initial state with that value, differentiable in it."""
T = TypeVar("T", float, Tensor)
UP = 1
WITHOUT = dict.fromkeys(("permeability", "consolidation"), "its water does not flow")
WITHOUT |= {"softening_length": "it never falls to a residual strength"}
WITHOUT |= {"friction_limit_deg": "its friction does not grow with the rate"}
"""Constant -> behaviour of a material without it, if another constant requires it."""
INSTEAD = {"permeability": "consolidation", "consolidation": "permeability"}  # what a material may state instead
OWNERS = {"thickness": "a mass of kind layer", "discharge_factor": "an inflow"}
OWNERS |= dict.fromkeys(("k0", "initial_pore_pressure_ratio"), "a mass")
"""Attribute -> its owner; other attributes belong to surfaces."""


@dataclass(frozen=True, kw_only=True)
class Kind:
    """A number of a scene or of one of its masses, baffles and solids: how its value enters both forward models."""

    form: str  # its name, with `[]` instead of an index
    unit: str  # printed unit
    digits: int  # printed decimals
    index: int | None = None  # of the mass, baffle or solid; None for the scene as a whole
    attribute: str = ""  # attribute that holds it; default: the last part of its name
    axis: int | None = None  # component, if the attribute is a vector
    positive: bool = True  # whether it has a natural zero and no sign, so that an error can be compared with the value
    changes_volume: bool = False  # whether it changes the released volume
    order: int = 2
    """Parameters are set in ascending order: shared constants (0), then those of a mass, which take precedence (2);
    residual strengths come last in each group (1, 3), because the cohesion of their material scales them."""
    requires: str = ""  # for a constant of a material: another constant, without which it has no effect
    input: Input | None = None  # how it enters the surrogate; None if it is no input

    @property
    def group(self) -> str:
        """`masses`, `baffles`, `solids`; empty for the scene as a whole."""
        return self.form.split("[]")[0] if "[]" in self.form else ""

    @property
    def key(self) -> str:
        return self.attribute or self.form.split(".")[-1]

    @property
    def predicted(self) -> bool:
        """Whether the surrogate predicts flows with other values: it is an input, or it changes the particles."""
        return self.input is not None or self.changes_volume

    def text(self, value: float) -> str:
        return f"{self.digit_text(value)} {self.unit}".removesuffix(" -")

    def digit_text(self, value: float) -> str:
        """The value without unit: with `digits` decimals, or with three figures if these would leave fewer than two."""
        return f"{value:.3g}" if 0.0 < abs(value) < 10.0 ** (1 - self.digits) else f"{value:z.{self.digits}f}"

    def check(self, scene: Scene) -> None:
        """Raise InputError if `scene` has no such number."""
        if self.index is not None and self.index >= (count := len(getattr(scene, self.group))):
            got = f"the number of {self.group} in the scene, got {self.index}"
            raise InputError(f"expected an index below {count}, {got}")
        if self.axis is not None and self.axis >= scene.dimension:
            message = f"the scene is {scene.dimension}D and has no {'xyz'[self.axis]}"
            raise InputError(f"expected a parameter along x or y, {message}")
        if idle := self.idle(scene):
            raise InputError(f"expected a quantity on which the flow depends, {idle}")
        if self.form == "masses[].height" and (kind := self.holder(scene).kind) != "box":
            raise InputError(f"expected a mass of kind box, got a {kind}")
        if self.axis is None and not isinstance(getattr(self.holder(scene), self.key, 0.0), float | int):
            owner = OWNERS.get(self.key, "a surface")
            raise InputError(f"expected {owner} whose {self.key} is a number in the scene, its own is none")

    def idle(self, scene: Scene) -> str:
        """Why the flow of `scene` does not depend on it, in words; empty if it does."""
        if self.form == "baffle_friction" and not scene.baffles:
            return "there are no baffles"
        if self.form == "baffle_friction" and all(baffle.friction is not None for baffle in scene.baffles):
            return "every baffle has a friction of its own"
        if self.form == "wall_friction" and scene.channel is not None:
            return "the walls of a channel have channel.friction_deg"
        if self.form == "wall_friction" and set(DOMAIN_SIDES[: 2 * scene.dimension]) - {"y-"} <= {*scene.open_sides}:
            return "all sides of the box are open"
        if self.form == "floor_friction" and "y-" in scene.open_sides:
            return "the floor is open"
        if self.form == "floor_friction" and scene.solids and (ground_raster(scene, scene.domain.cell)[2] >= 0).all():
            return "terrain covers the floor"
        if self.form == "solids[].friction" and self.holder(scene).contact != "coulomb":
            return f"solids[{self.index}] lets nothing slide"
        varies = [field.mass for field in scene.fields if field.quantity == self.form.split(".")[-1]]
        shared = [number for number, mass in enumerate(scene.masses) if mass.material is None]
        masses = shared if self.index is None else [self.index]
        if varies and (None in varies or set(masses) <= {*varies}):
            return "a field of the scene takes its place"
        return ""

    def holder(self, scene: Scene | Draft) -> Any:
        return scene if self.index is None else getattr(scene, self.group)[self.index]

    def value(self, holder: Any) -> float:
        current = getattr(holder, self.key)
        return float(current if self.axis is None else current[self.axis])

    def changes(self, draft: Draft, value: float) -> dict[str, Any]:
        """The changes of its scene, mass, baffle or solid with this value."""
        return {self.key: self.vector(getattr(self.holder(draft), self.key), value)}

    def vector(self, components: Any, value: float) -> Any:
        """The value, or the vector `components` with it as its component."""
        axis = self.axis
        return value if axis is None else (*components[:axis], value, *components[axis + 1 :])

    def read(self, scene: Scene) -> float:
        return self.value(self.holder(scene))

    def put(self, draft: Draft, value: float) -> None:
        """Set this value in the scene of the MPM. Use `with_parameters`."""
        changes = self.changes(draft, value)
        if self.index is None:
            vars(draft).update(changes)
            return
        members = list(getattr(draft, self.group))
        members[self.index] = replace(members[self.index], **changes)
        setattr(draft, self.group, tuple(members))


class Velocity(Kind):
    """Initial velocity of a mass along an axis [m/s]; a mass without any is at rest."""

    def value(self, holder: Any) -> float:
        return super().value(holder) if holder.velocity else 0.0

    def changes(self, draft: Draft, value: float) -> dict[str, Any]:
        mass = self.holder(draft)
        return {"velocity": self.vector(mass.velocity or (0.0,) * len(mass.size), value)}


class PartNumber(Kind):
    """A number of a part that not every scene has: friction of a channel's walls [deg], elevation of the water [m]."""

    def check(self, scene: Scene) -> None:
        if getattr(self.holder(scene), self.key, None) is None:
            raise InputError(f"expected a scene with a {self.form}, there is none")

    def holder(self, scene: Scene | Draft) -> Any:
        return getattr(scene, self.form.split(".")[0])

    def changes(self, draft: Draft, value: float) -> dict[str, Any]:
        change: dict[str, Any] = {self.key: value}
        return {self.form.split(".")[0]: replace(self.holder(draft), **change)}


class Clock(Kind):
    """Delay of the observations' clock after the start of the flow [s]; the flow does not depend on it."""

    def read(self, scene: Scene) -> float:
        return 0.0

    def changes(self, draft: Draft, value: float) -> dict[str, Any]:
        return {}


class Constant(Kind):
    """A constant of the material of a mass, or of the shared material."""

    def check(self, scene: Scene) -> None:
        super().check(scene)
        if self.index is None and all(mass.material is not None for mass in scene.masses):
            raise InputError("expected a mass of the scene's shared material, every mass has its own")
        if self.requires and getattr(self.material(scene), self.requires) is None:
            other = INSTEAD.get(self.requires)
            stated = other is not None and getattr(self.material(scene), other) is not None
            said = f"it states a {other}: make that the unknown" if stated else WITHOUT[self.requires]
            raise InputError(f"expected a material with a {self.requires}, {said}")

    def material(self, scene: Scene | Draft) -> Material:
        override = None if self.index is None else scene.masses[self.index].material
        effective: Material = override or scene.material
        return effective

    def read(self, scene: Scene) -> float:
        return self.value(self.material(scene))

    def changes(self, draft: Draft, value: float) -> dict[str, Any]:
        change: dict[str, Any] = {self.key: value}
        return {"material": replace(self.material(draft), **change)}


class Cohesion(Constant):
    """Cohesion [Pa]. The tension cutoff and residual values change with it in proportion."""

    def changes(self, draft: Draft, value: float) -> dict[str, Any]:
        material = self.material(draft)
        # Without cohesion there is no ratio, and cutoff and residual values are unchanged.
        ratio = value / material.cohesion if material.cohesion > 0.0 else 1.0
        keys = ("tension_cutoff", "residual_cohesion", "residual_tension_cutoff")
        strengths = {key: getattr(material, key) for key in keys}
        scaled = {key: ratio * strength for key, strength in strengths.items() if strength is not None}
        return {"material": replace(material, cohesion=value, **scaled)}


class Residual(Constant):
    """A residual strength: friction angle [deg] or cohesion [Pa] after a long slip."""

    def value(self, holder: Any) -> float:
        # By default, residual values equal the peak values.
        residual = getattr(holder, self.key)
        return float(getattr(holder, self.key.removeprefix("residual_")) if residual is None else residual)


class Extent(Kind):
    """Extent of a baffle [m]: upwards from its foot, else about its centre."""

    def changes(self, draft: Draft, value: float) -> dict[str, Any]:
        assert self.axis is not None, "a length along an axis"
        baffle = self.holder(draft)
        low, size = self.moved(baffle.lower[self.axis], baffle.size[self.axis], value)
        return {"lower": self.vector(baffle.lower, low), "size": self.vector(baffle.size, size)}

    def moved(self, low: T, size: T, value: T) -> tuple[T, T]:
        """Lower end and extent along the axis [m] with this value."""
        return (low if self.axis == UP else low + 0.5 * size - 0.5 * value), value


class Centre(Extent):
    """The centre of a baffle [m]."""

    def value(self, holder: Any) -> float:
        assert self.axis is not None, "a length along an axis"
        return float(holder.lower[self.axis] + 0.5 * holder.size[self.axis])

    def moved(self, low: T, size: T, value: T) -> tuple[T, T]:
        return value - 0.5 * size, size


def with_friction(kind: Constant, initial: InitialState, value: Tensor) -> InitialState:
    """Friction angle [deg], which enters as tan(phi) (`datasets.scene.material` explains which angle)."""
    current, tangent = initial.conditions.friction, tangent_of(kind.material(initial.scene), value)
    friction = torch.where(initial.of_mass(kind.index), tangent.to(current.dtype), current)
    return initial.with_conditions(friction=friction)


def tangent_of(material: Material, angle_deg: Tensor) -> Tensor:
    """tan(phi) [-] of friction angles [deg] measured like those of `material`, of the same shape."""
    tangent = torch.tan(torch.deg2rad(angle_deg))
    if material.angle == "slope":
        sine = sine_of_slope(tangent, math.radians(material.dilation_deg))
        tangent = sine / torch.sqrt(1.0 - sine * sine)
    return tangent


def with_cohesion(kind: Constant, initial: InitialState, value: Tensor) -> InitialState:
    """Cohesion at the top [Pa]; its increase with depth is unchanged."""
    current, material = initial.conditions.cohesion, kind.material(initial.scene)
    changed = current + (value - material.cohesion).to(current.dtype)
    return initial.with_conditions(cohesion=torch.where(initial.of_mass(kind.index), changed, current))


def with_velocity(kind: Kind, initial: InitialState, value: Tensor) -> InitialState:
    """Initial velocity of a mass [m/s]."""
    return thrown(initial, initial.of_mass(kind.index), kind.axis or 0, value)


def thrown(initial: InitialState, members: Tensor, axis: int, velocity: Tensor) -> InitialState:
    """The state in which particles, members [n], have a velocity along an axis [m/s], one or [n], and always had it."""
    state = initial.state
    mask = members[:, None] & (torch.arange(state.positions.shape[1]) == axis)
    displacement = (velocity * initial.step).to(state.displacements.dtype).reshape(-1, 1)
    displacements = torch.where(mask, displacement, state.displacements)
    return replace(initial, state=replace(state, displacements=displacements))


def with_baffle(kind: Extent, initial: InitialState, value: Tensor) -> InitialState:
    """Centre or extent of a baffle [m]."""
    boxes, index = initial.conditions.baffles, kind.index or 0
    assert boxes is not None, "the scene has baffles, and so has the model"
    number, corner, axis = torch.meshgrid(*map(torch.arange, boxes.shape[1:]), indexing="ij")
    mask = torch.eq(number, index) & torch.eq(axis, kind.axis or 0)
    lower, upper = boxes[0, index, :, kind.axis]
    low, size = kind.moved(lower, upper - lower, value.to(boxes.dtype))
    return initial.with_conditions(baffles=torch.where(mask, low + corner * size, boxes))


def with_baffle_friction(kind: Kind, initial: InitialState, value: Tensor) -> InitialState:
    """Friction of the baffles without their own [-]."""
    current = initial.conditions.baffle_friction
    assert current is not None, "the scene has baffles, and so has the model"
    shared = torch.tensor([baffle.friction is None for baffle in initial.scene.baffles])
    return initial.with_conditions(baffle_friction=torch.where(shared, value.to(current.dtype), current))


def with_constant(kind: Kind, initial: InitialState, value: Tensor) -> InitialState:
    """Friction of the walls, damping [-]."""
    current = getattr(initial.conditions, kind.key)
    return initial.with_conditions(**{kind.key: value.to(current.dtype).expand_as(current)})


def with_floor_friction(kind: Kind, initial: InitialState, value: Tensor) -> InitialState:
    """Friction of the floor [-], including floor beside terrain."""
    return with_ground_friction(kind, with_constant(kind, initial, value), value)


def with_ground_friction(kind: Kind, initial: InitialState, value: Tensor) -> InitialState:
    """Friction of the ground [-] that is the terrain of this index or, without an index, the floor."""
    ground = initial.conditions.ground
    if ground is None:
        return initial
    index = -1 if kind.index is None else kind.index
    mask = torch.from_numpy(ground_raster(initial.scene, ground.spacing)[2] == index)
    friction = torch.where(mask, value.to(ground.friction.dtype), ground.friction)
    return initial.with_conditions(ground=replace(ground, friction=friction))


_MATERIAL = (
    Constant(form="friction_deg", unit="deg", digits=2, order=0, input=with_friction),
    Cohesion(form="cohesion", unit="Pa", digits=1, order=0, input=with_cohesion),
    Constant(form="young", unit="Pa", digits=0, order=0),
    Residual(form="residual_friction_deg", unit="deg", digits=2, order=1, requires="softening_length"),
    Residual(form="residual_cohesion", unit="Pa", digits=1, order=1, requires="softening_length"),
    Constant(form="friction_limit_deg", unit="deg", digits=2, order=1, requires="friction_limit_deg"),
    Constant(form="inertial_number", unit="-", digits=3, order=1, requires="friction_limit_deg"),
    Constant(form="permeability", unit="m/s", digits=7, order=0, requires="permeability"),
    Constant(form="consolidation", unit="m^2/s", digits=6, order=0, requires="consolidation"),
)
_AXES = {"x": 0, "y": 1, "z": 2}
_VELOCITY: dict[str, Any] = {"unit": "m/s", "digits": 3, "attribute": "velocity", "input": with_velocity}
_BAFFLE: dict[str, Any] = {"unit": "m", "digits": 4, "attribute": "size", "input": with_baffle}

KINDS: dict[str, Kind] = {
    each.form: each
    for each in (
        *_MATERIAL,
        Kind(form="floor_friction", unit="-", digits=3, input=with_floor_friction),
        PartNumber(form="water.level", unit="m", digits=4, positive=False),
        PartNumber(form="channel.friction_deg", unit="deg", digits=2),
        Kind(form="wall_friction", unit="-", digits=3, input=with_constant),
        Kind(form="baffle_friction", unit="-", digits=3, input=with_baffle_friction),
        Kind(form="damping", unit="-", digits=3, input=with_constant),
        Clock(form="time_offset", unit="s", digits=4, positive=False),
        *(replace(each, form=f"masses[].{each.form}", order=each.order + 2) for each in _MATERIAL),
        *(Velocity(form=f"masses[].velocity_{x}", axis=axis, positive=False, **_VELOCITY) for x, axis in _AXES.items()),
        *(Centre(form=f"baffles[].{x}", axis=_AXES[x], positive=False, **_BAFFLE) for x in "xz"),
        Extent(form="baffles[].length", axis=_AXES["x"], positive=False, **_BAFFLE),
        Extent(form="baffles[].height", axis=_AXES["y"], positive=False, **_BAFFLE),
        Extent(form="baffles[].width", axis=_AXES["z"], positive=False, **_BAFFLE),
        Kind(form="masses[].k0", unit="-", digits=3),
        Kind(form="masses[].initial_pore_pressure_ratio", unit="-", digits=3),
        Kind(form="masses[].height", unit="m", digits=4, attribute="size", axis=_AXES["y"], changes_volume=True),
        Kind(form="masses[].thickness", unit="m", digits=4, changes_volume=True),
        Kind(form="masses[].discharge_factor", unit="-", digits=3, changes_volume=True),
        Kind(form="solids[].friction", unit="-", digits=3, input=with_ground_friction),
        Kind(form="solids[].turbulence", unit="m/s^2", digits=1),
    )
}
"""Name, with `[]` instead of an index -> kind."""
