"""The units in which a flow is the same at any size. Nothing here needs torch.

Flows of dry rigid grains have no length scale of their own (Froude similarity; for granular columns e.g. Lajeunesse,
Monnier & Homsy, Phys. Fluids 17, 103302, 2005). With the length l of the released body, gravity g and density rho

    x / l,    t / sqrt(l / g),    v / sqrt(g l),    sigma / (rho g l)

are the same in a flume and on a hillside. A model runs every scene at its own size (`in_model_units`). The stiffness is
left out, because sand hardly deforms under its own weight.
"""

import math
from dataclasses import dataclass

from datasets.errors import InputError
from datasets.scene import Scene
from datasets.scene.particles import released_volume
from gns.settings import GRAVITY, ModelSettings


@dataclass(frozen=True, kw_only=True)
class Units:
    """Size of the units of length, time and stress in a scene; all 1 for a model's training data."""

    length: float = 1.0  # [m]
    time: float = 1.0  # [s]
    stress: float = 1.0  # [Pa]

    @property
    def speed(self) -> float:
        return self.length / self.time  # [m/s]

    @staticmethod
    def of_body(scene: Scene) -> "Units":
        """l, sqrt(l / g) and rho g l of a scene with gravity."""
        length = released_volume(scene) ** (1.0 / scene.dimension)
        stress = scene.material_of(scene.masses[0]).density * scene.gravity * length
        return Units(length=length, time=math.sqrt(length / scene.gravity), stress=stress)

    @staticmethod
    def of_model(scene: Scene, settings: ModelSettings) -> "Units":
        """The units in which a model runs `scene`: its body gets the model's size, to a few per cent, since the scene
        lasts whole steps and gravity is the model's. Raises InputError without gravity."""
        if settings.body_length is None:
            return Units()
        if scene.gravity <= 0.0:
            raise InputError("expected gravity: the model has no flows without it", key="gravity")
        body = released_volume(scene) ** (1.0 / scene.dimension)
        time = math.sqrt(body / settings.body_length * GRAVITY / scene.gravity)
        steps = max(1, round(scene.duration / (time * settings.step)))
        if steps > 1:
            time = scene.duration / (steps * settings.step)
        return Units.of_time(scene, settings, time)

    @staticmethod
    def of_time(scene: Scene, settings: ModelSettings, time: float) -> "Units":
        """The units with the model's gravity for a unit of time of `time` [s]."""
        length = time**2 * scene.gravity / GRAVITY
        density = scene.material_of(scene.masses[0]).density / settings.density
        return Units(length=length, time=time, stress=density * scene.gravity / GRAVITY * length)
