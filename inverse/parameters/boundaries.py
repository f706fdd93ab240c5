"""Friction of floor, walls, baffles and solids, and damping: coefficients of the MPM alone."""

import dataclasses
from dataclasses import dataclass

from datasets.errors import InputError
from datasets.scene import Scene
from inverse.parameters.kind import Kind, Parts, require_index


@dataclass(frozen=True)
class SceneConstant(Kind):
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


@dataclass(frozen=True)
class SolidFriction(Kind):
    """Coulomb coefficient of a solid, the same all over it [-]."""

    solid: int

    unit = "-"
    digits = 3
    step = 0.02
    positive = True

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
