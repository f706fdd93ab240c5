"""The units that a flow is the same in, at any size. Nothing here needs torch.

Dry rigid grains know no length (Froude similarity; for granular columns e.g. Lajeunesse, Monnier & Homsy, Phys. Fluids
17, 103302, 2005). With the length l of the released body, gravity g and density rho

    x / l,    t / sqrt(l / g),    v / sqrt(g l),    sigma / (rho g l)

are the same in a flume and on a hillside. A model runs every scene at its own size (`in_model_units`). The stiffness
is left out, for sand that hardly yields under its own weight.
"""

import math
from dataclasses import dataclass

from datasets.errors import InputError
from datasets.scene import Scene
from datasets.scene.particles import released_volume
from gns.settings import GRAVITY, ModelSettings


@dataclass(frozen=True, kw_only=True)
class Units:
    """What one unit of length, time and stress is in a scene; those of a model's training data are all 1."""

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
        """Those in which a model runs `scene`: its body gets the model's size, to a few per cent, since time is such
        that the scene lasts whole steps, and length such that gravity is the model's. Raises InputError without."""
        if settings.body_length is None:
            return Units()
        if scene.gravity <= 0.0:
            raise InputError("expected gravity, the model knows no flow without", key="gravity")
        body = released_volume(scene) ** (1.0 / scene.dimension)
        time = math.sqrt(body / settings.body_length * GRAVITY / scene.gravity)
        steps = max(1, round(scene.duration / (time * settings.step)))
        if steps > 1:
            time = scene.duration / (steps * settings.step)
        return Units.of_time(scene, settings, time)

    @staticmethod
    def of_time(scene: Scene, settings: ModelSettings, time: float) -> "Units":
        """Those in which gravity is the model's where a unit of time lasts `time` [s]."""
        length = time**2 * scene.gravity / GRAVITY
        density = scene.material_of(scene.masses[0]).density / settings.density
        return Units(length=length, time=time, stress=density * scene.gravity / GRAVITY * length)
