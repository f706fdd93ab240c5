"""Friction of floor, walls, baffles and solids, and damping."""

import dataclasses
from dataclasses import dataclass

import torch
from torch import Tensor

from datasets.errors import InputError
from datasets.geometry.ground import ground_raster
from datasets.scene import Scene
from gns.initial import InitialState
from inverse.parameters.kind import Kind, Parts, require_index


@dataclass(frozen=True)
class SceneConstant(Kind):
    """A coefficient of the scene as a whole [-]: friction of floor, walls or baffles, damping."""

    name: str

    unit = "-"
    digits = 3
    step = 0.02
    positive = True
    differentiable = True

    def check(self, scene: Scene) -> None:
        if self.name == "baffle_friction" and not scene.baffles:
            raise InputError("expected a scene with baffles, there are none")

    def read(self, scene: Scene) -> float:
        return float(getattr(scene, self.name))

    def put(self, parts: Parts, value: float) -> None:
        parts.constants[self.name] = value

    def enter(self, initial: InitialState, value: Tensor) -> InitialState:
        known = getattr(initial.conditions, self.name)
        value = value.to(known.dtype)
        if self.name == "baffle_friction":
            # Of the baffles that have none of their own.
            shared = torch.tensor([baffle.friction is None for baffle in initial.scene.baffles])
            return initial.with_conditions(baffle_friction=torch.where(shared, value, known))
        changed = initial.with_conditions(**{self.name: value.expand_as(known)})
        return with_ground_friction(changed, None, value) if self.name == "floor_friction" else changed


@dataclass(frozen=True)
class SolidFriction(Kind):
    """Coulomb coefficient of a solid, the same all over it [-]."""

    solid: int

    unit = "-"
    digits = 3
    step = 0.02
    positive = True
    differentiable = True

    def check(self, scene: Scene) -> None:
        require_index("solids", self.solid, len(scene.solids))
        if not isinstance(scene.solids[self.solid].friction, float | int):
            raise InputError("expected a solid whose friction is a number in the scene, its own is a map")

    def read(self, scene: Scene) -> float:
        friction = scene.solids[self.solid].friction
        assert isinstance(friction, float | int), "`check` has been called"
        return float(friction)

    def put(self, parts: Parts, value: float) -> None:
        parts.solids[self.solid] = dataclasses.replace(parts.solids[self.solid], friction=value)

    def enter(self, initial: InitialState, value: Tensor) -> InitialState:
        return with_ground_friction(initial, self.solid, value)


def with_ground_friction(initial: InitialState, solid: int | None, value: Tensor) -> InitialState:
    """`initial` with the coefficient `value` where the ground is the terrain `solid`, for None the floor."""
    ground = initial.conditions.ground
    if ground is None:
        return initial
    own = torch.from_numpy(ground_raster(initial.scene, ground.spacing)[2] == (-1 if solid is None else solid))
    friction = torch.where(own, value.to(ground.friction.dtype), ground.friction)
    return initial.with_conditions(ground=dataclasses.replace(ground, friction=friction))
