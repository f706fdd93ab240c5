"""Pore water of a saturated material: the constants of a scene, and the numbers that the solver derives from them.

The pore pressure p of a mixture whose grains and water move together follows

    dp/dt = Q (div(kappa (grad p - rho_w g)) - div v),    kappa = k / (rho_w g)

with the permeability k [m/s] and a bulk modulus Q of the water per volume of the mixture. Q is numerical: `STIFFER`
times the constrained modulus M of the skeleton, far below that of water. The skeleton changes volume only by the water
that flows (`mpm.physics.water`), and shape by all strain, so that the coefficient of consolidation is

    c_v = kappa M / (1 + 4 G / (3 Q))    (Terzaghi 1923; k M / (rho_w g) for stiff water),

and a given `consolidation`, c_v, is reproduced for any Q.
"""

import numpy as np

from datasets.errors import require
from datasets.scene.material import Material
from datasets.scene.parts import TOLERANCE, SceneLayout, Water

DENSITY = 1000.0  # of water [kg/m^3]
CAVITATION = 1.0e5  # suction at which water cavitates [Pa]
NO_GRAVITY = 1.0e-9  # lower bound of gravity in a division [m/s^2]
STIFFER = 20.0  # Q / M [-]
DRAINED, UNDRAINED = 3.0, 0.01
"""c_v t / h^2 at which a layer of thickness h has consolidated by 99.9 %, and up to which by at most a ninth."""


def saturated(scene: SceneLayout) -> Material | None:
    """The saturated material of a scene; None if it is dry. Raises InputError for several different ones."""
    materials = {material for mass in scene.masses if (material := scene.material_of(mass)).saturated}
    require(len(materials) < 2, "masses", "one saturated material, beside dry ones", f"{len(materials)}")
    return next(iter(materials), None)


def constrained_modulus(material: Material) -> float:
    """M = lambda + 2 G of the skeleton [Pa]."""
    return material.lame + 2.0 * material.shear_modulus


def consolidation(material: Material, gravity: float) -> float:
    """c_v [m^2/s]; 0 for an undrained material."""
    if material.consolidation is not None:
        return material.consolidation
    return (material.permeability or 0.0) * constrained_modulus(material) / (DENSITY * max(gravity, NO_GRAVITY))


def mobility(material: Material, gravity: float) -> float:
    """kappa [m^2/(Pa s)] that gives the mixture the coefficient of `consolidation`."""
    modulus = constrained_modulus(material)
    deviator = 4.0 / 3.0 * material.shear_modulus / (STIFFER * modulus)
    return consolidation(material, gravity) * (1.0 + deviator) / modulus


def drainage(scene: SceneLayout, time: float) -> str:
    """Whether a flow of duration `time` [s] is drained, undrained or partly drained, in words; empty if dry."""
    material = saturated(scene)
    if material is None:
        return ""
    if scene.water is not None and scene.water.fixed:
        return "the pore pressure stays as it is at the start"
    from datasets.geometry.bodies import height

    tall = max(height(scene, mass) for mass in scene.masses if scene.material_of(mass) is material)
    rate = consolidation(material, scene.gravity)
    if rate == 0.0:
        return "undrained: the saturated material has no permeability"
    needed = tall**2 / rate
    kind = "drained" if time > DRAINED * needed else "undrained" if time < UNDRAINED * needed else "partly drained"
    figures = f"consolidation over {tall:.3g} m takes {needed:.3g} s"
    return f"{kind}: {figures}, {float(f'{needed / time:.2g}'):g} times the {time:.3g} s of the run"


def seepage(scene: SceneLayout) -> float:
    """Seepage from cell to cell during a scene: c_v time / cell^2 [-], at most 1; 0 if dry."""
    material = saturated(scene)
    rate = 0.0 if material is None else consolidation(material, scene.gravity)
    return min(rate * scene.duration / scene.domain.cell**2, 1.0)


def pore_numbers(scene: SceneLayout) -> tuple[float, float, float]:
    """Q [Pa], Q kappa [m^2/s] and Q over the density of the mixture [m^2/s^2]; 0 if the scene is dry."""
    material = saturated(scene)
    if material is None:
        return 0.0, 0.0, 0.0
    modulus = STIFFER * constrained_modulus(material)
    return modulus, modulus * mobility(material, scene.gravity), modulus / material.density


def unlikely_water(scene: SceneLayout) -> list[str]:
    """A warning for each water elevation that lies above the box, or below all saturated masses."""
    water, top = scene.water or Water(), scene.domain.size[1]
    table = None if water.table is None else np.array(water.table, np.float64)
    if table is not None and scene.dimension == 2:
        table = table[:, 1]
    feet = [mass.lower[1] for mass in scene.masses if scene.material_of(mass).saturated]
    lines = []
    for name, elevations in {"level": water.level, "table": table, "pool": water.pool}.items():
        if elevations is None:
            continue
        above, below = float(np.min(elevations)) - top, min(feet) - float(np.max(elevations))
        if above > 0.0:
            full = "all the ground is below it" if name == "pool" else "all that is saturated is full"
            lines.append(f"water.{name} lies {above:.3g} m above the top of the box: {full}")
        elif below > TOLERANCE and name != "pool" and (water.pool is None or water.pool <= min(feet)):
            lines.append(f"water.{name} lies {below:.3g} m below all that is saturated, which begins without pressure")
    return lines
