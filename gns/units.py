"""The units of a model: the scene scaled to the size, gravity and density of the model's training data.

Dry rigid grains know no length: a flow is determined by numbers without units (Froude similarity; for granular columns
e.g. Lajeunesse, Monnier & Homsy, Phys. Fluids 17, 103302, 2005). With the length l of the released body, gravity g and
density rho

    x / l,    t / sqrt(l / g),    v / sqrt(g l),    sigma / (rho g l)

are the same in a flume and on a hillside. A model runs every scene at its own size: lengths over `length`, times over
`time`, cohesion over `stress`. The stiffness is left out, for sand that hardly yields under its own weight.
"""

import math
from dataclasses import dataclass

from datasets.errors import InputError
from datasets.particles import released_volume
from datasets.scene import Scene
from gns.model.settings import GRAVITY, ModelSettings


@dataclass(frozen=True, kw_only=True)
class Units:
    """What one unit of a model is in a scene; the units of the model's training data are all 1."""

    length: float = 1.0
    """Length in the scene that is 1 m in the model [m]."""
    time: float = 1.0
    """Time in the scene that is 1 s in the model [s]."""
    stress: float = 1.0
    """Stress in the scene that is 1 Pa in the model [Pa]."""

    @staticmethod
    def of_scene(scene: Scene, settings: ModelSettings) -> "Units":
        """The units in which a model runs `scene`: its body gets the model's size, to a few per cent.

        The time is chosen such that the scene lasts a whole number of steps; length follows from it, so that gravity
        is that of the model. Raises InputError without gravity.
        """
        if settings.body_length is None:
            return Units()
        if scene.gravity <= 0.0:
            raise InputError("expected gravity, the model knows no flow without", key="gravity")
        body = released_volume(scene) ** (1.0 / scene.dimension)
        time = math.sqrt(body / settings.body_length * GRAVITY / scene.gravity)
        steps = max(1, round(scene.duration / (time * settings.step)))
        if steps > 1:
            time = scene.duration / (steps * settings.step)
        length = time**2 * scene.gravity / GRAVITY
        density = scene.material_of(scene.masses[0]).density / settings.density
        return Units(length=length, time=time, stress=density * scene.gravity / GRAVITY * length)
