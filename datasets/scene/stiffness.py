"""The largest speed that a flow may reach, and the default Young's modulus of a material.

The energy line (Heim 1932) bounds the speed of a body that slides or falls. From its release at x_0, y_0 with speed v_0
to any place x of the ground y(x), over the straight horizontal distance s,

    v^2 <= v_0^2 + 2 g_x (x - x_0) + 2 g_y (y_0 - y(x)) - 2 mu g_y s,    y_0: the middle of a body and half its height

with the components of gravity along the box and down, and the smallest friction mu of ground and grains. The modulus is

    E = max(2 MPa, 50 rho g h, rho v^2)

for a material of density rho and the height h of the material above a place. Its own weight then compresses it by less
than a fiftieth, and its pressure waves, c = 1.16 v for nu = 0.3, keep pace with the flow: a front and its speed change
by less than 3 % over a factor of ten of E (`tests/mpm/test_time_step.py`). A stiffer material only needs more steps.
"""

import dataclasses
import math
from typing import Any

import numpy as np

from datasets.scene.material import USUAL_YOUNG, Material
from datasets.scene.parts import SceneLayout

UNDER_WEIGHT, IN_MOTION = 50.0, 1.0  # Young's modulus over rho g h, and over rho v^2
PLACES = 100  # evaluated places of the ground along the longest side of the box


def with_stiffness(scene: SceneLayout) -> dict[str, Any]:
    """The scene's material and masses, each with a Young's modulus: its own, else the default."""
    given = [scene.material, *(mass.material for mass in scene.masses if mass.material is not None)]
    if all(material.young is not None for material in given):
        return {}
    stress = specific_stress(scene)

    def stiff(material: Material) -> Material:
        if material.young is not None:
            return material
        return dataclasses.replace(material, young=max(USUAL_YOUNG, stress * material.density))

    masses = tuple(
        mass if mass.material is None else dataclasses.replace(mass, material=stiff(mass.material))
        for mass in scene.masses
    )
    return {"material": stiff(scene.material), "masses": masses}


def specific_stress(scene: SceneLayout) -> float:
    """max(50 g h, v^2) [m^2/s^2]; multiplied by the density it is the smallest modulus that a flow needs."""
    from datasets.geometry.bodies import scene_height

    return max(UNDER_WEIGHT * scene.gravity * scene_height(scene), IN_MOTION * greatest_speed(scene) ** 2)


def greatest_speed(scene: SceneLayout) -> float:
    """The largest speed [m/s] that the energy line of any mass allows; 0 if all stay at rest."""
    from datasets.geometry.bodies import height
    from datasets.geometry.ground import ground_raster

    spacing = max(scene.domain.cell, max(scene.domain.size) / PLACES)
    ground, friction, _ = ground_raster(scene, spacing)
    axes = np.meshgrid(*(spacing * np.arange(count) for count in ground.shape), indexing="ij")
    along, down = scene.gravity_vector[0], -scene.gravity_vector[1]
    rough = any(solid.contact != "coulomb" for solid in scene.solids if solid.kind == "terrain")
    sand = [scene.material_of(mass) for mass in scene.masses]
    grains = min(math.tan(math.radians(material.phi_deg)) for material in sand)
    mu = grains if rough else min(grains, float(np.min(friction)))
    speeds = [max(map(abs, field.values)) for field in scene.fields if field.quantity.startswith("velocity")]
    fastest = math.hypot(*speeds) ** 2
    for mass in scene.masses:
        thrown = max([math.hypot(*(mass.velocity or ())), *(speed for _, _, speed in mass.hydrograph or ())])
        start = thrown + 0.5 * math.hypot(*mass.size) * float(np.linalg.norm(mass.spin, 2))
        middle = np.array(mass.lower) + 0.5 * np.array(mass.size)
        apart = [axis - place for axis, place in zip(axes, middle[::2].tolist(), strict=True)]
        level = np.sqrt(sum(offset**2 for offset in apart))
        fallen = down * (middle[1] + 0.5 * height(scene, mass) - ground - mu * level)
        fastest = max(fastest, start**2 + 2.0 * float(np.max(along * apart[0] + fallen, initial=0.0)))
    return math.sqrt(fastest)
